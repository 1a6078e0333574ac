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

class FineFormPictures : public testing::Test {
 protected:
  void SetUp() override {
    auto made =
        Compositor::create(test::kSceneWidth, test::kSceneHeight, Compositor::Surface::kOffscreen);
    if (!made && made.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1: " << made.error().detail;
    ASSERT_TRUE(made) << made.error().detail;
    compositor_ = std::move(*made);
  }
  Image<Rgb> drawn() {
    FramePixels frame = Image<Rgb>(test::kSceneWidth, test::kSceneHeight);
    EXPECT_TRUE(compositor_->composite({test::scene_camera(), nullptr, 1}, frame));
    return std::get<Image<Rgb>>(frame);
  }

  std::unique_ptr<Compositor> compositor_;
};

TEST_F(FineFormPictures, ShowAllVerticesInTheLightOfFew) {
  prt::BakedObject ball = ball_of_two_forms();
  EXPECT_LT(ball.mesh.positions.size(), 400U);
  const RadianceSh light = test::sloped_light(1, {.4, .3, .5}, 3);
  const auto draw = [&](const prt::BakedObject& object) {
    test::add_lit(*compositor_, object, light);
    return drawn();
  };
  const BallError fine = error_of(draw(ball), lighting::irradiance(light));
  compositor_->show(0, false);
  ball.fine.reset();
  const BallError naive = error_of(draw(ball), lighting::irradiance(light));
  ASSERT_GT(fine.pixels, 1000);
  EXPECT_LT(fine.rms, .02 * fine.mean);
  EXPECT_GT(naive.rms, .04 * naive.mean);  // few vertices smear the albedo
}

TEST_F(FineFormPictures, MaterialsAreThoseOfTheFineForm) {
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
  const int handle = test::add_lit(*compositor_, ball, light);
  compositor_->set_light_fractions(
      handle, std::vector<std::array<float, 4>>(ball.mesh.positions.size(), {1, 0, 1, 0}));
  const BallError error = error_of(drawn(), lighting::irradiance(light));
  EXPECT_LT(error.rms, .03 * error.mean);
}

}  // namespace
}  // namespace penumbra::compositor
