// Luminous surfaces on what stands around, against closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/conventions.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::shadows {
namespace {

struct EmitterWorld {
  prt::RayWorld rays = *prt::RayWorld::create();
  RayOccluders occluders() const { return {&rays, nullptr, 1e-4f}; }
};

constexpr double kHalfX = .2, kHalfZ = .15, kHeight = .3;

// A rectangle that looks down from kHeight, as an even grid of points.
Emitter panel(int across) {
  Emitter out;
  for (int i = 0; i < across; ++i)
    for (int j = 0; j < across; ++j) {
      out.positions.emplace_back(kHalfX * ((2 * i + 1.) / across - 1), kHeight,
                                 kHalfZ * ((2 * j + 1.) / across - 1));
      out.normals.emplace_back(0, -1, 0);
    }
  out.point_m2 = static_cast<float>(4 * kHalfX * kHalfZ / (across * across));
  return out;
}

// Irradiance over radiance below a corner of a rectangle x by z at a height (Howell, B-4), and of
// the whole panel at a place of the floor as four such corners.
double below_corner(double x, double z, double height) {
  const double a = x / height, b = z / height, ra = std::sqrt(1 + a * a), rb = std::sqrt(1 + b * b);
  return .5 * (a / ra * std::atan(b / ra) + b / rb * std::atan(a / rb));
}
double below_panel(double x, double z) {
  return below_corner(kHalfX - x, kHalfZ - z, kHeight) +
         below_corner(kHalfX + x, kHalfZ - z, kHeight) +
         below_corner(kHalfX - x, kHalfZ + z, kHeight) +
         below_corner(kHalfX + x, kHalfZ + z, kHeight);
}

TEST(Emitter, APanelFollowsTheClosedForm) {
  const EmitterWorld world;
  const std::vector<glm::vec3> points{{0, 0, 0}, {.1f, 0, .05f}, {.4f, 0, 0}, {-.6f, 0, .5f}},
      normals(points.size(), {0, 1, 0});
  std::vector<float> out(points.size());
  trace_emitter_points(world.occluders(), points, normals, panel(8), out);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double exact = below_panel(points[i].x, points[i].z);
    EXPECT_NEAR(out[i] * 4 * kHalfX * kHalfZ, exact, .01 * exact) << i;
  }
}

TEST(Emitter, AMapOfTheFloorHoldsTheSame) {
  const EmitterWorld world;
  ShadowMap map;
  const float brightest = trace_emitter_map(world.occluders(), {}, panel(8), map);
  ASSERT_FALSE(map.empty());
  for (const glm::dvec3 p : {glm::dvec3(0, 0, 0), {.3, 0, .1}, {-.5, 0, -.4}}) {
    const glm::dvec3 at = map.world_from_map.inverse() * p / double(map.cell_m);
    const int x = static_cast<int>(std::lround(at.x)), z = static_cast<int>(std::lround(at.z));
    const glm::dvec3 node =
        map.world_from_map * glm::dvec3(x * double(map.cell_m), 0, z * double(map.cell_m));
    const double exact = below_panel(node.x, node.z);
    EXPECT_NEAR(map.virtual_occlusion.at(x, z) * brightest * 4 * kHalfX * kHalfZ, exact,
                .01 * exact);
  }
  for (int i = 0; i < map.virtual_occlusion.width(); ++i)
    EXPECT_EQ(map.virtual_occlusion.at(i, 0), 0) << "ends at nothing";
}

TEST(Emitter, NearThePanelNothingBlowsUp) {
  const EmitterWorld world;
  const std::vector<glm::vec3> points{{0, float(kHeight) - .005f, 0}}, normals{{0, 1, 0}};
  float out = 0;
  trace_emitter_points(world.occluders(), points, normals, panel(8), {&out, 1});
  EXPECT_GT(out * 4 * kHalfX * kHalfZ, 0);
  EXPECT_LE(out * 4 * kHalfX * kHalfZ, 1.01 * kPi) << "that of a wall of light";
}

TEST(Emitter, SendsBehindItselfOnlyWhereItHasTwoSides) {
  const EmitterWorld world;
  const std::vector<glm::vec3> above{{0, .6f, 0}}, down{{0, -1, 0}};
  float out = -1;
  Emitter emitter = panel(8);
  trace_emitter_points(world.occluders(), above, down, emitter, {&out, 1});
  EXPECT_EQ(out, 0);
  emitter.double_sided = true;
  trace_emitter_points(world.occluders(), above, down, emitter, {&out, 1});
  EXPECT_NEAR(out * 4 * kHalfX * kHalfZ, below_panel(0, 0), .01 * below_panel(0, 0));
}

// The panel's own mesh and a screen under half of it are in the way of rays.
TEST(Emitter, ItselfHidesNothingAndAScreenHidesWhatIsBehind) {
  EmitterWorld world;
  (void)*world.rays.add(prt::make_box({-.2f, float(kHeight), -.15f}, {.2f, .4f, .15f}, 4, {}));
  const std::vector<glm::vec3> points{{0, 0, 0}}, normals{{0, 1, 0}};
  float open = 0, half = 0;
  trace_emitter_points(world.occluders(), points, normals, panel(8), {&open, 1});
  EXPECT_NEAR(open * 4 * kHalfX * kHalfZ, below_panel(0, 0), .01 * below_panel(0, 0));
  (void)*world.rays.add(prt::make_box({0, .1f, -1}, {1, .11f, 1}, 1, {}));
  trace_emitter_points(world.occluders(), points, normals, panel(8), {&half, 1});
  EXPECT_NEAR(half, open / 2, .01 * open);
}

TEST(Emitter, BelowAPlaneGivesNoMap) {
  const EmitterWorld world;
  const prt::Plane higher{{0, 1, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}};
  ShadowMap map;
  EXPECT_EQ(trace_emitter_map(world.occluders(), higher, panel(4), map), 0);
  EXPECT_TRUE(map.empty());
}

}  // namespace
}  // namespace penumbra::shadows
