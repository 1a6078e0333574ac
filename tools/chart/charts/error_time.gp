# Error against the time of a light update: shadows above, objects below, all logarithmic.
# Before it stand: heading; xlabel_text; zero_ms, zero_shadow, zero_object, where a value of 0 is
# drawn (0: there is none); measured_shadow, measured_object (0: no such error); and $data, blocks
# of rows "ms, shadow RMSE, object %, label" divided by tabs, each under its name: the two fronts,
# Penumbra's points, those that it chooses by itself, and one block a baseline.
set encoding utf8
set terminal svg size 1040,860 font 'sans-serif,13' background '#ffffff' noenhanced
set datafile separator '\t'
stats $data using 1 name 'ms' nooutput
stats $data using 2 name 'shadows' nooutput
stats $data using 3 name 'objects' nooutput
set multiplot layout 2,1 title heading font ',16' noenhanced margins screen .085,.70,.075,.93 spacing screen .03
set logscale xy
set border lw .8
set grid xtics ytics lw .8 lc rgb '#cccccc'
set tics scale .8,.4 font ',12'
# Okabe and Ito's colours, which differ for every kind of colour vision.
array colour[6] = ['#D55E00', '#009E73', '#000000', '#CC79A7', '#E69F00', '#56B4E9']
array shape[10] = [5, 9, 11, 13, 15, 4, 8, 10, 12, 14]
blue = '#0072B2'
baselines = ms_blocks - 4
# The ticks around a value, so that a few points that lie close together have numbers beside them.
below(v) = (e = floor(log10(v)), m = v / 10. ** e, 10. ** e * (m >= 5 ? 5 : m >= 2 ? 2 : 1))
above(v) = (e = floor(log10(v)), m = v / 10. ** e, 10. ** e * (m <= 1 ? 1 : m <= 2 ? 2 : m <= 5 ? 5 : 10))

do for [panel = 2:3] {
  shadow = panel == 2
  zero = shadow ? zero_shadow : zero_object
  measured = shadow ? measured_shadow : measured_object
  set ylabel (shadow ? 'Shadow error: RMSE of s = L/L_0' : 'Object error: relative RMSE (%)') noenhanced
  unset label
  # Ticks at 1, 2 and 5 of each decade, above the one for 0.
  set xtics ()
  set ytics ()
  do for [e = -6:5] {
    do for [m in "1 2 5"] {
      value = m * 10. ** e
      if (value > 1.5 * zero_ms) { set xtics add ((shadow ? '' : sprintf('%g', value)) value) }
      if (value > 1.5 * zero) { set ytics add (sprintf('%g', value) value) }
    }
  }
  if (zero_ms > 0) { set xtics add ((shadow ? '' : '0') zero_ms) }
  if (zero > 0) { set ytics add ('0' zero) }
  if (measured) {
    set xrange [below(.95 * ms_min):above(1.05 * ms_max)]
    set yrange [below(.95 * (shadow ? shadows_min : objects_min)):above(1.05 * (shadow ? shadows_max : objects_max))]
  } else {
    set label 'not measured' at graph .5,.5 center
    set xrange [.01:10]
    set yrange [.01:10]
  }
  if (shadow) {
    set key outside right top Left reverse samplen 1 spacing 1.15 font ',12' noenhanced
  } else {
    set key off
    set xlabel xlabel_text noenhanced
  }
  plot NaN notitle, \
       $data index panel - 2 using 1:panel with steps lw 1.6 lc rgb '#999999' title 'Pareto front', \
       $data index 2 using 1:panel with points pt 7 ps .62 lc rgb blue title 'Penumbra', \
       $data index 3 using 1:panel with points pt 6 ps 1.7 lw 2 lc rgb blue title 'Penumbra, chosen by itself', \
       for [i = 1:baselines] $data index 3 + i using 1:panel with points \
         pt shape[(i - 1) % 10 + 1] ps 1.35 lw 1.6 lc rgb colour[(i - 1) % 6 + 1] title columnheader(1), \
       $data index 3 using 1:panel:4 with labels center offset 0,1 font ',12' tc rgb blue noenhanced notitle
}
unset multiplot
