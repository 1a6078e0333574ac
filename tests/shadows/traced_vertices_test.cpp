// What few rays find at the vertices of an object whose visibility is not known.
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "core/conventions.h"
#include "shadows/silhouette/light_rays.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;
using test::sheet;

constexpr float kTraceNear = 3e-5f;

lighting::DistantLight sun(double elevation_deg, double radius_deg = .3) {
  lighting::DistantLight d;
  const double e = elevation_deg * kPi / 180;
  d.direction = {std::cos(e) * std::cos(.4), std::sin(e), std::cos(e) * std::sin(.4)};
  d.radius = Radians(radius_deg * kPi / 180);
  d.radiance = {1, 1, 1};
  return d;
}

prt::Mesh traced_knot() {
  return prt::make_knot(.5f, 240, 40, {.5f, .5f, .5f});
}

std::vector<glm::vec3> averaged_normals(const prt::Mesh& m) {
  std::vector<glm::vec3> out(m.positions.size(), glm::vec3(0));
  for (const auto& t : m.triangles)
    for (const auto v : t)
      out[v] +=
          glm::cross(m.positions[t[1]] - m.positions[t[0]], m.positions[t[2]] - m.positions[t[0]]);
  for (glm::vec3& n : out) n = glm::normalize(n);
  return out;
}

struct TracedWorld : test::CasterWorld {
  explicit TracedWorld(std::vector<prt::Mesh> all) : CasterWorld(std::move(all), kTraceNear) {}
  std::vector<float> shared_light(const lighting::DistantLight& source) const {
    return light(source, casters[0], &rays);
  }
  // All rays for every vertex. (Those of a wide light are averaged over neighbours: triangles tell
  // which.)
  std::vector<float> own_light(const lighting::DistantLight& source, const prt::RayWorld* occluders,
                               int samples = 4) const {
    return light(
        source,
        {is_wide(source) && penumbra_exceeds_edges(source, *casters[0].silhouette) ? meshes.data()
                                                                                   : &points,
         &none, casters[0].world_from_mesh},
        occluders, samples);
  }
  // From as many rays of their own.
  std::size_t different(const lighting::DistantLight& source, float more_than = 1e-5f) const {
    const std::vector<float> shared = shared_light(source), own = own_light(source, &rays);
    std::size_t out = 0;
    for (std::size_t i = 0; i < own.size(); ++i) out += std::abs(own[i] - shared[i]) > more_than;
    return out;
  }
};

TEST(TracedVertices, GivesWhatARayForEachVertexGives) {
  for (const double elevation : {12., 40., 75., 90.})
    for (const double radius : {.05, .3, 2., 5., 8.}) {
      const TracedWorld world({traced_knot()});
      const lighting::DistantLight source = sun(elevation, radius);
      // At the terminator one ray alone may lie below the surface where others of the light do not.
      // One ray for what is not at an edge, where many have rays of their own: a sample is missing
      // at a hundredth at most.
      EXPECT_LE(world.different(source), radius == 2 ? 96u : 24u) << elevation << ", " << radius;
      EXPECT_LE(world.different(source, .3f), 12u) << elevation << ", " << radius;
    }
}

// What stands high above, or aside, casts its penumbra far.
TEST(TracedVertices, KnowsWhatStandsFarAway) {
  struct Case {
    double elevation_deg, radius_deg;
    float ball_m;
    double far_m;
  };
  for (const Case& c : {Case{60, .3, .1f, 20},
                        {90, .3, .1f, 20},
                        {90, 4, .05f, 1},
                        {90, 8, .03f, .8},
                        {90, 8, .15f, 5},
                        {60, 8, .1f, 4}}) {
    const lighting::DistantLight source = sun(c.elevation_deg, c.radius_deg);
    for (const double off : {0., .7, 1.1, 1.3, 1.5, 1.7})  // up to well aside of the sheet
      for (const double turn : {0., 1.3, 1.82, 4.}) {
        const dvec3 centre =
            c.far_m * source.direction + off * dvec3(std::cos(turn), 0, std::sin(turn));
        const TracedWorld world({sheet(60), prt::make_sphere(glm::vec3(centre), c.ball_m, 3, {})});
        EXPECT_LE(world.different(source), 4u)
            << c.far_m << " m, " << c.radius_deg << " deg, aside " << off << ", " << turn;
      }
  }
}

