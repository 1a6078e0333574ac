// Vertices that share a ray have the light that a ray of their own would give them.
#include "shadows/shadows.h"
#include "prt/prt.h"
#include "lighting/lighting.h"
#include "shadows/visibility/internal/shared_sight.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "core/conventions.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;
using test::sheet;

constexpr float kNear = 3e-5f;

lighting::Disc sun(double elevation_deg, double radius_deg = .3) {
  lighting::Disc d;
  const double e = elevation_deg * kPi / 180;
  d.direction = {std::cos(e) * std::cos(.4), std::sin(e), std::cos(e) * std::sin(.4)};
  d.radius = Radians(radius_deg * kPi / 180);
  d.radiance = {1, 1, 1};
  return d;
}

prt::Mesh knot() {
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

struct World : test::CasterWorld {
  explicit World(std::vector<prt::Mesh> all) : CasterWorld(std::move(all), kNear) {}
  std::vector<float> shared_light(const lighting::Disc& disc) const {
    return light(disc, casters[0], &rays);
  }
  // All rays for every vertex. (Those of a broad disc are averaged over neighbours: triangles tell which.)
  std::vector<float> own_light(const lighting::Disc& disc, const prt::RayWorld* blockers,
                               int taps = 4) const {
    return light(disc,
                 {is_broad(disc) && is_smooth(disc, *casters[0].outline) ? meshes.data() : &points,
                  &none, casters[0].world_from_mesh},
                 blockers, taps);
  }
  // From as many rays of their own; what outlines tell in part from many, by an eighth of the disc.
  std::size_t different(const lighting::Disc& disc, float more_than = 1e-5f) const {
    const std::vector<float> shared = shared_light(disc), own = own_light(disc, &rays),
                             dense = own_light(disc, &rays, kMostTaps);
    const SharedSight found = sight(disc);
    std::size_t out = 0;
    for (std::size_t i = 0; i < own.size(); ++i)
      out += found.group()[i] == SharedSight::kInPart
                 ? std::abs(dense[i] - shared[i]) > std::max(more_than, .125f)
                 : std::abs(own[i] - shared[i]) > more_than;
    return out;
  }
  // Grouped vertices of a level sheet that do not see as much as the first of their group, all or nothing.
  std::size_t misplaced(const lighting::Disc& disc) const {
    const std::vector<float> own = own_light(disc, &rays), open = own_light(disc, nullptr);
    const SharedSight found = sight(disc);
    std::vector<int> seen(found.groups(), -1);
    std::size_t out = 0;
    for (std::size_t i = 0; i < own.size(); ++i) {
      if (found.group()[i] >= found.groups()) continue;
      const int here = own[i] > open[i] - 1e-5f ? 1 : own[i] < 1e-5f ? 0 : 2;
      int& first = seen[found.group()[i]];
      if (first < 0) first = here;
      out += here == 2 || here != first;
    }
    return out;
  }
};

TEST(SharedSight, GivesWhatARayForEachVertexGives) {
  for (const double elevation : {12., 40., 75., 90.})
    for (const double radius : {.05, .3, 2., 5., 8.}) {
      const World world({knot()});
      const lighting::Disc disc = sun(elevation, radius);
      EXPECT_GT(world.sight(disc).groups(), 0u) << elevation << ", " << radius;
      // At the terminator one ray alone may lie below the surface where others of the disc do not.
      // One ray for what is not at an edge, where many have rays of their own: a tap is missing at a hundredth at most.
      EXPECT_LE(world.different(disc), radius == 2 ? 96u : 12u) << elevation << ", " << radius;
      EXPECT_LE(world.different(disc, .3f), 12u) << elevation << ", " << radius;
    }
}

// What stands high above, or aside, throws its penumbra far.
TEST(SharedSight, KnowsWhatStandsFarAway) {
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
    const lighting::Disc disc = sun(c.elevation_deg, c.radius_deg);
    std::size_t grouped = 0;
    for (const double off : {0., .7, 1.1, 1.3, 1.5, 1.7})  // up to well aside of the sheet
      for (const double turn : {0., 1.3, 1.82, 4.}) {
        const dvec3 centre =
            c.far_m * disc.direction + off * dvec3(std::cos(turn), 0, std::sin(turn));
        const World world({sheet(60), prt::make_sphere(glm::vec3(centre), c.ball_m, 3, {})});
        grouped += world.sight(disc).groups();
        EXPECT_LE(world.different(disc), 4u)
            << c.far_m << " m, " << c.radius_deg << " deg, aside " << off << ", " << turn;
      }
    EXPECT_GT(grouped, 0u);
  }
}

