#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>

#include "calib/camera/colour.h"
#include "calib/estimate/colour_calibration.h"
#include "capture/environment/common_surfaces.h"
#include "capture/frames.h"
#include "capture/recording/undamaged_frames.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"

namespace penumbra::tools {

namespace {

struct CalibrateColourOptions {
  std::string capture;  // of a still scene
  std::string environment = "environment", view = "view", model = "matrix", output;
  bool chart = false;  // a ColorChecker stands in both pictures
  std::optional<std::string> report;
  bool json = false;
};

Result<std::vector<calib::ColourPair>> pairs_of_chart(const capture::StillPicture& environment,
                                                      const capture::StillPicture& view) {
  constexpr std::size_t kFewest = 12;
  const auto find = [](const capture::StillPicture& p) {
    return calib::find_colour_chart(p.radiance, p.clipped, p.camera.name);
  };
  PENUMBRA_ASSIGN(source, find(environment));
  PENUMBRA_ASSIGN(target, find(view));
  std::vector<calib::ColourPair> out;
  for (std::size_t i = 0; i < source.size(); ++i)
    if (source[i] && target[i]) out.push_back({*source[i], *target[i]});
  if (out.size() < kFewest)
    return fail(ErrorCode::kUndetermined, "colour calibration",
                fmt::format("only {} patches of the chart are neither clipped nor black in both "
                            "pictures, and {} are needed: add shorter and longer exposures",
                            out.size(), kFewest));
  return out;
}

std::vector<calib::ColourPair> pairs_of_surroundings(const capture::StillPicture& environment,
                                                     const capture::StillPicture& view,
                                                     double turned_rad = 0) {
  std::vector<calib::ColourPair> out;
  for (const capture::CommonSurface& s : capture::common_surfaces(environment, view, turned_rad))
    out.push_back(s.colours);
  return out;
}

// Even surroundings, or surfaces that only one camera sees, fit some matrix, too: but then as well
// when the pictures are turned against each other.
Result<void> check_same_surfaces(const capture::StillPicture& environment,
                                 const capture::StillPicture& view, calib::ColourModel model,
                                 const calib::ColourCalibration& found) {
  constexpr double kTurn = 8 * kPi / 180, kClearly = .7;
  for (const double turn : {-kTurn, kTurn}) {
    const auto turned =
        calib::calibrate_colour(pairs_of_surroundings(environment, view, turn), model);
    if (turned && found.rms > kClearly * turned->rms)
      return fail(ErrorCode::kUndetermined, "colour calibration",
                  fmt::format("the colours agree within {:.1f} % as they are, and within {:.1f} % "
                              "with one picture turned by 8 degrees: the surroundings are too "
                              "even, or too near; use --chart, or record outdoors",
                              100 * found.rms, 100 * turned->rms));
  }
  return {};
}

nlohmann::json to_json(const glm::dmat3& m) {
  nlohmann::json rows = nlohmann::json::array();
  for (int r = 0; r < 3; ++r) rows.push_back({m[0][r], m[1][r], m[2][r]});
  return rows;
}

void print_table(const calib::ColourCalibration& c, const CalibrateColourOptions& o) {
  fmt::print("{} = matrix * {}; {} of {} surfaces agree, {:.2f} % RMS\n", o.view, o.environment,
             std::ranges::count(c.used, true), c.used.size(), 100 * c.rms);
  for (int r = 0; r < 3; ++r)
    fmt::print("{:9.5f} {:9.5f} {:9.5f}   +- {:.5f} {:.5f} {:.5f}\n", c.matrix[0][r],
               c.matrix[1][r], c.matrix[2][r], c.sigma[0][r], c.sigma[1][r], c.sigma[2][r]);
}

}  // namespace

Result<void> calibrate_colour(const CalibrateColourOptions& o) {
  PENUMBRA_ASSIGN(model, calib::colour_model(o.model));
  PENUMBRA_TRY(check_writable(o.output));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(o.capture));
  PENUMBRA_ASSIGN(pictures, capture::merge_still(*source, {o.environment, o.view}));
  const capture::StillPicture &environment = pictures[0], &view = pictures[1];
  if (environment.camera.role != capture::Role::kEnvironment ||
      view.camera.role != capture::Role::kView)
    return fail(
        ErrorCode::kInvalid, "--environment, --view",
        fmt::format("{} is not an environment camera of the capture, or {} is not a view camera",
                    o.environment, o.view));
  PENUMBRA_ASSIGN(pairs, o.chart ? pairs_of_chart(environment, view)
                                 : Result<std::vector<calib::ColourPair>>(
                                       pairs_of_surroundings(environment, view)));
  PENUMBRA_ASSIGN(result, calib::calibrate_colour(pairs, model));
  if (!o.chart) PENUMBRA_TRY(check_same_surfaces(environment, view, model, result));
  PENUMBRA_TRY(write_bytes(o.output, calib::print_colour_file(result, o.environment, o.view)));
  if (o.report) PENUMBRA_TRY(write_colour_report(*o.report, result, pairs));
  if (o.json)
    print_json({{"matrix", to_json(result.matrix)},
                {"sigma", to_json(result.sigma)},
                {"rms", result.rms},
                {"surfaces", result.used.size()},
                {"used", std::ranges::count(result.used, true)}});
  else
    print_table(result, o);
  return {};
}

void add_calibrate_colour(CLI::App& parent, Action& action) {
  static CalibrateColourOptions colour;
  auto* c = parent.add_subcommand(
      "colour", "Find the matrix from an environment camera's colours to a view camera's");
  c->add_option(
       "capture", colour.capture,
       "Recording or capture folder of a still scene that both cameras see, with their poses")
      ->required();
  c->add_option("--environment", colour.environment, "Name of the environment camera")
      ->capture_default_str();
  c->add_option("--view", colour.view, "Name of the view camera")->capture_default_str();
  c->add_flag(
      "--chart", colour.chart,
      "Use a ColorChecker of 24 patches that is in both pictures; poses do not matter then");
  c->add_option("--model", colour.model,
                "Colour model: matrix, gains (one for each channel) or scale (one for all)")
      ->capture_default_str();
  c->add_option("-o,--output", colour.output, "Colour file to write, .toml")->required();
  c->add_option("--report", colour.report, "Folder for a plot and a table of the surfaces");
  add_json(c, colour.json);
  c->callback([&] { action = [] { return calibrate_colour(colour); }; });
}

}  // namespace penumbra::tools
