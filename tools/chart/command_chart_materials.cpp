// Error against time of ways to draw what mirrors its surroundings.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "capture/frames.h"
#include "capture/studio/environments.h"
#include "capture/studio/studio.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/threads/stage_times.h"
#include "lighting/estimate.h"
#include "prt/geometry/material.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/light_chart.h"
#include "tools/chart/charts/panel_plot.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/core_limit.h"
#include "tools/pictures/still.h"
#include "tools/plots/gnuplot.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

struct ChartedMaterial {
  const char* name;
  prt::Material material;
};
const Rgb kSteel{.55f, .56f, .55f};
const std::vector<ChartedMaterial>& charted_materials() {
  static const std::vector<ChartedMaterial> all = {
      {"chrome", {.base_colour = kSteel, .metallic = 1, .roughness = .05f}},
      {"gold", {.base_colour = {1, .77f, .34f}, .metallic = 1, .roughness = .25f}},
      {"brushed steel", {.base_colour = kSteel, .metallic = 1, .roughness = .5f}},
      {"plastic", {.base_colour = {.5f, .1f, .1f}, .metallic = 0, .roughness = .3f}}};
  return all;
}

struct WayToMirror {
  const char *method, *setting;
  std::optional<float> size_factor;  // of the maps; nothing: harmonics, or chalk
  bool objects = false, chalk = false;
};
constexpr std::array<WayToMirror, 9> kWays = {{{"as chalk", "", std::nullopt, false, true},
                                               {"harmonics mirrored", "", std::nullopt},
                                               {"surroundings mirrored", "1/4 of the size", .25f},
                                               {"surroundings mirrored", "half the size", .5f},
                                               {"surroundings mirrored", "the size", 1.f},
                                               {"objects too", "1/4 of the size", .25f, true},
                                               {"objects too", "half the size", .5f, true},
                                               {"objects too", "the size", 1.f, true},
                                               {"objects too", "twice the size", 2.f, true}}};

struct MaterialPoint {
  std::string mesh, environment, material;
  WayToMirror way{};
  Accuracy accuracy;
  double light_ms = 0, frame_ms = 0;
};

Result<runtime::PreparedScene> scene_of(const std::string& asset, const prt::Material& material) {
  runtime::Scene scene;
  runtime::SceneObject o;
  o.asset = asset;
  o.name = asset;
  o.albedo = material.base_colour;
  o.place_on_floor = true;
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{{0, 0, 0}, {0, 1, 0}};
  floor.albedo = Rgb{.4f, .4f, .4f};
  scene.objects = {o};
  scene.real = {floor};
  runtime::BakeSettings settings;
  settings.rays = settings.ground_rays = kBakeRays;
  PENUMBRA_ASSIGN(prepared, runtime::prepare(scene, settings, progress_bar));
  prt::BakedObject& baked = prepared.objects[0].baked;
  if (baked.fine)
    return fail(ErrorCode::kInvalid, asset, "has too many vertices for a chart of materials");
  prt::SurfaceMaterials surface;
  surface.materials = {material};
  surface.material.assign(baked.mesh.positions.size(), 0);
  baked.surface = std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
  return prepared;
}

const prt::PinholeView kView{
    192, 144, {210, 210}, {96, 72}, capture::look_at({.25, .95, 1.35}, {0, .2, 0})};

double median(std::vector<double> v) {
  std::ranges::nth_element(v, v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2));
  return v[v.size() / 2];
}

// One case: a material of an object in an environment, its truth traced once.
class MaterialCase {
 public:
  static Result<MaterialCase> make(runtime::PreparedScene scene, const Image<Rgb>& map,
                                   double error) {
    MaterialCase out;
    out.scene_ = std::make_unique<runtime::PreparedScene>(std::move(scene));
    out.map_ = std::make_unique<Image<Rgb>>(with_floor_below(map, out.scene_->planes));
    PENUMBRA_ASSIGN(masks, make_masks(*out.scene_, kView));
    out.masks_ = std::move(masks);
    PENUMBRA_ASSIGN(empty, render_real(out.in(), error, {}));
    out.empty_ = std::move(empty);
    PENUMBRA_ASSIGN(truth, render_reference(out.in(), true, error, std::nullopt, {}));
    out.truth_ = std::move(truth);
    return out;
  }

  Result<void> measure(MaterialPoint& point) {
    const WayToMirror& way = point.way;
    lighting::LightEstimator estimator({5, {}});
    if (way.size_factor) estimator.mirror(runtime::mirrored_roughness(*scene_), *way.size_factor);
    Environment environment;
    environment.radiance = *map_;
    lighting::LightEstimate light;
    std::vector<double> times;
    for (int i = 0; i < kTimings; ++i) {
      const Stopwatch watch;
      PENUMBRA_TRY(estimator.estimate(environment, light));
      times.push_back(watch.ms());
    }
    point.light_ms = median(times);
    runtime::ShadowSampling sampling;
    sampling.mirrored_objects = way.objects;
    const auto surface = scene_->objects[0].baked.surface;
    if (way.chalk) scene_->objects[0].baked.surface.reset();
    const auto ours = render_composite(in(), light, empty_, sampling);
    const auto frame_ms = time_frame(light, sampling);
    scene_->objects[0].baked.surface = surface;
    if (!ours) return std::unexpected(ours.error());
    if (!frame_ms) return std::unexpected(frame_ms.error());
    point.accuracy = compare_pictures(*ours, truth_, empty_, masks_);
    point.frame_ms = *frame_ms;
    return {};
  }

