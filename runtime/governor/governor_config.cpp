#include "runtime/governor/governor_config.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <vector>

#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/rays/ray_pattern.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/direct/scene_light.h"
#include "runtime/governor/internal/kept_costs.h"
#include "runtime/governor/single_thread_time.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

namespace {

constexpr std::size_t kProbesEach = 64, kProbes = 256;  // of an object, of all
constexpr int kRuns = 5;
// Of each of the seven costs that are fitted: a first start takes two seconds at most, unless one
// run is longer.
constexpr double kMaxFit_ms = 250;

// An object with its planar shadow, as a stage relights them.
class Relit {
 public:
  explicit Relit(const PreparedObject& o)
      : baked_(o.baked),
        patterns_(o.baked),
        light_(3 * o.baked.transfer.stride),
        deficit_(3 * o.baked.ground_deficit.stride) {}

  void relight(const RadianceSh& light, const RadianceSh* reflected) {
    patterns_.surface.relight(light, reflected, light_);
    const prt::Transfer& deficit = baked_.ground_deficit;
    if (!baked_.receiver || deficit.points == 0) return;
    patterns_.ground.relight(light, reflected, deficit_);
    shadows::compose_planar_shadow({baked_.receiver->grid, deficit.bands, deficit.stride, deficit_},
                                   light, shadow_);
  }

 private:
  const prt::BakedObject& baked_;
  RelightBases patterns_;
  std::vector<float> light_, deficit_;
  shadows::PlanarShadow shadow_;
};

// A row of a table of harmonics in the world's frame.
class WorldRow {
 public:
  WorldRow(const Pose& world_from_bake, int bands)
      : turn_(world_from_bake.rotation_matrix(), bands), row_(bands) {}
  void add(const prt::Transfer& table, int channel, std::size_t point, float scale,
           std::vector<float>& out) {
    for (int n = 0; n < row_.size(); ++n) {
      const bool known = n < coefficient_count(table.bands);
      row_[n].g = known ? scale * table.value(channel, n, point) : 0.f;
    }
    const RadianceSh turned = turn_ * row_;
    for (int n = 0; n < row_.size(); ++n) out.push_back(turned[n].g);
  }

 private:
  lighting::ShRotation turn_;
  RadianceSh row_;
};

// Steps by the golden ratio reach all of a table evenly, whatever the order of its points.
std::size_t evenly(std::size_t i, std::size_t points) {
  const double at = std::fmod(.5 + static_cast<double>(i) * .6180339887498949, 1.);
  return static_cast<std::size_t>(at * static_cast<double>(points));
}

// Of one light, at places that it has not been at before; it brings a third of what floors get.
double time_light(const PreparedScene& scene, DirectLightStage& lights,
                  const OcclusionProbes& around, double radius_rad, bool fine) {
  lighting::DistantLight light;
  light.id = 1;
  light.radius = Radians(radius_rad);
  light.radiance = {1, 1, 1};
  const std::vector<Rgb> open(scene.planes.size(), 3 * light.irradiance());
  const auto move = [&](int run) {
    light.direction = glm::normalize(glm::dvec3(1, 1.2, .1 * run));
    lights.update({&light, 1}, 1, around, open, fine ? 1 : 0);
  };
  const double ms = time_single_threaded(kRuns, move, kMaxFit_ms).p50_ms;
  lights.update({}, 1, around);  // forgets it
  return ms;
}

// A bright ceiling and four lamps: finding them takes as long as the projection.
Image<Rgb> lit_map(int rows) {
  Image<Rgb> map(2 * rows, rows, {1, 1, 1});
  for (int y = 0; y < rows / 8; ++y)
    for (Rgb& pixel : map.row(y)) pixel = {4, 4, 4};
  for (int lamp = 0; lamp < 4; ++lamp)
    for (int y = 0; y < rows / 16; ++y)
      for (int x = 0; x < rows / 16; ++x)
        map.at(rows / 2 * lamp + x, rows / 4 + y) = {200, 200, 200};
  return map;
}

double time_reading(int map_step) {
  penumbra::Environment environment;
  environment.radiance = lit_map(512);
  lighting::EstimateOptions options;
  options.map_step = map_step;
  lighting::LightEstimator estimator(options);
  lighting::LightEstimate out;
  const auto read = [&](int) { (void)estimator.estimate(environment, out); };
  read(0);  // makes its tables
  return time_single_threaded(kRuns, read, kMaxFit_ms).p50_ms;
}

// pi S_n around a ball that rests on a floor, in the world's frame: what stands on something real,
// where no bake tells what it takes of the light there. Places like those that a bake keeps.
std::vector<float> deficit_below_a_ball() {
  constexpr int kPoints = 32, kDirections = 576;
  std::vector<float> out;
  double basis[kMaxCoefficients];
  for (int i = 0; i < kPoints; ++i) {
    const double away = .6 + 1.8 * (i + .5) / kPoints,  // in radii
        azimuth = i * 2.399963229728653;
    const glm::dvec3 to(away * std::cos(azimuth), 1, away * std::sin(azimuth));
    const double distance = glm::length(to), half = std::asin(1 / distance);
    const glm::dmat3 frame(prt::frame_around(glm::vec3(to / distance)));
    std::vector<double> row(kMaxCoefficients);
    const double cap = 1 - std::cos(half);
    for (int k = 0; k < kDirections; ++k) {
      const double z = 1 - cap * (k + .5) / kDirections, r = std::sqrt(1 - z * z),
                   a = k * 2.399963229728653;
      const glm::dvec3 d = frame * glm::dvec3(r * std::cos(a), r * std::sin(a), z);
      if (d.y <= 0) continue;
      lighting::evaluate_basis(kMaxBands, d, basis);
      for (std::size_t n = 0; n < row.size(); ++n)
        row[n] += basis[n] * d.y * 2 * kPi * cap / kDirections;
    }
    out.insert(out.end(), row.begin(), row.end());
  }
  return out;
}

}  // namespace

