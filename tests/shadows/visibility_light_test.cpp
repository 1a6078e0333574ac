// A light's light looked up in what vertices are known to see, against rays.
#include "shadows/visibility/internal/visibility_light.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtx/quaternion.hpp>
#include <optional>

#include "core/conventions.h"
#include "shadows/silhouette/light_rays.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;

prt::BakedObject baked_alone(prt::Mesh mesh) {
  prt::BakeOptions options;
  options.rays = options.ground_rays = 64;
  options.bounces = 0;
  options.bands = 1;
  options.visibility = true;
  auto out = prt::bake(std::move(mesh), options);
  EXPECT_TRUE(out);
  return out ? std::move(*out) : prt::BakedObject{};
}

lighting::DistantLight source(double elevation_deg, double radius) {
  lighting::DistantLight d;
  const double e = elevation_deg * kPi / 180;
  d.direction = {std::cos(e) * std::cos(.4), std::sin(e), std::cos(e) * std::sin(.4)};
  d.radius = Radians(radius);
  d.radiance = {1, 1, 1};
  return d;
}

// A long lamp, a degree wide.
lighting::DistantLight strip(double elevation_deg) {
  lighting::DistantLight d = source(elevation_deg, .06);
  const dvec3 along = glm::normalize(glm::cross(d.direction, dvec3(0, 1, 0)));
  for (int i = 0; i < lighting::DistantLight::kShapePoints; ++i)
    d.shape.push_back(glm::normalize(d.direction + (i - 31.5) / 160 * along +
                                     (i % 2 - .5) * .017 * glm::cross(d.direction, along)));
  return d;
}

// An object in some pose, alone or with another thing.
struct VisibilityWorld {
  prt::BakedObject object;
  prt::VisibilityLookup lookup{object.visibility, object.mesh};
  SilhouetteMesh silhouette{object.mesh}, nobody;
  prt::Mesh points = object.mesh;  // each vertex for itself
  prt::Mesh ball = prt::make_sphere({0, 0, 0}, .2f, 3, {});
  SilhouetteMesh round{ball};
  Pose pose{glm::angleAxis(.7, glm::normalize(dvec3(1, .4, -.3))), {.3, .8, -.2}};
  std::optional<prt::Plane> plane;
  std::optional<Pose> ball_at;
  static constexpr float kNear = 3e-5f;

  explicit VisibilityWorld(prt::Mesh mesh = prt::make_knot(.5f, 160, 32, {.5f, .5f, .5f}))
      : object(baked_alone(std::move(mesh))) {
    points.triangles.clear();
  }
  std::vector<Caster> casters(bool with_visibility) const {
    std::vector<Caster> out{{&object.mesh, &silhouette, pose, with_visibility ? &lookup : nullptr}};
    if (ball_at) out.push_back({&ball, &round, *ball_at});
    return out;
  }
  LookupUse use(const lighting::DistantLight& d, int directions_used = 4) const {
    return lookup_use(casters(true)[0], d, directions_used);
  }
  CastersBetween between(const lighting::DistantLight& d) const {
    const auto all = casters(true);
    return {{all, {}, kNear}, all[0], d};
  }
  std::vector<float> light(const lighting::DistantLight& d, bool with_visibility) const {
    const auto all = casters(with_visibility);
    return traced(d, all, all[0], 4);
  }
  std::vector<float> truth(const lighting::DistantLight& d) const {
    return traced(d, casters(false), {&points, &nobody, pose}, kMaxSamples);
  }

 private:
  std::vector<float> traced(const lighting::DistantLight& d, std::span<const Caster> all,
                            const Caster& lit, int directions_used) const {
    prt::RayWorld rays = *prt::RayWorld::create();
    for (const Caster& c : all) {
      const auto index = rays.add(*c.mesh);
      EXPECT_TRUE(index);
      rays.set_pose(*index, c.world_from_mesh);
    }
    std::vector<float> out(object.mesh.positions.size());
    trace_direct_light({&rays, nullptr, kNear}, {all, {}, kNear}, lit, plane ? &*plane : nullptr, d,
                       directions_used, out);
    return out;
  }
};
const VisibilityWorld& knot_world() {
  static const VisibilityWorld world;
  return world;
}

// RMS, of the mean.
double error(const std::vector<float>& is, const std::vector<float>& should_be) {
  double square = 0, mean = 0;
  for (std::size_t i = 0; i < is.size(); ++i) {
    square += std::pow(double(is[i]) - should_be[i], 2);
    mean += should_be[i];
  }
  const auto count = static_cast<double>(is.size());
  return std::sqrt(square / count) / (mean / count);
}