// For a part of the disc other edges of a box are its outline than for the middle.
TEST(SharedSight, KnowsOutlinesOfAllPartsOfADisc) {
  prt::Mesh wall = prt::make_box({-.05f, 0, -.6f}, {.05f, 4, .6f}, 1, {});
  prt::transform(wall, glm::rotate(glm::dmat4(1), .3, dvec3(0, 1, 0)));
  for (const auto& [squares, elevation, radius] :
       {std::tuple(200u, 89.9, .9), {60u, 89.95, .3}, {45u, 89.98, .3}, {73u, 89.9, .4}}) {
    const World world({sheet(squares), wall});
    const lighting::Disc disc = sun(elevation, radius);
    EXPECT_GT(world.sight(disc).groups(), 0u);
    EXPECT_LE(world.misplaced(disc), squares == 200 ? 4u : 0u) << squares;
  }
}

// A window: light from a strip is thrown aside further one way than the other.
TEST(SharedSight, KnowsHowFarAFormReaches) {
  lighting::Disc window = sun(35, 2);
  const dvec3 side = glm::normalize(glm::cross(window.direction, dvec3(0, 1, 0)));
  for (int i = 0; i < 64; ++i)
    window.shape.push_back(glm::normalize(window.direction + (i / 63. - .5) * .28 * side));
  const prt::Mesh wire = prt::make_box({-.003f, .3f, -.9f}, {.003f, .306f, .9f}, 1, {});
  for (const World& world : {World({knot()}), World({sheet(60), wire})}) {
    EXPECT_GT(world.sight(window).groups(), 0u);
    EXPECT_LE(world.different(window), 4u);
  }
}

TEST(SharedSight, NeedsFewRays) {
  const World world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
  const lighting::Disc disc = sun(40);
  const SharedSight sight = world.sight(disc);
  std::size_t facing = 0, alone = 0;
  for (std::size_t i = 0; i < world.meshes[0].normals.size(); ++i) {
    if (glm::dot(dvec3(world.meshes[0].normals[i]), disc.direction) <= 0) continue;
    ++facing;
    alone += sight.group()[i] == SharedSight::kAlone || sight.group()[i] == SharedSight::kInPart;
    EXPECT_NE(sight.group()[i], SharedSight::kTurnedAway);
  }
  EXPECT_LT(double(alone + sight.groups()), .06 * double(facing));
}

// Thinner than the distance between vertices: rays from some of them would find nothing to follow.
TEST(SharedSight, FindsTheShadowOfAWire) {
  prt::Mesh wire = prt::make_box({-.003f, .3f, -.9f}, {.003f, .306f, .9f}, 1, {});
  prt::transform(wire, glm::rotate(glm::dmat4(1), .3, dvec3(0, 1, 0)));
  const World world({sheet(100), wire});
  const lighting::Disc disc = sun(60, .05);
  EXPECT_LE(world.different(disc), 2u);
  const auto light = world.shared_light(disc);
  EXPECT_GT(std::ranges::count_if(light, [](float l) { return l < .1f; }), 10);
}

// One sheet goes through the other: half of it lies in the shadow, and no outline passes over where that begins.
TEST(SharedSight, SeesWhereSurfacesCutThroughEachOther) {
  prt::Mesh slanted = sheet(20);
  prt::transform(slanted,
                 glm::rotate(glm::scale(glm::dmat4(1), dvec3(3, 1, 3)), .5, dvec3(0, 0, 1)));
  const World world({sheet(60), slanted});
  const lighting::Disc disc = sun(80);
  const auto light = world.shared_light(disc);
  const auto dark = std::ranges::count_if(light, [](float l) { return l == 0; });
  EXPECT_GT(dark, 1000);
  EXPECT_LT(dark, 2800);
  EXPECT_LE(world.different(disc), 2u);
}

