// Objects that are drawn in full and lit at few vertices, as the compositor draws them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <memory>

#include "compositor/composite/compositor.h"
#include "lighting/lighting.h"
#include "prt/rays/fine_form.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using glm::dvec3;

constexpr double kBallRadius = .4;
const dvec3 kBallCentre{0, .4, 0};

Rgb half_and_half(const dvec3& n) {
  return n.x < 0 ? Rgb{.8f, .1f, .1f} : Rgb{.1f, .6f, .1f};
}

prt::BakedObject ball_of_two_forms() {
  prt::Mesh fine = prt::make_sphere(kBallCentre, kBallRadius, 5, {1, 1, 1});
  for (std::size_t i = 0; i < fine.normals.size(); ++i)
    fine.albedo[i] = half_and_half(dvec3(fine.normals[i]));
  prt::BakeOptions options;
  options.bands = 3;
  options.bounces = 0;
  options.rays = 64;
  auto baked = prt::bake(prt::simplify(fine, 300).mesh, options);
  EXPECT_TRUE(baked);
  auto form = prt::lit_by(fine, baked->mesh);
  EXPECT_TRUE(form);
  baked->fine = std::make_shared<const prt::FineForm>(std::move(*form));
  return std::move(*baked);
}

struct BallError {
  double rms = 0, mean = 0;
  int pixels = 0;
};
// Against a sphere of that albedo in that light, but for the edge and the seam of its halves.
BallError error_of(const Image<Rgb>& picture, const IrradianceSh& irradiance) {
  const prt::PinholeView v = test::scene_camera();
  BallError out;
  for (int y = 0; y < test::kSceneHeight; ++y)
    for (int x = 0; x < test::kSceneWidth; ++x) {
      const dvec3 eye = v.world_from_camera.translation, d = test::pixel_ray(v, x + .5, y + .5);
      const double b = glm::dot(eye - kBallCentre, d),
                   c = glm::dot(eye - kBallCentre, eye - kBallCentre) - kBallRadius * kBallRadius,
                   root = b * b - c;
      if (root < .1 * kBallRadius * kBallRadius) continue;
      const dvec3 n = (eye + d * (-b - std::sqrt(root)) - kBallCentre) / kBallRadius;
      if (std::abs(n.x) < .06) continue;
      const double truth = half_and_half(n).g * lighting::evaluate(irradiance, n).g / kPi,
                   error = picture.at(x, y).g - truth;
      out.rms += error * error, out.mean += truth, ++out.pixels;
    }
  out.rms = std::sqrt(out.rms / out.pixels), out.mean /= out.pixels;
  return out;
}

TEST(FineFormPictures, ShowAllVerticesInTheLightOfFew) {
  auto compositor =
      Compositor::create(test::kSceneWidth, test::kSceneHeight, Compositor::Surface::kOffscreen);
  if (!compositor && compositor.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1: " << compositor.error().detail;
  ASSERT_TRUE(compositor);
  prt::BakedObject ball = ball_of_two_forms();
  EXPECT_LT(ball.mesh.positions.size(), 400U);
  const RadianceSh light = test::sloped_light(1, {.4, .3, .5}, 3);
  const auto draw = [&](const prt::BakedObject& object) {
    (*compositor)->show(test::add_lit(**compositor, object, light), true);
    FramePixels frame = Image<Rgb>(test::kSceneWidth, test::kSceneHeight);
    EXPECT_TRUE((*compositor)->composite({test::scene_camera(), nullptr, 1}, frame));
    return std::get<Image<Rgb>>(frame);
  };
  const BallError fine = error_of(draw(ball), lighting::irradiance(light));
  (*compositor)->show(0, false);
  ball.fine.reset();
  const BallError naive = error_of(draw(ball), lighting::irradiance(light));
  ASSERT_GT(fine.pixels, 1000);
  EXPECT_LT(fine.rms, .02 * fine.mean);
  EXPECT_GT(naive.rms, .04 * naive.mean);  // few vertices smear the albedo
}

TEST(FineFormPictures, MaterialsAreThoseOfTheFineForm) {
  auto compositor =
      Compositor::create(test::kSceneWidth, test::kSceneHeight, Compositor::Surface::kOffscreen);
  if (!compositor && compositor.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1: " << compositor.error().detail;
  ASSERT_TRUE(compositor);
  prt::BakedObject ball = ball_of_two_forms();
  const auto surface_for = [](const prt::Mesh& mesh) {
    prt::SurfaceMaterials s;
    s.materials = {{.metallic = 0, .roughness = 1, .specular = 0}};
    s.material.assign(mesh.positions.size(), 0);
    for (const glm::vec3& n : mesh.normals) s.tint.push_back(half_and_half(dvec3(n)));
    return std::make_shared<const prt::SurfaceMaterials>(std::move(s));
  };
  auto fine = std::make_shared<prt::FineForm>(*ball.fine);
  fine->surface = surface_for(fine->mesh);
  ball.surface = surface_for(ball.mesh);
  ball.fine = fine;
  const RadianceSh light = test::sloped_light(1, {.4, .3, .5}, 3);
  const int handle = test::add_lit(**compositor, ball, light);
  (*compositor)
      ->set_light_shares(
          handle, std::vector<std::array<float, 4>>(ball.mesh.positions.size(), {1, 0, 1, 0}));
  FramePixels frame = Image<Rgb>(test::kSceneWidth, test::kSceneHeight);
  ASSERT_TRUE((*compositor)->composite({test::scene_camera(), nullptr, 1}, frame));
  const BallError error = error_of(std::get<Image<Rgb>>(frame), lighting::irradiance(light));
  EXPECT_LT(error.rms, .03 * error.mean);
}

}  // namespace
}  // namespace penumbra::compositor
