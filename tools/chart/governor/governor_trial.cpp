#include "tools/chart/governor/governor_trial.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>

#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/map_average.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/reference/environment_light.h"
#include "prt/reference/reference.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/direct/scene_light.h"
#include "runtime/governor/governor_config.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "tools/common/progress.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

namespace {

constexpr int kProbesAside = 14;
constexpr std::size_t kPatches = 48, kPatchVertices = 7;
constexpr int kMaxLights = 8;
constexpr double kShadowed = .95;
constexpr double kTilt_rad = 12 * kPi / 180;

// One coefficient at the receiver's texels, bilinear at (u, v).
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

// Bilinear value of a node map at a place on the floor; 0 outside.
double at_plane(const shadows::ShadowMap& shadow, const glm::dvec3& world) {
  if (shadow.empty()) return 0;
  const glm::dvec3 p = shadow.world_from_map.inverse() * world / double(shadow.cell_m);
  const int x = static_cast<int>(std::floor(p.x)), y = static_cast<int>(std::floor(p.z));
  const auto& m = shadow.virtual_occlusion;
  if (x < 0 || y < 0 || x + 1 >= m.width() || y + 1 >= m.height()) return 0;
  const double u = p.x - x, v = p.z - y;
  return (1 - v) * ((1 - u) * m.at(x, y) + u * m.at(x + 1, y)) +
         v * ((1 - u) * m.at(x, y + 1) + u * m.at(x + 1, y + 1));
}

// A vertex and those around it: what a pixel averages. Not of what lies on the floor, which nobody
// sees.
std::vector<std::vector<std::uint32_t>> make_patches(const prt::Mesh& mesh, float floor) {
  const prt::Bounds bounds = prt::bounds_of(mesh);
  const float low = floor + .02f * (bounds.high.y - bounds.low.y);
  std::vector<std::uint32_t> seen;
  for (std::uint32_t v = 0; v < mesh.positions.size(); ++v)
    if (mesh.positions[v].y > low || mesh.normals[v].y > -.5f) seen.push_back(v);
  const std::size_t count = std::min(kPatches, seen.size());
  std::vector<std::vector<std::uint32_t>> out(count);
  std::vector<std::size_t> patch_of(mesh.positions.size(), count);
  for (std::size_t i = 0; i < count; ++i) {
    const double at = std::fmod(.5 + static_cast<double>(i) * .6180339887498949, 1.);
    const std::uint32_t v = seen[static_cast<std::size_t>(at * static_cast<double>(seen.size()))];
    out[i].push_back(v);
    patch_of[v] = i;
  }
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t v : triangle) {
      if (patch_of[v] == count) continue;
      auto& patch = out[patch_of[v]];
      for (const std::uint32_t other : triangle)
        if (patch.size() < kPatchVertices && std::ranges::find(patch, other) == patch.end())
          patch.push_back(other);
    }
  return out;
}

double square(double x) {
  return x * x;
}

}  // namespace

// Where a scene is measured, and what was baked there.
class Trial::Points {
 public:
  explicit Points(const runtime::PreparedScene& scene)
      : object_(scene.objects[0]),
        up_(scene.planes[0].normal),
        level_(runtime::stands_level(object_.baked, object_.world_from_bake)),
        patches_(make_patches(object_.baked.mesh, object_.baked.receiver->grid.height)) {
    const prt::Receiver& receiver = *object_.baked.receiver;
    const double reach = .45 * double(receiver.grid.half_extent);
    for (int j = 0; j < kProbesAside; ++j)
      for (int i = 0; i < kProbesAside; ++i) {
        // Denser near the object, like its shadow.
        const auto place = [&](int k) {
          const double w = (k + .5) / kProbesAside * 2 - 1;
          return reach * w * std::abs(w);
        };
        const glm::vec2 p = receiver.grid.centre + glm::vec2(place(i), place(j));
        floor_.push_back(object_.world_from_bake * glm::dvec3(p.x, receiver.grid.height, p.y));
        const glm::vec2 uv = receiver.grid.uv(p);
        add_row(object_.baked.ground_deficit, uv, deficit_);
        add_row(object_.baked.ground_reflected, uv, reflected_);
      }
  }