// A window: light from a strip is thrown aside further one way than the other.
TEST(TracedVertices, KnowsHowFarAFormReaches) {
  lighting::DistantLight window = sun(35, 2);
  const dvec3 side = glm::normalize(glm::cross(window.direction, dvec3(0, 1, 0)));
  for (int i = 0; i < 64; ++i)
    window.shape.push_back(glm::normalize(window.direction + (i / 63. - .5) * .28 * side));
  const prt::Mesh wire = prt::make_box({-.003f, .3f, -.9f}, {.003f, .306f, .9f}, 1, {});
  for (const TracedWorld& world : {TracedWorld({traced_knot()}), TracedWorld({sheet(60), wire})}) {
    EXPECT_LE(world.different(window), 4u);
  }
}

// Thinner than the distance between vertices: rays from some of them would find nothing to follow.
TEST(TracedVertices, FindsTheShadowOfAWire) {
  prt::Mesh wire = prt::make_box({-.003f, .3f, -.9f}, {.003f, .306f, .9f}, 1, {});
  prt::transform(wire, glm::rotate(glm::dmat4(1), .3, dvec3(0, 1, 0)));
  const TracedWorld world({sheet(100), wire});
  const lighting::DistantLight source = sun(60, .05);
  EXPECT_LE(world.different(source), 2u);
  const auto light = world.shared_light(source);
  EXPECT_GT(std::ranges::count_if(light, [](float l) { return l < .1f; }), 10);
}

// One sheet goes through the other: half of it lies in the shadow, and no silhouette passes over
// where that begins.
TEST(TracedVertices, SeesWhereSurfacesCutThroughEachOther) {
  prt::Mesh slanted = sheet(20);
  prt::transform(slanted,
                 glm::rotate(glm::scale(glm::dmat4(1), dvec3(3, 1, 3)), .5, dvec3(0, 0, 1)));
  const TracedWorld world({sheet(60), slanted});
  const lighting::DistantLight source = sun(80);
  const auto light = world.shared_light(source);
  const auto dark = std::ranges::count_if(light, [](float l) { return l == 0; });
  EXPECT_GT(dark, 1000);
  EXPECT_LT(dark, 2800);
  EXPECT_LE(world.different(source), 2u);
}

// A step that is turned away, in small: averaged normals at both of its ends look towards the
// light, but its foot lies in its shadow, and that is the lowest vertex of what is lit beyond.
TEST(TracedVertices, ASmallStepThatIsTurnedAwayIsDarkAtItsFoot) {
  prt::Mesh step = sheet(12);
  const auto height = [](float x) { return x < 0 ? 0.f : std::min(x, 1 / 6.f); };
  for (glm::vec3& p : step.positions) p = {p.x, height(p.x), p.z};
  step.normals = averaged_normals(step);
  const TracedWorld world({step});
  for (const double elevation : {36., 38., 40., 42., 44.}) {
    EXPECT_LE(world.different(sun(elevation)), 2u) << elevation;
  }
}

