# The error of each picture. Before it stands $data: rows of picture, used, rms_px.
set terminal svg size 1000,480 font 'sans,13' background rgb 'white'
set datafile separator ','
set title 'Error of each picture (red: left out)' noenhanced
set ylabel 'pixels RMS'
set yrange [0:*]
set key off
set style fill solid
set boxwidth .8
set xtics rotate by -50 noenhanced
set grid y lc rgb '#dddddd'
plot $data using 0:(column('rms_px')):(column('used') == 1 ? 0x2c3e50 : 0xc0392b):xtic(1) \
       with boxes lc rgb variable