// A step that is turned away, in small: averaged normals at both of its ends look towards the light, but its foot lies in its
// shadow, and that is the lowest vertex of what is lit beyond.
TEST(SharedSight, EdgesOfTrianglesThatAreTurnedAwayJoinNothing) {
  prt::Mesh step = sheet(12);
  const auto height = [](float x) { return x < 0 ? 0.f : std::min(x, 1 / 6.f); };
  for (glm::vec3& p : step.positions) p = {p.x, height(p.x), p.z};
  step.normals = averaged_normals(step);
  const World world({step});
  for (const double elevation : {36., 38., 40., 42., 44.}) {
    EXPECT_LE(world.different(sun(elevation)), 2u) << elevation;
    EXPECT_EQ(world.misplaced(sun(elevation)), 0u) << elevation;
  }
}

// Rims of a plane on which an object stands are far from it, though not a box around one that runs aslant.
TEST(SharedSight, LongEdgesLeaveGroups) {
  const World alone({knot()});
  const auto grouped = [&](const World& world, double elevation) {
    const SharedSight sight = world.sight(sun(elevation));
    return std::ranges::count_if(sight.group(), [&](auto g) { return g < sight.groups(); });
  };
  for (const double turn : {0., .3, .6, .9, 1.2})
    for (const double elevation : {15., 40., 80.}) {
      prt::Mesh quad = sheet(1);
      for (glm::vec3& p : quad.positions) p = {100 * p.x, -.25f, 60 * p.z};
      prt::transform(quad, glm::rotate(glm::dmat4(1), turn, dvec3(0, 1, 0)));
      EXPECT_EQ(grouped(World({knot(), quad}), elevation), grouped(alone, elevation))
          << turn << ", " << elevation;
    }
}

// An object twice in one place: the other's outlines touch this one's surface as its own do.
TEST(SharedSight, ACopyInItsPlaceLeavesGroups) {
  for (const double elevation : {15., 40., 80.}) {
    const SharedSight alone = World({knot()}).sight(sun(elevation)),
                      twice = World({knot(), knot()}).sight(sun(elevation));
    EXPECT_EQ(alone.parts().size(), twice.parts().size()) << elevation;
    EXPECT_TRUE(std::ranges::equal(alone.group(), twice.group())) << elevation;
  }
}

// What is kept of one light's outlines is not taken for another pose, plane or light: as with an outline for each object and no
// memo.
TEST(SharedSight, AMemoChangesNothing) {
  World world({knot(), knot()});
  world.casters[1].world_from_mesh = {glm::angleAxis(1.2, dvec3(0, 0, 1)), {.3, .2, .9}};
  world.rays.set_pose(1, world.casters[1].world_from_mesh);
  std::vector<Caster> one_outline = world.casters;
  one_outline[1].mesh = one_outline[0].mesh, one_outline[1].outline = one_outline[0].outline;
  const prt::Plane floor{}, wall{{0, 0, -.6}, {0, 0, 1}, {}, {}};
  OutlineMemo memo;
  for (const lighting::Disc& disc : {sun(50), sun(30), sun(50, 2), sun(.5), sun(50)}) {
    memo.clear();
    const Casters with{one_outline, {}, kNear, &memo}, without{world.casters, {}, kNear};
    for (std::size_t i = 0; i < 2; ++i) {
      std::vector<float> a(world.points.positions.size()), b(a.size());
      trace_disc_light({&world.rays, nullptr, kNear}, with, one_outline[i], nullptr, disc, 4, a);
      trace_disc_light({&world.rays, nullptr, kNear}, without, world.casters[i], nullptr, disc, 4,
                       b);
      EXPECT_EQ(a, b);
    }
    for (const prt::Plane& plane : {floor, wall}) {
      DiscShadow a, b;
      draw_disc_shadow(with, plane, disc, {}, a);
      draw_disc_shadow(without, plane, disc, {}, b);
      EXPECT_FALSE(a.empty());
      EXPECT_TRUE(std::ranges::equal(a.taken.pixels(), b.taken.pixels()));
    }
  }
}

