# Errors of the whole chain, one column an environment: shadows above, objects below. Filled: through
# both cameras' sensors; open: with the true map as light; triangles: the plan promises nothing.
# Before it stand: heading; xlabel_text; names, of the environments; goals, "shadow mean, shadow
# worst, object %";
# $sensor, $true_map and $lower_bound, rows of "column, shadow RMSE, object %" divided by tabs.
set encoding utf8
set terminal svg size 1040,820 font 'sans-serif,13' background '#ffffff' noenhanced
set datafile separator '\t'
set multiplot layout 2,1 title heading font ',16' noenhanced margins screen .085,.70,.14,.93 spacing screen .03
set border lw .8
set grid ytics lw .8 lc rgb '#cccccc'
set tics scale .8,.4 font ',12'
blue = '#0072B2'
red = '#D55E00'
count = words(names)
set xrange [.5:count + .5]
set yrange [0:*]
set offsets 0, 0, graph .05, 0
do for [panel = 2:3] {
  shadow = panel == 2
  set ylabel (shadow ? 'Shadow error: RMSE of s = L/L_0' : 'Object error: relative RMSE (%)') noenhanced
  set xtics ()
  do for [i = 1:count] { set xtics add ((shadow ? '' : word(names, i)) i) }
  if (shadow) {
    set key outside right top Left reverse samplen 1 spacing 1.15 font ',12' noenhanced
  } else {
    set key off
    set xtics rotate by -20
    set xlabel xlabel_text noenhanced
  }
  goal = real(word(goals, shadow ? 2 : 3))
  mean_goal = real(word(goals, 1))
  plot goal with lines dt 2 lc rgb red title 'goal, worst', \
       (shadow ? mean_goal : NaN) with lines dt 3 lc rgb red title 'goal, mean', \
       $true_map using 1:panel with points pt 6 ps 1.1 lc rgb '#666666' title 'light of the true map', \
       $sensor using 1:panel with points pt 7 ps .8 lc rgb blue title 'through the sensors', \
       $lower_bound using 1:panel with points pt 9 ps 1.3 lc rgb red title 'the same, light a lower bound'
}
unset multiplot