// What is kept of one light's silhouettes is not taken for another pose, plane or light: as with a
// silhouette for each object and no cache.
TEST(ShadowMap, ACacheOfSilhouettesChangesNothing) {
  TracedWorld world({traced_knot(), traced_knot()});
  world.casters[1].world_from_mesh = {glm::angleAxis(1.2, dvec3(0, 0, 1)), {.3, .2, .9}};
  world.rays.set_pose(1, world.casters[1].world_from_mesh);
  std::vector<Caster> one_outline = world.casters;
  one_outline[1].mesh = one_outline[0].mesh, one_outline[1].silhouette = one_outline[0].silhouette;
  const prt::Plane floor{}, wall{{0, 0, -.6}, {0, 0, 1}, {}, {}};
  SilhouetteCache cache;
  for (const lighting::DistantLight& source : {sun(50), sun(30), sun(50, 2), sun(.5), sun(50)}) {
    cache.clear();
    const ShadowCasters with{one_outline, {}, kTraceNear, &cache},
        without{world.casters, {}, kTraceNear};
    for (const prt::Plane& plane : {floor, wall}) {
      std::vector<ShadowMap> a, b;
      render_shadow_maps(with, plane, source, {}, a);
      render_shadow_maps(without, plane, source, {}, b);
      ASSERT_EQ(a.size(), b.size());
      EXPECT_FALSE(a.empty());
      for (std::size_t i = 0; i < a.size(); ++i)
        EXPECT_TRUE(
            std::ranges::equal(a[i].virtual_occlusion.pixels(), b[i].virtual_occlusion.pixels()));
    }
  }
}

// Of a sun that sets behind the plane on which an object stands half is left, for every vertex in
// front.
TEST(TracedVertices, OfASettingSunEveryVertexHasItsPart) {
  const TracedWorld world({prt::make_sphere({0, 1, 0}, .5f, 4, {})});
  const prt::Plane plane;
  const lighting::DistantLight source = sun(0, 2);
  std::vector<float> half(world.meshes[0].positions.size()), whole(half.size());
  for (const auto& [on, out] : {std::pair(&plane, &half), {nullptr, &whole}})
    trace_direct_light({&world.rays, nullptr, kTraceNear}, {world.casters, {}, kTraceNear},
                       world.casters[0], on, source, 4, *out);
  int in_front = 0, wrong = 0;
  for (std::size_t i = 0; i < half.size(); ++i) {
    if (glm::dot(dvec3(world.meshes[0].normals[i]), source.direction) < .2) continue;
    ++in_front;
    wrong += half[i] < .2f * whole[i] || half[i] > .8f * whole[i];
  }
  EXPECT_GT(in_front, 300);
  EXPECT_LT(wrong, in_front / 20);
}

TEST(TracedVertices, PointsWithoutTrianglesSeeForThemselves) {
  prt::Mesh points = sheet(10);
  points.triangles.resize(100);  // half of them
  const TracedWorld world({points, traced_knot()});
  EXPECT_EQ(world.different(sun(50)), 0u);
}

// A source that is no circle: 8 x 8 directions, radians from the middle to its sides.
lighting::DistantLight form(double elevation_deg, double across, double along) {
  lighting::DistantLight d = sun(elevation_deg);
  d.radius = Radians(std::sqrt(4 * across * along / kPi));
  const dvec3 side = glm::normalize(glm::cross(d.direction, dvec3(0, 1, 0))),
              up = glm::cross(side, d.direction);
  for (int i = 0; i < 64; ++i) {
    const double x = across * ((i / 8 + .5) / 4 - 1), y = along * ((i % 8 + .5) / 4 - 1);
    d.shape.push_back(glm::normalize(d.direction + x * side + y * up));
  }
  return d;
}

double rmse(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += std::pow(a[i] - b[i], 2);
  return std::sqrt(sum / static_cast<double>(a.size()));
}

// A sun behind haze: rays at its penumbras alone are as good as rays at every vertex.
TEST(TracedVertices, ASmallFormIsNarrow) {
  const TracedWorld world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
  const lighting::DistantLight source = form(40, .008, .02);
  ASSERT_FALSE(is_wide(source));
  const std::vector<float> ours = world.shared_light(source),
                           four = world.own_light(source, &world.rays),
                           dense = world.own_light(source, &world.rays, kMaxSamples);
  EXPECT_LT(rmse(ours, dense), .02);
  EXPECT_LT(rmse(ours, dense), 1.1 * rmse(four, dense));
}

