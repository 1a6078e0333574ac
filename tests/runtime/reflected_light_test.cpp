// What a stage shows of light that object and floor reflect to each other, against the bake's own
// coefficients.
#include <gtest/gtest.h>

#include <cmath>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/shading/composite_stage.h"
#include "shadows/shadows.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

constexpr int kWidth = 320, kHeight = 200;
constexpr Rgb kRed{.9f, .1f, .1f}, kFloor{.7f, .7f, .7f};

PreparedScene red_ball() {
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, kFloor, {}});
  prt::Mesh mesh = prt::make_sphere({0, .2f, 0}, .2f, 4, kRed);
  prt::BakeOptions bake;
  bake.rays = 256, bake.ground_rays = 1024;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 64), kFloor};
  scene.objects.push_back({"ball", *prt::bake(std::move(mesh), bake), {}, 0, nullptr});
  return scene;
}

capture::CameraInfo camera() {
  capture::CameraInfo c;
  c.name = "view", c.role = capture::Role::kView;
  c.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, kWidth, kHeight);
  c.projection.focal_px = {300, 300};
  c.world_from_camera = capture::look_at({0, 1.2, 1.2}, {0, .1, 0});
  return c;
}

// A sun behind the camera, half of all light.
lighting::LightEstimate sunny() {
  lighting::LightEstimate out;
  out.light = RadianceSh(3);
  out.light[0] = Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi) / kPi);
  out.upper_hemisphere_light = out.light;
  out.valid = true;
  lighting::DistantLight& sun = out.lights.emplace_back();
  sun.id = 1;
  sun.direction = glm::normalize(dvec3(0, 1, 1.5));
  sun.radius = Radians(.01);
  sun.radiance = Rgb{1, 1, 1} * static_cast<float>(1.5 / sun.solid_angle_sr());
  out.mean_radiance = Rgb{1, 1, 1} * .4f;
  return out;
}

// The pixel that shows a place, and what of the floor is in its middle.
glm::ivec2 pixel_of(const calib::CameraModel& p, const Pose& world_from_camera,
                    const dvec3& place) {
  const dvec3 seen = world_from_camera.inverse() * place;
  return {p.principal_px + p.focal_px * glm::dvec2(seen.x, -seen.y) / -seen.z};
}
dvec3 floor_under(const calib::CameraModel& p, const Pose& world_from_camera, glm::ivec2 pixel) {
  const glm::dvec2 off = (glm::dvec2(pixel) + .5 - p.principal_px) / p.focal_px;
  const dvec3 way = world_from_camera.rotation * dvec3(off.x, -off.y, -1),
              eye = world_from_camera.translation;
  return eye - eye.y / way.y * way;
}

Rgb ratio_at(const shadows::PlanarShadow& shadow, const prt::GroundGrid& grid, const dvec3& place) {
  const glm::vec2 texel = grid.uv(glm::vec2(place.x, place.z)) * float(grid.size) - .5f,
                  part = glm::fract(texel);
  const glm::ivec2 first(glm::floor(texel));
  const auto at = [&](int x, int y) { return shadow.ratio.at(first.x + x, first.y + y); };
  return (1 - part.y) * ((1 - part.x) * at(0, 0) + part.x * at(1, 0)) +
         part.y * ((1 - part.x) * at(0, 1) + part.x * at(1, 1));
}

// Before the sunlit side the floor turns red. By all coefficients of the bake, one light after the
// other.
TEST(ReflectedLight, OnTheFloorIsThatOfTheBake) {
  const PreparedScene scene = red_ball();
  const prt::BakedObject& baked = scene.objects[0].baked;
  const capture::CameraInfo view = camera();
  StageTimes times;
  auto stage =
      CompositeStage::create({view}, scene, compositor::Compositor::Surface::kOffscreen, times);
  if (!stage && stage.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << stage.error().detail;
  ASSERT_TRUE(stage) << stage.error().detail;
  const lighting::LightEstimate light = sunny();
  capture::Frame frame;
  frame.exposure = {Seconds(1), Gain(1)};
  frame.world_from_camera = view.world_from_camera;
  frame.pixels = std::make_shared<const FramePixels>(Image<Rgb>(kWidth, kHeight, Rgb{1, 1, 1}));
  auto out = (*stage)->process(frame, light);
  ASSERT_TRUE(out) << out.error().detail;
  const auto& picture = std::get<Image<Rgb>>(out->pixels);

  shadows::ReceiverLight on_floor(light.upper_hemisphere_light), no_reflection = on_floor;
  on_floor.lights = reflected_in_bake_frame(reflected_for(light.lights[0], true), true, {});
  on_floor.distant_irradiance = lighting::irradiance(light.lights[0], {0, 1, 0});
  no_reflection.distant_irradiance = on_floor.distant_irradiance;
  shadows::PlanarShadow expected, without;
  ASSERT_TRUE(shadows::compose_planar_shadow(baked, on_floor, expected));
  ASSERT_TRUE(shadows::compose_planar_shadow(baked, no_reflection, without));
  float largest = 0;
  for (const double z : {.12, .16, .2, .25, .3, .4}) {
    const glm::ivec2 pixel = pixel_of(view.projection, view.world_from_camera, {.02, 0, z});
    const dvec3 place = floor_under(view.projection, view.world_from_camera, pixel);
    const Rgb shown = picture.at(pixel.x, pixel.y),
              wanted = ratio_at(expected, baked.receiver->grid, place),
              dark = ratio_at(without, baked.receiver->grid, place);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(shown[c], wanted[c], .005) << z << " m, colour " << c;
    largest = std::max(largest, wanted.r - dark.r);
  }
  EXPECT_GT(largest, .05) << "nothing is reflected";
}

}  // namespace
}  // namespace penumbra::runtime
