#include "tools/pictures/still.h"

#include <algorithm>

#include "calib/camera/camera_model.h"
#include "capture/frames.h"
#include "compositor/composite/compositor.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/estimate.h"
#include "lighting/sh/irradiance.h"
#include "prt/reference/environment_light.h"
#include "prt/reference/reference.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/direct/scene_light.h"
#include "runtime/shading/composite_stage.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::tools {

namespace {

// In the camera's frame; 0 where the picture shows nothing.
glm::dvec3 ray_of(const calib::CameraModel& lens, glm::dvec2 px) {
  return calib::direction_from_pixel(lens, px).value_or(glm::dvec3(0));
}

// Radiance of white paper that lies in the light, as runtime::emission_unit() has it.
float emission_unit(const StillScene& in, const std::optional<lighting::LightEstimate>& light) {
  if (light) return runtime::emission_unit(*light);
  return luminance(exact_irradiance(*in.environment, {0, 1, 0})) * static_cast<float>(1 / kPi);
}

}  // namespace

calib::CameraModel camera_of(const prt::PinholeView& view,
                             const std::optional<calib::CameraModel>& lens) {
  if (lens) return *lens;
  return {calib::ProjectionKind::kPinhole, view.width, view.height, view.focal_px,
          view.principal_px};
}

