// Shadows drawn from silhouettes against a ray from every node to every direction.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <glm/gtc/matrix_transform.hpp>

#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"
#include "shadows/silhouette/light_rays.h"
#include "tests/support/shadow_maps.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;

constexpr float kNear = 1e-4f;
const prt::Plane kMapFloor{{.1, 0, .05}, {0, 1, 0}, {}, {}};

Pose world_of(double tilt, const dvec3& shift) {
  return {glm::angleAxis(tilt, glm::normalize(dvec3(1, .2, .5))), shift};
}

struct Thing {
  prt::Mesh mesh;
  Pose pose;
};

struct Setting {
  std::string name;
  std::function<std::vector<Thing>()> virtual_things, real_things;
  double elevation_deg = 40, radius_deg = .3;
  int samples = 16;
  double tilt = 0;       // of the whole world, radians
  dvec3 shift{0, 0, 0};  // of the whole world
  double plane_off = 0;  // of the plane's point along the plane, metres
};
void PrintTo(const Setting& s, std::ostream* out) {
  *out << s.name;
}

std::vector<Thing> nothing() {
  return {};
}

prt::Mesh map_knot() {
  return prt::make_knot(.5f, 160, 24, {.5f, .5f, .5f});
}

// A bowl: the lower half of a sphere without its lid, seen from both sides.
prt::Mesh bowl() {
  prt::Mesh m = prt::make_sphere({0, .5f, 0}, .3f, 4, {.5f, .5f, .5f});
  std::erase_if(m.triangles, [&](const auto& t) {
    return m.positions[t[0]].y > .5f && m.positions[t[1]].y > .5f && m.positions[t[2]].y > .5f;
  });
  return m;
}

// Every third triangle turned over, as some files have them.
prt::Mesh mixed_up(prt::Mesh m) {
  for (std::size_t t = 0; t < m.triangles.size(); t += 3)
    std::swap(m.triangles[t][0], m.triangles[t][1]);
  return m;
}

// No two triangles share a vertex.
prt::Mesh shattered(const prt::Mesh& m) {
  prt::Mesh out;
  for (const auto& t : m.triangles) {
    const auto first = static_cast<std::uint32_t>(out.positions.size());
    for (const std::uint32_t v : t) {
      out.positions.push_back(m.positions[v]);
      out.normals.push_back(m.normals[v]);
    }
    out.triangles.push_back({first, first + 1, first + 2});
  }
  return out;
}

std::vector<Thing> one(const prt::Mesh& mesh, const Pose& pose = {}) {
  return {{mesh, pose}};
}

std::vector<Thing> sunk() {
  return one(prt::make_sphere({0, 0, 0}, .3f, 4, {.5f, .5f, .5f}), {{1, 0, 0, 0}, {0, -.2, 0}});
}

std::vector<Thing> tilted() {
  return one(map_knot(), {glm::angleAxis(1.1, glm::normalize(dvec3(1, .3, -.4))), {.2, .3, -.1}});
}

std::vector<Thing> two() {
  return {{map_knot(), {}},
          {prt::make_box({-.1f, 0, -.1f}, {.1f, .6f, .1f}, 2, {}), {{1, 0, 0, 0}, {.4, 0, .1}}}};
}

// Large triangles: no vertex lies near the plane.
std::vector<Thing> coarse_box() {
  return one(prt::make_box({-.5f, -.5f, -.5f}, {.5f, .5f, .5f}, 1, {}),
             {glm::angleAxis(.5, dvec3(0, 0, 1)), {0, 0, 0}});
}

// A corner alone looks out.
std::vector<Thing> corner() {
  return one(prt::make_box({-.5f, -.5f, -.5f}, {.5f, .5f, .5f}, 1, {}),
             {glm::angleAxis(.955, glm::normalize(dvec3(1, 0, -1))), {0, -.4, 0}});
}