TEST(VisibilityLight, WideLightsAreLookedUpAsWellAsRaysFind) {
  const VisibilityWorld& world = knot_world();
  for (const lighting::DistantLight& d :
       {source(50, .17), source(20, .3), source(80, .9), strip(35)}) {
    SCOPED_TRACE(testing::Message() << d.radius.value() << ' ' << d.shape.size());
    ASSERT_EQ(world.use(d), LookupUse::kCoarse);
    const auto truth = world.truth(d);
    const double looked_up = error(world.light(d, true), truth),
                 traced = error(world.light(d, false), truth);
    EXPECT_LT(looked_up, 1.25 * traced) << "by four rays, shared by neighbours";
    if (d.shape.empty()) {
      EXPECT_LT(looked_up, .09) << ".1 to .12 with sixteen directions where the light is mixed";
    }
    EXPECT_LT(looked_up, .15);
  }
}

// So are lamps of a few degrees, in finer cells. (At sharp edges of shadows rays are better, in
// wide ones look-ups.)
TEST(VisibilityLight, LampsAreLookedUpInFinerCells) {
  const VisibilityWorld& world = knot_world();
  for (const lighting::DistantLight& d : {source(50, .06), source(25, .078), source(40, .04)}) {
    SCOPED_TRACE(d.radius.value());
    ASSERT_EQ(world.use(d), LookupUse::kFine);
    const auto truth = world.truth(d);
    EXPECT_LT(error(world.light(d, true), truth), 1.2 * error(world.light(d, false), truth))
        << "by four rays";
    EXPECT_LT(error(world.light(d, true), truth), .1) << "averaged it is up to 20 % off";
    const auto wrong = [&](int cells) {
      std::vector<prt::CosineSums> sums(truth.size());
      look_up(world.casters(true)[0], nullptr, d, cells, sums);
      std::vector<float> seen(truth.size());
      std::ranges::transform(sums, seen.begin(),
                             [&](const auto& s) { return s.seen / prt::VisibilitySamples::kMax; });
      return error(seen, truth);
    };
    EXPECT_GT(wrong(prt::VisibilityMap::kCells), 1.25 * wrong(prt::VisibilityMap::kFineCells))
        << "the naive form has wide cells alone";
  }
}

// Cells are too large to tell how much of such a light is seen, but not where all of it is, or
// nothing.
TEST(VisibilityLight, SmallerLightsAskRaysWhereTheVisibilityIsMixed) {
  const VisibilityWorld& world = knot_world();
  for (const lighting::DistantLight& d : {source(50, .03), source(25, .033), source(40, .027)}) {
    SCOPED_TRACE(d.radius.value());
    ASSERT_EQ(world.use(d), LookupUse::kScout);
    const auto truth = world.truth(d), asked = world.light(d, true);
    EXPECT_LT(error(asked, truth), 1.15 * error(world.light(d, false), truth));
    std::vector<VisibilityVerdict> verdict;
    scout(world.casters(true)[0], d, verdict);
    std::size_t wrong = 0, mixed = 0, sure = 0;
    for (std::size_t i = 0; i < verdict.size(); ++i) {
      mixed += verdict[i] == VisibilityVerdict::kMixed;
      if (verdict[i] != VisibilityVerdict::kLit && verdict[i] != VisibilityVerdict::kDark) continue;
      ++sure;
      wrong += std::abs(asked[i] - truth[i]) > .2f;
    }
    EXPECT_GT(mixed, 0u);
    EXPECT_GT(sure, mixed) << "else nothing is won";
    EXPECT_LT(wrong, sure / 500);
  }
}

// The edge of a sun's shadow runs past what the samples say, where all around a vertex agree and
// are wrong. It is followed from the vertices whose rays found it.
TEST(VisibilityLight, FollowsAShadowsEdgeToWhereTheMapDoesNotTell) {
  const VisibilityWorld& world = knot_world();
  std::size_t all_naive = 0, all_wrong = 0;
  for (const double elevation : {10., 20., 30., 45., 60., 70.}) {
    const lighting::DistantLight sun = source(elevation, .0047);
    ASSERT_EQ(world.use(sun), LookupUse::kScout);
    const auto truth = world.truth(sun), followed = world.light(sun, true);
    std::vector<VisibilityVerdict> verdict;
    scout(world.casters(true)[0], sun, verdict);
    std::size_t naive = 0, wrong = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      if (verdict[i] != VisibilityVerdict::kLit && verdict[i] != VisibilityVerdict::kDark) continue;
      const dvec3 normal = world.pose.rotation * dvec3(world.object.mesh.normals[i]);
      const double told =
          verdict[i] == VisibilityVerdict::kLit ? std::max(0., glm::dot(normal, sun.direction)) : 0;
      naive += std::abs(told - double(truth[i])) > .2;
      wrong += std::abs(followed[i] - truth[i]) > .2f;
    }
    EXPECT_LE(wrong, naive) << elevation;
    all_naive += naive, all_wrong += wrong;
  }
  std::printf("%zu vertices told wrongly, %zu after following edges\n", all_naive, all_wrong);
  EXPECT_LT(2 * all_wrong, all_naive);
}

