#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "capture/studio/world.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/chart/benches/through_sensor.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_plot.h"
#include "tools/chart/plots.h"
#include "tools/common/print.h"
#include "tools/plots/gnuplot.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

constexpr float kNight = .01f;                  // of the light of day
constexpr double kSensorReferenceError = .012;  // with .03 a small shadow came out a third better
constexpr double kMeanGoal = .02, kWorstGoal = .04, kObjectGoal = .04, kCaptureGoal = .01;

std::string percent(double fraction) {
  return fmt::format("{:.1f}", 100 * fraction);
}

std::string_view lens_name(const SensorPoint& p) {
  return kSensorLensNames[static_cast<std::size_t>(p.lens)];
}

nlohmann::ordered_json sensor_row(const SensorPoint& p) {
  const auto optional = [](const std::optional<double>& v) {
    return v ? nlohmann::ordered_json(*v) : nlohmann::ordered_json();
  };
  return {{"environment", p.environment},
          {"scene", p.scene},
          {"bits", p.settings.bits},
          {"shortest_exposure_s", p.settings.shortest_exposure.count()},
          {"view_lens", lens_name(p)},
          {"exposures", p.exposures},
          {"lights", p.lights},
          {"bands", p.bands},
          {"lower_bound", p.lower_bound},
          {"predicted_shadow_error", optional(p.predicted_error)},
          {"shadow_rmse", p.sensor.shadow_rmse},
          {"shadow_bias", p.sensor.shadow_bias},
          {"object_rel_rmse", p.sensor.object_rel_rmse},
          {"object_rel_bias", p.sensor.object_bias},
          {"true_map_shadow_rmse", p.true_map.shadow_rmse},
          {"true_map_shadow_bias", p.true_map.shadow_bias},
          {"true_map_object_rel_rmse", p.true_map.object_rel_rmse},
          {"true_map_object_rel_bias", p.true_map.object_bias}};
}

// What the goals speak of. Where the plan promises nothing no goal applies.
struct SensorSummary {
  int cases = 0, lower_bounds = 0;
  double shadow_mean = 0, shadow_worst = 0, object_mean = 0, object_worst = 0;
  double of_capture = 0;  // mean of the shadow's error through the sensor less that of the true map
  bool goals_met() const {
    return cases > 0 && shadow_mean <= kMeanGoal && shadow_worst <= kWorstGoal &&
           object_worst <= kObjectGoal && of_capture <= kCaptureGoal;
  }
};

SensorSummary summary_of(const std::vector<SensorPoint>& points) {
  SensorSummary out;
  for (const SensorPoint& p : points) {
    if (p.lower_bound) {
      ++out.lower_bounds;
      continue;
    }
    ++out.cases;
    out.shadow_mean += p.sensor.shadow_rmse;
    out.object_mean += p.sensor.object_rel_rmse;
    out.of_capture += p.sensor.shadow_rmse - p.true_map.shadow_rmse;
    out.shadow_worst = std::max(out.shadow_worst, p.sensor.shadow_rmse);
    out.object_worst = std::max(out.object_worst, p.sensor.object_rel_rmse);
  }
  if (out.cases > 0)
    for (double* mean : {&out.shadow_mean, &out.object_mean, &out.of_capture}) *mean /= out.cases;
  return out;
}

nlohmann::ordered_json to_json(const SensorSummary& s) {
  return {{"cases", s.cases},
          {"lower_bounds", s.lower_bounds},
          {"shadow_rmse_mean", s.shadow_mean},
          {"shadow_rmse_worst", s.shadow_worst},
          {"object_rel_rmse_mean", s.object_mean},
          {"object_rel_rmse_worst", s.object_worst},
          {"shadow_rmse_of_capture", s.of_capture},
          {"goals_met", s.goals_met()}};
}

void print_sensor_header() {
  fmt::print("{:<24} {:<14} {:>4} {:>3} {:>3} {:>3} {:>8} {:>8} {:>8} {:>8} {:>9} {:>7} {:>9}\n",
             "environment", "scene", "bits", "exp", "B", "K", "plan s", "shadow s", "bias s",
             "true map", "object %", "bias %", "true map");
}

void print(const SensorPoint& p) {
  fmt::print(
      "{:<24.24} {:<14.14} {:>4} {:>3} {:>3} {:>3} {:>8} {:>8.4f} {:>+8.4f} {:>8.4f} {:>9} {:>7} "
      "{:>9}\n",
      p.environment, p.scene, p.settings.bits, p.exposures, p.bands, p.lights,
      p.predicted_error ? fmt::format("{:.4f}", *p.predicted_error) : "unknown",
      p.sensor.shadow_rmse, p.sensor.shadow_bias, p.true_map.shadow_rmse,
      percent(p.sensor.object_rel_rmse), percent(p.sensor.object_bias),
      percent(p.true_map.object_rel_rmse));
}

void print(const SensorSummary& s) {
  fmt::print(
      "{} cases: shadow error mean {:.4f} (goal {}), worst {:.4f} (goal {}); object mean {} %, "
      "worst {} % (goal {}); of capture alone {:+.4f} (goal {})\n",
      s.cases, s.shadow_mean, kMeanGoal, s.shadow_worst, kWorstGoal, percent(s.object_mean),
      percent(s.object_worst), percent(kObjectGoal), s.of_capture, kCaptureGoal);
  if (s.lower_bounds > 0)
    fmt::print("{} more have a light that is a lower bound: no error is promised there\n",
               s.lower_bounds);
}

