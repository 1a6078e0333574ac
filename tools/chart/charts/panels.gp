# Error against time in panels. Before it stand: columns and rows of panels; time_axis and
# error_axis, what the axes are called; methods and titles, arrays of the lines' and
# the panels' names; $panel1 and so on, blocks of rows "ms, error %" divided by a tab, one a method.
set encoding utf8
set terminal svg size 300 * columns, 300 * rows + 60 font 'sans-serif,12' \
  background '#ffffff' noenhanced
set datafile separator '\t'
set multiplot layout rows, columns margins screen .06,.99,.16 / rows,1 - .12 / rows \
  spacing screen .045,.22 / rows
set logscale xy
set border lw .8
set grid xtics ytics lw .8 lc rgb '#cccccc'
set xtics (.1, .2, .5, 1, 2, 5, 10, 20, 50, 100)
set ytics (.01, .02, .05, .1, .2, .5, 1, 2, 5, 10, 20, 50, 100, 200)
# Okabe and Ito's colours, which differ for every kind of colour vision.
array colour[6] = ['#E69F00', '#009E73', '#0072B2', '#D55E00', '#CC79A7', '#56B4E9']
array shape[6] = [5, 9, 7, 11, 13, 15]
do for [i = 1:columns * rows] {
  set title titles[i] font ',11'
  set xlabel (i > columns * (rows - 1) ? time_axis : '')
  set ylabel (i % columns == 1 ? error_axis : '')
  if (i == 2) { set key top right samplen 1 font ',10' } else { set key off }
  plot for [m = 1:|methods|] '$panel'.i index m - 1 using 1:2 with linespoints \
    pt shape[m] ps .8 lw 1.6 lc rgb colour[m] title methods[m]
}
unset multiplot
