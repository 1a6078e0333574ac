# The cameras from above (x to the right, -z up) and from the side (-z to the right, y up); arrows
# look where a camera looks. Before it stands $data, the rows of rig.csv.
set terminal svg size 1000,520 font 'sans,13' background rgb 'white'
set datafile separator ','
array least[3]
array most[3]
do for [k = 1:3] {
  stats $data using k + 1 nooutput
  least[k] = 1000 * STATS_min
  most[k] = 1000 * STATS_max
}
larger(a, b) = a > b ? a : b
reach_mm = larger(20, .5 * sqrt((most[1] - least[1]) ** 2 + (most[2] - least[2]) ** 2 + (most[3] - least[3]) ** 2))
arrow_mm = .6 * reach_mm
shown_mm = 1.9 * reach_mm
q(name) = column(name)
look_x(n) = -2 * (q('qx') * q('qz') + q('qy') * q('qw'))
look_y(n) = -2 * (q('qy') * q('qz') - q('qx') * q('qw'))
look_z(n) = -(1 - 2 * (q('qx') ** 2 + q('qy') ** 2))
set multiplot layout 1,2
set key off
set grid lc rgb '#dddddd'
set size ratio -1
middle(k) = (least[k] + most[k]) / 2
set title 'From above'
set xlabel 'x, mm'
set ylabel '-z, mm'
set xrange [middle(1) - shown_mm:middle(1) + shown_mm]
set yrange [-middle(3) - shown_mm:-middle(3) + shown_mm]
plot $data using (1000 * q('x_m')):(-1000 * q('z_m')):(arrow_mm * look_x(0)):(-arrow_mm * look_z(0)) \
       with vectors lw 2 lc rgb '#c0392b', \
     $data using (1000 * q('x_m')):(-1000 * q('z_m')):1 with labels left offset 1,.7 noenhanced \
       point pt 7 ps .8 lc rgb '#2c3e50'
set title 'From the side'
set xlabel '-z, mm'
set ylabel 'y, mm'
set xrange [-middle(3) - shown_mm:-middle(3) + shown_mm]
set yrange [middle(2) - shown_mm:middle(2) + shown_mm]
plot $data using (-1000 * q('z_m')):(1000 * q('y_m')):(-arrow_mm * look_z(0)):(arrow_mm * look_y(0)) \
       with vectors lw 2 lc rgb '#c0392b', \
     $data using (-1000 * q('z_m')):(1000 * q('y_m')):1 with labels left offset 1,.7 noenhanced \
       point pt 7 ps .8 lc rgb '#2c3e50'
unset multiplot