std::string still_name(const SensorPoint& p) {
  std::string out = p.environment + '-' + p.scene + ".exr";
  std::ranges::replace(out, ' ', '-');
  std::ranges::replace(out, '/', '-');
  return out;
}

// Each scene a little to the right of the one before, so that equal errors do not hide each other.
Result<void> write_plot(const std::filesystem::path& target, const std::vector<SensorPoint>& points,
                        const std::vector<ChartEnvironment>& environments) {
  std::string names, sensor, true_map, lower_bound;
  for (const ChartEnvironment& e : environments) {
    std::string name = e.name;
    std::ranges::replace(name, ' ', '-');
    names += name + ' ';
  }
  std::vector<std::string> scenes;
  for (const SensorPoint& p : points)
    if (std::ranges::find(scenes, p.scene) == scenes.end()) scenes.push_back(p.scene);
  for (const SensorPoint& p : points) {
    const auto column = std::ranges::find(environments, p.environment, &ChartEnvironment::name) -
                        environments.begin() + 1;
    const auto scene = std::ranges::find(scenes, p.scene) - scenes.begin();
    const double x = double(column) + .7 * (double(scene + 1) / double(scenes.size() + 1) - .5);
    const auto row = [&](const SensorError& e) {
      return fmt::format("{:.9g}\t{:.9g}\t{:.9g}\n", x, e.shadow_rmse, 100 * e.object_rel_rmse);
    };
    (p.lower_bound ? lower_bound : sensor) += row(p.sensor);
    true_map += row(p.true_map);
  }
  const auto block = [](const char* name, const std::string& rows) {
    return gnuplot_block(name, rows.empty() ? "NaN\tNaN\tNaN\n" : rows);
  };
  const std::string order =
      fmt::format("in each column from left to right: {}", fmt::join(scenes, ", "));
  const std::string heading =
      fmt::format("From the sensor to the picture: {} cases, {} view camera", points.size(),
                  lens_name(points[0]));
  return run_gnuplot(fmt::format("heading = {}\nnames = {}\nxlabel_text = {}\ngoals = '{} {} {}'\n",
                                 gnuplot_quoted(heading), gnuplot_quoted(names),
                                 gnuplot_quoted(order), kMeanGoal, kWorstGoal, 100 * kObjectGoal) +
                         block("sensor", sensor) + block("true_map", true_map) +
                         block("lower_bound", lower_bound) + kThroughSensorPlot,
                     target);
}

Result<void> check(const ChartOptions& o) {
  if (!(o.shortest_exposure_s > 0 && o.shortest_exposure_s <= 1. / 30))
    return fail(ErrorCode::kInvalid, "--shortest-exposure", "is not above 0 and at most 1/30 s");
  for (const std::string& asset : o.assets)  // all of them before the long work
    PENUMBRA_TRY(runtime::load_asset(asset, {.7f, .7f, .7f}, 0));
  return {};
}

// As bright as the studio's cameras are made for, and the room by night.
Result<std::vector<ChartEnvironment>> environments_of(const ChartOptions& o) {
  PENUMBRA_ASSIGN(out, read_environments(o.environments, o.with_procedural));
  for (ChartEnvironment& e : out) {
    const auto world = capture::FloorWorld::make(std::move(e.map));
    if (!world) return fail(world.error().code, e.name, world.error().detail);
    e.map = (*world)->environment();
  }
  const auto room = std::ranges::find(out, "room", &ChartEnvironment::name);
  if (room == out.end()) return out;
  ChartEnvironment night{"night", room->map};
  for (Rgb& c : night.map.pixels()) c = c * kNight;
  out.push_back(std::move(night));
  return out;
}

}  // namespace

Result<void> chart_through_sensor(const ChartOptions& o) {
  PENUMBRA_TRY(check(o));
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(environments, environments_of(o));
  std::vector<std::string> assets = o.assets;
  if (assets.empty()) assets = {"builtin:knot", "builtin:walker"};
  const auto lens = static_cast<SensorLens>(std::ranges::find(kSensorLensNames, o.view_lens) -
                                            kSensorLensNames.begin());
  if (!o.json) print_sensor_header();
  std::vector<SensorPoint> points;
  for (const SensorScene& scene : sensor_scenes(assets)) {
    PENUMBRA_ASSIGN(bench, SensorBench::make(scene, lens));
    for (const ChartEnvironment& e : environments) {
      PENUMBRA_ASSIGN(world, bench.trace(e.name, e.map, o.error.value_or(kSensorReferenceError)));
      PENUMBRA_ASSIGN(point, bench.measure(world, {o.bits, Seconds(o.shortest_exposure_s)}));
      if (!o.json) print(point);
      points.push_back(std::move(point));
    }
  }
  auto rows = nlohmann::ordered_json::array();
  for (const SensorPoint& p : points) rows.push_back(sensor_row(p));
  const SensorSummary summary = summary_of(points);
  PENUMBRA_TRY(output.begin());
  PENUMBRA_TRY(write_bytes(output.file("through-sensor.csv"), csv_table(sensor_row({}), rows)));
  if (const auto plot = write_plot(output.file("through-sensor.svg"), points, environments); !plot)
    log_warning("the plot is not written: {}: {}", plot.error().where, plot.error().detail);
  for (const SensorPoint& p : points)
    if (o.stills) PENUMBRA_TRY(codec::write_hdr(output.file(still_name(p)), p.strip));
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    print_json({{"rows", rows}, {"summary", to_json(summary)}});
    return {};
  }
  print(summary);
  fmt::print("{0}/through-sensor.csv, {0}/through-sensor.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
