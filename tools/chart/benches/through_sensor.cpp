#include "tools/chart/benches/through_sensor.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response_table.h"
#include "capture/hdr/merge.h"
#include "capture/studio/studio.h"
#include "core/conventions.h"
#include "lighting/estimate.h"
#include "runtime/governor/governor_config.h"
#include "runtime/pipeline/pipeline.h"
#include "tools/common/progress.h"
#include "tools/runs/side_by_side.h"

namespace penumbra::tools {

namespace {

constexpr int kSensorWidth = 256, kSensorHeight = 192;
constexpr double kViewFps = 5;
// Suns are recovered from the floor once a second, and lights fade in; then as many noisy frames of
// one moment as make their own noise small.
constexpr int kSettling = 13, kAveraged = 8;
constexpr double kStepSeconds = .3;  // a walker with one leg before the other
constexpr double kVignetting = .3;   // of the view camera

// A far map, and a picture of what the view camera sees.
class PicturedWorld : public capture::RadianceWorld {
 public:
  PicturedWorld(const Image<Rgb>& map, const Image<Rgb>& picture, const calib::CameraModel& lens,
                const Pose& world_from_camera)
      : map_(map), picture_(picture), lens_(lens), world_from_camera_(world_from_camera) {}
  Rgb far_radiance(const glm::dvec3& direction) const override {
    const glm::dvec2 at = latlong_pixel(direction, map_.width(), map_.height());
    return nearest(map_, at);
  }
  Rgb radiance(const glm::dvec3&, const glm::dvec3& direction) const override {
    const auto at =
        calib::pixel_of_lens(lens_, glm::conjugate(world_from_camera_.rotation) * direction);
    return at ? nearest(picture_, *at) : Rgb{};
  }

