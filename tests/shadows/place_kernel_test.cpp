#include "shadows/silhouette/place_kernel.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <vector>

namespace penumbra::shadows {
namespace {

using glm::vec2;
using glm::vec3;

std::vector<vec3> random_points(std::size_t count, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<float> one(-1, 1);
  std::vector<vec3> out;
  for (std::size_t i = 0; i < count; ++i) out.emplace_back(one(rng), one(rng), one(rng));
  return out;
}

const AffineTransform kPlacing{glm::mat3_cast(glm::angleAxis(.7f, glm::normalize(vec3(1, 2, 3)))) *
                                   glm::mat3(2, 0, 0, 0, 1, 0, 0, 0, 3),
                               {.3f, .2f, -.1f}};
vec3 placed(const vec3& p) {
  return kPlacing.turn * p + kPlacing.shift;
}

constexpr std::size_t kSizes[] = {0, 1, 2, 3, 4, 7, 8, 9, 15, 16, 17, 31, 100};

// Surfaces that face all of the light, some of it and nothing.
TEST(PlaceKernel, MeanCosinesAreThoseOverTheDirections) {
  const vec3 middle = glm::normalize(vec3(1, 5, 2));
  std::vector<vec3> directions;
  vec3 mean(0);
  float reach = 0;
  for (const vec3& off : random_points(9, 3)) {
    directions.push_back(glm::normalize(middle + .2f * off));
    mean += directions.back() / 9.f;
    reach = std::max(reach, glm::distance(directions.back(), middle));
  }
  int partly = 0;
  for (const std::size_t size : kSizes) {
    std::vector<vec3> normals = random_points(size, 4);
    for (vec3& n : normals)
      n = glm::normalize(n + (size % 2 ? 0 : -.9f) * glm::dot(n, middle) * middle);
    std::vector<float> out(size + 1, 77);
    mean_cosines(normals, {directions, middle, mean, reach}, std::span(out).first(size));
    for (std::size_t i = 0; i < size; ++i) {
      float sum = 0;
      int before = 0;
      for (const vec3& d : directions) {
        sum += std::max(0.f, glm::dot(normals[i], d)) / 9;
        before += glm::dot(normals[i], d) > 0 ? 1 : 0;
      }
      partly += before % 9 != 0 ? 1 : 0;
      EXPECT_NEAR(out[i], sum, 1e-6f) << size;
    }
    EXPECT_EQ(out[size], 77);
  }
  EXPECT_GT(partly, 20);
}

TEST(PlaceKernel, FindsTheFootprintOfWhatIsAboveAPlane) {
  const Reach reach{{-.5f, -.2f}, {.9f, .3f}};
  constexpr float kNear = .05f;
  for (const std::size_t size : kSizes)
    for (const float lift : {-3.f, 0.f, 3.f}) {
      std::vector<vec3> positions = random_points(size, 5);
      for (vec3& p : positions) p += lift * glm::inverse(kPlacing.turn) * vec3(0, 1, 0);
      const Footprint f = footprint_of(positions, kPlacing, reach, kNear);
      Footprint wanted;
      for (const vec3& position : positions) {
        const vec3 p = placed(position);
        if (p.y < -kNear) wanted.below = true;
        if (p.y < -kNear) continue;
        const float y = std::max(p.y, 0.f);
        const vec2 foot(p.x, p.z);
        wanted.low = glm::min(wanted.low, foot), wanted.high = glm::max(wanted.high, foot);
        wanted.shadow_low = glm::min(wanted.shadow_low, foot + y * reach.low);
        wanted.shadow_high = glm::max(wanted.shadow_high, foot + y * reach.high);
      }
      EXPECT_EQ(f.below, wanted.below) << size << ", " << lift;
      for (const auto& [a, b] : {std::pair(f.low, wanted.low),
                                 {f.high, wanted.high},
                                 {f.shadow_low, wanted.shadow_low},
                                 {f.shadow_high, wanted.shadow_high}})
        EXPECT_LE(glm::distance(a, b), 1e-5f * glm::length(b)) << size << ", " << lift;
    }
}

}  // namespace
}  // namespace penumbra::shadows
