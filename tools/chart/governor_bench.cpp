#include "tools/chart/governor_bench.h"

#include <algorithm>
#include <cmath>

#include "capture/studio/environments.h"
#include "core/conventions.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"
#include "prt/bake/bake.h"
#include "prt/geometry/receiver.h"
#include "prt/reference/environment_light.h"
#include "prt/reference/reference.h"
#include "prt/transfer/transfer.h"
#include "runtime/pipeline/governor_config.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/direct_light_stage.h"
#include "shadows/field/planar_shadow.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"
#include "shadows/silhouette/silhouette_mesh.h"
#include "tools/chart/chart_bench.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

namespace {

constexpr int kProbesAside = 14;
constexpr int kMapRows = 256;
constexpr int kReferenceRays = 3000;
constexpr int kMaxLights = 8;
constexpr double kShadowed = .95;

using Values = std::vector<double>;

// Bilinear value of a node map at a floor position; 0 outside.
double at_plane(const shadows::ShadowMap& shadow, const glm::dvec3& world) {
  const glm::dvec3 p = shadow.world_from_map.inverse() * world / double(shadow.cell_m);
  const int x = static_cast<int>(std::floor(p.x)), y = static_cast<int>(std::floor(p.z));
  if (shadow.empty() || x < 0 || y < 0 || x + 1 >= shadow.taken.width() ||
      y + 1 >= shadow.taken.height())
    return 0;
  const double u = p.x - x, v = p.z - y;
  const auto& m = shadow.taken;
  return (1 - v) * ((1 - u) * m.at(x, y) + u * m.at(x + 1, y)) +
         v * ((1 - u) * m.at(x, y + 1) + u * m.at(x + 1, y + 1));
}

// One coefficient of the receiver's texels, bilinear at (u, v).
double at_grid(const prt::Transfer& t, int size, int n, glm::vec2 uv) {
  const double x = std::clamp(uv.x * size - .5, 0., size - 1.001),
               y = std::clamp(uv.y * size - .5, 0., size - 1.001);
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const auto value = [&](int i, int j) {
    return double(t.value(0, n, static_cast<std::size_t>(j * size + i)));
  };
  const double u = x - x0, v = y - y0;
  return (1 - v) * ((1 - u) * value(x0, y0) + u * value(x0 + 1, y0)) +
         v * ((1 - u) * value(x0, y0 + 1) + u * value(x0 + 1, y0 + 1));
}

// The floor around an object at fixed probes.
class FloorProbes {
 public:
  explicit FloorProbes(const runtime::PreparedObject& o) : object_(o) {
    const prt::Receiver& receiver = *o.baked.receiver;
    const double reach = .45 * double(receiver.grid.half_extent);
    for (int j = 0; j < kProbesAside; ++j)
      for (int i = 0; i < kProbesAside; ++i) {
        // Denser near the object, like its shadow.
        const auto place = [&](int k) {
          const double w = (k + .5) / kProbesAside * 2 - 1;
          return reach * w * std::abs(w);
        };
        const glm::vec2 p = receiver.grid.centre + glm::vec2(place(i), place(j));
        world_.push_back(o.world_from_bake * glm::dvec3(p.x, receiver.grid.height, p.y));
        uv_.push_back(receiver.grid.uv(p));
      }
    const prt::BakedObject& b = o.baked;
    for (const glm::vec2& uv : uv_) {
      for (int n = 0; n < coefficient_count(b.ground_deficit.bands); ++n)
        deficit_.push_back(at_grid(b.ground_deficit, receiver.grid.size, n, uv));
      for (int n = 0; n < coefficient_count(b.ground_indirect.bands); ++n)
        indirect_.push_back(at_grid(b.ground_indirect, receiver.grid.size, n, uv));
    }
  }

  std::size_t count() const { return world_.size(); }
  const glm::dvec3& world(std::size_t p) const { return world_[p]; }
  // pi sum l_n S_n
  double deficit(std::size_t p, const RadianceSh& light) const {
    return dot(deficit_, object_.baked.ground_deficit.bands, p, light);
  }
  double indirect(std::size_t p, const RadianceSh& light) const {
    return dot(indirect_, object_.baked.ground_indirect.bands, p, light);
  }

 private:
  static double dot(const Values& table, int bands, std::size_t p, const RadianceSh& light) {
    const auto stride = static_cast<std::size_t>(coefficient_count(bands));
    double sum = 0;
    for (int n = 0; n < std::min(light.size(), coefficient_count(bands)); ++n)
      sum += double(luminance(light[n])) * table[p * stride + static_cast<std::size_t>(n)];
    return kPi * sum;
  }

