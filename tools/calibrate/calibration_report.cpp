#include "tools/calibrate/calibration_report.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cctype>
#include <cmath>
#include <initializer_list>

#include "calib/camera/colour.h"
#include "calib/camera/response.h"
#include "core/files.h"
#include "tools/common/gnuplot.h"

namespace penumbra::tools {

namespace {

// The errors are drawn so much longer that the usual one is a sixtieth of the picture's width.
double enlargement(const calib::CameraCalibration& c) {
  return c.rms_px > 0 ? std::max(1., std::round(c.projection.width / 60. / c.rms_px)) : 1;
}

std::string coverage_plot(const calib::CameraCalibration& c,
                          std::span<const calib::BoardView> views) {
  const double times = enlargement(c);
  std::string script = fmt::format(
      "set terminal svg size 1000,{} font 'sans,13' background rgb 'white'\n"
      "set title 'Corners, and what is left of their errors {:g} times as long' noenhanced\n"
      "set xrange [0:{}]\nset yrange [{}:0]\nset size ratio -1\n"
      "set xlabel 'pixels'\nset ylabel 'pixels'\nset key off\nset grid lc rgb '#dddddd'\n"
      "plot '-' with vectors nohead lw 1.5 lc rgb '#c0392b', '-' with points pt 7 ps .35 lc rgb "
      "'#2c3e50'\n",
      120 + 1000 * c.projection.height / c.projection.width, times, c.projection.width,
      c.projection.height);
  std::string points;
  for (std::size_t b = 0; b < views.size(); ++b) {
    if (!c.boards[b].used) continue;
    for (std::size_t i = 0; i < views[b].pixels.size(); ++i) {
      const glm::dvec2 &p = views[b].pixels[i], r = times * c.boards[b].residuals_px[i];
      script += fmt::format("{} {} {} {}\n", p.x, p.y, r.x, r.y);
      points += fmt::format("{} {}\n", p.x, p.y);
    }
  }
  return script + "e\n" + points + "e\n";
}

std::string residual_plot(const calib::CameraCalibration& c) {
  const double reach = 4 * std::max(c.rms_px, 1e-3);
  std::string script = fmt::format(
      "set terminal svg size 640,640 font 'sans,13' background rgb 'white'\n"
      "set title 'Errors of the corners: {:.3f} px RMS' noenhanced\n"
      "set xrange [-{}:{}]\nset yrange [{}:-{}]\nset size square\nset grid lc rgb '#dddddd'\n"
      "set xlabel 'x, pixels'\nset ylabel 'y, pixels (down)'\nset key off\n"
      "plot '-' with points pt 7 ps .3 lc rgb '#2c3e50'\n",
      c.rms_px, reach, reach, reach, reach);
  for (const calib::BoardFit& b : c.boards)
    if (b.used)
      for (const glm::dvec2& r : b.residuals_px) script += fmt::format("{} {}\n", r.x, r.y);
  return script + "e\n";
}

// As gnuplot reads a word of inline data.
std::string one_word(std::string name) {
  for (char& letter : name)
    if (!std::isalnum(static_cast<unsigned char>(letter)) && letter != '-' && letter != '.')
      letter = '_';
  return name;
}

std::string board_plot(const calib::CameraCalibration& c) {
  std::string script =
      "set terminal svg size 1000,480 font 'sans,13' background rgb 'white'\n"
      "set title 'Error of each picture (red: left out)' noenhanced\n"
      "set ylabel 'pixels RMS'\nset yrange [0:*]\nset key off\nset style fill solid\n"
      "set boxwidth .8\nset xtics rotate by -50 noenhanced\nset grid y lc rgb '#dddddd'\n"
      "plot '-' using 1:3:($4>0?0x2c3e50:0xc0392b):xtic(2) with boxes lc rgb variable\n";
  for (std::size_t b = 0; b < c.boards.size(); ++b) {
    const std::string name = one_word(std::filesystem::path(c.boards[b].name).stem().string());
    script += fmt::format("{} {} {} {}\n", b, name, c.boards[b].rms_px, c.boards[b].used ? 1 : 0);
  }
  return script + "e\n";
}

std::string residual_table(const calib::CameraCalibration& c,
                           std::span<const calib::BoardView> views) {
  std::string text = "picture,used,x_px,y_px,board_x_m,board_y_m,error_x_px,error_y_px\n";
  for (std::size_t b = 0; b < views.size(); ++b) {
    const calib::BoardFit& fit = c.boards[b];
    for (std::size_t i = 0; i < fit.residuals_px.size(); ++i) {
      const glm::dvec2 &p = views[b].pixels[i], &m = views[b].on_board_m[i],
                       &r = fit.residuals_px[i];
      text += fmt::format("\"{}\",{},{},{},{},{},{},{}\n", fit.name, fit.used ? 1 : 0, p.x, p.y,
                          m.x, m.y, r.x, r.y);
    }
  }
  return text;
}

std::string response_plot(const calib::ResponseCalibration& c) {
  std::string script = fmt::format(
      "set terminal svg size 900,640 font 'sans,13' background rgb 'white'\n"
      "set title 'Response: light over code, uncertain by {:.2f} % of full scale' noenhanced\n"
      "set xrange [0:255]\nset logscale y\nset format y '%g'\nset yrange [*:1.2]\n"
      "set xlabel 'code'\nset ylabel 'light, full scale = 1'\nset grid lc rgb '#dddddd'\n"
      "set key bottom right\n"
      "plot '-' with lines lw 2 lc rgb '#c0392b' title 'red', '-' with lines lw 2 lc rgb '#27ae60' "
      "title 'green', '-' with lines lw 2 lc rgb '#2980b9' title 'blue', '-' with lines dt 2 lc "
      "rgb "
      "'#888888' title 'sRGB'\n",
      100 * c.sigma);
  for (int channel = 0; channel < 4; ++channel) {
    const calib::Response curve = channel < 3 ? c.response : calib::Response::srgb();
    for (int code = 1; code < 256; ++code)
      script +=
          fmt::format("{} {}\n", code, std::max(1e-6, curve.decode(code / 255., channel % 3)));
    script += "e\n";
  }
  return script;
}

std::string response_table(const calib::ResponseCalibration& c) {
  std::string text = "code,red,green,blue\n";
  for (int code = 0; code < 256; ++code)
    text += fmt::format("{},{},{},{}\n", code, c.response.decode(code / 255., 0),
                        c.response.decode(code / 255., 1), c.response.decode(code / 255., 2));
  return text;
}

// Plots are a comfort: a machine without gnuplot still calibrates.
std::string colour_plot(const calib::ColourCalibration& c,
                        std::span<const calib::ColourPair> pairs) {
  std::string script = fmt::format(
      "set terminal svg size 720,720 font 'sans,13' background rgb 'white'\n"
      "set title 'Surfaces as carried over, against the view camera: {:.2f} % RMS (grey: left "
      "out)' "
      "noenhanced\nset logscale xy\nset size square\nset format xy '%g'\nset grid lc rgb "
      "'#dddddd'\nset xlabel 'radiance in the view camera'\nset ylabel 'matrix * radiance in the "
      "environment camera'\nset key off\n"
      "plot x with lines lc rgb '#888888' dt 2, '-' using 1:2:3 with points pt 7 ps .4 lc rgb "
      "variable\n",
      100 * c.rms);
  constexpr int kColours[] = {0xc0392b, 0x27ae60, 0x2980b9}, kLeftOut = 0xbbbbbb;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const Rgb &s = pairs[i].source, &t = pairs[i].target;
    const glm::dvec3 carried = c.matrix * glm::dvec3(s.r, s.g, s.b);
    for (int n = 0; n < 3; ++n)
      if (carried[n] > 0)
        script += fmt::format("{} {} {}\n", t[n], carried[n], c.used[i] ? kColours[n] : kLeftOut);
  }
  return script + "e\n";
}

std::string colour_table(const calib::ColourCalibration& c,
                         std::span<const calib::ColourPair> pairs) {
  std::string text = "used,source_r,source_g,source_b,target_r,target_g,target_b,residual\n";
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const Rgb &s = pairs[i].source, &t = pairs[i].target;
    text += fmt::format("{},{},{},{},{},{},{},{}\n", c.used[i] ? 1 : 0, s.r, s.g, s.b, t.r, t.g,
                        t.b, c.residuals[i]);
  }
  return text;
}