 private:
  static Rgb nearest(const Image<Rgb>& picture, const glm::dvec2& at) {
    return picture.at(std::clamp(static_cast<int>(std::floor(at.x)), 0, picture.width() - 1),
                      std::clamp(static_cast<int>(std::floor(at.y)), 0, picture.height() - 1));
  }
  const Image<Rgb>&map_, &picture_;
  calib::CameraModel lens_;
  Pose world_from_camera_;
};

runtime::SceneObject object_at(const std::string& asset, const glm::dvec3& position) {
  runtime::SceneObject o;
  o.asset = asset;
  o.name = asset.starts_with("builtin:") ? asset.substr(8)
                                         : std::filesystem::path(asset).stem().string();
  o.albedo = {.6f, .6f, .6f};
  o.position = position;
  o.place_on_floor = true;
  o.fit_size_m = .45;
  if (asset == "builtin:walker") o.animation = "Walk";
  return o;
}

runtime::RealGeometry grey_floor() {
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  return floor;
}

runtime::RealGeometry block(double size_m, const glm::dvec3& position) {
  runtime::RealGeometry out;
  out.mesh = "builtin:box";
  out.albedo = Rgb{.5f, .42f, .35f};
  out.position = position;
  out.place_on_floor = true;
  out.fit_size_m = size_m;
  return out;
}

prt::PinholeView sensor_view(double focal_px) {
  return {kSensorWidth,
          kSensorHeight,
          {focal_px, focal_px},
          {kSensorWidth / 2., kSensorHeight / 2.},
          capture::look_at({.25, .95, 1.45}, {0, .15, 0})};
}

calib::CameraModel lens_of(calib::ProjectionKind kind, const prt::PinholeView& view,
                           const std::array<double, 5>& distortion) {
  return {kind, view.width, view.height, view.focal_px, view.principal_px, distortion};
}

capture::StudioOptions studio_options(const SensorSettings& settings, const prt::PinholeView& view,
                                      const std::optional<calib::CameraModel>& lens,
                                      const Image<Rgb>& map) {
  capture::StudioOptions o;
  o.environment_width = map.width();
  o.environment_height = map.height();
  o.view_width = view.width;
  o.view_height = view.height;
  o.view_focal_px = view.focal_px.x;
  o.view_lens = lens;
  o.world_from_view = view.world_from_camera;
  o.view_fps = kViewFps;
  o.view_frames = kSettling + kAveraged;
  o.sensor.bits = settings.bits;
  o.sensor.response = settings.bits == 8 ? calib::Response::srgb() : calib::Response::linear();
  o.sensor.vignetting = kVignetting;
  o.schedule = capture::choose_schedule(map, o.sensor, settings.shortest_exposure);
  return o;
}

// Back to radiance, as whoever has the camera's response would.
void add_radiance(const FramePixels& pixels, const capture::CameraInfo& camera, double exposure,
                  Image<Rgb>& sum) {
  const Vignetting vignetting = calib::vignetting_of(camera.projection, camera.vignetting);
  const auto add = [&](const auto& image, const ResponseTable& curve) {
    for (int y = 0; y < sum.height(); ++y)
      for (int x = 0; x < sum.width(); ++x) {
        const auto& c = image.at(x, y);
        const auto scale = static_cast<float>(1 / (exposure * vignetting.at({x + .5, y + .5})));
        sum.at(x, y) +=
            Rgb{curve.decode(0, c.r), curve.decode(1, c.g), curve.decode(2, c.b)} * scale;
      }
  };
  if (const auto* codes = std::get_if<Image<Rgb8>>(&pixels))
    add(*codes, capture::make_response_table(camera.response, 8, camera.black_level));
  else if (const auto* wide = std::get_if<Image<Rgb16>>(&pixels))
    add(*wide, capture::make_response_table(camera.response, 16, camera.black_level));
}

}  // namespace

std::vector<SensorScene> sensor_scenes(std::span<const std::string> assets) {
  std::vector<SensorScene> out;
  for (const std::string& asset : assets) {
    SensorScene scene{"", {{object_at(asset, {0, 0, 0})}, {grey_floor()}}, 0};
    scene.name = scene.scene.objects[0].name;
    if (!scene.scene.objects[0].animation.empty()) scene.seconds = kStepSeconds;
    out.push_back(std::move(scene));
  }
  const std::string& first = assets[0];
  const runtime::SceneObject twist = object_at("builtin:twist", {.42, 0, -.25}),
                             box = object_at("builtin:box", {0, 0, .25});
  out.push_back({"three", {{object_at(first, {-.38, 0, 0}), twist, box}, {grey_floor()}}});
  // The block is .34 x .4 x .26 m when it is .4 m tall.
  runtime::SceneObject small = object_at(first, {0, .3, 0});
  small.fit_size_m = .2;
  out.push_back({"on a block", {{small}, {grey_floor(), block(.3, {0, 0, 0})}}});
  out.push_back(
      {"before a wall", {{object_at(first, {0, 0, 0})}, {grey_floor(), block(1.4, {0, 0, -.75})}}});
  return out;
}

Result<SensorBench> SensorBench::make(const SensorScene& scene, SensorLens lens) {
  SensorBench bench;
  bench.name_ = scene.name;
  bench.seconds_ = scene.seconds;
  PENUMBRA_ASSIGN(prepared, runtime::prepare(scene.scene, {}, progress_bar));
  bench.prepared_ = std::make_shared<const runtime::PreparedScene>(std::move(prepared));
  bench.given_ = bench.prepared_;
  if (scene.told) {
    PENUMBRA_ASSIGN(told, runtime::prepare(*scene.told, {}, progress_bar));
    bench.given_ = std::make_shared<const runtime::PreparedScene>(std::move(told));
  }
  // The wider the lens, the more of the floor it shows, and the smaller the object.
  constexpr std::array<double, 3> kFocal_px{280, 240, 180};
  bench.lens_kind_ = lens;
  bench.view_ = sensor_view(kFocal_px[static_cast<std::size_t>(lens)]);
  if (lens == SensorLens::kBarrel)
    bench.lens_ = lens_of(calib::ProjectionKind::kPinhole, bench.view_, {-.25, .06, .001, -.001});
  if (lens == SensorLens::kFisheye)
    bench.lens_ = lens_of(calib::ProjectionKind::kKannalaBrandt, bench.view_, {-.03, .004});
  PENUMBRA_ASSIGN(masks, make_masks(*bench.prepared_, bench.view_, scene.seconds, bench.lens_));
  bench.masks_ = std::move(masks);
  return bench;
}

Result<SensorBench::World> SensorBench::trace(const std::string& name,
                                              const Image<Rgb>& environment, double error) const {
  const StillScene in{prepared_.get(), &environment, view_, seconds_, lens_};
  PENUMBRA_ASSIGN(empty, render_real(in, error, progress_bar(name + ", empty")));
  PENUMBRA_ASSIGN(full,
                  render_reference(in, true, error, std::nullopt, progress_bar(name + ", truth")));
  std::vector<bool> shaded = shaded_floor(full.radiance, empty.radiance, masks_);
  return World{name, &environment, std::move(empty), std::move(full), std::move(shaded)};
}

// Errors against the two independent halves of the reference are multiplied, which takes out its
// noise.
SensorError SensorBench::compare(const Image<Rgb>& composite, const Image<Rgb>& camera,
                                 const World& world, double full_scale) const {
  const auto at = [](const Image<Rgb>& picture, std::size_t i) {
    return double(luminance(picture.pixels()[i]));
  };
  const auto half = [&](const Still& still, bool second, std::size_t i) {
    if (still.half_a.pixels().empty()) return at(still.radiance, i);
    return at(second ? still.half_b : still.half_a, i);
  };
  double shadow = 0, shadow_bias = 0, floor = 0, object = 0, bias = 0, mean = 0, objects = 0;
  for (std::size_t i = 0; i < masks_.object.size(); ++i) {
    const Rgb& true_radiance = world.full.radiance.pixels()[i];
    if (std::max({true_radiance.r, true_radiance.g, true_radiance.b}) > .95 * full_scale) continue;
    if (masks_.object[i]) {
      const double ours = at(composite, i);
      object += (ours - half(world.full, false, i)) * (ours - half(world.full, true, i));
      bias += ours - luminance(true_radiance);
      mean += luminance(true_radiance);
      ++objects;
    } else if (world.shaded[i] && at(camera, i) > 0) {
      const double empty_a = half(world.empty, false, i), empty_b = half(world.empty, true, i);
      if (!(empty_a > 0 && empty_b > 0)) continue;  // too dark for the reference
      const double ours = at(composite, i) / at(camera, i);
      const double a = ours - half(world.full, false, i) / empty_a,
                   b = ours - half(world.full, true, i) / empty_b;
      shadow += a * b;
      shadow_bias += (a + b) / 2;
      ++floor;
    }
  }
  SensorError out;
  // Below what the reference's noise lets tell, the mean error stands for the error.
  const auto rmse = [](double product, double mean_error) {
    return std::sqrt(std::max(product, mean_error * mean_error));
  };
  if (floor > 0) {
    out.shadow_bias = shadow_bias / floor;
    out.shadow_rmse = rmse(shadow / floor, out.shadow_bias);
  }
  if (objects > 0) {
    out.object_bias = bias / mean;
    out.object_rel_rmse = rmse(object / objects, bias / objects) / (mean / objects);
  }
  return out;
}

Result<SensorError> SensorBench::under_true_map(const World& world, double full_scale,
                                                const lighting::GovernorConfig& config) const {
  lighting::LightEstimator estimator({});
  estimator.set_governor(config);
  estimator.mirror(runtime::mirrored_roughness(*given_));
  Environment environment;
  environment.radiance = *world.environment;
  PENUMBRA_ASSIGN(light, estimator.estimate(environment));
  PENUMBRA_ASSIGN(pipeline, make_still_pipeline(*given_, view_, {}, lens_));
  PENUMBRA_ASSIGN(ours, composite_still(pipeline, view_, light, world.empty, seconds_));
  return compare(ours.radiance, world.empty.radiance, world, full_scale);
}

Result<SensorPoint> SensorBench::measure(const World& world, const SensorSettings& settings) const {
  const auto pictured = std::make_shared<PicturedWorld>(
      *world.environment, world.empty.radiance, camera_of(view_, lens_), view_.world_from_camera);
  capture::Studio studio(pictured, studio_options(settings, view_, lens_, *world.environment));
  PipelineOptions options;
  options.oversampling = 4;
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(studio.cameras(), given_, options));