  const runtime::PreparedObject& object_;
  std::vector<glm::dvec3> world_;
  std::vector<glm::vec2> uv_;
  Values deficit_, indirect_;  // [probe][n]
};

// s at the probes with the object really there.
Result<Values> reference_ratios(const runtime::PreparedScene& scene, const FloorProbes& probes,
                                const Image<Rgb>& map, int rays) {
  PENUMBRA_ASSIGN(light, prt::EnvironmentLight::from_map(map));
  prt::ReferenceWorld world;
  world.mesh = runtime::world_mesh(scene, true);
  world.planes = scene.planes;
  world.light = &light;
  std::vector<prt::IrradiancePoint> points;
  for (std::size_t p = 0; p < probes.count(); ++p)
    points.push_back({probes.world(p), scene.planes[0].normal});
  PENUMBRA_ASSIGN(irradiance, prt::reference_irradiance(world, points, rays, 1));
  const double open = luminance(exact_irradiance(map, scene.planes[0].normal));
  Values out;
  for (const Rgb& e : irradiance) out.push_back(open > 0 ? luminance(e) / open : 1);
  return out;
}

void add(RadianceSh& sum, const RadianceSh& other) {
  for (int n = 0; n < sum.size(); ++n) sum[n] += other[n];
}

// One environment's light, split as far as it goes, with the shadows of all its lights.
struct Split {
  lighting::ShProjection residual;
  std::vector<lighting::DistantLight> lights;
  std::vector<shadows::ShadowMap> shadows;
};

Result<Split> split_and_trace(const runtime::PreparedScene& scene, const Image<Rgb>& map) {
  lighting::LightExtraction split;
  PENUMBRA_TRY(lighting::extract_lights(map, {kMaxLights, .02}, split));
  PENUMBRA_ASSIGN(residual, lighting::project_latlong(split.residual, kMaxBands));
  Split out{residual, std::move(split.lights), {}};
  const runtime::PreparedObject& o = scene.objects[0];
  const shadows::SilhouetteMesh silhouette(o.baked.mesh);
  const shadows::Caster caster{&o.baked.mesh, &silhouette, o.world_from_bake};
  for (const lighting::DistantLight& d : out.lights)
    shadows::render_shadow_map({{&caster, 1}, {}}, scene.planes[0], d, {},
                               out.shadows.emplace_back());
  return out;
}

// Our s at the probes with so many bands and lights, as compose_planar_shadow and the compositor
// make it.
Values our_ratios(const FloorProbes& probes, const Split& split, int bands, int lights) {
  const glm::dvec3 up(0, 1, 0);
  RadianceSh upper_moments = split.residual.upper_moments, traced(kMaxBands);
  double distant_irradiance = 0;
  for (std::size_t j = 0; j < split.lights.size(); ++j) {
    const lighting::DistantLight& d = split.lights[j];
    const bool used = j < static_cast<std::size_t>(lights);
    add(used ? traced : upper_moments, project_upper_distant_light(d, kMaxBands));
    if (used) distant_irradiance += luminance(lighting::irradiance(d, up));
  }
  const RadianceSh light = lighting::upper_hemisphere_light(upper_moments, bands),
                   reflected = lighting::upper_hemisphere_light(traced, prt::kIndirectBands);
  const double open =
      luminance(lighting::evaluate(lighting::irradiance(light), up)) + distant_irradiance;
  Values out;
  for (std::size_t p = 0; p < probes.count(); ++p) {
    double lost = probes.deficit(p, light);
    if (lights > 0) lost -= probes.indirect(p, reflected);
    for (std::size_t j = 0; j < static_cast<std::size_t>(lights); ++j)
      lost += at_plane(split.shadows[j], probes.world(p)) *
              luminance(lighting::irradiance(split.lights[j], up));
    out.push_back(open > 0 ? std::clamp(1 - lost / open, 0., 1.5) : 1);
  }
  return out;
}

// The reference's own noise counts as the plan's error: kReferenceRays keep it small.
double shadow_rmse(const Values& ours, const Values& reference) {
  double square = 0, count = 0;
  for (std::size_t p = 0; p < ours.size(); ++p)
    if (reference[p] < kShadowed) square += std::pow(ours[p] - reference[p], 2), ++count;
  return count > 0 ? std::sqrt(square / count) : -1;
}

double binomial_upper_tail(int successes, int trials, double p) {
  double sum = 0;
  for (int k = successes; k <= trials; ++k)
    sum += std::exp(std::lgamma(trials + 1.) - std::lgamma(k + 1.) - std::lgamma(trials - k + 1.) +
                    k * std::log(p) + (trials - k) * std::log1p(-p));
  return sum;
}

}  // namespace

double clopper_pearson_low(int successes, int trials) {
  if (successes == 0) return 0;
  double low = 0, high = 1;
  for (int i = 0; i < 60; ++i) {
    const double p = (low + high) / 2;
    (p > 0 && p < 1 && binomial_upper_tail(successes, trials, p) < .05 ? low : high) = p;
  }
  return low;
}