std::string noise_plot(const calib::NoiseCalibration& c) {
  std::string script = fmt::format(
      "set terminal svg size 760,560 font 'sans,13' background rgb 'white'\n"
      "set title 'Noise: full well {:.0f} electrons, read noise {:.2g} of full scale' noenhanced\n"
      "set logscale xy\nset format xy '%g'\nset grid lc rgb '#dddddd'\nset key left top\n"
      "set xlabel 'signal, full scale = 1'\nset ylabel 'standard deviation over gain'\n"
      "plot '-' with points pt 7 ps .6 lc rgb '#2c3e50' title 'measured', '-' with lines lw 2 lc "
      "rgb "
      "'#c0392b' title 'model, gain 1'\n",
      c.model.full_well_electrons, c.model.read_noise);
  double lowest = 1;
  for (const calib::NoisePoint& p : c.points) {
    if (p.signal <= 0) continue;
    lowest = std::min(lowest, p.signal);
    // At gain 1 the same electrons are 1/g of the signal.
    script += fmt::format("{} {}\n", p.signal / p.gain, std::sqrt(p.variance) / p.gain);
  }
  script += "e\n";
  for (double y = lowest / 2; y < 1; y *= 1.1)
    script += fmt::format("{} {}\n", y, std::sqrt(c.model.variance(y, 1)));
  return script + "e\n";
}