// What is thinner than cells and vertices are apart hides between the rays of one vertex, but not
// of all around it.
TEST(VisibilityLight, FindsTheShadowOfItsOwnWire) {
  prt::Mesh mesh = test::sheet(60, .25f);
  mesh.albedo.assign(mesh.positions.size(), {.5f, .5f, .5f});
  prt::append(mesh, prt::make_box({-.2f, .2f, -.003f}, {.2f, .206f, .003f}, 8, {.5f, .5f, .5f}));
  const VisibilityWorld world(std::move(mesh));
  for (const lighting::DistantLight& d :
       {source(80, .028), source(90, .05), source(60, .06), source(75, .09), source(70, .2)}) {
    SCOPED_TRACE(d.radius.value());
    ASSERT_NE(world.use(d), LookupUse::kNone);
    const auto truth = world.truth(d), asked = world.light(d, true);
    EXPECT_LT(error(asked, truth), .05);
    if (d.radius.value() > .05) {
      EXPECT_LT(error(asked, truth), 1.3 * error(world.light(d, false), truth));
    }
    // The wire takes as much light as it does.
    const auto taken_of = [](std::vector<float> light) {
      light.resize(61 * 61);  // the sheet
      const float open = *std::ranges::max_element(light);
      double sum = 0;
      for (const float l : light) sum += open - l;
      return sum;
    };
    const double taken = taken_of(truth), found = taken_of(asked);
    EXPECT_GT(taken, 1);
    EXPECT_NEAR(found / taken, 1, .1);
  }
}

TEST(VisibilityLight, RaysStayForWhatItCannotTell) {
  VisibilityWorld world;
  EXPECT_EQ(world.use(source(50, .005)), LookupUse::kScout);
  EXPECT_EQ(world.use(source(50, .3), 1), LookupUse::kNone) << "hard shadows";
  EXPECT_EQ(world.use(source(50, .3), 16), LookupUse::kNone) << "who asks for many rays gets them";
  EXPECT_EQ(world.use(source(50, .3), 8), LookupUse::kCoarse);
  EXPECT_EQ(world.use(source(50, .04), 4), LookupUse::kFine);
  EXPECT_EQ(world.use(source(50, .04), 8), LookupUse::kScout)
      << "as good as four rays, not as eight";
}

// Another thing in the light is not in the map.
TEST(VisibilityLight, RaysFindWhatOthersTake) {
  VisibilityWorld world;
  for (const lighting::DistantLight& light :
       {source(50, .17), source(50, .06), source(50, .03), source(50, .005)}) {
    SCOPED_TRACE(light.radius.value());
    const Pose before{{1, 0, 0, 0}, world.pose.translation + .8 * light.direction};
    const Pose beside{{1, 0, 0, 0}, before.translation + dvec3(.15, 0, -.15)};
    world.ball_at.reset();
    const auto alone = world.light(light, true);
    const double error_alone = error(alone, world.truth(light));
    for (const Pose& at : {before, beside}) {
      world.ball_at = at;
      const CastersBetween others = world.between(light);
      ASSERT_TRUE(others.any());
      const auto asked = world.light(light, true), truth = world.truth(light);
      EXPECT_LT(error(asked, truth),
                1.25 * std::max(error_alone, error(world.light(light, false), truth)));
      EXPECT_GT(error(alone, truth), .1) << "the naive form leaves its shadow out";
      std::size_t left = 0, changed = 0;
      for (std::size_t i = 0; i < asked.size(); ++i) {
        if (others.may_shade(world.object.mesh.positions[i])) continue;
        ++left;
        changed += asked[i] != alone[i];
      }
      EXPECT_GT(left, asked.size() / (light.radius.value() > .05 ? 15 : 4))
          << "the naive form asks rays everywhere";
      EXPECT_LT(changed, left / 50) << "but for a shadow's edge that runs out of the ball's";
    }
  }
  const lighting::DistantLight d = source(50, .17), sun = source(50, .005);
  world.ball_at = Pose{{1, 0, 0, 0}, world.pose.translation + 1.5 * d.direction};
  for (const lighting::DistantLight& light : {d, sun}) {
    const auto truth = world.truth(light);
    EXPECT_LT(error(world.light(light, true), truth),
              1.06 * error(world.light(light, false), truth));
  }
  const auto shaded = world.light(d, true);
  world.ball_at = Pose{{1, 0, 0, 0}, world.pose.translation - 3. * d.direction};
  EXPECT_FALSE(world.between(d).any()) << "behind the object";
  EXPECT_GT(error(shaded, world.light(d, true)), .1) << "the naive form leaves its shadow out";
}

