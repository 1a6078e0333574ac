# The errors of the corners that count. Before it stand: rms_px, and $data, the rows of residuals.csv.
set terminal svg size 640,640 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Errors of the corners: %.3f px RMS', rms_px) noenhanced
reach = 4 * (rms_px > 1e-3 ? rms_px : 1e-3)
set xrange [-reach:reach]
set yrange [reach:-reach]
set size square
set grid lc rgb '#dddddd'
set xlabel 'x, pixels'
set ylabel 'y, pixels (down)'
set key off
plot $data using (column('used') == 1 ? column('error_x_px') : NaN):(column('error_y_px')) \
       with points pt 7 ps .3 lc rgb '#2c3e50'
