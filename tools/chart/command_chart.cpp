#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include "core/conventions.h"
#include "core/files.h"
#include "core/log.h"
#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/sh/projection.h"
#include "runtime/pipeline/governor_config.h"
#include "runtime/pipeline/report.h"
#include "runtime/pipeline/single_thread_time.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/direct_light_stage.h"
#include "tools/chart/accuracy.h"
#include "tools/chart/baselines.h"
#include "tools/chart/chart_bench.h"
#include "tools/chart/chart_environments.h"
#include "tools/chart/chart_options.h"
#include "tools/chart/chart_plot.h"
#include "tools/chart/commands.h"
#include "tools/chart/flicker.h"
#include "tools/chart/governor_bench.h"
#include "tools/common/command.h"
#include "tools/common/output.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

namespace {

constexpr double kReferenceError = .004;
constexpr int kBakeRays = 1024, kTruncatedBakeRays = 8192;
constexpr int kFlickerMaps = 6;
// A machine that others use too is a third slower from one second to the next. What is cheap is
// timed again after all the others, so that points that are compared have seen the same seconds.
constexpr int kRounds = 5;
constexpr double kCheap_ms = 15;

// One way to light the scene, as the chart's columns describe it.
struct Method {
  std::string label = "lights and bands";
  bool baseline = false;
  int bands = 5, max_lights = 8, map_size = 256, rows = 0, bake_rays = kBakeRays;
  runtime::ShadowSampling sampling;
  int age_columns = 0;  // how far the map has turned since the light was measured
  double update_rate = 1;
  bool chosen = false;
  bool default_plan = false;
};

Method with(const std::function<void(Method&)>& change) {
  Method m;
  change(m);
  m.sampling.plane.size = m.map_size;
  return m;
}

// Around the default, one axis at a time, and bands against lights.
std::vector<Method> sweep(const ChartOptions& o) {
  std::vector<Method> out{with([](Method& m) { m.default_plan = true; })};
  if (!o.bands.empty()) {
    out.clear();
    for (const int b : o.bands)
      out.push_back(with([&](Method& m) { m.bands = b, m.max_lights = o.lights; }));
    return out;
  }
  for (const int b : {1, 2, 3, 4, 5, 6, 9})
    out.push_back(with([&](Method& m) { m.bands = b, m.max_lights = 0; }));
  for (const int b : {2, 3, 5})
    for (const int k : {1, 2})
      out.push_back(with([&](Method& m) { m.bands = b, m.max_lights = k; }));
  for (const int b : {2, 3, 4, 6, 9}) out.push_back(with([&](Method& m) { m.bands = b; }));
  for (const int t : {1, 4, 64})
    out.push_back(with([&](Method& m) {
      m.sampling.plane.samples = t, m.sampling.object = std::clamp(t / 4, 1, 16);
    }));
  const auto cheaply = [](Method& m, int b, int k, int size) {
    m.bands = b, m.max_lights = k, m.map_size = size, m.rows = 256;
    m.sampling.plane.samples = 4, m.sampling.object = 1;
  };
  // A head that turns by a degree a frame: the oldest light in use.
  const auto every = [](Method& m, int frames) {
    m.update_rate = 1. / frames, m.age_columns = 3 * (frames - 1);
  };
  for (const int b : {2, 3, 5})
    for (const int k : {1, 8}) {
      for (const int s : {128, 256}) out.push_back(with([&](Method& m) { cheaply(m, b, k, s); }));
      out.push_back(with([&](Method& m) { cheaply(m, b, k, 128), every(m, 2); }));
    }
  for (const int b : {2, 3, 5}) out.push_back(with([&](Method& m) { cheaply(m, b, 1, 384); }));
  for (const int s : {32, 64, 128, 512}) out.push_back(with([&](Method& m) { m.map_size = s; }));
  for (const int r : {16, 32, 64, 128}) out.push_back(with([&](Method& m) { m.rows = r; }));
  for (const int r : {64, 256, 4096}) out.push_back(with([&](Method& m) { m.bake_rays = r; }));
  for (const int frames : {2, 4}) out.push_back(with([&](Method& m) { every(m, frames); }));
  return out;
}

// Box filter to so many rows.
Image<Rgb> reduced(const Image<Rgb>& map, int rows) {
  const int block = std::max(1, map.height() / rows);
  Image<Rgb> out(map.width() / block, map.height() / block);
  for (int y = 0; y < out.height(); ++y) {
    double weight = 0;
    for (int j = 0; j < block; ++j)
      weight += latlong_solid_angle(y * block + j, map.width(), map.height());
    for (int x = 0; x < out.width(); ++x) {
      Rgb sum;
      for (int j = 0; j < block; ++j) {
        const double w = latlong_solid_angle(y * block + j, map.width(), map.height());
        for (int i = 0; i < block; ++i)
          sum += map.at(x * block + i, y * block + j) * static_cast<float>(w / weight / block);
      }
      out.at(x, y) = sum;
    }
  }
  return out;
}

Image<Rgb> turned(const Image<Rgb>& map, int columns) {
  Image<Rgb> out(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y)
    std::ranges::rotate_copy(map.row(y), map.row(y).begin() + columns, out.row(y).begin());
  return out;
}

// What was not measured is a dash.
std::string cell_of(fmt::format_string<double&> format, double value) {
  return std::isfinite(value) ? fmt::format(format, value) : "-";
}

using TimeOf = std::function<runtime::LightTime()>;

class Charter {
 public:
  /// `bench` is of the asset, by kBakeRays.
  Charter(const ChartOptions& o, const std::string& asset, const ChartScene& bench,
          std::vector<ChartPoint>& points)
      : o_(o), asset_(asset), bench_(bench), points_(points) {}

