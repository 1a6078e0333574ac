// Two objects on one floor: what they darken together.
#include <gtest/gtest.h>

#include "prt/prt.h"
#include "shadows/shadows.h"
#include "tests/support/lights.h"

namespace penumbra::shadows {
namespace {

constexpr Rgb kWhiteLight{1, 1, 1};
constexpr float kRadius = .4f;

prt::BakedObject baked(const prt::Mesh& mesh) {
  prt::BakeOptions options;
  options.bands = 5;
  options.bounces = 0;
  options.rays = 64;
  options.ground_rays = 1024;
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 96), {0, 0, 0}};
  auto object = prt::bake(mesh, options);
  EXPECT_TRUE(object);
  return object ? std::move(*object) : prt::BakedObject{};
}

const prt::BakedObject& sphere() {
  static const prt::BakedObject object =
      baked(prt::make_sphere({0, kRadius, 0}, kRadius, 3, {0, 0, 0}));
  return object;
}

PlanarShadow shadow_of(const prt::BakedObject& object, const RadianceSh& light) {
  PlanarShadow out;
  EXPECT_TRUE(compose_planar_shadow(object, light, out));
  return out;
}

// Nearest texel of an object's map at a world position on the floor, 1 outside.
double ratio_at(const prt::BakedObject& object, const PlanarShadow& shadow, const Pose& pose,
                const glm::dvec3& world, int channel = 1) {
  const glm::dvec3 p = pose.inverse() * world;
  const glm::vec2 uv = object.receiver->grid.uv({p.x, p.z});
  const int size = object.receiver->grid.size;
  const int x = static_cast<int>(uv.x * static_cast<float>(size)),
            y = static_cast<int>(uv.y * static_cast<float>(size));
  return uv.x < 0 || uv.y < 0 || x >= size || y >= size ? 1
                                                        : double(shadow.ratio.at(x, y)[channel]);
}

TEST(CombinedShadow, EqualObjectsInOnePlaceDarkenOnce) {
  const PlanarShadow alone = shadow_of(sphere(), penumbra::test::constant_light(kWhiteLight, 5));
  PlanarShadow second = alone;
  combine_shadows({&sphere(), {}, &alone}, {&sphere(), {}, &alone}, second);
  double worst = 0, naive = 0;
  for (std::size_t i = 0; i < alone.ratio.area(); ++i) {
    const double one = double(alone.ratio.pixels()[i].g);
    if (one < .02) continue;  // nothing left to share below the point of contact
    worst = std::max(worst, std::abs(one * double(second.ratio.pixels()[i].g) - one));
    naive = std::max(naive, one - one * one);
  }
  EXPECT_LT(worst, 1e-3);
  EXPECT_GT(naive, .2) << "the plain product darkens twice";
}

TEST(CombinedShadow, TurningOneOfTwoEqualSpheresChangesNothing) {
  const RadianceSh light = penumbra::test::constant_light(kWhiteLight, 5);
  const PlanarShadow alone = shadow_of(sphere(), light);
  const Pose turned{glm::angleAxis(.7, glm::dvec3(0, 1, 0)), {0, 0, 0}};
  PlanarShadow second = alone;
  combine_shadows({&sphere(), turned, &alone}, {&sphere(), {}, &alone}, second);
  for (int y = second.y0; y < second.y1; ++y)
    for (int x = second.x0; x < second.x1; ++x) {
      const double one = double(alone.ratio.at(x, y).g);
      if (one > .1) {
        // The other's map is read at its nearest texel: half a texel's change of s, at most .03
        // here.
        ASSERT_NEAR(one * double(second.ratio.at(x, y).g), one, .03) << x << " " << y;
      }
    }
}

// Two spheres side by side against rays through both; the bound and the plain product beside it.
TEST(CombinedShadow, NeighboursAreCloserToTheTruthThanTheProduct) {
  const RadianceSh light = penumbra::test::constant_light(kWhiteLight, 5);
  const PlanarShadow alone = shadow_of(sphere(), light);
  const Pose a{}, b{{1, 0, 0, 0}, {.5, 0, .1}};  // they reach into each other
  PlanarShadow second = alone;
  combine_shadows({&sphere(), a, &alone}, {&sphere(), b, &alone}, second);
  prt::ReferenceWorld world;
  world.mesh = prt::make_sphere({0, kRadius, 0}, kRadius, 3, {0, 0, 0});
  append(world.mesh, prt::make_sphere({.5f, kRadius, .1f}, kRadius, 3, {0, 0, 0}));
  const prt::EnvironmentLight sky = prt::EnvironmentLight::from_sh(light);
  world.light = &sky;
  std::vector<prt::IrradiancePoint> points;
  for (double x = -1; x <= 1.6; x += .1)
    for (double z = -1; z <= 1.2; z += .1) points.push_back({{x, 0, z}, {0, 1, 0}});
  const auto truth = prt::reference_irradiance(world, points, 1024, 1);
  ASSERT_TRUE(truth);
  double ours = 0, product = 0, count = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double s = double((*truth)[i].g) / kPi;
    if (s > .95 || s < .02) continue;
    const double first = ratio_at(sphere(), alone, a, points[i].position);
    ours += std::pow(first * ratio_at(sphere(), second, b, points[i].position) - s, 2);
    product += std::pow(first * ratio_at(sphere(), alone, b, points[i].position) - s, 2);
    ++count;
  }
  ours = std::sqrt(ours / count), product = std::sqrt(product / count);
  EXPECT_LT(ours, .05);
  EXPECT_LT(ours, .7 * product) << "product " << product;
}

// What two take together is at least what either takes and at most both of it, as far as there is
// light.
TEST(CombinedShadow, StaysInsideTheProvenInterval) {
  double max_beyond = 0, product_beyond = 0;
  const prt::GroundGrid& grid = sphere().receiver->grid;
  for (unsigned seed = 1; seed < 6; ++seed) {
    const RadianceSh light = penumbra::test::random_light(5, seed, .2f);
    const PlanarShadow alone = shadow_of(sphere(), light);
    const Pose b{{1, 0, 0, 0}, {.15 * (seed - 1), 0, .1 * (seed - 1)}};
    PlanarShadow second = alone;
    combine_shadows({&sphere(), {}, &alone}, {&sphere(), b, &alone}, second);
    for (int y = second.y0; y < second.y1; ++y)
      for (int x = second.x0; x < second.x1; ++x) {
        const glm::vec2 p = grid.position(
            {(float(x) + .5f) / float(grid.size), (float(y) + .5f) / float(grid.size)});
        for (int c = 0; c < 3; ++c) {
          const double own = 1 - double(alone.ratio.at(x, y)[c]),
                       other = 1 - ratio_at(sphere(), alone, {}, b * glm::dvec3(p.x, 0, p.y), c);
          ASSERT_TRUE(std::isfinite(second.ratio.at(x, y)[c]));
          // What next to nothing leaves of the first has no ratio of its own.
          if (own <= 0 || other <= 0 || other > .95) continue;
          const double taken = 1 - (1 - other) * double(second.ratio.at(x, y)[c]),
                       smallest = std::max(own, other), largest = std::min(1., own + other);
          max_beyond = std::max({max_beyond, smallest - taken, taken - largest});
          product_beyond =
              std::max(product_beyond, std::abs(1 - (1 - own) * (1 - other) - smallest));
        }
      }
  }
  EXPECT_LE(max_beyond, 1e-3);
  EXPECT_GT(product_beyond, .1) << "nothing is common to them";
}

}  // namespace
}  // namespace penumbra::shadows
