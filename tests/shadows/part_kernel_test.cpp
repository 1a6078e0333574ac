// Counting layers in vectors against one direction at a time, for any number of directions.
#include "shadows/shadows.h"
#include "shadows/visibility/internal/part_kernel.h"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <vector>

namespace penumbra::shadows {
namespace {

// Directions all over the square of side 2, some of them behind the surface and some that do not count.
PartTaps random_taps(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> place(-1, 1);
  PartTaps taps;
  taps.count = count;
  for (std::size_t k = 0; k < count; ++k) {
    taps.x[k] = place(random), taps.z[k] = place(random);
    const glm::vec3 d = glm::normalize(glm::vec3(place(random), 1, place(random)));
    taps.towards_x[k] = d.x, taps.towards_y[k] = d.y, taps.towards_z[k] = d.z;
    taps.counted[k] = k % 5 == 2 ? 0 : 1;
  }
  return taps;
}

float cosine_of(const PartTaps& t, std::size_t k, const glm::vec3& n) {
  return std::max(0.f, n.x * t.towards_x[k] + n.y * t.towards_y[k] + n.z * t.towards_z[k]);
}

// 1 where the way from the origin passes the line to its left side, -1 where to its right one.
float passes(const Crossing& line, float x, float z) {
  const auto left_of = [](const glm::vec2& a, const glm::vec2& b, const glm::vec2& p) {
    return (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) > 0;
  };
  const glm::vec2 p(x, z), middle(0);
  if ((p.x * line.from.y - p.y * line.from.x >= 0) == (p.x * line.to.y - p.y * line.to.x >= 0))
    return 0;
  const bool there = left_of(line.from, line.to, p), here = left_of(line.from, line.to, middle);
  return there == here ? 0 : there ? 1 : -1;
}

TEST(PartKernel, CountsAsOneByOne) {
  const glm::vec3 normals[] = {{0, 1, 0}, glm::normalize(glm::vec3(1, .3f, 0)), {0, -1, 0}};
  for (const std::size_t count : {1, 3, 8, 15, 16, 17, 33, 64})
    for (const glm::vec3& normal : normals) {
      PartTaps taps = random_taps(count, static_cast<unsigned>(count));
      std::mt19937 random(7);
      std::uniform_real_distribution<float> place(-1.5f, 1.5f);
      begin_place(normal, taps);
      std::vector<float> layers(count);
      for (int i = 0; i < 12; ++i) {
        const Crossing line{{place(random), place(random)},
                            {place(random), place(random)},
                            static_cast<float>(i % 3) - 1.5f};
        add_layers(line, taps);
        for (std::size_t k = 0; k < count; ++k)
          layers[k] += line.layers * passes(line, taps.x[k], taps.z[k]);
      }
      float open = 0, seen = 0, fewest = 1e30f;
      std::set<std::uint32_t> alike;
      for (std::size_t k = 0; k < count; ++k) {
        EXPECT_FLOAT_EQ(taps.layers[k], layers[k]) << count << ", " << k;
        EXPECT_NEAR(taps.cosine[k], cosine_of(taps, k, normal), 1e-6f);
        if (cosine_of(taps, k, normal) > 0) fewest = std::min(fewest, layers[k]);
      }
      for (std::uint32_t k = 0; k < count; ++k) {
        open += cosine_of(taps, k, normal);
        if (cosine_of(taps, k, normal) <= 0 || layers[k] != fewest) continue;
        alike.insert(k);
        seen += taps.counted[k] * cosine_of(taps, k, normal);
      }
      const FewestLayers found = fewest_layers(taps);
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
TEST(PartKernel, NoWayPassesBetweenLinesThatMeet) {
  PartTaps taps;
  taps.count = 16;
  for (std::size_t k = 0; k < taps.count; ++k) {
    taps.x[k] = .1f * static_cast<float>(k + 1), taps.z[k] = .07f * static_cast<float>(k + 1);
    taps.towards_y[k] = 1;
  }
  const glm::vec2 low(.9f, -1), corner(.65f, .455f), high(.3f, 1.4f);  // the corner on all ways
  for (const bool turned : {false, true}) {
    begin_place({0, 1, 0}, taps);
    add_layers(turned ? Crossing{corner, low, -2} : Crossing{low, corner, 2}, taps);
    add_layers(turned ? Crossing{high, corner, -2} : Crossing{corner, high, 2}, taps);
    for (std::size_t k = 0; k < taps.count; ++k)
      EXPECT_EQ(taps.layers[k], k < 6 ? 0 : -2) << k << turned;
  }
}

// Of a ring of directions the one nearest to their middle is asked.
TEST(PartKernel, AsksAmidThoseThatAreAlike) {
  PartTaps taps;
  taps.count = 17;
  for (std::size_t k = 0; k < taps.count; ++k) {
    const auto a = .4f * static_cast<float>(k);
    taps.x[k] = k == 16 ? .1f : std::cos(a), taps.z[k] = k == 16 ? .1f : std::sin(a);
    taps.towards_y[k] = taps.counted[k] = 1;
  }
  begin_place({0, 1, 0}, taps);
  EXPECT_EQ(fewest_layers(taps).ask, 16u);
}

}  // namespace
}  // namespace penumbra::shadows