std::size_t cuts(const Outline& outline) {
  std::size_t out = 0;
  for (std::size_t i = 0; i < outline.edges().size(); ++i) out += outline.is_cut(i);
  return out;
}

// A mesh that goes through itself: no outline passes over where the sunny side of a post goes through the ground, and what
// it encloses is dark.
TEST(SharedSight, AnOutlineKnowsWhereItsMeshIsCut) {
  prt::Mesh both = sheet(60);
  const prt::Mesh post = prt::make_box({.2f, -.3f, .2f}, {.37f, .3f, .37f}, 8, {});
  const auto shift = static_cast<std::uint32_t>(both.positions.size());
  both.positions.insert(both.positions.end(), post.positions.begin(), post.positions.end());
  both.normals.insert(both.normals.end(), post.normals.begin(), post.normals.end());
  for (const auto& [a, b, c] : post.triangles)
    both.triangles.push_back({a + shift, b + shift, c + shift});
  World world({both});
  const lighting::Disc disc = sun(40);
  EXPECT_FALSE(world.sight(disc).may_be_cut());
  EXPECT_GT(world.sight(disc).groups(), 0u);
  EXPECT_EQ(world.misplaced(disc), 0u);
  EXPECT_EQ(world.different(disc), 0u);
  EXPECT_GT(cuts(world.outlines[0]), 20u);
  world.outlines[0].set_form(both);
  EXPECT_FALSE(world.outlines[0].knows_cuts());
  EXPECT_TRUE(world.sight(disc).may_be_cut());
  EXPECT_GT(world.misplaced(disc), 10u);
}

// A few that seem cut cost a few rays.
TEST(SharedSight, WhatDoesNotGoThroughItselfIsNotCut) {
  for (const prt::Mesh& mesh : {knot(), prt::make_sphere({0, 0, 0}, .5f, 4, {}), sheet(20),
                                prt::make_box({-1, 0, -1}, {1, 1, 1}, 6, {})}) {
    const World world({mesh});
    EXPECT_LE(cuts(world.outlines[0]), world.outlines[0].edges().size() / 300);
  }
}

// Where the other sheet cuts off a strip along the rows no outline tells, and probes in a beat with the rows would miss it.
TEST(SharedSight, ProbesHaveNoBeat) {
  struct Case {
    std::uint32_t squares;
    float cut_at;
  };
  for (const Case& c : {Case{63, .8f}, Case{63, .5f}, Case{54, .9f}, Case{143, .9f}}) {
    prt::Mesh slanted = sheet(20);
    for (glm::vec3& p : slanted.positions) p = {3 * p.x, .5f * (3 * p.x - c.cut_at), 3 * p.z};
    EXPECT_LE(World({sheet(c.squares), slanted}).different(sun(80)), 4u)
        << c.squares << ", " << c.cut_at;
  }
}

// Of a sun that sets behind the plane on which an object stands half is left, for every vertex in front.
TEST(SharedSight, OfASettingSunEveryVertexHasItsPart) {
  const World world({prt::make_sphere({0, 1, 0}, .5f, 4, {})});
  const prt::Plane plane;
  const lighting::Disc disc = sun(0, 2);
  std::vector<float> half(world.meshes[0].positions.size()), whole(half.size());
  for (const auto& [on, out] : {std::pair(&plane, &half), {nullptr, &whole}})
    trace_disc_light({&world.rays, nullptr, kNear}, {world.casters, {}, kNear}, world.casters[0],
                     on, disc, 4, *out);
  int in_front = 0, wrong = 0;
  for (std::size_t i = 0; i < half.size(); ++i) {
    if (glm::dot(dvec3(world.meshes[0].normals[i]), disc.direction) < .2) continue;
    ++in_front;
    wrong += half[i] < .2f * whole[i] || half[i] > .8f * whole[i];
  }
  EXPECT_GT(in_front, 300);
  EXPECT_LT(wrong, in_front / 20);
}