// What may not be shaded by others is not, whatever stands where: rays say so.
TEST(VisibilityLight, CastersBetweenAreNeverMissed) {
  VisibilityWorld world;
  world.ball = prt::make_box({-.5f, -.02f, -.1f}, {.5f, .02f, .1f}, 1, {});
  world.round = SilhouetteMesh(world.ball);
  prt::RayWorld rays = *prt::RayWorld::create();
  const auto index = rays.add(world.ball);
  ASSERT_TRUE(index);
  std::size_t shaded = 0, missed = 0, spared = 0, all = 0;
  for (int k = 0; k < 60; ++k) {
    const dvec3 off(std::sin(3. * k), std::cos(7. * k), std::sin(11. * k + 1));
    const Pose at{glm::angleAxis(.9 * k, glm::normalize(dvec3(1, .3 * k, -2))),
                  world.pose.translation + .9 * off};
    const lighting::DistantLight light = source(15. + k, k % 2 ? .2 : .01);
    world.ball_at = at;
    rays.set_pose(*index, at);
    const CastersBetween others = world.between(light);
    SamplePattern pattern;
    pattern.make(light, 16, kTurns);
    for (std::size_t v = 0; v < world.object.mesh.positions.size(); v += 7) {
      const glm::vec3& p = world.object.mesh.positions[v];
      const bool may = others.any() && others.may_shade(p);
      const glm::vec3 o(world.pose * dvec3(p));
      prt::RayWorld::Rays packet;
      int count = 0;
      for (const glm::vec3& d : pattern.at(v)) {
        packet.ox[count] = o.x, packet.oy[count] = o.y, packet.oz[count] = o.z;
        packet.dx[count] = d.x, packet.dy[count] = d.y, packet.dz[count] = d.z;
        ++count;
      }
      const bool is = rays.occluded(packet, count) != 0;
      shaded += is, missed += is && !may, spared += !may, ++all;
    }
  }
  EXPECT_EQ(missed, 0u);
  EXPECT_GT(shaded, all / 100);
  EXPECT_GT(spared, all / 2) << "else nothing is won";
}

// What lies in front of a wall, with the light before both, has nothing between.
TEST(VisibilityLight, AWallBehindIsNotBetween) {
  VisibilityWorld world;
  world.ball = prt::make_box({-9, -9, -.1f}, {9, 9, -.05f}, 1, {});
  world.round = SilhouetteMesh(world.ball);
  const lighting::DistantLight sun = source(40, .005);
  const glm::dquat facing =
      glm::rotation(dvec3(0, 0, 1), glm::normalize(dvec3(sun.direction.x, 0, sun.direction.z)));
  world.ball_at = Pose{facing, world.pose.translation - 1. * (facing * dvec3(0, 0, 1))};
  EXPECT_FALSE(world.between(sun).any()) << "though its sphere is all around";
  world.ball_at = Pose{facing, world.pose.translation + 1. * (facing * dvec3(0, 0, 1))};
  EXPECT_TRUE(world.between(sun).any());
}

// Or two objects in one place would not look like one.
TEST(VisibilityLight, AThingLikeTheObjectInItsPlaceIsTheObject) {
  const VisibilityWorld& world = knot_world();
  const prt::Mesh copy = world.object.mesh;
  const SilhouetteMesh silhouette(copy);
  std::vector<Caster> all = world.casters(true);
  all.push_back({&copy, &silhouette, world.pose});
  const auto between = [&] {
    return CastersBetween({all, {}, VisibilityWorld::kNear}, all[0], source(50, .3)).any();
  };
  EXPECT_FALSE(between());
  all[1].world_from_mesh.translation.x += 1e-3;
  EXPECT_TRUE(between());
}

TEST(VisibilityLight, LightFromBehindThePlaneDoesNotCount) {
  VisibilityWorld world;
  for (const auto& [radius, use] :
       {std::pair(.3, LookupUse::kCoarse), {.08, LookupUse::kFine}, {.03, LookupUse::kScout}}) {
    const lighting::DistantLight d = source(0, radius);
    world.plane = prt::Plane{{0, 0, 0}, {0, 1, 0}, {}, {}};
    ASSERT_EQ(world.use(d), use);
    const auto above = world.light(d, true), truth = world.truth(d);
    EXPECT_LT(error(above, truth), 1.2 * error(world.light(d, false), truth)) << radius;
    world.plane.reset();
    EXPECT_GT(error(world.light(d, true), truth), .3) << "half of the light is behind it";
  }
}

}  // namespace
}  // namespace penumbra::shadows