// Between the object and the light, and behind it.
std::vector<Thing> real_posts() {
  return {{prt::make_box({-.05f, 0, -.05f}, {.05f, 1, .05f}, 2, {}), {{1, 0, 0, 0}, {.5, 0, .2}}},
          {prt::make_box({-.05f, 0, -.3f}, {.05f, .3f, .3f}, 2, {}), {{1, 0, 0, 0}, {-.6, 0, 0}}}};
}

// High up and towards the light of 40 degrees, but aside: its foot is far from the map, its
// penumbra is not.
std::vector<Thing> slab_aside() {
  return one(prt::make_box({-.3f, 0, -.3f}, {.3f, .1f, .3f}, 1, {}),
             {{1, 0, 0, 0}, {1.977, 2, 1.658}});
}

class Scene {
 public:
  explicit Scene(const std::vector<Thing>& things, const Pose& world = {}) : things_(things) {
    for (Thing& t : things_) t.pose = world * t.pose;
    silhouettes_.reserve(things_.size());
    for (const Thing& t : things_) {
      silhouettes_.emplace_back(t.mesh);
      casters_.push_back({&t.mesh, &silhouettes_.back(), t.pose});
      const auto index = rays_.add(t.mesh);
      EXPECT_TRUE(index);
      rays_.set_pose(*index, t.pose);
    }
  }
  std::span<const Caster> casters() const { return casters_; }
  // Those that way.
  std::uint32_t blocked(const dvec3& from, std::span<const glm::vec3> directions) const {
    prt::RayWorld::Rays rays;
    for (std::size_t k = 0; k < directions.size(); ++k) {
      rays.far[k] = 1e30f;
      rays.ox[k] = float(from.x), rays.oy[k] = float(from.y), rays.oz[k] = float(from.z);
      rays.dx[k] = directions[k].x, rays.dy[k] = directions[k].y, rays.dz[k] = directions[k].z;
    }
    return rays_.empty() ? 0 : rays_.occluded(rays, int(directions.size()));
  }

 private:
  std::vector<Thing> things_;
  std::vector<SilhouetteMesh> silhouettes_;
  std::vector<Caster> casters_;
  prt::RayWorld rays_ = *prt::RayWorld::create();
};

lighting::DistantLight distant_light_of(const Setting& s) {
  lighting::DistantLight d;
  const double e = s.elevation_deg * kPi / 180;
  d.direction = {std::cos(e) * std::cos(.3), std::sin(e), std::cos(e) * std::sin(.3)};
  d.radius = Radians(s.radius_deg * kPi / 180);
  d.radiance = {1, 1, 1};
  return d;
}

class ShadowOnPlane : public testing::TestWithParam<Setting> {};

struct Wrong {
  std::size_t nodes = 0, dark = 0, wrong = 0;
};

// The nodes of a map against a ray to every direction.
Wrong compare(const ShadowMap& shadow, const Scene& virtual_things, const Scene& real_things,
              const dvec3& up, const lighting::DistantLight& source, int samples) {
  SamplePattern pattern;
  pattern.make(source, samples, 1);
  float all = 0;
  for (const glm::vec3& d : pattern.at(0)) all += std::max(0.f, glm::dot(glm::vec3(up), d));
  Wrong out;
  for (int y = 1; y + 1 < shadow.virtual_occlusion.height(); ++y)
    for (int x = 1; x + 1 < shadow.virtual_occlusion.width(); ++x) {
      const dvec3 from = shadow.world_from_map *
                         dvec3(x * double(shadow.cell_m), kNear, y * double(shadow.cell_m));
      float taken = 0, missing = 0;
      for (std::size_t k = 0; k < pattern.at(0).size(); k += 16) {
        const auto part =
            pattern.at(0).subspan(k, std::min(pattern.at(0).size() - k, std::size_t{16}));
        const std::uint32_t by_virtual = virtual_things.blocked(from, part),
                            by_real = real_things.blocked(from, part);
        for (std::size_t i = 0; i < part.size(); ++i) {
          const float weight = std::max(0.f, glm::dot(glm::vec3(up), part[i])) / all;
          if (by_real >> i & 1)
            missing += weight;
          else if (by_virtual >> i & 1)
            taken += weight;
        }
      }
      ++out.nodes;
      out.dark += taken > .5f;
      const float left = shadow.real_occlusion.empty() ? 0 : shadow.real_occlusion.at(x, y);
      out.wrong +=
          std::abs(shadow.virtual_occlusion.at(x, y) - taken) + std::abs(left - missing) > 1e-4f;
    }
  return out;
}

