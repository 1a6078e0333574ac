// What silhouettes leave of a light in visibility: by closed form, and by many rays.
#include "shadows/visibility/internal/soft_shadow_volume.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "core/conventions.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;
using test::sheet;

constexpr float kNear = 1e-6f;
constexpr double kRadius = .3 * kPi / 180;

lighting::DistantLight sun(double elevation_deg = 90) {
  lighting::DistantLight d;
  const double e = elevation_deg * kPi / 180;
  d.direction = {std::cos(e), std::sin(e), 0};
  d.radius = Radians(kRadius);
  d.radiance = {1, 1, 1};
  return d;
}

// Without a thickness: single layers with open edges.
prt::Mesh panel(glm::vec2 low, glm::vec2 high, float height, double turn = 0) {
  prt::Mesh m;
  for (const glm::vec2 c : {low, {low.x, high.y}, high, {high.x, low.y}})
    m.positions.emplace_back(c.x, height, c.y);
  m.normals.assign(4, {0, 1, 0});
  m.triangles = {{0, 1, 2}, {0, 2, 3}};
  prt::transform(m, glm::rotate(glm::dmat4(1), turn, dvec3(0, 1, 0)));
  return m;
}
prt::Mesh slab(glm::vec2 low, glm::vec2 high, float height, double turn = 0) {
  prt::Mesh m = prt::make_box({low.x, height - .002f, low.y}, {high.x, height, high.y}, 1, {});
  prt::transform(m, glm::rotate(glm::dmat4(1), turn, dvec3(0, 1, 0)));
  return m;
}

struct World : test::CasterWorld {
  explicit World(std::vector<prt::Mesh> all) : CasterWorld(std::move(all), kNear) {}
  std::vector<float> light(const lighting::DistantLight& source, int samples,
                           bool by_silhouettes) const {
    const Caster alone{&points, &none, {}};
    return CasterWorld::light(source, by_silhouettes ? casters[0] : alone, &rays, samples);
  }
  std::size_t in_part(const lighting::DistantLight& source) const {
    return visibility(source).parts().size();
  }
};

struct Errors {
  double rms = 0, largest = 0;
};
template <class Truth>
Errors errors(const std::vector<float>& light, Truth truth) {
  Errors out;
  for (std::size_t i = 0; i < light.size(); ++i) {
    const double e = std::abs(double(light[i]) - truth(i));
    out.rms += e * e / double(light.size());
    out.largest = std::max(out.largest, e);
  }
  out.rms = std::sqrt(out.rms);
  return out;
}

// Fraction of a unit light on one side of a line so far from its middle.
double fraction_beside(double off) {
  const double t = std::clamp(off, -1., 1.);
  return 1 - (std::acos(t) - t * std::sqrt(1 - t * t)) / kPi;
}

// Straight edges, of one layer and of two, at the zenith and aslant: the fraction of the light
// beside them. Four rays a vertex miss it by a fifth here and there.
TEST(SoftShadowVolume, BesideAnEdgeIsTheShareOfTheLight) {
  constexpr double kHeight = 1;
  for (const double elevation : {90., 60.})
    for (const bool closed : {false, true})
      for (const double turn : {.05, .9}) {
        const lighting::DistantLight source = sun(elevation);
        const double sine = std::sin(elevation * kPi / 180);
        prt::Mesh roof =
            closed ? slab({0, -3}, {3, 3}, kHeight, turn) : panel({0, -3}, {3, 3}, kHeight, turn);
        const dvec3 on_edge = kHeight / sine * source.direction;
        for (glm::vec3& p : roof.positions) p += glm::vec3(on_edge.x, 0, on_edge.z);
        const World world({sheet(160, .9f), roof});
        const dvec3 along(std::sin(turn), 0, std::cos(turn)),
            across = glm::normalize(glm::cross(source.direction, along));
        const auto truth = [&](std::size_t i) {
          const double off = glm::dot(on_edge - dvec3(world.points.positions[i]), across);
          return sine * fraction_beside(off / (kHeight / sine * std::tan(kRadius)));
        };
        const Errors ours = errors(world.light(source, 64, true), truth),
                     few = errors(world.light(source, 4, true), truth),
                     four_rays = errors(world.light(source, 4, false), truth);
        EXPECT_GT(world.in_part(source), 100u);
        EXPECT_LT(ours.largest, .05) << elevation << closed << turn;
        EXPECT_LT(few.largest, .1) << elevation << closed << turn;
        EXPECT_LT(few.rms, .4 * four_rays.rms) << elevation << closed << turn;
        EXPECT_GT(four_rays.largest, .2) << elevation << closed << turn;
      }
}

// Corners, slits, crossed bars, one thing over another, a hole, and what lies all in the dark: the
// same as by sixty-four rays.
TEST(SoftShadowVolume, AgreesWithManyRays) {
  const std::vector<std::vector<prt::Mesh>> scenes = {
      {slab({0, 0}, {3, 3}, 1)},                                               // a corner
      {slab({-3, -3}, {-.002f, 3}, 1, .2), slab({.002f, -3}, {3, 3}, 1, .2)},  // a slit
      {slab({-.001f, -3}, {.001f, 3}, 1, .3), slab({-.001f, -3}, {.001f, 3}, .7f, 1.4)},
      {slab({0, -3}, {3, 3}, 1, .1), slab({-3, 0}, {3, 3}, .5f, .2)},    // one over another
      {slab({-3, -3}, {.004f, 3}, 1), slab({-.004f, -3}, {3, 3}, .6f)},  // no light at all
      {panel({-3, -3}, {.001f, 3}, 1, .4),
       slab({.003f, -3}, {3, 3}, .8f, .5)},        // one layer and two
      {prt::make_sphere({0, 1, 0}, .05f, 3, {})},  // round
      {prt::make_sphere({0, 1, 0}, .03f, 1, {}), slab({.002f, -3}, {3, 3}, 1, .3)}};
  for (std::size_t s = 0; s < scenes.size(); ++s)
    for (const double elevation : {90., 55.}) {
      const lighting::DistantLight source = sun(elevation);
      std::vector<prt::Mesh> all = {sheet(160, .9f)};
      for (prt::Mesh m : scenes[s]) {
        // Into the light over the sheet.
        const double aside = 1 / std::tan(elevation * kPi / 180);
        for (glm::vec3& p : m.positions) p.x += p.y * static_cast<float>(aside);
        all.push_back(std::move(m));
      }
      const World world(std::move(all));
      const std::vector<float> dense = world.light(source, 64, false);
      const auto truth = [&](std::size_t i) { return dense[i]; };
      const Errors same = errors(world.light(source, 64, true), truth),
                   few = errors(world.light(source, 4, true), truth),
                   four_rays = errors(world.light(source, 4, false), truth);
      EXPECT_GT(world.in_part(source), 20u) << s;
      EXPECT_LT(same.largest, .1) << s << ", " << elevation;
      EXPECT_LE(few.rms, .5 * four_rays.rms + 1e-4) << s << ", " << elevation;
    }
}

}  // namespace
}  // namespace penumbra::shadows
