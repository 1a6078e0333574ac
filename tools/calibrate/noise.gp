# Standard deviation over signal, measured and as modelled. Before it stand: full_well_electrons,
# read_noise, and $data, the rows of noise.csv. At gain 1 the same electrons are 1/gain of the signal.
set terminal svg size 760,560 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Noise: full well %.0f electrons, read noise %.2g of full scale', full_well_electrons, read_noise) noenhanced
set logscale xy
set format xy '%g'
set grid lc rgb '#dddddd'
set key left top
set xlabel 'signal, full scale = 1'
set ylabel 'standard deviation over gain'
set samples 200
model(y) = sqrt(y / full_well_electrons + read_noise ** 2)
plot $data using (column('signal') > 0 ? column('signal') / column('gain') : NaN):(sqrt(column('variance')) / column('gain')) \
       with points pt 7 ps .6 lc rgb '#2c3e50' title 'measured', \
     model(x) with lines lw 2 lc rgb '#c0392b' title 'model, gain 1'