  std::span<const glm::dvec3> floor() const { return floor_; }
  const glm::dvec3& up() const { return up_; }
  std::span<const std::vector<std::uint32_t>> patches() const { return patches_; }
  bool level() const { return level_; }
  const runtime::PreparedObject& object() const { return object_; }

  /// The world's light for what stands here, in the bake frame.
  RadianceSh light_here(const RadianceSh& whole, const RadianceSh& upper_moments, int bands) const {
    if (level_) return lighting::upper_hemisphere_light(upper_moments, bands);
    return turned(whole.with_bands(bands));
  }
  RadianceSh reflected_here(const RadianceSh& light, int bands) const {
    return runtime::reflected_in_bake_frame(light, level_, object_.world_from_bake, bands);
  }
  double open_irradiance(const RadianceSh& light) const {
    return luminance(lighting::evaluate(lighting::irradiance(light), glm::dvec3(0, 1, 0)));
  }
  /// pi sum l_n S_n
  double deficit(std::size_t p, const RadianceSh& light) const {
    return dot(deficit_, object_.baked.ground_deficit.bands, p, light);
  }
  double reflected(std::size_t p, const RadianceSh& light) const {
    return dot(reflected_, object_.baked.ground_reflected.bands, p, light);
  }
  /// Mean over a patch of what vertices have of `transfer` under a light.
  double at_patch(std::size_t patch, const prt::Transfer& transfer, const RadianceSh& light) const {
    const int terms = std::min(light.size(), coefficient_count(transfer.bands));
    double sum = 0;
    for (const std::uint32_t v : patches_[patch])
      for (int n = 0; n < terms; ++n)
        sum += double(luminance(light[n])) * double(transfer.value(0, n, v));
    return sum / static_cast<double>(patches_[patch].size());
  }

 private:
  RadianceSh turned(const RadianceSh& light) const {
    const lighting::ShRotation turn(glm::transpose(object_.world_from_bake.rotation_matrix()),
                                    light.bands());
    return turn * light;
  }
  void add_row(const prt::Transfer& t, glm::vec2 uv, std::vector<double>& out) const {
    for (int n = 0; n < coefficient_count(t.bands); ++n)
      out.push_back(at_grid(t, object_.baked.receiver->grid.size, n, uv));
  }
  static double dot(const std::vector<double>& table, int bands, std::size_t p,
                    const RadianceSh& light) {
    const auto stride = static_cast<std::size_t>(coefficient_count(bands));
    double sum = 0;
    for (int n = 0; n < std::min(light.size(), coefficient_count(bands)); ++n)
      sum += double(luminance(light[n])) * table[p * stride + static_cast<std::size_t>(n)];
    return kPi * sum;
  }

  const runtime::PreparedObject& object_;
  glm::dvec3 up_;
  bool level_;
  std::vector<std::vector<std::uint32_t>> patches_;
  std::vector<glm::dvec3> floor_;
  std::vector<double> deficit_, reflected_;  // [point][n]
};

Result<std::vector<TrialScene>> make_trial_scenes(const std::vector<std::string>& assets,
                                                  int rays) {
  struct Floor {
    float albedo;
    double tilt_rad;
  };
  constexpr Floor kFloors[] = {{.4f, 0}, {.15f, 0}, {.7f, kTilt_rad}};
  std::vector<TrialScene> out;
  for (const std::string& asset : assets)
    for (const Floor& floor : kFloors) {
      runtime::SceneObject object;
      object.asset = asset;
      object.name = std::filesystem::path(asset).stem().string();
      object.albedo = {.6f, .6f, .6f};
      object.place_on_floor = true;
      runtime::RealGeometry real;
      runtime::RealPlane plane;
      plane.normal = {std::sin(floor.tilt_rad), std::cos(floor.tilt_rad), 0};
      real.plane = plane;
      real.albedo = Rgb{floor.albedo, floor.albedo, floor.albedo};
      runtime::BakeSettings settings;
      settings.bands = kMaxBands;
      settings.rays = settings.ground_rays = rays;
      PENUMBRA_ASSIGN(prepared, runtime::prepare({{object}, {real}}, settings, progress_bar));
      out.push_back({fmt::format("{} on {:.0f} %{}", object.name, 100 * floor.albedo,
                                 floor.tilt_rad > 0 ? ", tilted" : ""),
                     std::move(prepared)});
    }
  return out;
}

