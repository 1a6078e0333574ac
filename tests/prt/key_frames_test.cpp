
#include <gtest/gtest.h>

#include <cmath>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

TEST(KeyFrames, TimesFindTheirPlace) {
  const KeyFrames keys{16, {0, 8, 10, 12}};
  EXPECT_EQ(keys.frame_at(0), 0);
  EXPECT_EQ(keys.frame_at(.25), .5);
  EXPECT_EQ(keys.frame_at(.5), 1);
  EXPECT_EQ(keys.frame_at(9. / 16), 1.5);
  EXPECT_EQ(keys.frame_at(14. / 16), 3.5) << "to the begin";
  EXPECT_EQ(keys.frame_at(2.25), 8.5);
  EXPECT_EQ(keys.frame_at(-.5), -3);
}

TEST(KeyFrames, TheBoundHoldsAndIsNotLoose) {
  // Every point goes round a circle, in another phase.
  const auto value = [](double clips, std::size_t p) {
    return std::sin(2 * kPi * clips + .7 * static_cast<double>(p));
  };
  const KeyFrames keys{96, {0, 8, 16, 20, 24, 28, 32, 33, 34, 35, 36, 40, 48, 56, 64, 72, 80, 88}};
  std::vector<Transfer> frames;
  for (const std::uint32_t at : keys.at) {
    frames.emplace_back(1, 1, 700);
    for (std::size_t p = 0; p < 700; ++p)
      frames.back().set(0, 0, p, static_cast<float>(value(at / 96., p)));
  }
  const std::vector<double> bounds = interpolation_errors(keys, frames);
  ASSERT_EQ(bounds.size(), keys.at.size());
  for (std::size_t i = 0; i < bounds.size(); ++i) {
    const double h = keys.width(i);
    if (h < 4) continue;  // halves are not that fine
    double sum = 0;
    for (std::size_t p = 0; p < 700; ++p) {
      const double line = .5 * (value(keys.at[i] / 96., p) + value((keys.at[i] + h) / 96., p));
      sum += std::pow(line - value((keys.at[i] + .5 * h) / 96., p), 2);
    }
    const double error = std::sqrt(sum / 700) * std::sqrt(mean_band_energy()[0]);
    // Twice what a smooth function asks for.
    EXPECT_GT(bounds[i], 2 * .97 * error) << i;
    EXPECT_LT(bounds[i], 2 * 1.2 * error) << i;
  }
}

}  // namespace
}  // namespace penumbra::prt
