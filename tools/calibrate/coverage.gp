# Where corners were seen, with what is left of their errors. Before it stand: width_px, height_px,
# enlargement, and $data, the rows of residuals.csv.
set terminal svg size 1000,(120 + 1000 * height_px / width_px) font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Corners, and what is left of their errors %g times as long', enlargement) noenhanced
set xrange [0:width_px]
set yrange [height_px:0]
set size ratio -1
set xlabel 'pixels'
set ylabel 'pixels'
set key off
set grid lc rgb '#dddddd'
used(value) = column('used') == 1 ? value : NaN
x(n) = used(column('x_px'))
plot $data using (x(0)):(column('y_px')):(enlargement * column('error_x_px')):(enlargement * column('error_y_px')) \
       with vectors nohead lw 1.5 lc rgb '#c0392b', \
     $data using (x(0)):(column('y_px')) with points pt 7 ps .35 lc rgb '#2c3e50'