TEST(SharedSight, PointsWithoutTrianglesSeeForThemselves) {
  prt::Mesh points = sheet(10);
  points.triangles.resize(100);  // half of them
  const World world({points, knot()});
  const SharedSight sight = world.sight(sun(50));
  ASSERT_EQ(sight.group().size(), points.positions.size());
  EXPECT_EQ(sight.group().back(), SharedSight::kInPart);
  EXPECT_EQ(world.different(sun(50)), 0u);
}

// In penumbras of a curved object's own parts, in any pose, whether they are virtual or real: half of four rays' error at most.
TEST(SharedSight, WhatItSeesInPartIsNearManyRays) {
  const Pose poses[] = {{}, {glm::angleAxis(.9, glm::normalize(dvec3(.2, 1, .4))), {3, 1, -2}}};
  for (const Pose& pose : poses)
    for (const double elevation : {20., 60.})
      for (const bool real : {false, true}) {
        World world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
        world.rays.set_pose(0, pose);
        world.casters.front().world_from_mesh = pose;
        const prt::RayWorld* const none = nullptr;
        const Blockers blockers{real ? none : &world.rays, real ? &world.rays : none, kNear};
        const std::span<const Caster> all(world.casters), nobody;
        const Casters casters{real ? nobody : all, real ? all : nobody, kNear};
        const lighting::Disc disc = sun(elevation);
        const auto light = [&](const Caster& object, int taps) {
          std::vector<float> out(world.points.positions.size());
          trace_disc_light(blockers, casters, object, nullptr, disc, taps, out);
          return out;
        };
        const Caster alone{&world.points, &world.none, pose};
        const std::vector<float> ours = light(world.casters[0], 4), dense = light(alone, kMostTaps),
                                 four = light(alone, 4);
        SharedSight sight;
        TapPattern taps;
        taps.make(disc, 16, 1);
        sight.find(casters, world.casters[0], disc, {taps.at(0)});
        double our_sum = 0, four_sum = 0;
        for (const auto& [i, seen] : sight.parts()) {
          our_sum += std::pow(ours[i] - dense[i], 2);
          four_sum += std::pow(four[i] - dense[i], 2);
        }
        const auto count = static_cast<double>(sight.parts().size());
        EXPECT_GT(count, 200);
        EXPECT_LT(std::sqrt(our_sum / count), .02) << elevation << real;
        EXPECT_LT(our_sum, .25 * four_sum) << elevation << real;
      }
}

// A source that is no circle: 8 x 8 directions, radians from the middle to its sides.
lighting::Disc form(double elevation_deg, double across, double along) {
  lighting::Disc d = sun(elevation_deg);
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
TEST(SharedSight, ASmallFormIsNarrow) {
  const World world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
  const lighting::Disc disc = form(40, .008, .02);
  ASSERT_FALSE(is_broad(disc));
  const std::vector<float> ours = world.shared_light(disc),
                           four = world.own_light(disc, &world.rays),
                           dense = world.own_light(disc, &world.rays, kMostTaps);
  EXPECT_LT(rmse(ours, dense), .02);
  EXPECT_LT(rmse(ours, dense), 1.1 * rmse(four, dense));
}

// Low over the plane on which the object stands, lying or upright: what is behind the plane brings nothing. (.11 if sixteen
// directions tell of an upright one how much that is.)
TEST(SharedSight, ASmallFormSetsInParts) {
  const World world({prt::make_sphere({0, .6f, 0}, .5f, 5, {})});
  const prt::Plane floor;
  const auto light = [&](const Caster& object, const lighting::Disc& disc, int taps) {
    std::vector<float> out(world.points.positions.size());
    trace_disc_light({&world.rays, nullptr, kNear}, {world.casters, {}, kNear}, object, &floor,
                     disc, taps, out);
    return out;
  };
  for (const auto& [across, along] : {std::pair(.003, .045), {.045, .003}}) {
    const lighting::Disc disc = form(1.5, across, along);
    ASSERT_FALSE(is_broad(disc));
    EXPECT_LT(rmse(light(world.casters[0], disc, 4),
                   light({&world.points, &world.none, {}}, disc, kMostTaps)),
              .04)
        << along;
  }
}

// A long window: four rays a vertex, averaged with those of its neighbours, ask all of it. (The first has .030 if the groups of
// its directions keep step, .018 if there are no groups.)
TEST(SharedSight, NeighboursAskOtherPartsOfAForm) {
  const World world({prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f})});
  for (const auto& [across, along] : {std::pair(.08, .3), {.25, .1}}) {
    const lighting::Disc disc = form(50, across, along);
    ASSERT_TRUE(is_broad(disc));
    const std::vector<float> ours = world.shared_light(disc),
                             dense = world.own_light(disc, &world.rays, kMostTaps);
    EXPECT_LT(rmse(ours, dense), .015) << across;
  }
}

