#include "tools/chart/charts/light_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <span>

#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/sh/map_average.h"
#include "lighting/sh/projection.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/governor/governor_config.h"
#include "runtime/governor/single_thread_time.h"
#include "runtime/scene/scene.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/benches/flicker.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/chart/peers/baselines.h"
#include "tools/common/progress.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

namespace {

constexpr double kLightReferenceError = .004;
constexpr int kTruncatedBakeRays = 8192;
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
  bool full = false;                   // every knob as far as it goes by default
  std::optional<lighting::Plan> plan;  // of what is chosen
};

Method with(const std::function<void(Method&)>& change) {
  Method m;
  change(m);
  m.sampling.plane.size = m.map_size;
  return m;
}

// Around the default, one axis at a time, and bands against lights.
std::vector<Method> sweep(const ChartOptions& o) {
  std::vector<Method> out{with([](Method& m) { m.full = true; })};
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
    if (o_.bands.empty() && costs_.relight_ms < 0) {
      PENUMBRA_ASSIGN(costs,
                      runtime::fit_costs(baked_with(lighting::Governor::Limits{}.max_bands)));
      costs_ = costs;
    }
    PENUMBRA_ASSIGN(truth,
                    trace_truth(bench_, environment.map, o_.error.value_or(kLightReferenceError)));
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
      compare_choice(std::span(points_).subspan(first));
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
    m.plan = *plan;
    return ours(m, e, truth);
  }

  Result<void> ours(const Method& m, const ChartEnvironment& e, const Truth& truth) {
    lighting::EstimateOptions options{m.bands, {m.max_lights, .02}};
    if (m.plan) options.map_step = m.plan->map_step;
    Image<Rgb> map = seen_by(m, e);
    auto light = lighting::estimate_map(map, options);
    if (!light) return fail(light.error().code, e.name, light.error().detail);
    light->plan = m.plan;
    lighting::LightEstimator estimator(options);
    penumbra::Environment measured;
    measured.radiance = std::move(map);
    const TimeOf estimate = [options, m, &e] { return reading_time(options, m, e); };
    const LightOf again = [&estimator, &measured, &m](const Image<Rgb>& newer, TimestampNs time) {
      measured.radiance = newer;
      measured.time = time;
      auto newest = estimator.estimate(measured);
      if (newest) newest->plan = m.plan;
      return newest;
    };
    const bool may_flicker = m.chosen || m.full;
    PENUMBRA_ASSIGN(scene, baked_for(m));
    return add(m, e, *scene, *light, estimate, may_flicker ? again : LightOf(), truth);
  }

  static Image<Rgb> seen_by(const Method& m, const ChartEnvironment& e) {
    Image<Rgb> map = m.age_columns > 0 ? turned(e.map, m.age_columns) : e.map;
    const int side = m.rows > 0 ? std::max(1, map.height() / m.rows) : 1;
    if (side == 1) return map;
    Image<Rgb> reduced;
    lighting::average_blocks(map, side, reduced);
    return reduced;
  }
  // With what averaging takes, as a program that comes by the whole map has to do it.
  static runtime::LightTime reading_time(const lighting::EstimateOptions& options, const Method& m,
                                         const ChartEnvironment& e) {
    lighting::LightEstimator estimator(options);
    penumbra::Environment environment;
    environment.radiance = seen_by(m, e);
    const int side = e.map.height() / environment.radiance.height();
    (void)estimator.estimate(environment);  // makes its tables
    return runtime::time_single_threaded(9, [&](int) {
      if (side > 1) lighting::average_blocks(e.map, side, environment.radiance);
      (void)estimator.estimate(environment);
    });
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
    if (m.plan) p.environment_rows /= m.plan->map_step;
    p.fine_lights = m.plan ? m.plan->fine_lights : p.lights;
    p.full = m.full;
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

  // What is chosen beside every knob at full, and beside the cheapest that would have kept the
  // limit. Fewer updates are no choice here: where nothing moves there are none.
  static void compare_choice(std::span<ChartPoint> points) {
    constexpr double kLimit = lighting::Governor::Limits{}.max_error;
    double full_ms = std::numeric_limits<double>::quiet_NaN(), cheapest_ms = HUGE_VAL;
    for (const ChartPoint& p : points) {
      if (p.full) full_ms = p.ms_p50;
      if (!p.baseline && p.update_rate == 1 && p.shadow_rmse <= kLimit &&
          p.object_rel_rmse <= kLimit)
        cheapest_ms = std::min(cheapest_ms, p.ms_p50);
    }
    for (ChartPoint& p : points) {
      if (!p.chosen) continue;
      p.saved = full_ms / p.ms_p50;
      if (std::isfinite(cheapest_ms)) p.regret = p.ms_p50 / cheapest_ms;
    }
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
  std::vector<Image<Rgb>> maps_;  // of the environment at hand, measured again and again
  lighting::CostModel costs_{.relight_ms = -1};                   // until fitted
  std::map<std::pair<int, int>, runtime::PreparedScene> scenes_;  // by bands and rays of the bake
  std::vector<Timing> timings_;                                   // of the environment at hand
};

// What our own steps cost: both sides under the same truncated light.
Result<void> chart_truncated(const ChartOptions& o, const ChartScene& bench,
                             const ChartEnvironment& environment, std::vector<ChartPoint>& points) {
  const StillScene in = bench.in(environment.map);
  PENUMBRA_ASSIGN(empty, render_real(in, o.error.value_or(kLightReferenceError), {}));
  auto projection = lighting::project_latlong(environment.map, kMaxBands);
  if (!projection)
    return fail(projection.error().code, environment.name, projection.error().detail);
  for (const int bands : o.bands.empty() ? std::vector{1, 2, 3, 4, 5, 6, 9} : o.bands) {
    const lighting::LightEstimate light = lighting::make_estimate(*projection, bands);
    PENUMBRA_ASSIGN(truth,
                    render_reference(in, true, o.error.value_or(kLightReferenceError), light,
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

void print_light_header() {
  fmt::print(
      "n coefficients, K lights, smp samples of a light, map texels along its shadow map,\n"
      "rows of the environment, rays of the bake, rate updates a frame; errors of the object,\n"
      "of the shadow ratio s, FLIP, of the shadow's edge, flicker F; ms of an update on one "
      "thread\n"
      "{:<28} {:<8} {:<26} {:>3} {:>3} {:>3} {:>4} {:>4} {:>4} {:>5} {:>9} {:>7} {:>8} {:>8} {:>7} "
      "{:>7} {:>7} {:>8}\n",
      "environment", "mesh", "method", "n", "K", "smp", "map", "rows", "rays", "rate", "object %",
      "bias %", "shadow s", "bias s", "FLIP", "edge %", "F %", "ms");
}

}  // namespace

Result<std::vector<ChartPoint>> chart_lights(const ChartOptions& o,
                                             std::span<const std::string> assets,
                                             std::span<const ChartEnvironment> environments) {
  std::vector<ChartPoint> points;
  if (!o.json && !o.truncated) print_light_header();
  for (const std::string& asset : assets) {
    PENUMBRA_ASSIGN(bench, ChartScene::make(asset, o.truncated ? kTruncatedBakeRays : kBakeRays));
    Charter charter(o, asset, bench, points);
    for (const ChartEnvironment& e : environments)
      PENUMBRA_TRY(o.truncated ? chart_truncated(o, bench, e, points) : charter.run(e));
  }
  return points;
}

}  // namespace penumbra::tools
