# Light over the distance from the centre. Before it stand: corner, and $data, the rows of
# vignetting.csv.
set terminal svg size 760,520 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Vignetting: %.1f %% of the light in the corners', 100 * corner) noenhanced
set grid lc rgb '#dddddd'
set key left bottom
set yrange [0:*]
set xrange [0:1]
set xlabel 'distance from the centre, half diagonals'
set ylabel 'fraction of the light'
plot $data using 'distance':'seen' with points pt 7 ps .6 lc rgb '#2c3e50' title 'seen', \
     $data using 'distance':'fitted' with lines lw 2 lc rgb '#c0392b' title 'fitted'