TEST_P(ShadowOnPlane, IsWhatRaysFind) {
  const Setting& s = GetParam();
  const Pose world = world_of(s.tilt, s.shift);
  const Scene virtual_things(s.virtual_things(), world), real_things(s.real_things(), world);
  lighting::DistantLight source = distant_light_of(s);
  source.direction = world.rotation * source.direction;
  const prt::Plane floor{world * (kMapFloor.point + s.plane_off * dvec3(1, 0, .3)),
                         world.rotation * kMapFloor.normal,
                         {},
                         {}};
  ShadowMap shadow;
  render_shadow_map({virtual_things.casters(), real_things.casters(), kNear}, floor, source,
                    {s.samples, 128}, shadow);
  ASSERT_FALSE(shadow.empty());
  EXPECT_EQ(shadow.real_occlusion.empty(), real_things.casters().empty());
  for (int x = 1; x + 1 < shadow.virtual_occlusion.width(); ++x)  // nothing is cut off
    for (const int y : {1, shadow.virtual_occlusion.height() - 2})
      EXPECT_LT(shadow.virtual_occlusion.at(x, y), .01f);
  for (int y = 1; y + 1 < shadow.virtual_occlusion.height(); ++y)
    for (const int x : {1, shadow.virtual_occlusion.width() - 2})
      EXPECT_LT(shadow.virtual_occlusion.at(x, y), .01f);
  const Wrong found = compare(shadow, virtual_things, real_things, floor.normal, source,
                              is_wide(source) ? std::min(64, 4 * s.samples) : s.samples);
  EXPECT_GT(found.dark, found.nodes / 50);
  // A node on an edge may go either way.
  EXPECT_LT(found.wrong, found.nodes / 200) << "of " << found.nodes;
}

// Nodes of one map where they lie on another one.
float at(const ShadowMap& shadow, const dvec3& world) {
  const dvec3 p = shadow.world_from_map.inverse() * world / double(shadow.cell_m);
  const int x = static_cast<int>(std::floor(p.x)), y = static_cast<int>(std::floor(p.z));
  if (x < 0 || y < 0 || x + 1 >= shadow.virtual_occlusion.width() ||
      y + 1 >= shadow.virtual_occlusion.height())
    return 0;
  const auto u = static_cast<float>(p.x - x), v = static_cast<float>(p.z - y);
  return (1 - v) * ((1 - u) * shadow.virtual_occlusion.at(x, y) +
                    u * shadow.virtual_occlusion.at(x + 1, y)) +
         v * ((1 - u) * shadow.virtual_occlusion.at(x, y + 1) +
              u * shadow.virtual_occlusion.at(x + 1, y + 1));
}

