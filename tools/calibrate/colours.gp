# Each surface as carried over, against the view camera. Before it stand: rms, m (the matrix, nine
# values by rows), and $data, the rows of colours.csv.
set terminal svg size 720,720 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Surfaces as carried over, against the view camera: %.2f %% RMS (grey: left out)', 100 * rms) noenhanced
set logscale xy
set size square
set format xy '%g'
set grid lc rgb '#dddddd'
set xlabel 'radiance in the view camera'
set ylabel 'matrix * radiance in the environment camera'
set key off
carried(row) = m[3 * row + 1] * column('source_r') + m[3 * row + 2] * column('source_g') + m[3 * row + 3] * column('source_b')
array colour[3] = [0xc0392b, 0x27ae60, 0x2980b9]
array target[3] = ['target_r', 'target_g', 'target_b']
plot x with lines lc rgb '#888888' dt 2, \
     for [n = 0:2] $data using (column(target[n + 1])):(carried(n)):(column('used') == 1 ? colour[n + 1] : 0xbbbbbb) \
       with points pt 7 ps .4 lc rgb variable