 private:
  static constexpr int kTimings = 7;

  StillScene in() const { return {scene_.get(), map_.get(), kView}; }
  // A live one of 1280 x 720 pixels, from where no frame was before.
  Result<double> time_frame(const lighting::LightEstimate& light,
                            const runtime::ShadowSampling& sampling) const {
    capture::CameraInfo camera;
    camera.name = "view", camera.role = capture::Role::kView;
    camera.projection = {calib::ProjectionKind::kPinhole, 1280, 720, {1100, 1100}, {640, 360}};
    StageTimes stage_times;
    PENUMBRA_ASSIGN(stage, runtime::CompositeStage::create(
                               {camera}, *scene_, compositor::Compositor::Surface::kOffscreen,
                               stage_times, 2, sampling));
    stage->keep_time();
    capture::Frame frame;
    frame.pixels = std::make_shared<const FramePixels>(Image<Rgb>(1280, 720, {.1f, .1f, .1f}));
    runtime::Composited out;
    std::vector<double> times;
    for (int i = 0; i <= kTimings; ++i) {
      frame.time = {std::int64_t{33'333'333} * i};
      frame.world_from_camera = capture::look_at({.25 + .002 * i, .95, 1.35}, {0, .2, 0});
      const Stopwatch watch;
      PENUMBRA_TRY(stage->process(frame, light, out));
      if (i > 0) times.push_back(watch.ms());
    }
    return median(times);
  }

  std::unique_ptr<runtime::PreparedScene> scene_;
  std::unique_ptr<Image<Rgb>> map_;
  Masks masks_;
  Still empty_, truth_;
};

nlohmann::ordered_json to_json(const MaterialPoint& p) {
  return {{"mesh", p.mesh},
          {"environment", p.environment},
          {"material", p.material},
          {"method", p.way.method},
          {"setting", p.way.setting},
          {"object_rel_rmse", p.accuracy.object_without_noise},
          {"object_bias", p.accuracy.object_bias},
          {"light_ms", p.light_ms},
          {"frame_ms", p.frame_ms}};
}

Result<std::vector<MaterialPoint>> measure_materials(
    const std::vector<std::string>& assets, const std::vector<ChartEnvironment>& environments,
    double error) {
  std::vector<MaterialPoint> out;
  for (const std::string& asset : assets)
    for (const ChartEnvironment& e : environments) {
      const auto progress = progress_bar(fmt::format("{} in {}", asset, e.name));
      double done = 0;
      for (const ChartedMaterial& m : charted_materials()) {
        PENUMBRA_ASSIGN(scene, scene_of(asset, m.material));
        PENUMBRA_ASSIGN(charted, MaterialCase::make(std::move(scene), e.map, error));
        for (const WayToMirror& way : kWays) {
          MaterialPoint& p = out.emplace_back(MaterialPoint{asset, e.name, m.name, way, {}});
          PENUMBRA_TRY(charted.measure(p));
        }
        if (progress) progress(++done / static_cast<double>(charted_materials().size()));
      }
    }
  return out;
}

std::string plot_of(const std::vector<MaterialPoint>& points) {
  std::vector<PanelPoint> out;
  for (const MaterialPoint& p : points)
    out.push_back({fmt::format("{} of {}, {}", p.mesh, p.material, p.environment), p.way.method,
                   p.light_ms + p.frame_ms, p.accuracy.object_without_noise});
  return panel_plot(out, charted_materials().size(), "Time of a light estimate and a frame (ms)",
                    "Error of the object (%)");
}

}  // namespace

Result<void> chart_materials(const ChartOptions& o) {
  constexpr double kError = .025;
  std::vector<std::string> assets = o.assets;
  if (assets.empty()) assets = {"builtin:ball", "builtin:knot"};
  for (const std::string& asset : assets)  // all before the long work
    PENUMBRA_TRY(runtime::load_asset(asset, {.7f, .7f, .7f}, 0));
  PENUMBRA_ASSIGN(environments, read_environments(o.environments, o.with_procedural));
  if (o.environments.empty() && !o.with_procedural) environments.resize(1);
  const CoreLimit cores;
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(points, measure_materials(assets, environments, o.error.value_or(kError)));
  PENUMBRA_TRY(output.begin());
  auto rows = nlohmann::ordered_json::array();
  for (const MaterialPoint& p : points) rows.push_back(to_json(p));
  PENUMBRA_TRY(write_bytes(output.file("materials.csv"), csv_table(rows[0], rows)));
  if (const auto plot = run_gnuplot(plot_of(points), output.file("materials.svg")); !plot)
    log_warning("the plot is not written: {}: {}", plot.error().where, plot.error().detail);
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    print_json({{"rows", rows}});
    return {};
  }
  for (const MaterialPoint& p : points)
    fmt::print(
        "{:<14} {:<10} {:<13} {:<21} {:<15} {:>6.1f} %, bias {:>+5.1f} %, light {:>5.1f} ms, "
        "frame {:>5.1f} ms\n",
        p.mesh, p.environment, p.material, p.way.method, p.way.setting,
        100 * p.accuracy.object_without_noise, 100 * p.accuracy.object_bias, p.light_ms,
        p.frame_ms);
  fmt::print("{0}/materials.csv, {0}/materials.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