// One tap: as a point in the disc's middle lights, at every vertex, however wide the penumbra would be.
TEST(SharedSight, OneTapThrowsHardShadows) {
  const World world({knot()});
  const auto light = [&](const Caster& object, const lighting::Disc& of, int taps) {
    std::vector<float> out(world.points.positions.size());
    trace_disc_light({&world.rays, nullptr, kNear}, {world.casters, {}, kNear}, object, nullptr, of,
                     taps, out);
    return out;
  };
  const Caster alone{&world.points, &world.none, {}};
  const auto hard = light(alone, sun(35, .001), 4);
  for (const double radius_deg : {2., 15.}) {
    const auto ours = light(world.casters[0], sun(35, radius_deg), 1),
               soft = light(alone, sun(35, radius_deg), kMostTaps);
    int wrong = 0, in_penumbra = 0;  // rays of either come from a rounding's distance
    // What faces all of the disc has its light.
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
TEST(SharedSight, OneTapOfASettingSunIsAllOrNothing) {
  const World world({prt::make_sphere({0, 1, 0}, .5f, 4, {})});
  const prt::Plane plane;
  std::vector<float> out(world.meshes[0].positions.size());
  for (const double radius_deg : {2., 15.})
    for (const double elevation : {.2, -.2}) {
      trace_disc_light({&world.rays, nullptr, kNear}, {world.casters, {}, kNear}, world.casters[0],
                       &plane, sun(elevation, radius_deg), 1, out);
      EXPECT_EQ(std::ranges::max(out) > .9f, elevation > 0) << radius_deg;
      EXPECT_EQ(std::ranges::max(out) > 0, elevation > 0) << radius_deg;
    }
}

// A sun half below the plane on which an object stands, behind a post: directions behind the plane bring nothing.
TEST(SharedSight, WhatItSeesInPartEndsAtThePlane) {
  prt::Mesh wall = sheet(40);
  prt::transform(wall, glm::rotate(glm::translate(glm::dmat4(1), dvec3(0, 1, 0)), -kPi / 2,
                                   dvec3(0, 0, 1)));  // looks along x
  lighting::Disc disc = sun(0, .6);
  disc.direction = {1, 0, 0};
  const World world({wall, prt::make_box({.9f, 0, -.3f}, {1, 2.5f, .3f}, 1, {})});
  const prt::Plane floor;
  const auto light = [&](const Caster& object, int taps) {
    std::vector<float> out(wall.positions.size());
    trace_disc_light({&world.rays, nullptr, kNear}, {world.casters, {}, kNear}, object, &floor,
                     disc, taps, out);
    return out;
  };
  const auto ours = light(world.casters[0], 16),
             dense = light({&world.points, &world.none, {}}, 64);
  const SharedSight found = world.sight(disc);
  EXPECT_GT(found.parts().size(), 20u);
  for (const auto& [i, seen] : found.parts()) {
    EXPECT_NEAR(ours[i], dense[i], .13) << i;
    EXPECT_LT(ours[i], .6f) << i;
  }
}

TEST(SharedSight, FollowsThePoseOfAnObject) {
  World world({knot()});
  const Pose pose{glm::angleAxis(.9, glm::normalize(dvec3(.2, 1, .4))), {3, 1, -2}};
  world.rays.set_pose(0, pose);
  world.casters.front().world_from_mesh = pose;
  EXPECT_LE(world.different(sun(35)), 4u);
}

}  // namespace
}  // namespace penumbra::shadows
