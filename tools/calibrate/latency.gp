# How fast camera and tracker turn, at the offset that was found. Before it stand: offset_ms,
# sigma_ms, and $data, the rows of latency.csv.
set terminal svg size 900,520 font 'sans,13' background rgb 'white'
set datafile separator ','
set title sprintf('Tracker time = camera time + %.2f ms +- %.2f', offset_ms, sigma_ms) noenhanced
set grid lc rgb '#dddddd'
set key top right opaque
set yrange [0:*]
set xlabel 'time of the camera, s'
set ylabel 'degrees a second'
plot $data using 'time_s':'tracker_deg_s' with lines lw 2 lc rgb '#c0392b' title 'tracker', \
     $data using 'time_s':'camera_deg_s' with points pt 7 ps .5 lc rgb '#2c3e50' title 'camera'