  Result<void> run(const ChartEnvironment& environment) {
    if (o_.bands.empty() && costs_.per_light_ms < 0) {
      PENUMBRA_ASSIGN(costs,
                      runtime::fit_costs(baked_with(lighting::Governor::Limits{}.max_bands)));
      costs_ = costs;
    }
    PENUMBRA_ASSIGN(truth,
                    trace_truth(bench_, environment.map, o_.error.value_or(kReferenceError)));
    if (o_.bands.empty()) {
      auto maps = measured_maps(environment.map, kFlickerMaps);
      if (!maps) return fail(maps.error().code, environment.name, maps.error().detail);
      maps_ = std::move(*maps);
    }
    const std::size_t first = points_.size();
    timings_.clear();
    const std::vector<Method> methods = sweep(o_);
    const auto progress = progress_bar(environment.name);
    for (std::size_t i = 0; i < methods.size(); ++i) {
      PENUMBRA_TRY(ours(methods[i], environment, truth));
      if (progress) progress(double(i + 1) / double(methods.size()));
    }
    if (o_.bands.empty()) {
      PENUMBRA_TRY(governed(environment, truth));
      PENUMBRA_TRY(baselines(environment, truth));
      PENUMBRA_TRY(time_again());
    }
    for (std::size_t i = first; i < points_.size() && !o_.json; ++i) print(points_[i]);
    return {};
  }

 private:
  // What the program picks by itself with the default budget.
  Result<void> governed(const ChartEnvironment& e, const Truth& truth) {
    auto plan = default_plan(bench_, e.map, costs_);
    if (!plan) return fail(plan.error().code, e.name, plan.error().detail);
    Method m;
    m.label = "governor", m.bands = plan->bands, m.max_lights = plan->lights, m.chosen = true;
    return ours(m, e, truth);
  }

  Result<void> ours(const Method& m, const ChartEnvironment& e, const Truth& truth) {
    const lighting::EstimateOptions options{m.bands, {m.max_lights, .02}};
    Image<Rgb> map = seen_by(m, e);
    auto light = lighting::estimate_map(map, options);
    if (!light) return fail(light.error().code, e.name, light.error().detail);
    lighting::LightEstimator estimator(options);
    penumbra::Environment measured;
    measured.radiance = std::move(map);
    const TimeOf estimate = [options, m, &e] {
      lighting::LightEstimator fresh(options);
      penumbra::Environment environment;
      environment.radiance = seen_by(m, e);
      return time_of(fresh, environment);
    };
    const LightOf again = [&estimator, &measured](const Image<Rgb>& newer, TimestampNs time) {
      measured.radiance = newer;
      measured.time = time;
      return estimator.estimate(measured);
    };
    const bool may_flicker = m.chosen || m.default_plan;
    PENUMBRA_ASSIGN(scene, baked_for(m));
    return add(m, e, *scene, *light, estimate, may_flicker ? again : LightOf(), truth);
  }