Rgb exact_irradiance(const Image<Rgb>& map, const glm::dvec3& normal) {
  double sum[3] = {};
  for (int y = 0; y < map.height(); ++y) {
    const double w = latlong_solid_angle(y, map.width(), map.height());
    for (int x = 0; x < map.width(); ++x) {
      const double c =
          glm::dot(latlong_direction(x + .5, y + .5, map.width(), map.height()), normal);
      if (c <= 0) continue;
      for (int k = 0; k < 3; ++k) sum[k] += w * c * map.at(x, y)[k];
    }
  }
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

Result<Still> render_real(const StillScene& in, double error, const Progress& progress) {
  if (!in.scene->real_mesh.triangles.empty() || in.scene->planes.size() > 1)
    return render_reference(in, false, error, std::nullopt, progress);
  PENUMBRA_ASSIGN(light, prt::EnvironmentLight::from_map(*in.environment));
  std::vector<Rgb> exit_radiance;
  for (const prt::Plane& p : in.scene->planes)
    exit_radiance.push_back(p.albedo * exact_irradiance(*in.environment, p.normal) *
                            static_cast<float>(1 / kPi));
  constexpr int kSamples = 4;
  Still out;
  out.radiance = Image<Rgb>(in.view.width, in.view.height);
  const glm::dvec3 eye = in.view.world_from_camera.translation;
  const calib::CameraModel lens = camera_of(in.view, in.lens);
  parallel_for(0, in.view.height, [&](int y) {
    for (int x = 0; x < in.view.width; ++x) {
      Rgb sum;
      for (int k = 0; k < kSamples * kSamples; ++k) {
        const glm::dvec3 d = in.view.world_from_camera.rotation *
                             ray_of(lens, {x + (k % kSamples + .5) / kSamples,
                                           y + (double(k / kSamples) + .5) / kSamples});
        if (d == glm::dvec3(0)) continue;
        double nearest = 1e30;
        std::size_t hit = exit_radiance.size();
        for (std::size_t i = 0; i < exit_radiance.size(); ++i) {
          const prt::Plane& p = in.scene->planes[i];
          const double slope = glm::dot(p.normal, d), t = glm::dot(p.normal, p.point - eye) / slope;
          if (slope < 0 && t > 1e-4 && t < nearest) nearest = t, hit = i;
        }
        sum += hit < exit_radiance.size() ? exit_radiance[hit] : light.radiance(glm::vec3(d));
      }
      out.radiance.at(x, y) = sum * (1.f / (kSamples * kSamples));
    }
  });
  return out;
}

Image<Rgb> with_floor_below(Image<Rgb> map, const std::vector<prt::Plane>& planes) {
  const prt::Plane* floor = nullptr;
  for (const prt::Plane& p : planes)
    if (p.normal.y > runtime::kLevel && luminance(p.albedo) > 0 &&
        (!floor || p.point.y > floor->point.y))
      floor = &p;
  if (!floor) return map;
  const Rgb radiance =
      floor->albedo * exact_irradiance(map, floor->normal) * static_cast<float>(1 / kPi);
  for (int y = (map.height() + 1) / 2; y < map.height(); ++y)
    std::ranges::fill(map.row(y), radiance);
  return map;
}

Result<Pipeline> make_still_pipeline(const runtime::PreparedScene& scene,
                                     const prt::PinholeView& view,
                                     const runtime::ShadowSampling& sampling,
                                     const std::optional<calib::CameraModel>& lens) {
  capture::CameraInfo camera;
  camera.name = "camera";
  camera.role = capture::Role::kView;
  camera.projection = camera_of(view, lens);
  camera.world_from_camera = view.world_from_camera;
  PipelineOptions options;
  options.oversampling = 4;
  options.varies_rays = true;
  options.sampling = sampling;
  const std::shared_ptr<const runtime::PreparedScene> borrowed(std::shared_ptr<void>(), &scene);
  return Pipeline::create({camera}, borrowed, options);
}

Result<Still> composite_still(Pipeline& pipeline, const prt::PinholeView& view,
                              const lighting::LightEstimate& light, const Still& real,
                              double seconds) {
  // Between the stage's own samples, four to a pixel along each axis, so that no two share a row or
  // a column.
  constexpr double kShifts[4][2] = {{-3, -1}, {-1, 3}, {1, -3}, {3, 1}}, kUnit = 1. / 32;  // pixels
  Still out{Image<Rgb>(view.width, view.height), real.error, real.samples, {}, {}};
  const auto picture = std::make_shared<const FramePixels>(real.radiance);
  pipeline.set_light(light);
  for (const auto& [right, down] : kShifts) {
    capture::Frame frame;
    frame.exposure = {Seconds(1), Gain(1)};
    frame.time = TimestampNs{static_cast<std::int64_t>(std::llround(1e9 * seconds))};
    frame.pixels = picture;
    frame.world_from_camera = view.world_from_camera;
    frame.world_from_camera.rotation *= glm::dquat(
        glm::dvec3(-down * kUnit / view.focal_px.y, -right * kUnit / view.focal_px.x, 0));
    PENUMBRA_ASSIGN(composited, pipeline.composite(frame));
    const auto& pass = std::get<Image<Rgb>>(composited.pixels);
    for (std::size_t i = 0; i < pass.area(); ++i)
      out.radiance.pixels()[i] += pass.pixels()[i] * (1.f / std::size(kShifts));
  }
  return out;
}

Result<Still> render_composite(const StillScene& in, const lighting::LightEstimate& light,
                               const Still& real, const runtime::ShadowSampling& sampling) {
  PENUMBRA_ASSIGN(pipeline, make_still_pipeline(*in.scene, in.view, sampling, in.lens));
  return composite_still(pipeline, in.view, light, real, in.seconds);
}

const RadianceSh& light_on(const std::vector<prt::Plane>& planes,
                           const lighting::LightEstimate& light) {
  const bool level = !planes.empty() && std::ranges::all_of(planes, [](const prt::Plane& p) {
    return p.normal.y > runtime::kLevel;
  });
  return level ? light.upper_hemisphere_light : light.light;
}

Result<Still> render_reference(const StillScene& in, bool with_objects, double error,
                               const std::optional<lighting::LightEstimate>& truncated,
                               const Progress& progress) {
  PENUMBRA_ASSIGN(map_light, prt::EnvironmentLight::from_map(*in.environment));
  const prt::EnvironmentLight light =
      truncated ? prt::EnvironmentLight::from_sh(light_on(in.scene->planes, *truncated))
                : map_light;
  prt::ReferenceWorld world;
  world.mesh = runtime::world_mesh(*in.scene, with_objects, in.seconds);
  PENUMBRA_ASSIGN(surface, runtime::world_surface(*in.scene, with_objects, in.seconds));
  world.surface = std::move(surface);
  world.emission_unit = emission_unit(in, truncated);
  world.planes = in.scene->planes;
  if (with_objects)
    for (const shadows::Lamp& lamp : in.scene->lamps)
      world.lamps.push_back({lamp.position, lamp.radius_m, lamp.irradiance_at_1m});
  world.light = &light;
  world.background = [&](const glm::vec3& d) { return map_light.radiance(d); };
  prt::ReferenceOptions options;
  options.error = error;
  options.progress = progress;
  if (in.lens) options.ray = [&lens = *in.lens](glm::dvec2 pixel) { return ray_of(lens, pixel); };
  PENUMBRA_ASSIGN(reference, prt::render_reference(world, in.view, options));
  return Still{std::move(reference.radiance), reference.error, reference.samples,
               std::move(reference.half_a), std::move(reference.half_b)};
}

}  // namespace penumbra::tools
