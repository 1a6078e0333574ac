// Counting layers in vectors against one direction at a time, for any number of directions.
#include "shadows/visibility/internal/soft_shadow_kernel.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <vector>

namespace penumbra::shadows {
namespace {

// Directions all over the square of side 2, some of them behind the surface and some that do not
// count.
LayerSamples random_samples(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> place(-1, 1);
  LayerSamples samples;
  samples.count = count;
  for (std::size_t k = 0; k < count; ++k) {
    samples.x[k] = place(random), samples.z[k] = place(random);
    const glm::vec3 d = glm::normalize(glm::vec3(place(random), 1, place(random)));
    samples.towards_x[k] = d.x, samples.towards_y[k] = d.y, samples.towards_z[k] = d.z;
    samples.counted[k] = k % 5 == 2 ? 0 : 1;
  }
  return samples;
}

float cosine_of(const LayerSamples& t, std::size_t k, const glm::vec3& n) {
  return std::max(0.f, n.x * t.towards_x[k] + n.y * t.towards_y[k] + n.z * t.towards_z[k]);
}

// 1 where the way from the origin passes the line to its left side, -1 where to its right one.
float passes(const SilhouetteCrossing& line, float x, float z) {
  const auto left_of = [](const glm::vec2& a, const glm::vec2& b, const glm::vec2& p) {
    return (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) > 0;
  };
  const glm::vec2 p(x, z), middle(0);
  if ((p.x * line.from.y - p.y * line.from.x >= 0) == (p.x * line.to.y - p.y * line.to.x >= 0))
    return 0;
  const bool there = left_of(line.from, line.to, p), here = left_of(line.from, line.to, middle);
  return there == here ? 0 : there ? 1 : -1;
}

TEST(FractionKernel, CountsAsOneByOne) {
  const glm::vec3 normals[] = {{0, 1, 0}, glm::normalize(glm::vec3(1, .3f, 0)), {0, -1, 0}};
  for (const std::size_t count : {1, 3, 8, 15, 16, 17, 33, 64})
    for (const glm::vec3& normal : normals) {
      LayerSamples samples = random_samples(count, static_cast<unsigned>(count));
      std::mt19937 random(7);
      std::uniform_real_distribution<float> place(-1.5f, 1.5f);
      begin_place(normal, samples);
      std::vector<float> layers(count);
      for (int i = 0; i < 12; ++i) {
        const SilhouetteCrossing line{{place(random), place(random)},
                                      {place(random), place(random)},
                                      static_cast<float>(i % 3) - 1.5f};
        add_layers(line, samples);
        for (std::size_t k = 0; k < count; ++k)
          layers[k] += line.layers * passes(line, samples.x[k], samples.z[k]);
      }
      float open = 0, seen = 0, fewest = 1e30f;
      std::set<std::uint32_t> alike;
      for (std::size_t k = 0; k < count; ++k) {
        EXPECT_FLOAT_EQ(samples.layers[k], layers[k]) << count << ", " << k;
        EXPECT_NEAR(samples.cosine[k], cosine_of(samples, k, normal), 1e-6f);
        if (cosine_of(samples, k, normal) > 0) fewest = std::min(fewest, layers[k]);
      }
      for (std::uint32_t k = 0; k < count; ++k) {
        open += cosine_of(samples, k, normal);
        if (cosine_of(samples, k, normal) <= 0 || layers[k] != fewest) continue;
        alike.insert(k);
        seen += samples.counted[k] * cosine_of(samples, k, normal);
      }
      const FewestLayers found = fewest_layers(samples);
      EXPECT_NEAR(found.open, open, 1e-4f) << count;
      EXPECT_NEAR(found.seen, seen, 1e-4f) << count;
      if (alike.empty()) {
        EXPECT_EQ(found.ask, 0u);
      } else {
        EXPECT_TRUE(alike.contains(found.ask)) << count;
      }
    }
}

// Of two lines that meet on a way one passes it, whatever their order.
TEST(FractionKernel, NoWayPassesBetweenLinesThatMeet) {
  LayerSamples samples;
  samples.count = 16;
  for (std::size_t k = 0; k < samples.count; ++k) {
    samples.x[k] = .1f * static_cast<float>(k + 1), samples.z[k] = .07f * static_cast<float>(k + 1);
    samples.towards_y[k] = 1;
  }
  const glm::vec2 low(.9f, -1), corner(.65f, .455f), high(.3f, 1.4f);  // the corner on all ways
  for (const bool turned : {false, true}) {
    begin_place({0, 1, 0}, samples);
    add_layers(turned ? SilhouetteCrossing{corner, low, -2} : SilhouetteCrossing{low, corner, 2},
               samples);
    add_layers(turned ? SilhouetteCrossing{high, corner, -2} : SilhouetteCrossing{corner, high, 2},
               samples);
    for (std::size_t k = 0; k < samples.count; ++k)
      EXPECT_EQ(samples.layers[k], k < 6 ? 0 : -2) << k << turned;
  }
}

// Of a ring of directions the one nearest to their middle is asked.
TEST(FractionKernel, AsksAmidThoseThatAreAlike) {
  LayerSamples samples;
  samples.count = 17;
  for (std::size_t k = 0; k < samples.count; ++k) {
    const auto a = .4f * static_cast<float>(k);
    samples.x[k] = k == 16 ? .1f : std::cos(a), samples.z[k] = k == 16 ? .1f : std::sin(a);
    samples.towards_y[k] = samples.counted[k] = 1;
  }
  begin_place({0, 1, 0}, samples);
  EXPECT_EQ(fewest_layers(samples).ask, 16u);
}

}  // namespace
}  // namespace penumbra::shadows