  static Image<Rgb> seen_by(const Method& m, const ChartEnvironment& e) {
    Image<Rgb> map = m.age_columns > 0 ? turned(e.map, m.age_columns) : e.map;
    return m.rows > 0 ? reduced(map, m.rows) : map;
  }

  const runtime::PreparedScene& baked_with(int bands) {
    const auto [known, is_new] = scenes_.try_emplace({bands, kBakeRays});
    if (is_new) known->second = bench_.prepared_with(bands);
    return known->second;
  }
  Result<const runtime::PreparedScene*> baked_for(const Method& m) {
    if (m.bake_rays == kBakeRays) return &baked_with(m.bands);
    const auto [known, is_new] = scenes_.try_emplace({m.bands, m.bake_rays});
    if (is_new) {
      PENUMBRA_ASSIGN(other, ChartScene::make(asset_, m.bake_rays));
      known->second = other.prepared_with(m.bands);
    }
    return &known->second;
  }

  static runtime::LightTime time_of(lighting::LightEstimator& estimator,
                                    const penumbra::Environment& environment) {
    (void)estimator.estimate(environment);  // makes its tables
    return runtime::time_single_threaded(9, [&](int) { (void)estimator.estimate(environment); });
  }
  // What it costs to get so many bands from a map, for those who need nothing else of it.
  static runtime::LightTime projection_time(const Image<Rgb>& map, int bands) {
    lighting::LightEstimator estimator({bands, {0, 1}});
    penumbra::Environment environment;
    environment.radiance = map;
    return time_of(estimator, environment);
  }

  Result<void> baselines(const ChartEnvironment& e, const Truth& truth) {
    const auto projection = [&e](int bands) -> TimeOf {
      return [&e, bands] { return projection_time(e.map, bands); };
    };
    const TimeOf three_bands = projection(3);
    const auto plain = [&](const char* label, int bands) {
      Method m;
      m.label = label, m.baseline = true, m.bands = bands, m.max_lights = 0;
      return m;
    };
    auto bands3 = lighting::estimate_map(e.map, {3, {0, 1}});
    if (!bands3) return fail(bands3.error().code, e.name, bands3.error().detail);
    const runtime::PreparedScene& scene = baked_with(3);
    PENUMBRA_TRY(add(plain("no floor shadow", 3), e, without_floor_shadow(scene), *bands3,
                     three_bands, {}, truth));
    PENUMBRA_TRY(add(plain("unshadowed SH9", 3), e, without_shadows(scene), *bands3, three_bands,
                     {}, truth));
    PENUMBRA_TRY(add(plain("ambient occlusion", 3), e, with_ambient_occlusion(scene), *bands3,
                     three_bands, {}, truth));
    using MakeLight = std::function<lighting::LightEstimate(const Image<Rgb>&)>;
    const auto always = [](const MakeLight& make) -> LightOf {
      return [make](const Image<Rgb>& map, TimestampNs) -> Result<lighting::LightEstimate> {
        return make(map);
      };
    };
    PENUMBRA_TRY(add(plain("SH9 (Xu 2005)", 3), e, scene, dissertation_light(e.map), three_bands,
                     always(dissertation_light), truth));
    // Sampling a map is not counted, in its favour.
    const auto points = [&](const std::string& label, const MakeLight& make, const TimeOf& estimate,
                            bool may_flicker) {
      const lighting::LightEstimate light = make(e.map);
      Method m = plain("", 1);
      m.label = label;
      m.sampling = {1, {1, 256}};
      m.max_lights = static_cast<int>(light.lights.size());
      return add(m, e, baked_with(1), light, estimate, may_flicker ? always(make) : LightOf(),
                 truth);
    };
    PENUMBRA_TRY(points("ambient and one hard light", phone_light, projection(2), true));
    for (const int n : {16, 64, 256})
      PENUMBRA_TRY(points(
          fmt::format("{} sampled lights", n),
          [n](const Image<Rgb>& map) { return sampled_lights(map, n); },
          [] { return runtime::LightTime{}; }, n == 16));
    return {};
  }

