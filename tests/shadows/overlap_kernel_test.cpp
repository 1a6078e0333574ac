// Overlap of two deficits, sixteen texels at a time, against sums in double precision.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <vector>

#include "core/half.h"
#include "lighting/sh/rotation.h"
#include "shadows/field/internal/overlap_kernel.h"

namespace penumbra::shadows {
namespace {

constexpr std::size_t kBatch = DeficitBatch::kTexels;

// Correlated, of very different sizes, of which the least are too small for a normal half.
DeficitBatch random_deficits(unsigned seed) {
  DeficitBatch out{};
  std::mt19937 rng(seed);
  std::uniform_real_distribution<float> value(-1, 1);
  for (int n = 0; n < kMaxCoefficients; ++n)
    for (std::size_t i = 0; i < kBatch; ++i) {
      const float scale = std::pow(10.f, -float(i) / 3), common = value(rng), own = value(rng);
      out.first[n][i] = half_from_float(scale * common);
      out.second[n][i] = half_from_float(.5f * scale * (common + own));
    }
  return out;
}

double half_at(const std::uint16_t (&of)[kMaxCoefficients][kBatch], int n, std::size_t texel) {
  return double(float_from_half(of[n][texel]));
}

std::vector<float> entries_of(const lighting::ShRotation& rotation) {
  std::vector<float> out;
  for (int l = 0; l < rotation.bands(); ++l)
    for (int m = -l; m <= l; ++m)
      for (int n = -l; n <= l; ++n) out.push_back(float(rotation.entry(l, m, n)));
  return out;
}

void expect_plain_sums(const DeficitBatch& deficits, const lighting::ShRotation* rotation,
                       int bands) {
  OverlapBatch found{};
  find_overlap(deficits, bands, rotation ? entries_of(*rotation) : std::vector<float>{}, found);
  for (std::size_t i = 0; i < kBatch; ++i) {
    double common = 0, first = 0, second = 0;
    for (int l = 0; l < bands; ++l)
      for (int m = -l; m <= l; ++m) {
        double a = 0;
        for (int n = -l; n <= l; ++n)
          a += (rotation ? rotation->entry(l, m, n) : double(m == n)) *
               half_at(deficits.first, l * l + l + n, i);
        const double b = half_at(deficits.second, l * l + l + m, i);
        common += a * b, first += a * a, second += b * b;
      }
    ASSERT_NEAR(double(found.of_first[i]), std::clamp(common / first, 0., 1.), 1e-4)
        << bands << " bands, texel " << i;
    ASSERT_NEAR(double(found.of_second[i]), std::clamp(common / second, 0., 1.), 1e-4)
        << bands << " bands, texel " << i;
  }
}

TEST(OverlapKernel, AgreesWithPlainSums) {
  const glm::dmat3 turn = glm::mat3_cast(glm::angleAxis(.7, glm::dvec3(0, 1, 0)));
  for (int bands = 1; bands <= kMaxBands; ++bands) {
    const DeficitBatch deficits = random_deficits(unsigned(bands));
    const lighting::ShRotation rotation(turn, bands);
    expect_plain_sums(deficits, nullptr, bands);
    expect_plain_sums(deficits, &rotation, bands);
  }
}

TEST(OverlapKernel, NothingBlockedHasNothingInCommon) {
  DeficitBatch deficits = random_deficits(7);
  for (auto& of_texels : deficits.first) of_texels[3] = 0;
  for (int n = 0; n < kMaxCoefficients; ++n) {  // opposite; twice as much of the same
    deficits.second[n][4] = half_from_float(-float(half_at(deficits.first, n, 4)));
    deficits.second[n][5] = half_from_float(2 * float(half_at(deficits.first, n, 5)));
  }
  OverlapBatch found{};
  find_overlap(deficits, 5, {}, found);
  EXPECT_EQ(found.of_first[3], 0);
  EXPECT_EQ(found.of_second[3], 0);
  EXPECT_EQ(found.of_first[4], 0);
  EXPECT_EQ(found.of_first[5], 1) << "all of it, not twice";
  EXPECT_NEAR(double(found.of_second[5]), .5, 1e-6);
}

}  // namespace
}  // namespace penumbra::shadows
