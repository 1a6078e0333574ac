#include "tools/chart/benches/chart_bench.h"

#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>

#include "capture/studio/studio.h"
#include "core/conventions.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/map_average.h"
#include "lighting/sh/projection.h"
#include "lighting/sh/rotation.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/governor/governor_config.h"
#include "runtime/pipeline/stage_access.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/object_memory.h"
#include "tools/chart/governor/governor_bench.h"
#include "tools/chart/measures/flip.h"
#include "tools/common/progress.h"

namespace penumbra::tools {

namespace {

constexpr int kRuns = 9, kManyLights = 32;
constexpr int kChartWidth = 192, kChartHeight = 144;

prt::PinholeView chart_view() {
  return {kChartWidth,
          kChartHeight,
          {210, 210},
          {kChartWidth / 2., kChartHeight / 2.},
          capture::look_at({.25, .95, 1.35}, {0, .17, 0})};
}

// The same light turned a little about a slanting axis, so that nothing of the last run can be
// kept.
lighting::LightEstimate turned(const lighting::LightEstimate& light, double radians) {
  const glm::dmat3 turn =
      glm::mat3_cast(glm::angleAxis(radians, glm::normalize(glm::dvec3(1, 1, .5))));
  lighting::LightEstimate out = light;
  const lighting::ShRotation rotation(turn, light.light.bands());
  out.light = rotation * light.light;
  out.upper_hemisphere_light = rotation * light.upper_hemisphere_light;
  for (lighting::DistantLight& d : out.lights) {
    d.direction = turn * d.direction;
    for (glm::dvec3& s : d.shape) s = turn * s;
  }
  return out;
}

// Every update with another light.
runtime::LightTime time_updates(runtime::CompositeStage& stage,
                                const lighting::LightEstimate& light) {
  constexpr double kTurn = .01;  // radians: more than DirectLightStage overlooks
  const int runs = light.lights.size() > kManyLights ? 1 : kRuns;  // these take seconds
  return runtime::time_single_threaded(
      runs, [&](int run) { stage.shade(turned(light, kTurn * (runs - run)), 0); });
}

}  // namespace

prt::Transfer with_bands(const prt::Transfer& t, int bands) {
  if (bands >= t.bands) return t;
  prt::Transfer out(bands, t.channels, t.points);
  const auto kept = static_cast<std::ptrdiff_t>(out.values.size()) / t.channels;
  for (int c = 0; c < t.channels; ++c)
    std::copy_n(t.values.begin() + static_cast<std::ptrdiff_t>(t.index(c, 0, 0)), kept,
                out.values.begin() + c * kept);
  return out;
}

runtime::PreparedScene ChartScene::prepared_with(int bands) const {
  runtime::PreparedScene out = prepared_;
  for (runtime::PreparedObject& o : out.objects) {
    o.baked.transfer = with_bands(o.baked.transfer, bands);
    o.baked.ground_deficit = with_bands(o.baked.ground_deficit, bands);
  }
  return out;
}

Result<ChartScene> ChartScene::make(const std::string& asset, int rays) {
  ChartScene bench;
  const std::string stem = std::filesystem::path(asset).stem().string();
  bench.name_ = asset.starts_with("builtin:") ? asset.substr(8) : stem;
  runtime::SceneObject object;
  object.asset = asset;
  object.name = bench.name_;
  object.albedo = {.6f, .6f, .6f};
  object.place_on_floor = true;
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  runtime::BakeSettings settings;
  settings.bands = kMaxBands;
  settings.rays = settings.ground_rays = rays;
  PENUMBRA_ASSIGN(prepared, runtime::prepare({{object}, {floor}}, settings, progress_bar));
  bench.prepared_ = std::move(prepared);
  bench.view_ = chart_view();
  PENUMBRA_ASSIGN(masks, make_masks(bench.prepared_, bench.view_));
  bench.masks_ = std::move(masks);
  return bench;
}

Result<lighting::Plan> default_plan(const ChartScene& scene, const Image<Rgb>& environment,
                                    const lighting::CostModel& costs) {
  lighting::LightExtraction split;
  PENUMBRA_TRY(lighting::extract_lights(environment, {}, split));
  PENUMBRA_ASSIGN(residual, lighting::project_latlong(split.residual, kMaxBands));
  const lighting::Governor::Limits limits;
  const bool has_blocks = lighting::divides_into_blocks(environment, lighting::kMapBlock);
  const lighting::ErrorTable table({&residual.upper_moments, split.lights, environment.height(),
                                    has_blocks ? lighting::kMapBlock : 1},
                                   runtime::scene_probes(scene.prepared(), limits.max_bands),
                                   limits.max_bands, limits.max_lights);
  return lighting::Governor({}, costs).cheapest(table, limits.max_error);
}

Result<Truth> trace_truth(const ChartScene& scene, const Image<Rgb>& environment, double error) {
  const StillScene in = scene.in(environment);
  PENUMBRA_ASSIGN(empty, render_real(in, error, {}));
  PENUMBRA_ASSIGN(full, render_reference(in, true, error, std::nullopt, progress_bar("reference")));
  return Truth{std::move(empty), std::move(full)};
}

Result<Measured> measure(const ChartScene& bench, const runtime::PreparedScene& scene,
                         const lighting::LightEstimate& light,
                         const runtime::ShadowSampling& sampling, const Truth& truth) {
  PENUMBRA_ASSIGN(pipeline, make_still_pipeline(scene, bench.view(), sampling));
  Measured out;
  out.time = time_updates(runtime::StageAccess::stage_of(pipeline), light);
  PENUMBRA_ASSIGN(ours, composite_still(pipeline, bench.view(), light, truth.empty));
  out.accuracy = compare_pictures(ours, truth.full, truth.empty, bench.masks());
  if (auto flip = hdr_flip(truth.full.radiance, ours.radiance)) out.flip = mean_flip(*flip);
  return out;
}

Result<runtime::LightTime> time_updates(const ChartScene& bench,
                                        const runtime::PreparedScene& scene,
                                        const lighting::LightEstimate& light,
                                        const runtime::ShadowSampling& sampling) {
  PENUMBRA_ASSIGN(pipeline, make_still_pipeline(scene, bench.view(), sampling));
  return time_updates(runtime::StageAccess::stage_of(pipeline), light);
}

std::size_t memory_of(const runtime::PreparedScene& scene, std::size_t lights, int map_size) {
  std::size_t bytes = 0;
  for (const runtime::PreparedObject& o : scene.objects) {
    const runtime::ObjectMemory memory =
        runtime::memory_of(o.baked, runtime::RelightBases(o.baked), map_size);
    bytes += memory.surface + memory.ground + memory.shadows;
    if (lights > 0) bytes += memory.visibility + lights * memory.bytes_a_light;
  }
  return bytes;
}

}  // namespace penumbra::tools
