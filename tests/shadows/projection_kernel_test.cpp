// Stretches of silhouettes on the plane, on every kind of processor that this one can be.
#include "shadows/silhouette/projection_kernel.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace penumbra::shadows {
namespace {

class ProjectionKernel : public testing::TestWithParam<std::int64_t> {
 protected:
  void SetUp() override {
    if ((hwy::SupportedTargets() & GetParam()) == 0)
      GTEST_SKIP() << "no " << hwy::TargetName(GetParam()) << " on this machine";
    hwy::SetSupportedTargetsForTest(GetParam());
    hwy::GetChosenTarget().Update(GetParam());
  }
  void TearDown() override {
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  }
};

// The rows that a stretch crosses lie between its ends, and where it meets them is on the line.
TEST_P(ProjectionKernel, StretchesCrossTheRowsBetweenTheirEnds) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<float> place(-20, 84), shift(-3, 3), up(0, 4);
  constexpr int kHeight = 64;
  int crossed = 0, level = 0, outside = 0;
  for (int i = 0; i < 2000; ++i) {
    SegmentSpan s{place(rng), up(rng), place(rng), place(rng), up(rng), place(rng)};
    if (i % 5 == 0) s.to_z = s.from_z, s.to_y = s.from_y;        // level
    if (i % 5 == 1) s.to_z = s.from_z + .3f, s.to_y = s.from_y;  // a row at most
    Shifts shifts;
    for (std::size_t k = 0; k < kGroup; ++k) shifts.x[k] = shift(rng), shifts.z[k] = shift(rng);
    ProjectedEdge out{};
    const std::uint16_t crosses = fall(s, shifts, kHeight, out);
    for (std::size_t k = 0; k < kGroup; ++k) {
      const double z0 = s.from_z + double(s.from_y) * shifts.z[k],
                   z1 = s.to_z + double(s.to_y) * shifts.z[k],
                   x0 = s.from_x + double(s.from_y) * shifts.x[k],
                   x1 = s.to_x + double(s.to_y) * shifts.x[k];
      const auto row = [](double z) {
        return static_cast<int>(std::clamp(std::ceil(z), 0., double(kHeight)));
      };
      if (std::abs(z0 - std::round(z0)) < 1e-4 || std::abs(z1 - std::round(z1)) < 1e-4)
        continue;  // either row, by rounding
      const bool should_cross = row(z0) != row(z1);
      ASSERT_EQ(crosses >> k & 1, should_cross) << z0 << ' ' << z1;
      if (!should_cross) {
        ++(z0 == z1 ? level : outside);
        continue;
      }
      ++crossed;
      ASSERT_EQ(out.row[k], row(z0));
      ASSERT_EQ(out.last[k], row(z1));
      const double at = std::min(out.row[k], out.last[k]),
                   x = out.x[k] + (at - out.z[k]) * double(out.slope[k]),
                   line = x0 + (at - z0) / (z1 - z0) * (x1 - x0);
      ASSERT_NEAR(x, line, 1e-3 * (1 + std::abs(double(out.slope[k]))));
    }
  }
  EXPECT_GT(crossed, 1000);
  EXPECT_GT(level, 100);
  EXPECT_GT(outside, 100);
}

INSTANTIATE_TEST_SUITE_P(Targets, ProjectionKernel,
                         testing::Values(std::int64_t{HWY_SSSE3}, std::int64_t{HWY_SSE4},
                                         std::int64_t{HWY_AVX2}, std::int64_t{HWY_AVX3}),
                         [](const auto& target) {
                           return std::string(hwy::TargetName(target.param));
                         });

}  // namespace
}  // namespace penumbra::shadows