std::optional<lighting::PredictedErrors> measured_errors(const TrialValues& ours,
                                                         const TrialValues& truth) {
  double shadow = 0, count = 0, object = 0, all = 0;
  for (std::size_t p = 0; p < truth.ratio.size(); ++p)
    if (truth.ratio[p] < kShadowed) shadow += square(ours.ratio[p] - truth.ratio[p]), ++count;
  for (std::size_t p = 0; p < truth.object.size(); ++p)
    object += square(ours.object[p] - truth.object[p]), all += square(truth.object[p]);
  if (count == 0 || all <= 0) return std::nullopt;
  return lighting::PredictedErrors{std::sqrt(shadow / count), std::sqrt(object / all)};
}

namespace {

// With the object really there. The rays' own noise counts as the treatment's error: many keep it
// small.
Result<TrialValues> trace_truth(const runtime::PreparedScene& scene,
                                std::span<const glm::dvec3> floor,
                                std::span<const std::vector<std::uint32_t>> patches,
                                const Image<Rgb>& map, int rays) {
  PENUMBRA_ASSIGN(light, prt::EnvironmentLight::from_map(map));
  prt::ReferenceWorld world;
  world.mesh = runtime::world_mesh(scene, true);
  world.planes = scene.planes;
  world.light = &light;
  const glm::dvec3 up = scene.planes[0].normal;
  std::vector<prt::IrradiancePoint> points;
  for (const glm::dvec3& p : floor) points.push_back({p, up});
  PENUMBRA_ASSIGN(on_floor, prt::reference_irradiance(world, points, rays, 1));
  points.clear();
  for (const auto& patch : patches)
    for (const std::uint32_t v : patch)
      points.push_back({glm::dvec3(world.mesh.positions[v]), glm::dvec3(world.mesh.normals[v])});
  PENUMBRA_ASSIGN(on_object, prt::reference_irradiance(
                                 world, points, rays / static_cast<int>(kPatchVertices) + 1, 2));
  const double open = luminance(exact_irradiance(map, up));
  TrialValues out;
  for (const Rgb& e : on_floor) out.ratio.push_back(open > 0 ? luminance(e) / open : 1);
  std::size_t next = 0;
  for (const auto& patch : patches) {
    double sum = 0;
    for (std::size_t k = 0; k < patch.size(); ++k) sum += luminance(on_object[next++]);
    out.object.push_back(sum / (kPi * static_cast<double>(patch.size())));
  }
  return out;
}

}  // namespace

Result<Trial::Split> Trial::split(const TrialScene& scene, const Points& points,
                                  const Image<Rgb>& map, int map_step) {
  Image<Rgb> averaged;
  if (map_step > 1) lighting::average_blocks(map, map_step, averaged);
  const Image<Rgb>& read = map_step > 1 ? averaged : map;
  lighting::LightExtraction extraction;
  PENUMBRA_TRY(lighting::extract_lights(read, {kMaxLights, .02}, extraction));
  PENUMBRA_ASSIGN(residual, lighting::project_latlong(extraction.residual, kMaxBands));
  Split out{residual, {}};
  PENUMBRA_ASSIGN(stage, runtime::DirectLightStage::create(scene.prepared, {}));
  const runtime::OcclusionProbes around(scene.prepared);
  const double mean = kPi * extraction.mean_luminance;
  const Rgb open[] = {exact_irradiance(map, points.up())};
  const prt::Transfer& transfer = points.object().baked.transfer;
  std::vector<float> relit(3 * transfer.stride);
  for (lighting::DistantLight& d : extraction.lights) {
    d.id = static_cast<int>(out.lights.size()) + 1;
    TrialLight& traced = out.lights.emplace_back();
    traced.light = d;
    traced.irradiance = luminance(lighting::irradiance(d, points.up()));
    for (const std::size_t fine : {std::size_t{0}, std::size_t{1}}) {
      stage.update({}, mean, around, open);
      stage.update({&d, 1}, mean, around, open, fine);
      std::vector<compositor::ShadowMapOnPlane> maps;
      stage.shadows(open, maps);
      for (const glm::dvec3& p : points.floor()) {
        double virtual_occlusion = 0;
        for (const auto& m : maps) virtual_occlusion += at_plane(*m.shadow, p);
        traced.virtual_occlusion[fine].push_back(virtual_occlusion);
      }
    }
    std::ranges::fill(relit, 0.f);
    stage.add_light(0, relit);
    for (const auto& patch : points.patches()) {
      double sum = 0;
      for (const std::uint32_t v : patch)
        sum += luminance(Rgb{relit[v], relit[transfer.stride + v], relit[2 * transfer.stride + v]});
      traced.object.push_back(sum / static_cast<double>(patch.size()));
    }
  }
  return out;
}