std::string noise_table(const calib::NoiseCalibration& c) {
  std::string text = "signal,gain,variance,model_variance,samples\n";
  for (const calib::NoisePoint& p : c.points)
    text += fmt::format("{},{},{},{},{}\n", p.signal, p.gain, p.variance,
                        c.model.variance(p.signal, p.gain), p.samples);
  return text;
}

std::string vignetting_plot(const calib::VignettingCalibration& c) {
  std::string script = fmt::format(
      "set terminal svg size 760,520 font 'sans,13' background rgb 'white'\n"
      "set title 'Vignetting: {:.1f} % of the light in the corners' noenhanced\n"
      "set grid lc rgb '#dddddd'\nset key left bottom\nset yrange [0:*]\nset xrange [0:1]\n"
      "set xlabel 'distance from the centre, half diagonals'\nset ylabel 'fraction of the light'\n"
      "plot '-' with points pt 7 ps .6 lc rgb '#2c3e50' title 'seen', '-' with lines lw 2 lc rgb "
      "'#c0392b' title 'fitted'\n",
      100 * c.corner);
  for (const auto& ring : c.rings) script += fmt::format("{} {}\n", ring.distance, ring.seen);
  script += "e\n";
  constexpr int kSteps = 50;
  for (int i = 0; i <= kSteps; ++i) {
    const double p = double(i) / kSteps;
    script += fmt::format("{} {}\n", p, c.vignetting.at_squared(p * p));
  }
  return script + "e\n";
}

std::string vignetting_table(const calib::VignettingCalibration& c) {
  std::string text = "distance,seen,fitted\n";
  for (const auto& ring : c.rings)
    text += fmt::format("{},{},{}\n", ring.distance, ring.seen,
                        c.vignetting.at_squared(ring.distance * ring.distance));
  return text;
}

// From above (x to the right, -z up) and from the side (-z to the right, y up); arrows look where a camera looks.
std::string rig_plot(std::span<const calib::RigCameraInput> cameras, std::span<const Pose> poses) {
  double reach = .02;
  glm::dvec3 middle(0);
  for (const Pose& p : poses) middle += p.translation / static_cast<double>(poses.size());
  for (const Pose& p : poses) reach = std::max(reach, glm::length(p.translation - middle));
  const double arrow = .6 * reach, shown = 1.9 * reach;
  std::string script =
      "set terminal svg size 1000,520 font 'sans,13' background rgb 'white'\n"
      "set multiplot layout 1,2\nset key off\nset grid lc rgb '#dddddd'\nset size ratio -1\n";
  const auto panel = [&](const char* title, const char* x, const char* y, const auto& project) {
    const glm::dvec2 centre = 1000. * project(middle);
    script += fmt::format(
        "set title '{}'\nset xlabel '{}'\nset ylabel '{}'\nset xrange [{}:{}]\nset yrange "
        "[{}:{}]\nplot '-' with vectors lw 2 lc rgb '#c0392b', '-' with labels left offset 1,.7 "
        "noenhanced point pt 7 ps .8 lc rgb '#2c3e50'\n",
        title, x, y, centre.x - 1000 * shown, centre.x + 1000 * shown, centre.y - 1000 * shown,
        centre.y + 1000 * shown);
    std::string labels;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const glm::dvec2 at = 1000. * project(poses[i].translation),
                       look = 1000. * arrow * project(poses[i].rotation * glm::dvec3(0, 0, -1));
      script += fmt::format("{} {} {} {}\n", at.x, at.y, look.x, look.y);
      labels += fmt::format("{} {} {}\n", at.x, at.y, one_word(cameras[i].name));
    }
    script += "e\n" + labels + "e\n";
  };
  panel("From above", "x, mm", "-z, mm", [](const glm::dvec3& p) { return glm::dvec2(p.x, -p.z); });
  panel("From the side", "-z, mm", "y, mm",
        [](const glm::dvec3& p) { return glm::dvec2(-p.z, p.y); });
  return script + "unset multiplot\n";
}

