# Light over code value. Before it stand: sigma, and $data, the rows of response.csv.
set terminal svg size 900,640 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Response: light over code value, uncertain by %.2f %% of full scale', 100 * sigma) noenhanced
set xrange [0:255]
set logscale y
set format y '%g'
set yrange [*:1.2]
set xlabel 'code value'
set ylabel 'light, full scale = 1'
set grid lc rgb '#dddddd'
set key bottom right
set samples 256
lit(v) = v > 1e-6 ? v : 1e-6
srgb(code) = code <= .04045 * 255 ? code / 255 / 12.92 : ((code / 255 + .055) / 1.055) ** 2.4
plot $data using (column('code') > 0 ? column('code') : NaN):(lit(column('red'))) with lines lw 2 lc rgb '#c0392b' title 'red', \
     $data using (column('code') > 0 ? column('code') : NaN):(lit(column('green'))) with lines lw 2 lc rgb '#27ae60' title 'green', \
     $data using (column('code') > 0 ? column('code') : NaN):(lit(column('blue'))) with lines lw 2 lc rgb '#2980b9' title 'blue', \
     [1:255] srgb(x) with lines dt 2 lc rgb '#888888' title 'sRGB'
