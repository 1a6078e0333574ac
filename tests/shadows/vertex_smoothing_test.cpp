// Light that neighbouring vertices share: noise of few rays goes, edges of shadows stay.
#include "shadows/visibility/internal/vertex_smoothing.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/conventions.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using test::CasterWorld;
using test::sheet;

lighting::DistantLight lamp_above(double radius_deg) {
  lighting::DistantLight d;
  d.direction = glm::normalize(glm::dvec3(.3, 1, .2));
  d.radius = Radians{radius_deg * kPi / 180};
  d.radiance = {1, 1, 1};
  return d;
}

double error_of(const std::vector<prt::CosineSums>& sums, const std::vector<float>& truth) {
  double sum = 0;
  for (std::size_t i = 0; i < sums.size(); ++i)
    sum += std::pow(sums[i].seen / sums[i].open - truth[i], 2);
  return std::sqrt(sum / static_cast<double>(sums.size()));
}

// So many random directions at each vertex, of which its true fraction is seen.
std::vector<prt::CosineSums> asked(const std::vector<float>& truth, int directions) {
  std::mt19937 random(5);
  std::vector<prt::CosineSums> out;
  for (const float p : truth) {
    std::binomial_distribution<int> seen(directions, double{p});
    out.push_back({static_cast<float>(seen(random)), static_cast<float>(directions)});
  }
  return out;
}

struct SharedErrors {
  double asked, averaged, ours;
};
SharedErrors share(const prt::Mesh& mesh, const std::vector<float>& truth, int directions,
                   const lighting::DistantLight& source) {
  std::vector<prt::CosineSums> sums = asked(truth, directions), averaged = sums, ours = sums;
  smooth_over_neighbours(mesh, smoothing_passes(source), averaged);
  smooth_noise_over_neighbours(mesh, source, directions, ours);
  return {error_of(sums, truth), error_of(averaged, truth), error_of(ours, truth)};
}

TEST(SharedNoise, GoesWherePenumbrasAreWide) {
  const prt::Mesh mesh = sheet(60);
  std::vector<float> truth;
  for (const glm::vec3& p : mesh.positions) truth.push_back(.5f + .4f * p.x);
  for (const double radius_deg : {6., 20.})
    for (const int directions : {2, 4, 8}) {
      lighting::DistantLight source = lamp_above(radius_deg);
      for (int k = 0; k < lighting::DistantLight::kShapePoints; ++k)  // not stratified
        source.shape.push_back(source.direction);
      const SharedErrors e = share(mesh, truth, directions, source);
      EXPECT_LT(e.ours, .55 * e.asked) << directions << ", " << radius_deg;
      EXPECT_LT(e.ours, 1.5 * e.averaged + .01) << directions << ", " << radius_deg;
    }
}

// Averages alone make two rows of vertices grey.
TEST(SharedNoise, AnEdgeSharperThanTheMeshStays) {
  const prt::Mesh mesh = sheet(60);
  std::vector<float> truth;
  for (const glm::vec3& p : mesh.positions) truth.push_back(p.x + .3f * p.z > .01f ? 1 : 0);
  for (const double radius_deg : {6., 20.}) {
    const SharedErrors e = share(mesh, truth, 4, lamp_above(radius_deg));
    EXPECT_GT(e.averaged, .05) << radius_deg;
    EXPECT_LT(e.ours, 1e-6) << radius_deg;
  }
}

TEST(SharedNoise, VerticesWhoseDirectionsLieBehindThemTakeWhatIsAround) {
  const prt::Mesh mesh = sheet(4);
  std::vector<prt::CosineSums> sums(mesh.positions.size(), {1, 2});
  sums[12] = {};
  smooth_noise_over_neighbours(mesh, lamp_above(6), 4, sums);
  EXPECT_NEAR(sums[12].seen / sums[12].open, .5, 1e-6);
}

// A plate just above a coarse floor, under a lamp: its penumbra is a tenth of an edge wide.
TEST(SharedNoise, ContactShadowsOnCoarseMeshesStaySharp) {
  prt::Mesh plate = sheet(4, .4f);
  for (glm::vec3& p : plate.positions) p.y = .02f;
  const CasterWorld world({sheet(40), plate}, 1e-4f);
  const lighting::DistantLight source = lamp_above(8);
  ASSERT_TRUE(is_wide(source));
  const Caster alone{&world.points, &world.none, {}};
  const std::vector<float> dense = world.light(source, alone, &world.rays, 64),
                           ours = world.light(source, world.casters[0], &world.rays),
                           open = world.light(source, alone, nullptr);
  std::vector<prt::CosineSums> averaged;
  std::vector<float> truth;
  const std::vector<float> few = world.light(source, alone, &world.rays);
  double sum = 0;
  for (std::size_t i = 0; i < dense.size(); ++i) {
    averaged.push_back({few[i], open[i]});
    truth.push_back(dense[i] / open[i]);
    sum += std::pow(ours[i] / open[i] - truth[i], 2);
  }
  smooth_over_neighbours(world.meshes[0], 1, averaged);
  const double error = std::sqrt(sum / static_cast<double>(dense.size()));
  EXPECT_GT(error_of(averaged, truth), .05);
  EXPECT_LT(error, .015);
}

}  // namespace
}  // namespace penumbra::shadows