// Low over the plane on which the object stands, lying or upright: what is behind the plane brings
// nothing.
TEST(TracedVertices, ASmallFormSetsInParts) {
  const TracedWorld world({prt::make_sphere({0, .6f, 0}, .5f, 5, {})});
  const prt::Plane floor;
  const auto light = [&](const Caster& object, const lighting::DistantLight& source, int samples) {
    std::vector<float> out(world.points.positions.size());
    trace_direct_light({&world.rays, nullptr, kTraceNear}, {world.casters, {}, kTraceNear}, object,
                       &floor, source, samples, out);
    return out;
  };
  for (const auto& [across, along] : {std::pair(.003, .045), {.045, .003}}) {
    const lighting::DistantLight source = form(1.5, across, along);
    ASSERT_FALSE(is_wide(source));
    EXPECT_LT(rmse(light(world.casters[0], source, 4),
                   light({&world.points, &world.none, {}}, source, kMaxSamples)),
              .04)
        << along;
  }
}

// A long window: four rays a vertex, averaged with those of its neighbours, ask all of it. (The
// first has .030 if the groups of its directions keep step, .018 if there are no groups.)
TEST(TracedVertices, NeighboursAskOtherPartsOfAForm) {
  const TracedWorld world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
  for (const auto& [across, along] : {std::pair(.08, .3), {.25, .1}}) {
    const lighting::DistantLight source = form(50, across, along);
    ASSERT_TRUE(is_wide(source));
    const std::vector<float> ours = world.shared_light(source),
                             dense = world.own_light(source, &world.rays, kMaxSamples);
    EXPECT_LT(rmse(ours, dense), .015) << across;
  }
}

// One sample: as a point in the light's middle lights, at every vertex, however wide the penumbra
// would be.
TEST(TracedVertices, OneSampleThrowsHardShadows) {
  const TracedWorld world({traced_knot()});
  const auto light = [&](const Caster& object, const lighting::DistantLight& of, int samples) {
    std::vector<float> out(world.points.positions.size());
    trace_direct_light({&world.rays, nullptr, kTraceNear}, {world.casters, {}, kTraceNear}, object,
                       nullptr, of, samples, out);
    return out;
  };
  const Caster alone{&world.points, &world.none, {}};
  const auto hard = light(alone, sun(35, .001), 4);
  for (const double radius_deg : {2., 15.}) {
    const auto ours = light(world.casters[0], sun(35, radius_deg), 1),
               soft = light(alone, sun(35, radius_deg), kMaxSamples);
    int wrong = 0, in_penumbra = 0;  // rays of either come from a rounding's distance
    // What faces all of the light has its light.
    const auto whole = static_cast<float>(.5 + .5 * std::cos(radius_deg * kPi / 180));
    for (std::size_t i = 0; i < ours.size(); ++i) {
      wrong += std::abs(ours[i] - whole * hard[i]) > .002f;
      in_penumbra += std::abs(soft[i] - hard[i]) > .01f;
    }
    EXPECT_LE(wrong, 1) << radius_deg;
    EXPECT_GT(in_penumbra, 200) << radius_deg;
  }
}

// A sun of which a little more or less than half stands over the plane.
TEST(TracedVertices, OneSampleOfASettingSunIsAllOrNothing) {
  const TracedWorld world({prt::make_sphere({0, 1, 0}, .5f, 4, {})});
  const prt::Plane plane;
  std::vector<float> out(world.meshes[0].positions.size());
  for (const double radius_deg : {2., 15.})
    for (const double elevation : {.2, -.2}) {
      trace_direct_light({&world.rays, nullptr, kTraceNear}, {world.casters, {}, kTraceNear},
                         world.casters[0], &plane, sun(elevation, radius_deg), 1, out);
      EXPECT_EQ(std::ranges::max(out) > .9f, elevation > 0) << radius_deg;
      EXPECT_EQ(std::ranges::max(out) > 0, elevation > 0) << radius_deg;
    }
}

TEST(TracedVertices, FollowsThePoseOfAnObject) {
  TracedWorld world({traced_knot()});
  const Pose pose{glm::angleAxis(.9, glm::normalize(dvec3(.2, 1, .4))), {3, 1, -2}};
  world.rays.set_pose(0, pose);
  world.casters.front().world_from_mesh = pose;
  EXPECT_LE(world.different(sun(35)), 4u);
}

}  // namespace
}  // namespace penumbra::shadows
