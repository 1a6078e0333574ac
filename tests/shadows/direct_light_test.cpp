#include <gtest/gtest.h>

#include <cmath>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::shadows {
namespace {

// A level patch of real ground under a ball, in the light of a wide panel overhead.
struct Patch {
  prt::Mesh ball = prt::make_sphere({0, .35f, 0}, .2f, 4, {.5f, .5f, .5f});
  prt::RayWorld virtual_things = *prt::RayWorld::create();
  prt::Mesh ground;
  lighting::DistantLight panel;

  Patch() {
    EXPECT_TRUE(virtual_things.add(ball));
    constexpr std::uint32_t kSide = 60;
    for (std::uint32_t y = 0; y <= kSide; ++y)
      for (std::uint32_t x = 0; x <= kSide; ++x) {
        ground.positions.emplace_back(float(x) / kSide - .5f, 0, float(y) / kSide - .5f);
        ground.normals.emplace_back(0, 1, 0);
        if (x == kSide || y == kSide) continue;
        const std::uint32_t i = y * (kSide + 1) + x;
        ground.triangles.push_back({i, i + kSide + 1, i + 1});
        ground.triangles.push_back({i + 1, i + kSide + 1, i + kSide + 2});
      }
    panel.direction = glm::normalize(glm::dvec3(.3, 1, .2));
    panel.radius = Radians(.3);
    panel.radiance = {1, 1, 1};
  }
  std::vector<float> taken(const prt::Mesh& mesh, int samples) const {
    DirectLightAtVertices out;
    trace_direct_light_at_vertices({&virtual_things, nullptr, 1e-4f}, mesh, panel, samples, out);
    return out.virtual_occlusion;
  }
};

double rms(const std::vector<float>& a, const std::vector<float>& b) {
  double square = 0;
  for (std::size_t i = 0; i < a.size(); ++i) square += std::pow(double(a[i]) - b[i], 2);
  return std::sqrt(square / static_cast<double>(a.size()));
}

// Four rays a vertex leave blotches in a wide penumbra; vertices that know their neighbours do
// not.
TEST(LightVertices, BroadPenumbraOnRealGroundIsSmooth) {
  const Patch patch;
  prt::Mesh alone = patch.ground;
  alone.triangles.clear();
  const auto truth = patch.taken(alone, 64);
  EXPECT_GT(*std::ranges::max_element(truth), .5f);
  EXPECT_LT(rms(patch.taken(patch.ground, 4), truth), .015);
  EXPECT_GT(rms(patch.taken(alone, 4), truth), .03) << "each vertex for itself";
}

// Of a wide strip as of a round light; the light itself is that of all of it.
TEST(LightVertices, ByOneSampleALightIsHiddenAsItsMiddleIs) {
  Patch patch;
  const lighting::DistantLight round = patch.panel;
  lighting::DistantLight strip = round;
  glm::dvec3 all(0);
  for (int i = 0; i < 64; ++i) {
    strip.shape.push_back(glm::normalize(glm::dvec3(.13 + (i - 31.5) / 80, 1, .07)));
    all += strip.shape.back();
  }
  strip.direction = glm::normalize(all);
  for (const auto& [radius, source] : {std::pair(.03, round), {.3, round}, {.3, strip}}) {
    patch.panel = source;
    patch.panel.radius = Radians(radius);
    const auto hard = patch.taken(patch.ground, 1), soft = patch.taken(patch.ground, 64);
    const double mean = source.shape.empty() ? .5 + .5 * std::cos(radius) : glm::length(all) / 64;
    patch.panel = round;
    patch.panel.direction = source.direction;
    patch.panel.radius = Radians(1e-5);
    auto point = patch.taken(patch.ground, 64);
    for (float& p : point) p *= static_cast<float>(mean);
    EXPECT_LT(rms(hard, point), 1e-3) << radius;
    EXPECT_GT(rms(soft, point), .03) << radius;
  }
}

TEST(LightVertices, OpenGroundHasTheLightOfTheWholeLight) {
  const Patch patch;
  DirectLightAtVertices out;
  trace_direct_light_at_vertices({nullptr, nullptr, 1e-4f}, patch.ground, patch.panel, 4, out);
  // Int cos over the light / its solid angle = cos(angle to its axis) (1 + cos r) / 2
  const double expected = patch.panel.direction.y * (1 + std::cos(patch.panel.radius.value())) / 2;
  for (const float open : out.open) ASSERT_NEAR(open, expected, .004);
  for (const float taken : out.virtual_occlusion) ASSERT_EQ(taken, 0);
}

}  // namespace
}  // namespace penumbra::shadows
