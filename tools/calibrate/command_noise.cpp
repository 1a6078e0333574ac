#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <map>

#include "calib/estimate/noise_calibration.h"
#include "capture/frames.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/pictures/camera_film.h"

namespace penumbra::tools {

namespace {

struct CalibrateNoiseOptions {
  std::string capture;                // of a still scene
  std::optional<std::string> capped;  // the same camera with its lens capped
  std::string camera = "camera", output;
  std::optional<std::string> report;
  bool json = false;
};

struct Film {
  capture::CameraInfo camera;
  std::vector<calib::StillSeries> series;  // one an exposure and gain
};

Result<Film> read_film(const std::string& path, const std::string& name) {
  constexpr std::size_t kMaxExposures = 16;
  PENUMBRA_ASSIGN(frames, CameraFilm::open(path, name));
  std::map<std::pair<double, double>, calib::StillSeries> by_exposure;  // time, gain
  const auto progress = progress_count("frames looked at");
  std::size_t count = 0;
  while (true) {
    PENUMBRA_ASSIGN(frame, frames.next());
    if (!frame) break;
    const double gain = frame->exposure.gain.value();
    const auto [series, added] =
        by_exposure.try_emplace(std::pair(frame->exposure.time.count(), gain),
                                calib::StillSeries(gain, frame->exposure.time.count()));
    if (by_exposure.size() > kMaxExposures)
      return fail(
          ErrorCode::kUndetermined, path,
          fmt::format("has more than {} exposures: record a few fixed ones", kMaxExposures));
    PENUMBRA_TRY(
        series->second.add(*frame->pixels, fmt::format("{} frame {}", name, frame->sequence)));
    progress(++count);
  }
  Film out{frames.camera(), {}};
  for (auto& [exposure, series] : by_exposure) out.series.push_back(std::move(series));
  return out;
}

nlohmann::json to_json(const calib::NoiseCalibration& c) {
  return {{"full_well_electrons", c.model.full_well_electrons},
          {"full_well_sigma", c.full_well_sigma},
          {"read_noise", c.model.read_noise},
          {"read_sigma", c.read_sigma},
          {"black_level", c.black_level},
          {"black_measured", c.black_measured},
          {"error", c.error},
          {"neighbour_correlation", c.neighbour_correlation},
          {"frame_correlation", c.frame_correlation},
          {"points", c.points.size()}};
}

Result<void> check_model(const CalibrateNoiseOptions& o, const calib::NoiseCalibration& c) {
  if (c.error > calib::kMaxNoiseModelError)
    return fail(
        ErrorCode::kUndetermined, o.camera,
        fmt::format("the noise is {:.0f} % off the model, in which its square grows with the "
                    "light: the camera reduces noise or sharpens, or has another response; "
                    "switch such processing off, or record raw frames",
                    100 * c.error));
  constexpr double kWorthAWord = .07;
  if (c.error > kWorthAWord)
    log_warning("{}: the noise is {:.0f} % off the model: does the camera reduce noise?", o.camera,
                100 * c.error);
  const bool alike = std::abs(c.neighbour_correlation) > calib::kMaxNoiseCorrelation,
             lasting = std::abs(c.frame_correlation) > calib::kMaxNoiseCorrelation;
  if (alike || lasting)
    log_warning(
        "{}: the noise of {} is correlated ({:.2f}), which a sensor's is not: the full well is "
        "that of pictures as the camera smooths, sharpens or compresses them",
        o.camera, alike ? "neighbouring pixels" : "successive frames",
        alike ? c.neighbour_correlation : c.frame_correlation);
  if (!c.black_measured)
    log_warning(
        "{}: nothing tells the black level, and {:.5f} of full scale is taken for it: record the "
        "capped lens for --dark, or two exposures",
        o.camera, c.black_level);
  return {};
}

}  // namespace

Result<void> calibrate_noise(const CalibrateNoiseOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(film, read_film(o.capture, o.camera));
  std::vector<calib::StillSeries> capped;
  if (o.capped) {
    PENUMBRA_ASSIGN(dark, read_film(*o.capped, o.camera));
    capped = std::move(dark.series);
  }
  PENUMBRA_ASSIGN(result, calib::calibrate_noise(film.series, capped, film.camera.response,
                                                 film.camera.black_level));
  if (o.report) PENUMBRA_TRY(write_noise_report(*o.report, result));
  PENUMBRA_TRY(check_model(o, result));
  PENUMBRA_TRY(write_bytes(o.output, calib::print_noise_file(result)));
  if (o.json)
    print_json(to_json(result));
  else
    fmt::print(
        "full well {:.0f} +- {:.0f} electrons, read noise {:.5f} +- {:.5f} of full scale, black "
        "{:.5f}; "
        "{} points, {:.1f} % off the model\n",
        result.model.full_well_electrons, result.full_well_sigma, result.model.read_noise,
        result.read_sigma, result.black_level, result.points.size(), 100 * result.error);
  return {};
}

void add_calibrate_noise(CLI::App& parent, Action& action) {
  static CalibrateNoiseOptions noise;
  auto* c = parent.add_subcommand(
      "noise",
      "Find full well, read noise and black level from frames of a still scene (photon transfer)");
  c->add_option(
       "capture", noise.capture,
       "Recording or capture folder of a still scene that goes from dark to bright, with at least "
       "eight frames of each exposure and gain")
      ->required();
  c->add_option(
      "--dark", noise.capped,
      "Recording or capture folder of the same camera with its lens capped, for the black level");
  c->add_option("--camera", noise.camera, "Name of the camera in the captures")
      ->capture_default_str();
  c->add_option("-o,--output", noise.output, "Noise file to write, .toml")->required();
  c->add_option("--report", noise.report, "Folder for a plot and a table of the measured points");
  add_json(c, noise.json);
  c->callback([&] { action = [] { return calibrate_noise(noise); }; });
}

}  // namespace penumbra::tools
