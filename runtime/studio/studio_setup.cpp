#include "runtime/studio/studio_setup.h"

#include <filesystem>

#include "calib/camera/response.h"
#include "capture/studio/environments.h"
#include "prt/geometry/mesh.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/studio/internal/real_mesh_world.h"

namespace penumbra::runtime {

namespace {

// A real thing as a rig's owner would describe it: about as large as the objects, where they leave
// room.
RealGeometry place_real_mesh(const std::string& asset, bool behind) {
  RealGeometry real;
  real.mesh = asset;
  real.albedo = Rgb{.55f, .42f, .3f};
  real.position = behind ? glm::dvec3(.12, 0, -.42) : glm::dvec3(.45, 0, -.15);
  real.place_on_floor = true;
  real.fit_size_m = .42;
  return real;
}

std::string name_of(const std::string& asset) {
  constexpr std::string_view kBuiltIn = "builtin:";
  return asset.starts_with(kBuiltIn) ? asset.substr(kBuiltIn.size())
                                     : std::filesystem::path(asset).stem().string();
}

Result<std::shared_ptr<const capture::RadianceWorld>> with_real_mesh(
    std::shared_ptr<const capture::FloorWorld> floor, const RealGeometry& real,
    const std::function<void(double)>& progress) {
  PENUMBRA_ASSIGN(asset, load_asset(real.mesh, *real.albedo, 0));
  prt::Mesh& mesh = asset.mesh;
  prt::transform(mesh, world_from_mesh(real, mesh));
  auto world = RealMeshWorld::make(std::move(floor), std::move(mesh), progress);
  if (!world) return fail(world.error().code, real.mesh, world.error().detail);
  return std::move(*world);
}

}  // namespace

Result<StudioSetup> set_up_studio(
    const StudioRequest& r,
    const std::function<std::function<void(double)>(const std::string&)>& progress) {
  StudioSetup out;
  Image<Rgb> map;
  if (r.environment) {
    PENUMBRA_ASSIGN(light,
                    read_light(*r.environment, {.rotation_deg = r.environment_rotation_deg}));
    PENUMBRA_ASSIGN(latlong, whole_latlong(light));
    map = std::move(latlong);
  } else {
    map = capture::make_room_environment(4096, 2048);
  }
  auto world =
      capture::FloorWorld::make(std::move(map), capture::FloorWorld::Ground::kGreyUnderSky);
  if (!world)
    return fail(world.error().code, r.environment.value_or("environment"), world.error().detail);
  const std::shared_ptr<const capture::FloorWorld> floor_world = std::move(*world);
  out.world = floor_world;

  capture::StudioOptions& o = out.options;
  o.view_width = r.width;
  o.view_height = r.height;
  o.view_focal_px = 1.15 * r.height * 16 / 9 / 1.4;  // 60 degrees across at 16:9
  o.world_from_view =
      capture::look_at({.25, capture::FloorWorld::kCaptureHeight, 1.75}, {.02, .3, 0});
  o.view_fps = r.fps;
  o.view_frames = r.frames;
  o.clip = r.clip;
  o.sensor.response = calib::Response::srgb();
  o.white = floor_world->floor_irradiance();

  RealGeometry floor;
  floor.plane = RealPlane{};
  floor.albedo = floor_world->mean_floor_albedo();
  out.scene.real.push_back(floor);
  if (r.real_mesh) {
    out.scene.real.push_back(place_real_mesh(*r.real_mesh, r.animated));
    PENUMBRA_ASSIGN(furnished, with_real_mesh(floor_world, out.scene.real.back(),
                                              progress("light on the real mesh")));
    out.world = std::move(furnished);
  }
  SceneObject still;
  still.asset = r.asset.value_or(r.animation ? "builtin:walker" : "builtin:knot");
  still.animation = r.animation.value_or("");
  still.name = name_of(still.asset);
  still.albedo = {.62f, .60f, .57f};
  still.place_on_floor = true;
  still.fit_size_m = r.animation ? .8 : .5;
  if (r.animated) still.position = {-.22, 0, .05};
  out.scene.objects.push_back(still);
  if (r.animated) {
    SceneObject turning;
    turning.asset = "builtin:twist";
    turning.name = "twist";
    turning.albedo = {.66f, .32f, .18f};
    turning.position = {.42, 0, -.12};
    turning.place_on_floor = true;
    turning.fit_size_m = .5;
    turning.spin_rpm = 10;
    out.scene.objects.push_back(turning);
  }
  return out;
}

}  // namespace penumbra::runtime