Result<Trial> Trial::make(const TrialScene& scene, const Image<Rgb>& map, int rays) {
  Trial out;
  out.scene_ = &scene;
  out.points_ = std::make_shared<const Points>(scene.prepared);
  PENUMBRA_ASSIGN(
      truth, trace_truth(scene.prepared, out.points_->floor(), out.points_->patches(), map, rays));
  out.truth_ = std::move(truth);
  if (!measured_errors(out.truth_, out.truth_))
    return fail(ErrorCode::kUndetermined, "scene", "has no shadow to measure");
  PENUMBRA_ASSIGN(as_it_is, split(scene, *out.points_, map, 1));
  PENUMBRA_ASSIGN(in_blocks, split(scene, *out.points_, map, lighting::kMapBlock));
  out.splits_ = {std::move(as_it_is), std::move(in_blocks)};
  std::vector<lighting::DistantLight> lights;
  for (const TrialLight& t : out.splits_[0].lights) lights.push_back(t.light);
  const lighting::Governor::Limits limits;
  out.predicted_.predict(
      {&out.splits_[0].residual.upper_moments, lights, map.height(), lighting::kMapBlock},
      runtime::scene_probes(scene.prepared, limits.max_bands), limits.max_bands, limits.max_lights);
  return out;
}

// As the composite makes them.
TrialValues Trial::values(const lighting::Treatment& t) const {
  const Points& points = *points_;
  const Split& split = splits_[t.map_step > 1 ? 1 : 0];
  const auto used = std::min(static_cast<std::size_t>(t.lights), split.lights.size());
  RadianceSh whole = split.residual.light, moments = split.residual.upper_moments,
             reflected(prt::kReflectedBands);
  double distant = 0;
  for (std::size_t j = 0; j < split.lights.size(); ++j) {
    const lighting::DistantLight& d = split.lights[j].light;
    if (j < used) {
      distant += split.lights[j].irradiance;
      const RadianceSh own = runtime::reflected_for(d, points.level());
      for (int n = 0; n < reflected.size(); ++n) reflected[n] += own[n];
      continue;
    }
    const RadianceSh own = project_distant_light(d, kMaxBands),
                     above = project_upper_distant_light(d, kMaxBands);
    for (int n = 0; n < kMaxCoefficients; ++n) whole[n] += own[n], moments[n] += above[n];
  }
  const RadianceSh light = points.light_here(whole, moments, t.bands),
                   lights = points.reflected_here(reflected, points.object().baked.reflected.bands);
  const double open = points.open_irradiance(light) + distant;
  TrialValues out;
  for (std::size_t p = 0; p < points.floor().size(); ++p) {
    double lost = points.deficit(p, light);
    if (used > 0) lost -= points.reflected(p, lights);
    for (std::size_t j = 0; j < used; ++j) {
      const bool fine = j < static_cast<std::size_t>(t.fine_lights);
      lost += split.lights[j].virtual_occlusion[fine ? 1 : 0][p] * split.lights[j].irradiance;
    }
    out.ratio.push_back(open > 0 ? std::clamp(1 - lost / open, 0., 1.5) : 1);
  }
  const prt::BakedObject& baked = points.object().baked;
  for (std::size_t p = 0; p < points.patches().size(); ++p) {
    double sum = points.at_patch(p, baked.transfer, light);
    if (used > 0) sum += points.at_patch(p, baked.reflected, lights);
    for (std::size_t j = 0; j < used; ++j) sum += split.lights[j].object[p];
    out.object.push_back(sum);
  }
  return out;
}

lighting::PredictedErrors Trial::measured(const lighting::Treatment& treatment) const {
  return *measured_errors(values(treatment), truth_);  // the truth has a shadow: see make
}

}  // namespace penumbra::tools