  Result<void> add(const Method& m, const ChartEnvironment& e, const runtime::PreparedScene& scene,
                   const lighting::LightEstimate& light, const TimeOf& estimate,
                   const LightOf& again, const Truth& truth) {
    PENUMBRA_ASSIGN(measured, measure(bench_, scene, light, m.sampling, truth));
    const Accuracy& a = measured.accuracy;
    ChartPoint p;
    p.environment = e.name;
    p.mesh = bench_.name();
    p.method = m.label;
    p.baseline = m.baseline;
    p.coefficients = coefficient_count(m.bands);
    p.lights = static_cast<int>(light.lights.size());
    p.max_lights = m.max_lights;
    p.sampling = m.sampling.plane.samples;
    p.object_samples = m.sampling.object;
    p.map_size = m.sampling.plane.size;
    p.bake_rays = m.bake_rays;
    p.environment_rows = m.rows > 0 ? m.rows : e.map.height();
    p.update_rate = m.update_rate;
    p.object_rel_rmse = a.object_without_noise;
    p.object_bias = a.object_bias;
    p.shadow_rmse = a.shadow_rmse;
    p.shadow_bias = a.shadow_bias;
    p.penumbra_error = a.penumbra_error;
    p.flip = measured.flip;
    if (again && !maps_.empty()) {
      PENUMBRA_ASSIGN(flicker,
                      measure_flicker(bench_, scene, again, m.sampling, truth.empty, maps_));
      p.flicker = flicker;
    }
    p.chosen = m.chosen;
    p.bytes = memory_of(scene, light.lights.size(), p.map_size);
    p.reference_error = a.reference_error;
    points_.push_back(p);
    // `scene` of a baseline is gone by the next round, where it is one of its own.
    timings_.push_back({points_.size() - 1,
                        m.update_rate,
                        estimate,
                        m.sampling,
                        light,
                        is_baked(scene) ? &scene : nullptr,
                        {}});
    add_round(timings_.back(), measured.time);
    return {};
  }

  bool is_baked(const runtime::PreparedScene& scene) const {
    return std::ranges::any_of(scenes_, [&](const auto& s) { return &s.second == &scene; });
  }

  // Of getting the light from its map, and of an update with it.
  struct Timing {
    std::size_t point;
    double rate;  // updates a frame
    TimeOf estimate;
    runtime::ShadowSampling sampling;
    lighting::LightEstimate light;
    const runtime::PreparedScene* scene;
    std::vector<runtime::LightTime> rounds;
  };

  void add_round(Timing& t, const runtime::LightTime& update) {
    const runtime::LightTime estimate = t.estimate();
    t.rounds.push_back(
        {t.rate * (update.p50_ms + estimate.p50_ms), update.p99_ms + estimate.p99_ms});
    const auto median = [&](double runtime::LightTime::*which) {
      std::vector<double> all;
      for (const runtime::LightTime& round : t.rounds) all.push_back(round.*which);
      std::ranges::nth_element(all, all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2));
      return all[all.size() / 2];
    };
    points_[t.point].ms_p50 = median(&runtime::LightTime::p50_ms);
    points_[t.point].ms_p99 = median(&runtime::LightTime::p99_ms);
  }

  Result<void> time_again() {
    for (int round = 1; round < kRounds; ++round)
      for (Timing& t : timings_) {
        if (!t.scene || t.rounds[0].p50_ms > kCheap_ms) continue;
        PENUMBRA_ASSIGN(update, time_updates(bench_, *t.scene, t.light, t.sampling));
        add_round(t, update);
      }
    return {};
  }