lighting::SceneProbes scene_probes(const PreparedScene& scene, int bands) {
  lighting::SceneProbes out;
  out.has_floor = !scene.planes.empty();
  out.on_planes_only = scene.real_mesh.triangles.empty();
  for (const PreparedObject& o : scene.objects) {
    out.transfer_bands = std::max(out.transfer_bands, std::min(bands, o.baked.transfer.bands));
    if (!o.baked.receiver)
      out.on_planes_only = false;
    else
      out.level = out.level && stands_level(o.baked, o.world_from_bake);
  }
  const std::size_t each = std::max<std::size_t>(
      8, std::min(kProbesEach, kProbes / std::max<std::size_t>(1, scene.objects.size())));
  bool stood_in = false;
  for (const PreparedObject& o : scene.objects) {
    const prt::Transfer &floor = o.baked.shadow_probes, &surface = o.baked.transfer;
    WorldRow on_floor(o.world_from_bake, kMaxBands);
    for (std::size_t i = 0; i < std::min(each, floor.points); ++i)
      on_floor.add(floor, 0, i, static_cast<float>(kPi), out.deficit);
    const bool any_below = out.has_floor || !scene.real_mesh.triangles.empty();
    if (floor.points == 0 && any_below && !stood_in) {
      const std::vector<float> ball = deficit_below_a_ball();
      out.deficit.insert(out.deficit.end(), ball.begin(), ball.end());
      stood_in = true;
    }
    if (out.transfer_bands == 0) continue;
    WorldRow on_surface(o.world_from_bake, out.transfer_bands);
    for (std::size_t i = 0; i < std::min(each, surface.points); ++i)
      on_surface.add(surface, surface.channels == 1 ? 0 : 1, evenly(i, surface.points), 1,
                     out.transfer);
  }
  return out;
}

Result<lighting::CostModel> fit_costs(const PreparedScene& scene) {
  PENUMBRA_ASSIGN(lights, DirectLightStage::create(scene, {}));
  const OcclusionProbes alone(
      scene);  // nothing looked at yet: what stands around costs the same for any plan
  lighting::CostModel costs;
  costs.read_ms = time_reading(1);
  costs.read_blocks_ms = time_reading(lighting::kMapBlock);
  std::vector<Relit> things;
  for (const PreparedObject& o : scene.objects) things.emplace_back(o);
  const RadianceSh light(kMaxBands);
  const auto relight = [&](const RadianceSh* reflected) {
    const auto all = [&](int) {
      for (Relit& thing : things) thing.relight(light, reflected);
    };
    return time_single_threaded(kRuns, all, kMaxFit_ms).p50_ms;
  };
  // The first light brings reflected light.
  costs.relight_ms = relight(nullptr);
  const double reflected_ms = std::max(0., relight(&light) - costs.relight_ms);
  const auto time = [&](Radians radius, bool fine) {
    return reflected_ms + time_light(scene, lights, alone, radius.value(), fine);
  };
  costs.fine_light_ms = time(.2 * lighting::kWideLight, true);
  costs.coarse_light_ms = time(.2 * lighting::kWideLight, false);
  costs.wide_light_ms = time(2 * lighting::kWideLight, true);
  return costs;
}

Result<lighting::GovernorConfig> make_governor_config(const PreparedScene& scene,
                                                      const lighting::Governor::Limits& limits,
                                                      CostSource costs) {
  lighting::GovernorConfig out;
  out.limits = limits;
  out.probes = scene_probes(scene, limits.max_bands);
  if (costs == CostSource::kFixed) return out;
  const auto fit = [&] { return fit_costs(scene); };
  auto fitted = costs == CostSource::kKept ? recall_or_fit(scene, fit) : fit();
  if (!fitted) return std::unexpected(std::move(fitted).error());
  out.costs = *fitted;
  return out;
}

}  // namespace penumbra::runtime