  const double exposure = studio.view_exposure().product();
  const capture::CameraInfo& view_camera = studio.cameras()[1];
  Image<Rgb> composite(view_.width, view_.height), camera(view_.width, view_.height);
  int views = 0;
  while (true) {
    PENUMBRA_ASSIGN(frame, studio.next());
    if (!frame) break;
    if (pipeline.shows_surroundings(frame->camera)) {
      PENUMBRA_TRY(pipeline.add_environment(*frame));
      continue;
    }
    if (frame->for_light) {
      PENUMBRA_TRY(pipeline.composite(*frame));
      continue;
    }
    const bool counts = views++ >= kSettling;
    if (counts) frame->time = TimestampNs{0} + Seconds(seconds_);
    if (counts && !pipeline.light().valid)
      return fail(ErrorCode::kUndetermined, world.name, "gives no light that can be measured");
    PENUMBRA_ASSIGN(shown, pipeline.composite(*frame));
    if (shown.darker_view) studio.take_darker(frame->camera, *shown.darker_view);
    if (!counts) continue;
    add_radiance(shown.pixels, view_camera, exposure * kAveraged, composite);
    add_radiance(*frame->pixels, view_camera, exposure * kAveraged, camera);
  }

  SensorPoint out;
  out.environment = world.name;
  out.scene = name_;
  out.settings = settings;
  out.lens = lens_kind_;
  out.exposures = static_cast<int>(studio.schedule().size());
  out.lights = static_cast<int>(pipeline.light().lights.size());
  out.bands = pipeline.light().light.bands();
  if (const auto plan = pipeline.plan()) {
    out.lower_bound = plan->lower_bound;
    if (!plan->lower_bound) out.predicted_error = plan->error;
  }
  out.sensor = compare(composite, camera, world, 1 / exposure);
  const lighting::Governor::Limits limits{options.max_shadow_error, options.bands,
                                          options.max_lights};
  PENUMBRA_ASSIGN(config,
                  runtime::make_governor_config(*given_, limits, runtime::CostSource::kFixed));
  PENUMBRA_ASSIGN(true_map, under_true_map(world, 1 / exposure, config));
  out.true_map = true_map;
  const Image<Rgb> pictures[] = {std::move(camera), std::move(composite), world.full.radiance};
  out.strip = side_by_side(std::span<const Image<Rgb>>(pictures));
  for (Rgb& c : out.strip.pixels()) c = c * static_cast<float>(exposure);
  return out;
}

}  // namespace penumbra::tools