  static void print(const ChartPoint& p) {
    fmt::print(
        "{:<28.28} {:<8.8} {:<26.26} {:>3} {:>3} {:>3} {:>4} {:>4} {:>4} {:>5.2f} {:>9.2f} "
        "{:>7.2f} "
        "{:>8.4f} {:>8.4f} {:>7.4f} {:>7} {:>7} {:>8.2f}\n",
        p.environment, p.mesh, p.method, p.coefficients, p.lights, p.sampling, p.map_size,
        p.environment_rows, p.bake_rays, p.update_rate, 100 * p.object_rel_rmse,
        100 * p.object_bias, p.shadow_rmse, p.shadow_bias, p.flip,
        cell_of("{:.1f}", 100 * p.penumbra_error), cell_of("{:.2g}", 100 * p.flicker), p.ms_p50);
  }

  const ChartOptions& o_;
  const std::string& asset_;
  const ChartScene& bench_;
  std::vector<ChartPoint>& points_;
  std::vector<Image<Rgb>> maps_;         // of the environment at hand, measured again and again
  lighting::CostModel costs_{0, 0, -1};  // until fitted
  std::map<std::pair<int, int>, runtime::PreparedScene> scenes_;  // by bands and rays of the bake
  std::vector<Timing> timings_;                                   // of the environment at hand
};

// What our own steps cost: both sides under the same truncated light.
Result<void> chart_truncated(const ChartOptions& o, const ChartScene& bench,
                             const ChartEnvironment& environment, std::vector<ChartPoint>& points) {
  const StillScene in = bench.in(environment.map);
  PENUMBRA_ASSIGN(empty, render_real(in, o.error.value_or(kReferenceError), {}));
  auto projection = lighting::project_latlong(environment.map, kMaxBands);
  if (!projection)
    return fail(projection.error().code, environment.name, projection.error().detail);
  for (const int bands : o.bands.empty() ? std::vector{1, 2, 3, 4, 5, 6, 9} : o.bands) {
    const lighting::LightEstimate light = lighting::make_estimate(*projection, bands);
    PENUMBRA_ASSIGN(truth,
                    render_reference(in, true, o.error.value_or(kReferenceError), light,
                                     progress_bar(fmt::format("{} {}", environment.name, bands))));
    Still lit = empty;
    light_floor(in, light, bench.masks(), lit);
    PENUMBRA_ASSIGN(ours, render_composite(in, light, lit));
    const Accuracy a = compare_pictures(ours, truth, lit, bench.masks());
    ChartPoint p;
    p.environment = environment.name, p.mesh = bench.name(), p.method = "same truncated light";
    p.coefficients = coefficient_count(bands), p.bake_rays = kTruncatedBakeRays;
    p.object_rel_rmse = a.object_without_noise, p.object_bias = a.object_bias;
    p.shadow_rmse = a.shadow_rmse, p.reference_error = a.reference_error;
    points.push_back(p);
    if (!o.json)
      fmt::print(
          "{:<28.28} {:<8.8} {:>3} object {:.2f} % (reference noise {:.2f} %), bias {:.2f} %, "
          "shadow {:.4f}\n",
          p.environment, p.mesh, p.coefficients, 100 * p.object_rel_rmse, 100 * p.reference_error,
          100 * p.object_bias, p.shadow_rmse);
  }
  return {};
}