// A wide lamp that brings little is drawn with fewer directions and cells: its error counts by
// what it brings.
TEST(ShadowMap, AWeakLampIsDrawnAsWellAsItsShareNeeds) {
  const Scene scene(one(map_knot()));
  lighting::DistantLight window = distant_light_of({"", {}, {}, 40, 3});
  const dvec3 side = glm::normalize(glm::cross(window.direction, dvec3(0, 1, 0)));
  for (int i = 0; i < 64; ++i)
    window.shape.push_back(glm::normalize(window.direction + .2 * ((i + .5) / 32 - 1) * side));
  for (const lighting::DistantLight& lamp : {distant_light_of({"", {}, {}, 40, 10}), window}) {
    SCOPED_TRACE(lamp.shape.size());
    const auto drawn = [&](const ShadowMapOptions& options) {
      ShadowMap out;
      render_shadow_map({scene.casters(), {}, kNear}, kMapFloor, lamp, options, out);
      return out;
    };
    const ShadowMap truth = drawn({16, 1024});
    const auto error = [&](const ShadowMap& shadow) {
      double sum = 0;
      int nodes = 0;
      for (int y = 0; y < truth.virtual_occlusion.height(); y += 4)
        for (int x = 0; x < truth.virtual_occlusion.width(); x += 4, ++nodes)
          sum +=
              std::pow(at(shadow, truth.world_from_map * (double(truth.cell_m) * dvec3(x, 0, y))) -
                           truth.virtual_occlusion.at(x, y),
                       2);
      return std::sqrt(sum / nodes);
    };
    const ShadowMap strong = drawn({16, 256, 1}), half = drawn({16, 256, .5}),
                    weak = drawn({16, 256, .25});
    EXPECT_LT(half.virtual_occlusion.area(),
              .7 * static_cast<double>(strong.virtual_occlusion.area()));
    EXPECT_LT(weak.virtual_occlusion.area(),
              .5 * static_cast<double>(strong.virtual_occlusion.area()));
    EXPECT_GT(error(weak), 1.2 * error(strong)) << "the naive form draws strong ones so too";
    // The most that each brings: all, a half, a quarter.
    EXPECT_LT(.5 * error(half), error(strong) + .002);
    EXPECT_LT(.25 * error(weak), error(strong) + .002);
  }
  ShadowMap fewest;
  render_shadow_map({scene.casters(), {}, kNear}, kMapFloor, distant_light_of({"", {}, {}, 40, 10}),
                    {1, 16, .25}, fewest);
  EXPECT_FALSE(fewest.empty());
}

