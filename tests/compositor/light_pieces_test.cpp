#include "compositor/layers/light_pieces.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "lighting/reflections/ggx.h"

namespace penumbra::compositor {
namespace {

using glm::dvec3;

prt::Material metal(float roughness) {
  return {.metallic = 1, .roughness = roughness};
}

MirroredLight lamp(double radius_rad) {
  return {glm::normalize(dvec3(.3, .9, .2)), radius_rad, {3, 2, 1}};
}

// What a white metal sends along its normal, of light along `l`, but for the light's irradiance.
double lobe(const dvec3& n, const dvec3& v, const dvec3& l, double alpha) {
  const double n_dot_l = glm::dot(n, l), n_dot_v = glm::dot(n, v);
  if (n_dot_l <= 0 || n_dot_v <= 0) return 0;
  const auto a = static_cast<float>(alpha);
  const double n_dot_m = std::min(1., glm::dot(n, glm::normalize(l + v)));
  return n_dot_l * double(lighting::ggx_density(a, float(n_dot_m))) *
         double(lighting::ggx_visibility(a, float(n_dot_l), float(n_dot_v)));
}

double mirrored(const LightPieces& pieces, const dvec3& n, const dvec3& v, double alpha) {
  double sum = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(pieces.count); ++i)
    sum += double(pieces.irradiances[i].x) *
           lobe(n, v, dvec3(pieces.places[i]), std::hypot(alpha, .5 * double(pieces.places[i].w)));
  return sum;
}

// A lamp as large as the lobe, at places across its highlight, slantwise: there a single lobe that
// is wider by it is too wide along the lamp.
TEST(LightPieces, ALampLikeTheLobeIsMirroredAsItsDisc) {
  constexpr double kRadius = .054;
  constexpr float kRoughness = .25f;
  const double alpha = kRoughness * kRoughness;
  const MirroredLight one = lamp(kRadius);
  const LightPieces pieces({&one, 1}, metal(kRoughness)), whole({&one, 1}, metal(.05f));
  ASSERT_EQ(pieces.count, 4);
  ASSERT_EQ(whole.count, 1) << "a mirror shows the disc";
  const dvec3 x = glm::normalize(glm::cross(one.direction, dvec3(0, 1, 0))),
              y = glm::cross(one.direction, x);
  double off_pieces = 0, off_whole = 0, all = 0;
  for (double turn = 0; turn < 6; turn += .7)
    for (double lean = 0; lean < .15; lean += .01) {
      // The normal leans, so that what is mirrored passes over the lamp.
      const dvec3 v = glm::normalize(.8 * x - .6 * one.direction);  // slantwise
      const dvec3 n = glm::normalize(glm::normalize(one.direction + v) +
                                     lean * (std::cos(turn) * x + std::sin(turn) * y));
      double truth = 0;
      constexpr int kRings = 12, kTurns = 24;
      for (int r = 0; r < kRings; ++r)
        for (int t = 0; t < kTurns; ++t) {
          const double out = kRadius * std::sqrt((r + .5) / kRings), at = 2 * kPi * t / kTurns;
          truth += 3. / (kRings * kTurns) *
                   lobe(n, v,
                        glm::normalize(one.direction + out * (std::cos(at) * x + std::sin(at) * y)),
                        alpha);
        }
      off_pieces += std::pow(mirrored(pieces, n, v, alpha) - truth, 2);
      off_whole += std::pow(mirrored(whole, n, v, alpha) - truth, 2);
      all += truth * truth;
    }
  EXPECT_LT(std::sqrt(off_pieces / all), .06);
  EXPECT_GT(std::sqrt(off_whole / all), .15) << "what this is for";
}

TEST(LightPieces, NothingIsLostAndNoMoreThanFit) {
  for (const int lights : {1, 2, 3, 4, 6}) {
    const std::vector<MirroredLight> all(static_cast<std::size_t>(lights), lamp(.06));
    const LightPieces pieces(all, metal(.25f));
    ASSERT_LE(pieces.count, int(LightPieces::kMost));
    std::array<float, Surroundings::kMaxLights> sums{};
    for (std::size_t i = 0; i < static_cast<std::size_t>(pieces.count); ++i)
      sums.at(static_cast<std::size_t>(pieces.lights[i])) += pieces.irradiances[i].y;
    for (std::size_t i = 0; i < std::min<std::size_t>(all.size(), sums.size()); ++i)
      EXPECT_NEAR(sums[i], 2, 1e-5f) << lights;
  }
}

// Where the roughness is a picture's, or a coat is smoother, the parts could be seen.
TEST(LightPieces, WhatMayBeSmootherShowsTheWhole) {
  const MirroredLight one = lamp(.06);
  prt::Material coated = metal(.25f), painted = metal(.25f);
  coated.clearcoat = 1, coated.clearcoat_roughness = .03f;
  painted.metallic_roughness_map.picture = std::make_shared<prt::TexturePicture>();
  EXPECT_EQ(LightPieces({&one, 1}, coated).count, 1);
  EXPECT_EQ(LightPieces({&one, 1}, painted).count, 1);
  const MirroredLight sun = lamp(.0047);
  EXPECT_EQ(LightPieces({&sun, 1}, metal(.25f)).count, 1);
}

}  // namespace
}  // namespace penumbra::compositor