Result<void> chart_governor(const ChartOptions& o) {
  const std::string asset = o.assets.empty() ? "builtin:knot" : o.assets[0];
  PENUMBRA_ASSIGN(bench, ChartScene::make(asset, kBakeRays));
  PENUMBRA_ASSIGN(costs,
                  runtime::fit_costs(bench.prepared_with(lighting::Governor::Limits{}.max_bands)));
  PENUMBRA_ASSIGN(proof, prove_governor(bench.prepared(), costs, o.budget, o.governor,
                                        progress_bar("random scenes")));
  if (o.json) {
    print_json({{"needed_factor", proof.needed_factor},
                {"factor", proof.factor},
                {"calibration_scenes", proof.calibration},
                {"scenes", proof.scenes},
                {"promised", proof.promised},
                {"kept", proof.kept},
                {"coverage_low", proof.coverage_low},
                {"mean_regret", proof.mean_regret},
                {"mean_error", proof.mean_error},
                {"worst_error", proof.worst_error},
                {"budget", o.budget}});
    return {};
  }
  fmt::print("cost model: {:.2f} ms + {:.4f} ms a coefficient + {:.1f} ms a light, one thread\n",
             costs.base_ms, costs.per_coefficient_ms, costs.per_light_ms);
  fmt::print(
      "{} scenes need a factor of {:.2f}, taken {:.2f}; of {} others {} had a plan within {:.3f}, "
      "{} kept it (at least {:.1f} % with 95 % confidence)\n",
      proof.calibration, proof.needed_factor, proof.factor, proof.scenes, proof.promised, o.budget,
      proof.kept, 100 * proof.coverage_low);
  fmt::print(
      "chosen: {:.1f} bands and {:.1f} lights on average, error mean {:.4f} worst {:.4f}; "
      "{:.1f} times the cost of the cheapest sufficient plan\n",
      proof.mean_bands, proof.mean_lights, proof.mean_error, proof.worst_error,
      1 + proof.mean_regret);
  return {};
}

}  // namespace

Result<void> chart(const ChartOptions& o) {
  if (o.governor < 0 || o.governor > 10'000)
    return fail(ErrorCode::kInvalid, "--governor", "is not within 1..10000 scenes");
  if (!(o.budget > 0 && o.budget <= 1))
    return fail(ErrorCode::kInvalid, "--max-shadow-error", "is not above 0 and at most 1");
  if (o.lights < 0 || o.lights > 64)
    return fail(ErrorCode::kInvalid, "--max-lights", "is not within 0..64");
  if (o.governor > 0) return chart_governor(o);
  if (o.error && !(*o.error > 0 && *o.error < 1))
    return fail(ErrorCode::kInvalid, "--error", "is not above 0 and below 1");
  if (o.through_sensor) return chart_through_sensor(o);
  for (int b : o.bands)
    if (b < 1 || b > kMaxBands)
      return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", b));
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(environments, read_environments(o.environments, o.with_procedural));
  std::vector<std::string> assets = o.assets;
  if (assets.empty()) assets = {"builtin:knot", "builtin:twist"};
  for (const std::string& asset : assets)  // all of them before the long work
    PENUMBRA_TRY(runtime::load_asset(asset, {.7f, .7f, .7f}, 0));
  std::vector<ChartPoint> points;
  if (!o.json && !o.truncated)
    fmt::print(
        "n coefficients, K lights, smp samples of a light, map texels along its shadow map, rows "
        "of the environment, rays of the bake, rate updates a frame; errors of the object, of the "
        "shadow ratio s, FLIP, of the shadow's edge, flicker F; ms of an update on one thread\n"
        "{:<28} {:<8} {:<26} {:>3} {:>3} {:>3} {:>4} {:>4} {:>4} {:>5} {:>9} {:>7} {:>8} {:>8} "
        "{:>7} "
        "{:>7} {:>7} {:>8}\n",
        "environment", "mesh", "method", "n", "K", "smp", "map", "rows", "rays", "rate", "object %",
        "bias %", "shadow s", "bias s", "FLIP", "edge %", "F %", "ms");
  for (const std::string& asset : assets) {
    PENUMBRA_ASSIGN(bench, ChartScene::make(asset, o.truncated ? kTruncatedBakeRays : kBakeRays));
    Charter charter(o, asset, bench, points);
    for (const ChartEnvironment& e : environments)
      PENUMBRA_TRY(o.truncated ? chart_truncated(o, bench, e, points) : charter.run(e));
  }
  PENUMBRA_TRY(output.begin());
  PENUMBRA_TRY(write_bytes(output.file("accuracy.csv"), chart_csv(points)));
  if (!o.truncated)
    if (const auto plots = write_chart_plots(output.work(), points); !plots)
      log_warning("the plots are not written: {}: {}", plots.error().where, plots.error().detail);
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    print_json({{"rows", chart_json(points)}});
  } else {
    fmt::print("{}/accuracy.csv, {}/error-time.svg\n", o.output, o.output);
  }
  return {};
}