// What lights by a form casts shadows by sixteen of its directions where it is small in every
// direction, by all 64 where not.
TEST(ShadowMap, AFormTakesTheDirectionsThatItsReachNeeds) {
  const Scene scene(one(map_knot())), nobody({});
  for (const auto& [half_length, directions] : {std::pair(.03, 16), {.2, 64}}) {
    lighting::DistantLight source = distant_light_of({"", {}, {}, 40, 1});
    const dvec3 side = glm::normalize(glm::cross(source.direction, dvec3(0, 1, 0)));
    for (int i = 0; i < 64; ++i)
      source.shape.push_back(
          glm::normalize(source.direction + half_length * ((i + .5) / 32 - 1) * side));
    ShadowMap shadow;
    render_shadow_map({scene.casters(), {}, kNear}, kMapFloor, source, {16, 128}, shadow);
    const Wrong found = compare(shadow, scene, nobody, kMapFloor.normal, source, directions),
                other = compare(shadow, scene, nobody, kMapFloor.normal, source, 80 - directions);
    EXPECT_GT(found.dark, found.nodes / 50);
    EXPECT_LT(found.wrong, found.nodes / 200) << half_length;
    EXPECT_GT(other.wrong, found.nodes / 50) << half_length;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Of, ShadowOnPlane,
    testing::Values(
        Setting{"knot", [] { return one(map_knot()); }, nothing},
        Setting{"knot_wide", [] { return one(map_knot()); }, nothing, 40, 12},
        Setting{"knot_at_sunset", [] { return one(map_knot()); }, nothing, 14},
        Setting{"knot_under_zenith", [] { return one(map_knot()); }, nothing, 90, 5},
        Setting{"tilted", tilted, nothing}, Setting{"two", two, nothing, 30, 3},
        Setting{"bowl", [] { return one(bowl()); }, nothing},
        Setting{"mixed_up", [] { return one(mixed_up(map_knot())); }, nothing},
        Setting{"shattered", [] { return one(shattered(map_knot())); }, nothing},
        Setting{"few_samples", [] { return one(map_knot()); }, nothing, 40, .3, 5},
        Setting{"one_tap", [] { return one(map_knot()); }, nothing, 40, 2, 1},
        Setting{"samples_in_three_groups", [] { return one(map_knot()); }, nothing, 40, 8, 10},
        Setting{"low_disc", [] { return one(map_knot()); }, nothing, 21, 7},
        Setting{"plane_tilted", two, nothing, 40, .3, 16, .7},
        Setting{"world_far_away", two, nothing, 40, .3, 16, .7, {300, -50, 200}},
        Setting{"point_of_the_plane_far_away", two, nothing, 40, .3, 16, .7, {0, 0, 0}, 300},
        Setting{"penumbra_from_aside", [] { return one(map_knot()); }, slab_aside, 40, 12},
        Setting{"wall", two, real_posts, 40, 5, 16, kPi / 2},
        Setting{"coarse_box", coarse_box, nothing}, Setting{"corner", corner, nothing},
        Setting{"sunk", sunk, nothing}, Setting{"sunk_wide", sunk, nothing, 40, 12},
        Setting{"behind_real_things", two, real_posts},
        Setting{"behind_real_things_wide", two, real_posts, 40, 12}),
    [](const auto& p) { return p.param.name; });

TEST(ShadowOnPlane, FollowsAnotherForm) {
  prt::Mesh mesh = map_knot();
  SilhouetteMesh silhouette(mesh);
  const Caster caster{&mesh, &silhouette, {}};
  const lighting::DistantLight source = distant_light_of({});
  ShadowMap moved, fresh;
  prt::transform(mesh, glm::rotate(glm::dmat4(1), .8, dvec3(0, 1, 0)));
  silhouette.update_vertices(mesh);
  render_shadow_map({{&caster, 1}, {}, kNear}, kMapFloor, source, {}, moved);
  const SilhouetteMesh other(mesh);
  const Caster again{&mesh, &other, {}};
  render_shadow_map({{&again, 1}, {}, kNear}, kMapFloor, source, {}, fresh);
  ASSERT_EQ(moved.virtual_occlusion.area(), fresh.virtual_occlusion.area());
  EXPECT_TRUE(
      std::ranges::equal(moved.virtual_occlusion.pixels(), fresh.virtual_occlusion.pixels()));
}

TEST(ShadowOnPlane, OfALightThatSetsOnlyTheUpperPartCounts) {
  const Scene scene(one(map_knot()));
  ShadowMap shadow;
  render_shadow_map({scene.casters(), {}, kNear}, kMapFloor, distant_light_of({"", {}, {}, 2, 6}),
                    {}, shadow);
  ASSERT_FALSE(shadow.empty());
  const auto [smallest, largest] = std::ranges::minmax(shadow.virtual_occlusion.pixels());
  EXPECT_EQ(smallest, 0);
  EXPECT_NEAR(largest, 1, .05);
}

// All of its light is thrown as if it came from 1.15 degrees: by silhouettes that are not those of
// the light itself.
TEST(ShadowOnPlane, OfASunAtTheHorizonIsWhole) {
  const Scene scene(one(map_knot()));
  ShadowMap at_horizon, higher;
  render_shadow_map({scene.casters(), {}, kNear}, kMapFloor,
                    distant_light_of({"", {}, {}, .25, .2}), {}, at_horizon);
  render_shadow_map({scene.casters(), {}, kNear}, kMapFloor,
                    distant_light_of({"", {}, {}, 1.146, .2}), {}, higher);
  ASSERT_EQ(at_horizon.virtual_occlusion.width(), higher.virtual_occlusion.width());
  ASSERT_EQ(at_horizon.virtual_occlusion.height(), higher.virtual_occlusion.height());
  double difference = 0;
  for (std::size_t i = 0; i < higher.virtual_occlusion.area(); ++i)
    difference +=
        std::abs(at_horizon.virtual_occlusion.pixels()[i] - higher.virtual_occlusion.pixels()[i]);
  EXPECT_LT(difference / double(higher.virtual_occlusion.area()), .02);
}

TEST(ShadowOnPlane, ALightBelowTheHorizonThrowsNone) {
  const Scene scene(one(map_knot()));
  ShadowMap shadow;
  render_shadow_map({scene.casters(), {}, kNear}, kMapFloor, distant_light_of({"", {}, {}, -3}), {},
                    shadow);
  EXPECT_TRUE(shadow.empty());
}

TEST(ShadowOnPlane, WhatIsBelowThePlaneThrowsNone) {
  const Thing above{map_knot(), {}}, below{map_knot(), {{1, 0, 0, 0}, {.1, -2, 0}}};
  ShadowMap alone, both;
  render_shadow_map({Scene({below}).casters(), {}, kNear}, kMapFloor, distant_light_of({}), {},
                    alone);
  EXPECT_TRUE(alone.empty());
  const Scene one_thing({above}), two_things({above, below});
  render_shadow_map({one_thing.casters(), {}, kNear}, kMapFloor, distant_light_of({}), {}, alone);
  render_shadow_map({two_things.casters(), {}, kNear}, kMapFloor, distant_light_of({}), {}, both);
  EXPECT_TRUE(
      std::ranges::equal(alone.virtual_occlusion.pixels(), both.virtual_occlusion.pixels()));
}

TEST(ShadowOnPlane, ObjectsFarApartHaveMapsOfTheirOwn) {
  const Scene near_and_far({{map_knot(), {}}, {map_knot(), {{1, 0, 0, 0}, {5, 0, 1}}}}), none({});
  const lighting::DistantLight source = distant_light_of({});
  std::vector<ShadowMap> maps;
  render_shadow_maps({near_and_far.casters(), {}, kNear}, kMapFloor, source, {16, 128}, maps);
  ASSERT_EQ(maps.size(), 2u);
  for (const ShadowMap& map : maps) {
    const Wrong found = compare(map, near_and_far, none, {0, 1, 0}, source, 16);
    EXPECT_GT(found.dark, found.nodes / 50);
    EXPECT_LT(found.wrong, found.nodes / 200);
  }
}

TEST(ShadowOnPlane, OfRealThingsIsWhatRaysFind) {
  const Scene posts(real_posts()), none({});
  for (const double radius_deg : {.3, 12.}) {
    const lighting::DistantLight source = distant_light_of({"", {}, {}, 40, radius_deg});
    ShadowMap shadow;
    const Neighbourhood around{{0, .2, 0}, 1.2};
    render_real_shadow_map({{}, posts.casters(), kNear}, {&around, 1}, kMapFloor, source, {16, 128},
                           shadow);
    ASSERT_FALSE(shadow.empty());
    const Wrong found = compare(shadow, posts, none, {0, 1, 0}, source, is_wide(source) ? 64 : 16);
    EXPECT_GT(found.dark, found.nodes / 100);
    EXPECT_LT(found.wrong, found.nodes / 200);
  }
}

TEST(SilhouetteMesh, KnowsRimsSeamsAndWrongTurns) {
  const auto open = [](const SilhouetteMesh& o) {
    return std::ranges::count(o.edges(), SilhouetteMesh::kOpen, &SilhouetteMesh::Edge::right);
  };
  const prt::Mesh closed = map_knot();
  const SilhouetteMesh whole(closed);
  EXPECT_EQ(open(whole), 0);
  EXPECT_EQ(2 * whole.edges().size(), 3 * whole.triangles().size());
  EXPECT_EQ(open(SilhouetteMesh(shattered(closed))), 0);
  EXPECT_GT(open(SilhouetteMesh(mixed_up(closed))), 0);
  EXPECT_GT(open(SilhouetteMesh(bowl())), 0);
  prt::Mesh thin = closed;
  thin.triangles.push_back({3, 3, 7});
  EXPECT_EQ(SilhouetteMesh(thin).triangles().size(), closed.triangles.size());
}

// RMS of one map at the nodes of another, where either has a shadow.
double difference(const ShadowMap& a, const ShadowMap& b) {
  const Pose to_b = b.world_from_map.inverse() * a.world_from_map;
  double square = 0;
  std::size_t count = 0;
  for (int y = 0; y < a.virtual_occlusion.height(); ++y)
    for (int x = 0; x < a.virtual_occlusion.width(); ++x) {
      const dvec3 p = to_b * dvec3(x * double(a.cell_m), 0, y * double(a.cell_m));
      const int i = static_cast<int>(std::lround(p.x / double(b.cell_m))),
                j = static_cast<int>(std::lround(p.z / double(b.cell_m)));
      const bool within =
          i >= 0 && j >= 0 && i < b.virtual_occlusion.width() && j < b.virtual_occlusion.height();
      const float here = a.virtual_occlusion.at(x, y),
                  there = within ? b.virtual_occlusion.at(i, j) : 0;
      if (here < .02f && there < .02f) continue;
      square += std::pow(double(here) - there, 2), ++count;
    }
  return std::sqrt(square / static_cast<double>(count));
}

// A thousandth of the radius is a fifteenth of a map's cell.
TEST(SilhouetteMesh, ASimplifiedOneThrowsTheSameShadow) {
  const prt::Mesh mesh = prt::make_knot(.5f, 480, 80, {.5f, .5f, .5f});
  const SilhouetteMesh whole(mesh);
  const SilhouetteMesh coarse(mesh, 1e-3f * whole.radius_m()),
      coarser(mesh, .03f * whole.radius_m());
  EXPECT_LT(4 * coarse.triangles().size(), whole.triangles().size());
  EXPECT_EQ(std::ranges::count(coarse.edges(), SilhouetteMesh::kOpen, &SilhouetteMesh::Edge::right),
            0)
      << "no holes";
  const auto shadow_of = [&](const SilhouetteMesh& silhouette, double radius_deg) {
    const Caster caster{&mesh, &silhouette, {}};
    Setting s;
    s.radius_deg = radius_deg;
    ShadowMap out;
    render_shadow_map({{&caster, 1}, {}, kNear}, kMapFloor, distant_light_of(s), {}, out);
    return out;
  };
  for (const double radius_deg : {.3, 3., 12.}) {
    const ShadowMap truth = shadow_of(whole, radius_deg);
    EXPECT_LT(difference(shadow_of(coarse, radius_deg), truth), radius_deg < 1 ? .05 : .01)
        << radius_deg;
    EXPECT_GT(difference(shadow_of(coarser, radius_deg), truth), .03) << "too few triangles";
  }
}

TEST(SilhouetteMesh, SimplifyingKeepsRimsAndSeams) {
  const auto open = [](const SilhouetteMesh& o) {
    return std::ranges::count(o.edges(), SilhouetteMesh::kOpen, &SilhouetteMesh::Edge::right);
  };
  const prt::Mesh closed = prt::make_knot(.5f, 320, 64, {.5f, .5f, .5f});
  const SilhouetteMesh torn(shattered(closed), 1e-3f);
  EXPECT_LT(2 * torn.triangles().size(), closed.triangles.size());
  EXPECT_EQ(open(torn), 0);
  const prt::Mesh half = bowl();
  EXPECT_GT(2 * open(SilhouetteMesh(half, 1e-3f)), open(SilhouetteMesh(half)))
      << "the rim is still round";
  const prt::Mesh flat = prt::make_box({0, 0, 0}, {1, 1, 1}, 8, {});
  const SilhouetteMesh box(flat, 1e-3f);
  EXPECT_LT(3 * box.triangles().size(), flat.triangles.size());
  EXPECT_EQ(open(box), 0);
  EXPECT_TRUE(SilhouetteMesh(prt::Mesh{}, 1e-3f).triangles().empty());
}

}  // namespace
}  // namespace penumbra::shadows
