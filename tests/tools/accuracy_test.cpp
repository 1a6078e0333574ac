#include "tools/chart/measures/accuracy.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace penumbra::tools {

using namespace runtime;
namespace {

constexpr int kSide = 256;
constexpr std::size_t kPixels = kSide * kSide;

// Everything is object; the reference's halves are the truth with independent noise.
struct Pictures {
  Still ours, truth, empty;
  Masks masks{std::vector<bool>(kPixels, true), std::vector<bool>(kPixels, false)};
};

Pictures of(const Rgb& truth, const Rgb& ours, float noise) {
  std::mt19937 rng(5);
  std::normal_distribution<float> normal(0, noise);
  Pictures p;
  for (Image<Rgb>* image : {&p.truth.radiance, &p.truth.half_a, &p.truth.half_b})
    *image = Image<Rgb>(kSide, kSide, truth);
  p.ours.radiance = Image<Rgb>(kSide, kSide, ours);
  p.empty.radiance = Image<Rgb>(kSide, kSide, {1, 1, 1});
  for (std::size_t i = 0; i < kPixels; ++i) {
    for (int c = 0; c < 3; ++c) {
      p.truth.half_a.pixels()[i][c] += normal(rng);
      p.truth.half_b.pixels()[i][c] += normal(rng);
    }
    p.truth.radiance.pixels()[i] = (p.truth.half_a.pixels()[i] + p.truth.half_b.pixels()[i]) * .5f;
  }
  return p;
}

Accuracy compare(const Pictures& p) {
  return compare_pictures(p.ours, p.truth, p.empty, p.masks);
}

TEST(Accuracy, NoiseOfTheReferenceIsNoErrorOfOurs) {
  const Rgb truth{.5f, .4f, .3f};
  const Accuracy a = compare(of(truth, truth, .05f));
  EXPECT_GT(a.object_rel_rmse, .03) << "the plain figure holds the noise";
  EXPECT_LT(a.object_without_noise, .01);
  EXPECT_NEAR(compare(of(truth, truth * 1.05f, .05f)).object_without_noise, .05, .005);
}

// Truncated light is negative in places, and not in all channels at once: a luminance of what is
// cut off is not the cut-off luminance.
TEST(Accuracy, AChannelThatIsCutOffAtZeroIsNoError) {
  const Rgb truth{-.3f, .4f, .5f}, cut{0, .4f, .5f};
  EXPECT_LT(compare(of(truth, cut, .02f)).object_without_noise, .01);
  EXPECT_NEAR(compare(of(truth, cut, .02f)).object_bias, 0, .01);
  const double naive = std::abs(luminance(cut) / luminance(truth) - 1);
  EXPECT_GT(naive, .2);
  EXPECT_GT(compare(of(Rgb{.3f, .4f, .5f}, cut, .02f)).object_without_noise, .1)
      << "positive in the reference";
}

// Where the truth is zero, the noise of the two halves must not look like light that ours lacks.
TEST(Accuracy, NoiseAboutZeroIsNoError) {
  Pictures p = of({0, 0, 0}, {0, 0, 0}, .1f);
  for (std::size_t i = 0; i < kPixels / 2; ++i)
    for (Image<Rgb>* image :
         {&p.ours.radiance, &p.truth.radiance, &p.truth.half_a, &p.truth.half_b})
      image->pixels()[i] = {1, 1, 1};
  EXPECT_LT(compare(p).object_without_noise, .015);
  double naive = 0, mean = 0;
  for (std::size_t i = 0; i < kPixels; ++i) {
    const auto positive = [i](const Still& s, const Image<Rgb>& half) {
      return std::max(0., double(luminance(half.pixels()[i]) - luminance(s.radiance.pixels()[i])));
    };
    naive += positive(p.ours, p.truth.half_a) * positive(p.ours, p.truth.half_b);
    mean += std::max(0.f, luminance(p.truth.radiance.pixels()[i]));
  }
  EXPECT_GT(std::sqrt(naive / kPixels) / (mean / kPixels), .04) << "each half cut off by itself";
}

}  // namespace
}  // namespace penumbra::tools