std::string rig_table(std::span<const calib::RigCameraInput> cameras, std::span<const Pose> poses,
                      const calib::RigCalibration& c) {
  std::string text =
      "camera,x_m,y_m,z_m,qx,qy,qz,qw,sigma_x_m,sigma_y_m,sigma_z_m,sigma_turn_x_rad,sigma_turn_y_"
      "rad,sigma_turn_z_rad,boards,rms_px\n";
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const auto& [rotation, at] = poses[i];
    const calib::RigCameraPose& k = c.cameras[i];
    text += fmt::format("\"{}\",{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n", cameras[i].name,
                        at.x, at.y, at.z, rotation.x, rotation.y, rotation.z, rotation.w,
                        k.position_sigma_m.x, k.position_sigma_m.y, k.position_sigma_m.z,
                        k.rotation_sigma_rad.x, k.rotation_sigma_rad.y, k.rotation_sigma_rad.z,
                        k.boards, k.rms_px);
  }
  return text;
}

Result<void> draw(const std::filesystem::path& folder,
                  std::initializer_list<std::pair<const char*, std::string>> plots) {
  for (const auto& [name, script] : plots) {
    auto drawn = run_gnuplot(script, folder / name);
    if (drawn) continue;
    if (drawn.error().code != ErrorCode::kUnavailable) return drawn;
    spdlog::warn("no plots: {}", drawn.error().detail);
    return {};
  }
  return {};
}

}  // namespace

Result<void> write_response_report(const std::filesystem::path& folder,
                                   const calib::ResponseCalibration& c) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "response.csv", response_table(c)));
  return draw(folder, {{"response.svg", response_plot(c)}});
}

Result<void> write_camera_report(const std::filesystem::path& folder,
                                 const calib::CameraCalibration& c,
                                 std::span<const calib::BoardView> views) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "residuals.csv", residual_table(c, views)));
  return draw(folder, {{"coverage.svg", coverage_plot(c, views)},
                       {"residuals.svg", residual_plot(c)},
                       {"boards.svg", board_plot(c)}});
}

Result<void> write_colour_report(const std::filesystem::path& folder,
                                 const calib::ColourCalibration& c,
                                 std::span<const calib::ColourPair> pairs) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "colours.csv", colour_table(c, pairs)));
  return draw(folder, {{"colours.svg", colour_plot(c, pairs)}});
}

Result<void> write_noise_report(const std::filesystem::path& folder,
                                const calib::NoiseCalibration& c) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "noise.csv", noise_table(c)));
  return draw(folder, {{"noise.svg", noise_plot(c)}});
}

Result<void> write_vignetting_report(const std::filesystem::path& folder,
                                     const calib::VignettingCalibration& c) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "vignetting.csv", vignetting_table(c)));
  return draw(folder, {{"vignetting.svg", vignetting_plot(c)}});
}

Result<void> write_rig_report(const std::filesystem::path& folder,
                              std::span<const calib::RigCameraInput> cameras,
                              std::span<const Pose> poses, const calib::RigCalibration& c) {
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(write_bytes(folder / "rig.csv", rig_table(cameras, poses, c)));
  return draw(folder, {{"rig.svg", rig_plot(cameras, poses)}});
}

}  // namespace penumbra::tools