std::optional<lighting::Plan> ScenePlans::choose(const lighting::CostModel& costs, double budget,
                                                 double factor) const {
  const lighting::Governor governor({budget, predicted.max_bands(), predicted.max_lights()}, costs,
                                    factor);
  const lighting::Plan plan = governor.cheapest(predicted, budget);
  return plan.within_budget ? std::optional(plan) : std::nullopt;
}

double ScenePlans::min_factor(const lighting::CostModel& costs, double budget) const {
  // The choice changes where a plan leaves the budget: just above budget/predicted.
  std::vector<double> factors{0};
  for (int lights = 0; lights <= predicted.max_lights(); ++lights)
    for (int bands = 1; bands <= predicted.max_bands(); ++bands)
      factors.push_back(budget / predicted.error(bands, lights) * (1 + 1e-9));
  std::ranges::sort(factors, std::greater<>());
  double smallest = factors.front();
  for (const double factor : factors) {
    const auto chosen = choose(costs, budget, factor);
    if (chosen && measured_error(*chosen) > budget) return smallest;
    smallest = factor;
  }
  return 0;
}

Result<ScenePlans> measure_plans(const runtime::PreparedScene& scene, std::uint32_t seed,
                                 int rays) {
  const Image<Rgb> map = capture::make_random_environment(2 * kMapRows, kMapRows, seed);
  const FloorProbes probes(scene.objects[0]);
  PENUMBRA_ASSIGN(reference, reference_ratios(scene, probes, map, rays));
  PENUMBRA_ASSIGN(split, split_and_trace(scene, map));
  const lighting::Governor::Limits limits;
  ScenePlans out{seed,
                 {{&split.residual.upper_moments, split.lights},
                  runtime::shadow_probes(scene),
                  limits.max_bands,
                  limits.max_lights},
                 {}};
  for (int lights = 0; lights <= out.predicted.max_lights(); ++lights)
    for (int bands = 1; bands <= limits.max_bands; ++bands) {
      const double error = shadow_rmse(our_ratios(probes, split, bands, lights), reference);
      if (error < 0) return fail(ErrorCode::kUndetermined, "scene", "has no shadow to measure");
      out.measured.push_back(error);
    }
  return out;
}

Result<GovernorProof> prove_governor(const runtime::PreparedScene& scene,
                                     const lighting::CostModel& costs, double budget,
                                     int test_scenes, const std::function<void(double)>& progress) {
  constexpr int kCalibration = 59;
  constexpr std::uint32_t kFirstCalibration = 1001, kFirstTest = 20001;
  GovernorProof proof;
  double regret = 0, error = 0, regretted = 0;
  const auto next_scene = [&](std::uint32_t& seed) -> Result<ScenePlans> {
    for (;; ++seed) {
      auto plans = measure_plans(scene, seed, kReferenceRays);
      if (!plans && plans.error().code == ErrorCode::kUndetermined) continue;
      ++seed;
      if (progress)
        progress(double(proof.calibration + proof.scenes + 1) / (kCalibration + test_scenes));
      return plans;
    }
  };
  for (std::uint32_t seed = kFirstCalibration; proof.calibration < kCalibration;
       ++proof.calibration) {
    PENUMBRA_ASSIGN(plans, next_scene(seed));
    for (const double b : kBudgets)
      proof.needed_factor = std::max(proof.needed_factor, plans.min_factor(costs, b));
  }
  proof.factor = std::max(proof.needed_factor, lighting::Governor::kConformalFactor);
  for (std::uint32_t seed = kFirstTest; proof.scenes < test_scenes;) {
    PENUMBRA_ASSIGN(plans, next_scene(seed));
    ++proof.scenes;
    const auto chosen = plans.choose(costs, budget, proof.factor);
    if (!chosen) continue;  // it says that it cannot
    const double measured = plans.measured_error(*chosen);
    ++proof.promised;
    proof.kept += measured <= budget ? 1 : 0;
    error += measured;
    proof.worst_error = std::max(proof.worst_error, measured);
    proof.mean_bands += chosen->bands;
    proof.mean_lights += chosen->lights;
    double oracle_ms = HUGE_VAL;
    for (int lights = 0; lights <= plans.predicted.max_lights(); ++lights)
      for (int bands = 1; bands <= plans.predicted.max_bands(); ++bands)
        if (plans.measured_error({bands, lights}) <= budget)
          oracle_ms = std::min(oracle_ms, costs.ms(bands, lights));
    if (oracle_ms < HUGE_VAL)
      regret += costs.ms(chosen->bands, chosen->lights) / oracle_ms - 1, ++regretted;
  }
  if (proof.promised > 0) {
    proof.mean_error = error / proof.promised;
    proof.mean_bands /= proof.promised;
    proof.mean_lights /= proof.promised;
  }
  proof.mean_regret = regretted > 0 ? regret / regretted : 0;
  proof.coverage_low = clopper_pearson_low(proof.kept, proof.promised);
  return proof;
}

}  // namespace penumbra::tools