void add_chart(CLI::App& parent, Action& action) {
  static ChartOptions chart_options;
  auto* c = parent.add_subcommand(
      "chart",
      "Measure error against time for many settings and for other methods; writes CSV and SVG");
  c->add_option("--out", chart_options.output, "Folder for the results")->capture_default_str();
  c->add_option("--environment", chart_options.environments,
                "HDR environment maps, .exr or .hdr; by default the built-in ones");
  c->add_flag("--with-procedural", chart_options.with_procedural,
              "Add the built-in environments to those of --environment");
  c->add_option("--asset", chart_options.assets,
                "Meshes of the objects; by default builtin:knot and builtin:twist");
  c->add_option(
       "--bands", chart_options.bands,
       "Chart only these fixed numbers of bands of spherical harmonics, 1 to 9, separated by "
       "commas, with --max-lights; by default the whole sweep")
      ->delimiter(',');
  c->add_option("--max-lights", chart_options.lights,
                "Maximum number of distant lights beside --bands, 0 to 64")
      ->capture_default_str();
  CLI::Option* const governor = c->add_option(
      "--governor", chart_options.governor,
      "Calibrate the governor on 59 random scenes, and test its promise on this many others, "
      "1 to 10000");
  c->add_option(
       "--max-shadow-error", chart_options.budget,
       "Limit of the RMS error of the shadow ratio that the governor has to keep, above 0 and "
       "at most 1; with --governor")
      ->capture_default_str();
  c->add_option(
      "--error", chart_options.error,
      "Relative error at which path tracing of the reference stops, above 0 and below 1; by "
      "default 0.004, with --through-sensor 0.03");
  c->add_flag(
      "--truncated", chart_options.truncated,
      "Compare with the reference under the same truncated light, which leaves the errors of bake, "
      "shadows and composite");
  const char* const kSensor = "The whole chain through both cameras' sensors instead";
  CLI::Option* const sensor = c->add_flag(
      "--through-sensor", chart_options.through_sensor,
      "Film each world, and compare the composite with a world in which the object stands; writes "
      "through-sensor.csv and through-sensor.svg");
  sensor->excludes(governor)->group(kSensor);
  c->add_option("--bits", chart_options.bits,
                "Bits of both cameras: 8 with the response of sRGB, 12 linear")
      ->check([](const std::string& text) {
        return text == "8" || text == "12" ? "" : "is neither 8 nor 12";
      })
      ->capture_default_str()
      ->needs(sensor)
      ->group(kSensor);
  c->add_option("--shortest-exposure", chart_options.shortest_exposure_s,
                "Shortest exposure time that the environment camera can take, seconds, above 0 and "
                "at most 1/30")
      ->capture_default_str()
      ->needs(sensor)
      ->group(kSensor);
  c->add_flag("--stills", chart_options.stills,
              "Write camera, composite and truth of each case side by side, .exr")
      ->needs(sensor)
      ->group(kSensor);
  const char* const kClip = "Compression of a clip's transfer instead";
  CLI::Option* const clip =
      c->add_option(
           "--animation", chart_options.animation,
           "Clip of the first --asset, by default of builtin:walker: chart bytes against the error "
           "of the rendered picture for several coders of its transfer")
          ->check(not_empty)
          ->excludes(governor)
          ->excludes(sensor)
          ->group(kClip);
  c->add_option("--light-map", chart_options.light_map,
                "Size of the light map, WIDTHxHEIGHT texels, 8 to 4096 each")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option("--frames", chart_options.frames,
                "Number of frames that are taken from the clip, 1 to 1000")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  c->add_option("--samples", chart_options.samples,
                "Number of rays per texel and frame, a multiple of 64")
      ->capture_default_str()
      ->needs(clip)
      ->group(kClip);
  add_json(c, chart_options.json);
  c->callback([&] {
    action = [] {
      return chart_options.animation.empty() ? chart(chart_options) : chart_clip(chart_options);
    };
  });
}

}  // namespace penumbra::tools
