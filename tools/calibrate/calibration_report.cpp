#include "tools/calibrate/calibration_report.h"

#include <fmt/format.h>

#include <cmath>
#include <initializer_list>

#include "calib/camera/colour.h"
#include "calib/camera/response.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/calibrate/plots.h"
#include "tools/plots/gnuplot.h"

namespace penumbra::tools {

namespace {

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

std::string board_table(const calib::CameraCalibration& c) {
  std::string text = "picture,used,rms_px\n";
  for (const calib::BoardFit& b : c.boards) {
    const std::string name = std::filesystem::path(b.name).stem().string();
    text += fmt::format("{},{:d},{}\n", gnuplot_cell(name), b.used, b.rms_px);
  }
  return text;
}

std::string response_table(const calib::ResponseCalibration& c) {
  std::string text = "code,red,green,blue\n";
  for (int code = 0; code < 256; ++code)
    text += fmt::format("{},{},{},{}\n", code, c.response.decode(code / 255., 0),
                        c.response.decode(code / 255., 1), c.response.decode(code / 255., 2));
  return text;
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

std::string noise_table(const calib::NoiseCalibration& c) {
  std::string text = "signal,gain,variance,model_variance,samples\n";
  for (const calib::NoisePoint& p : c.points)
    text += fmt::format("{},{},{},{},{}\n", p.signal, p.gain, p.variance,
                        c.model.variance(p.signal, p.gain), p.samples);
  return text;
}

std::string vignetting_table(const calib::VignettingCalibration& c) {
  std::string text = "distance,seen,fitted\n";
  for (const auto& ring : c.rings)
    text += fmt::format("{},{},{}\n", ring.distance, ring.seen,
                        c.vignetting.at_squared(ring.distance * ring.distance));
  return text;
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

std::string latency_table(const calib::Latency& l) {
  std::string text = "time_s,camera_deg_s,tracker_deg_s\n";
  for (const calib::TurnStep& s : l.steps) {
    const double per_step = 180 / kPi / s.seconds;
    text +=
        fmt::format("{},{},{}\n", s.middle_s, s.camera_rad * per_step, s.tracker_rad * per_step);
  }
  return text;
}

// A plot: settings of the script, the rows that it reads, and the script.
struct Drawing {
  const char* name;
  std::string settings, rows;
  const char* script;
};

// Plots are a comfort: a machine without gnuplot still calibrates.
Result<void> draw(const std::filesystem::path& folder, std::initializer_list<Drawing> drawings) {
  for (const Drawing& d : drawings) {
    auto drawn =
        run_gnuplot(d.settings + gnuplot_block("data", d.rows) + d.script, folder / d.name);
    if (drawn) continue;
    if (drawn.error().code != ErrorCode::kUnavailable) return drawn;
    log_warning("no plots: {}", drawn.error().detail);
    return {};
  }
  return {};
}

Result<void> write_table(const std::filesystem::path& file, const std::string& table) {
  PENUMBRA_TRY(make_folder(file.parent_path()));
  return write_bytes(file, table);
}

}  // namespace

Result<void> write_response_report(const std::filesystem::path& folder,
                                   const calib::ResponseCalibration& c) {
  const std::string table = response_table(c);
  PENUMBRA_TRY(write_table(folder / "response.csv", table));
  return draw(folder,
              {{"response.svg", fmt::format("sigma = {}\n", c.sigma), table, kResponsePlot}});
}

Result<void> write_camera_report(const std::filesystem::path& folder,
                                 const calib::CameraCalibration& c,
                                 std::span<const calib::BoardView> views) {
  const std::string table = residual_table(c, views);
  PENUMBRA_TRY(write_table(folder / "residuals.csv", table));
  // The errors are drawn so much longer that the usual one is a sixtieth of the picture's width.
  const double longer =
      c.rms_px > 0 ? std::max(1., std::round(c.projection.width / 60. / c.rms_px)) : 1;
  const std::string size = fmt::format("width_px = {}\nheight_px = {}\nenlargement = {}\n",
                                       c.projection.width, c.projection.height, longer);
  return draw(folder,
              {{"coverage.svg", size, table, kCoveragePlot},
               {"residuals.svg", fmt::format("rms_px = {}\n", c.rms_px), table, kResidualsPlot},
               {"boards.svg", "", board_table(c), kBoardsPlot}});
}

Result<void> write_colour_report(const std::filesystem::path& folder,
                                 const calib::ColourCalibration& c,
                                 std::span<const calib::ColourPair> pairs) {
  const std::string table = colour_table(c, pairs);
  PENUMBRA_TRY(write_table(folder / "colours.csv", table));
  std::string settings = fmt::format("rms = {}\narray m[9]\n", c.rms);
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column)
      settings += fmt::format("m[{}] = {}\n", 3 * row + column + 1, c.matrix[column][row]);
  return draw(folder, {{"colours.svg", settings, table, kColoursPlot}});
}

Result<void> write_noise_report(const std::filesystem::path& folder,
                                const calib::NoiseCalibration& c) {
  const std::string table = noise_table(c);
  PENUMBRA_TRY(write_table(folder / "noise.csv", table));
  const std::string model = fmt::format("full_well_electrons = {}\nread_noise = {}\n",
                                        c.model.full_well_electrons, c.model.read_noise);
  return draw(folder, {{"noise.svg", model, table, kNoisePlot}});
}

Result<void> write_vignetting_report(const std::filesystem::path& folder,
                                     const calib::VignettingCalibration& c) {
  const std::string table = vignetting_table(c);
  PENUMBRA_TRY(write_table(folder / "vignetting.csv", table));
  return draw(folder,
              {{"vignetting.svg", fmt::format("corner = {}\n", c.corner), table, kVignettingPlot}});
}

Result<void> write_rig_report(const std::filesystem::path& folder,
                              std::span<const calib::RigCameraInput> cameras,
                              std::span<const Pose> poses, const calib::RigCalibration& c) {
  const std::string table = rig_table(cameras, poses, c);
  PENUMBRA_TRY(write_table(folder / "rig.csv", table));
  return draw(folder, {{"rig.svg", "", table, kRigPlot}});
}

Result<void> write_latency_report(const std::filesystem::path& folder, const calib::Latency& l) {
  const std::string table = latency_table(l);
  PENUMBRA_TRY(write_table(folder / "latency.csv", table));
  const std::string found =
      fmt::format("offset_ms = {}\nsigma_ms = {}\n", 1000 * l.offset_s, 1000 * l.sigma_s);
  return draw(folder, {{"latency.svg", found, table, kLatencyPlot}});
}

}  // namespace penumbra::tools
