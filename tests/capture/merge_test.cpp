#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/brackets.h"

namespace penumbra::capture {
namespace {

constexpr double kTwoStops[] = {1, 1. / 4, 1. / 16, 1. / 64, 1. / 256, 1. / 1024};

Sensor linear16(double black_level = .03) {
  Sensor s;
  s.black_level = black_level;
  s.bits = 16;
  return s;
}

Sensor srgb8(double black_level = .02) {
  Sensor s;
  s.response = calib::Response::srgb();
  s.black_level = black_level;
  return s;
}

/// Errors of one decade of radiance.
struct Decade {
  double bias = 0, square = 0;
  int count = 0;
  double mean_bias() const { return bias / count; }
  double rmse_over_bound() const { return std::sqrt(square / count); }
};

std::vector<Decade> errors_by_decade(const Sensor& sensor, std::span<const Exposure> exposures,
                                     double low, int decades, unsigned seed) {
  const auto truth = test::log_uniform_radiance(768, 512, low, low * std::pow(10, decades), seed);
  const auto merged = merge(test::bracket(sensor, truth, exposures, seed));
  EXPECT_TRUE(merged);
  std::vector<Decade> out(static_cast<std::size_t>(decades));
  for (std::size_t i = 0; merged && i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double x = truth.pixels()[i][c], bound = test::radiance_bound(sensor, exposures, x);
      if (bound == 0) continue;
      const double error = merged->radiance.pixels()[i][c] - x;
      Decade& d = out[std::min(out.size() - 1, static_cast<std::size_t>(std::log10(x / low)))];
      d.bias += error / x, d.square += error * error / bound, ++d.count;
    }
  return out;
}

void expect_optimal(const std::vector<Decade>& decades, const char* name) {
  for (std::size_t k = 0; k < decades.size(); ++k) {
    const Decade& d = decades[k];
    std::printf("%s, decade %zu: bias %+.3f %%, RMSE %.3f of the bound, %d samples\n", name, k,
                100 * d.mean_bias(), d.rmse_over_bound(), d.count);
    ASSERT_GT(d.count, 20000);
    EXPECT_LE(std::abs(d.mean_bias()), .005) << name << ' ' << k;
    EXPECT_LE(d.rmse_over_bound(), 1.05) << name << ' ' << k;
    EXPECT_GE(d.rmse_over_bound(), .9) << "nothing beats the bound; the bound is wrong";
  }
}

// ------------------------------------------------------------------------------------- estimate

TEST(Merge, ReachesTheCramerRaoBoundWithoutBiasOverFiveDecades) {
  expect_optimal(errors_by_decade(linear16(), test::exposures_of(kTwoStops), 4e-3, 5, 1),
                 "linear 16 bit");
}

TEST(Merge, ReachesTheCramerRaoBoundWithoutBiasOfEightBitCodes) {
  expect_optimal(errors_by_decade(srgb8(), test::exposures_of(kTwoStops), .02, 4, 2), "sRGB 8 bit");
}

TEST(Merge, ReachesTheCramerRaoBoundWithGainInTheBracket) {
  const Exposure mixed[] = {{Seconds(1), Gain(4)},
                            {Seconds(1), Gain(1)},
                            {Seconds(.1), Gain(1)},
                            {Seconds(.01), Gain(1)},
                            {Seconds(.001), Gain(1)}};
  expect_optimal(errors_by_decade(linear16(), mixed, 4e-3, 4, 3), "linear 16 bit, gains 4 and 1");
}

// Debevec & Malik 1997: weights fall to 0 at both ends of the code range, averages of logarithms.
double hat_log_average(std::span<const double> signals, std::span<const Exposure> exposures) {
  double sum = 0, weights = 0;
  for (std::size_t k = 0; k < signals.size(); ++k) {
    const double y = std::max(signals[k], 1. / 65535), w = std::min(y, 1 - y);
    sum += w * std::log(y / exposures[k].product());
    weights += w;
  }
  return std::exp(sum / weights);
}

TEST(Merge, HasNoBiasInTheDarkWhereTheHatAndLogAverageHas) {
  const auto exposures = test::exposures_of(std::span(kTwoStops).first(4));
  for (const float x : {.001f, .003f}) {
    Image<Rgb> truth(512, 512, {x, x, x});
    truth.at(0, 0) = {.5f, .5f, .5f};
    const auto stack = test::bracket(linear16(), truth, exposures, 4);
    const auto merged = merge(stack);
    ASSERT_TRUE(merged);
    double ours = 0, naive = 0;
    for (std::size_t i = 1; i < truth.area(); ++i) {
      double signals[4];
      for (std::size_t k = 0; k < 4; ++k)
        signals[k] =
            std::get<Image<Rgb16>>(*stack.frames[k]).pixels()[i].g / 65535. - stack.black_level;
      ours += merged->radiance.pixels()[i].g / x - 1;
      naive += hat_log_average(signals, exposures) / x - 1;
    }
    ours /= double(truth.area() - 1), naive /= double(truth.area() - 1);
    const double snr = x / std::sqrt(test::signal_variance(linear16(), x, 1));
    std::printf("SNR %.1f: bias %+.3f %%, hat and logarithm %+.1f %%\n", snr, 100 * ours,
                100 * naive);
    EXPECT_LE(std::abs(ours), .005) << x;
    EXPECT_GT(std::abs(naive), .05) << "the naive average should fail here";
  }
}

TEST(Merge, KeepsNegativeResultsSoThatBlackHasNoBias) {
  Image<Rgb> truth(256, 256);
  truth.at(0, 0) = {.5f, .5f, .5f};
  const auto exposures = test::exposures_of(std::span(kTwoStops).first(3));
  const auto merged = merge(test::bracket(linear16(), truth, exposures, 5));
  ASSERT_TRUE(merged);
  double sum = 0, square = 0, negative = 0;
  const double n = 3 * double(truth.area() - 1);
  for (std::size_t i = 1; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double v = merged->radiance.pixels()[i][c];
      sum += v, square += v * v, negative += v < 0;
    }
  const double sigma = std::sqrt(square / n);
  EXPECT_LT(sigma, 1.2 * std::sqrt(test::radiance_bound(linear16(), exposures, 1e-9)));
  EXPECT_LT(std::abs(sum / n), 5 * sigma / std::sqrt(n));
  EXPECT_NEAR(negative / n, .5, .02);
}

TEST(Merge, IgnoresTheOrderOfTheExposures) {
  const auto truth = test::log_uniform_radiance(61, 37, .01, 300, 6);
  const auto stack = test::bracket(srgb8(), truth, test::exposures_of(kTwoStops), 6);
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  ExposureStack shuffled = stack;
  std::vector<std::size_t> order(stack.frames.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::mt19937 rng(7);
  for (int round = 0; round < 4; ++round) {
    std::ranges::shuffle(order, rng);
    for (std::size_t k = 0; k < order.size(); ++k) {
      shuffled.frames[k] = stack.frames[order[k]];
      shuffled.exposures[k] = stack.exposures[order[k]];
    }
    const auto again = merge(shuffled);
    ASSERT_TRUE(again);
    EXPECT_EQ(again->clipped, merged->clipped);
    EXPECT_EQ(again->black_fraction, merged->black_fraction);
    for (std::size_t i = 0; i < truth.area(); ++i)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(again->radiance.pixels()[i][c], merged->radiance.pixels()[i][c],
                    1e-6 * std::abs(merged->radiance.pixels()[i][c]) + 1e-9);
  }
}

// What large pictures look up in tables of all codes is what small ones compute.
TEST(Merge, OfALargePictureWithAnOrderOfTrustIsThatOfItsParts) {
  constexpr int kWidth = 800, kHeight = 400, kPart = 200;
  std::mt19937 random(9);
  std::uniform_int_distribution<int> code(0, 255);
  std::vector<Image<Rgb8>> pictures(3, Image<Rgb8>(kWidth, kHeight));
  for (Image<Rgb8>& p : pictures)
    for (Rgb8& c : p.pixels())
      c = {static_cast<std::uint8_t>(code(random)), static_cast<std::uint8_t>(code(random)),
           static_cast<std::uint8_t>(code(random))};
  const auto merged = [&](int x0, int width) {
    ExposureStack stack;
    stack.response = calib::Response::srgb();
    stack.priority = {1, 0, 2};
    stack.noise_known = false;
    for (int k = 0; k < 3; ++k) {
      Image<Rgb8> part(width, kHeight);
      for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < width; ++x)
          part.at(x, y) = pictures[static_cast<std::size_t>(k)].at(x0 + x, y);
      stack.frames.push_back(std::make_shared<const FramePixels>(std::move(part)));
      stack.exposures.push_back({Seconds(std::pow(4., k - 1)), Gain(1)});
    }
    return merge(stack);
  };
  const auto whole = merged(0, kWidth), part = merged(kPart, kPart);
  ASSERT_TRUE(whole && part);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kPart; ++x)
      ASSERT_EQ(whole->radiance.at(kPart + x, y), part->radiance.at(x, y)) << x << ' ' << y;
}

TEST(Merge, ScalingAllExposuresByKScalesRadianceByOneOverK) {
  const auto truth = test::log_uniform_radiance(61, 37, .01, 300, 8);
  const auto stack = test::bracket(linear16(), truth, test::exposures_of(kTwoStops), 8);
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  for (const double k : {1e-3, .37, 8., 1e4}) {
    ExposureStack scaled = stack;
    for (Exposure& e : scaled.exposures) e.time *= k;
    const auto again = merge(scaled);
    ASSERT_TRUE(again);
    for (std::size_t i = 0; i < truth.area(); ++i)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(k * again->radiance.pixels()[i][c], merged->radiance.pixels()[i][c],
                    1e-6 * std::abs(merged->radiance.pixels()[i][c]) + 1e-9)
            << k;
  }
}

TEST(Merge, OfFloatFramesNeedsNoResponseAndClipsNothing) {
  const auto truth = test::log_uniform_radiance(31, 17, .01, 300, 9);
  ExposureStack stack;
  stack.response = calib::Response::gamma(3);  // unused: the frames are linear
  for (const double t : {.5, 4.}) {
    Image<Rgb> frame = truth;
    for (Rgb& p : frame.pixels()) p = p * static_cast<float>(t);
    stack.frames.push_back(std::make_shared<const FramePixels>(std::move(frame)));
    stack.exposures.push_back({Seconds(t), Gain(1)});
  }
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  EXPECT_EQ(merged->clipped_fraction, 0);
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c)
      ASSERT_NEAR(merged->radiance.pixels()[i][c] / truth.pixels()[i][c], 1, 1e-5);
}

// ------------------------------------------------------------------------------------- ends of the
// range

// As a raw converter writes them: everything above full scale is 1. Without being told, the mean of
// both exposures would be 2.5 and .55 where 4 and 1 are the truth.
TEST(Merge, FloatFramesDevelopedToAFullScaleAreClippedThere) {
  ExposureStack stack;
  for (const double time : {1., .1, .01}) {
    Image<Rgb> frame(64, 8);
    for (int y = 0; y < 8; ++y)
      for (int x = 0; x < 64; ++x) {
        // White balance has left each channel a full scale of its own, above a black level.
        const double v = .05 + std::min(1., time * std::exp2(x / 8. - 3));
        frame.at(x, y) = {static_cast<float>(v), static_cast<float>(.05 + .5 * (v - .05)), .05f};
      }
    stack.frames.push_back(std::make_shared<const FramePixels>(std::move(frame)));
    stack.exposures.push_back({Seconds(time), Gain(1)});
  }
  stack.black_level = .05;
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  EXPECT_EQ(merged->clipped_fraction, 0);
  for (int x = 0; x < 64; ++x) {
    EXPECT_NEAR(merged->radiance.at(x, 3).r / std::exp2(x / 8. - 3), 1, .01) << x;
    EXPECT_NEAR(merged->radiance.at(x, 3).g / std::exp2(x / 8. - 4), 1, .01) << x;
  }
}

// The brightest part of an unclipped bracket is flat: over a black level it stays.
TEST(Merge, FlatBrightestPartOfAFloatBracketIsNotClipped) {
  ExposureStack stack;
  stack.black_level = .05;
  for (const double time : {1., .1}) {
    const auto v = static_cast<float>(.05 + .5 * time);
    stack.frames.push_back(std::make_shared<const FramePixels>(Image<Rgb>(64, 8, {v, v, v})));
    stack.exposures.push_back({Seconds(time), Gain(1)});
  }
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  EXPECT_EQ(merged->clipped_fraction, 0);
  EXPECT_NEAR(merged->radiance.at(5, 5).g, .5, 1e-5);
}

TEST(Merge, PixelClippedEverywhereGetsTheLowerBoundAndTheFlag) {
  Image<Rgb> truth(8, 4, {.1f, .1f, .1f});
  truth.at(3, 2) = {5000, .1f, .1f};  // one channel is enough
  const auto exposures = test::exposures_of(std::span(kTwoStops).first(4));
  for (const Sensor& sensor : {linear16(), srgb8()}) {
    const auto merged = merge(test::bracket(sensor, truth, exposures, 10));
    ASSERT_TRUE(merged);
    for (int y = 0; y < 4; ++y)
      for (int x = 0; x < 8; ++x) EXPECT_EQ(merged->clipped.at(x, y), x == 3 && y == 2);
    EXPECT_DOUBLE_EQ(merged->clipped_fraction, 1. / 32);
    const double bound = (1 - sensor.black_level) / exposures.back().product();
    EXPECT_NEAR(merged->radiance.at(3, 2).r / bound, 1, 1e-5);
    EXPECT_NEAR(merged->radiance.at(3, 2).g, .1, .02);
  }
}

TEST(Merge, ClippedCodesDoNotCount) {
  // The longest exposure is clipped; alone it would say 1/e.
  const Image<Rgb> truth(64, 64, {2, 2, 2});
  Sensor sensor = linear16();
  sensor.noisy = false;
  const double times[] = {1, .1};
  const auto merged = merge(test::bracket(sensor, truth, test::exposures_of(times), 11));
  ASSERT_TRUE(merged);
  EXPECT_EQ(merged->clipped_fraction, 0);
  for (const Rgb& p : merged->radiance.pixels()) ASSERT_NEAR(p.g, 2, 1e-3);
}

void expect_undetermined(float radiance, const std::string& word) {
  for (const Sensor& sensor : {linear16(), srgb8()}) {
    const Image<Rgb> truth(16, 9, {radiance, radiance, radiance});
    const auto merged = merge(test::bracket(sensor, truth, test::exposures_of(kTwoStops), 12));
    ASSERT_FALSE(merged);
    EXPECT_EQ(merged.error().code, ErrorCode::kUndetermined);
    EXPECT_NE(merged.error().detail.find(word), std::string::npos) << merged.error().detail;
  }
}

// An estimated curve is a guess in the dark: four times too bright here. Where the short exposure
// is trusted most, its word kept the long one out, and a dark tree became one value.
TEST(Merge, DarkCodesOfAGuessedCurveOnlyBoundTheLight) {
  const auto guessed = [] {
    std::vector<float> table;
    for (int z = 0; z < 256; ++z)
      table.push_back(static_cast<float>(
          calib::Response::srgb().decode(std::max(z, z < 8 ? 2 * z : z) / 255., 0) *
          (z < 8 ? 2 : 1)));
    for (std::size_t z = 1; z < table.size(); ++z) table[z] = std::max(table[z], table[z - 1]);
    return *calib::Response::from_table({table, table, table});
  }();
  ExposureStack stack;
  stack.response = guessed;
  stack.noise_known = false;
  stack.priority = {0, 1};
  Image<Rgb8> dark(16, 16), bright(16, 16);
  const calib::Response srgb = calib::Response::srgb();
  double truth = 0;
  for (std::size_t i = 0; i < dark.area(); ++i) {
    const double light = .0014 + .000002 * static_cast<double>(i);
    truth += light / static_cast<double>(dark.area());
    const auto code = [&](double x) {
      return static_cast<std::uint8_t>(std::lround(255 * srgb.encode(x, 0)));
    };
    dark.pixels()[i] = {code(light), code(light), code(light)};
    bright.pixels()[i] = {code(64 * light), code(64 * light), code(64 * light)};
  }
  stack.frames = {std::make_shared<const FramePixels>(dark),
                  std::make_shared<const FramePixels>(bright)};
  stack.exposures = {{Seconds(1), Gain(1)}, {Seconds(64), Gain(1)}};
  const auto mean = [&] {
    const auto merged = merge(stack);
    EXPECT_TRUE(merged);
    double sum = 0;
    for (const Rgb& p : merged->radiance.pixels()) sum += double(p.g);
    return sum / static_cast<double>(merged->radiance.area());
  };
  EXPECT_GT(mean() / truth, 1.3) << "the test shows nothing";
  stack.first_code = calib::kFirstReliableCode;
  EXPECT_NEAR(mean() / truth, 1, .02);
}

TEST(Merge, AllClippedIsUndetermined) {
  expect_undetermined(1e5f, "clipped");
}

TEST(Merge, AllBlackIsUndetermined) {
  // Without noise: chance lifts a few of many pixels above any threshold.
  for (Sensor sensor : {linear16(), srgb8()}) {
    sensor.noisy = false;
    const auto merged =
        merge(test::bracket(sensor, Image<Rgb>(16, 9), test::exposures_of(kTwoStops), 13));
    ASSERT_FALSE(merged);
    EXPECT_EQ(merged.error().code, ErrorCode::kUndetermined);
    EXPECT_NE(merged.error().detail.find("black"), std::string::npos) << merged.error().detail;
  }
}

// ------------------------------------------------------------------------------------- bad input

ExposureStack good_stack() {
  const double times[] = {1, .25};
  return test::bracket(srgb8(), test::log_uniform_radiance(16, 9, .1, 1, 14),
                       test::exposures_of(times), 14);
}

void expect_invalid(const ExposureStack& stack, const std::string& where) {
  const auto merged = merge(stack);
  ASSERT_FALSE(merged) << "expected an error naming " << where;
  EXPECT_EQ(merged.error().code, ErrorCode::kInvalid);
  EXPECT_NE(merged.error().where.find(where), std::string::npos) << merged.error().where;
}

TEST(Merge, RefusesExposuresThatAreNotPositiveAndFinite) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  ASSERT_TRUE(merge(good_stack()));
  for (const double bad : {0., -1., kNan, kInfinity, -kInfinity}) {
    ExposureStack stack = good_stack();
    stack.exposures[1].time = Seconds(bad);
    expect_invalid(stack, "exposure 2");
    stack = good_stack();
    stack.exposures[0].gain = Gain(bad);
    expect_invalid(stack, "exposure 1");
  }
}

TEST(Merge, RefusesFramesThatDoNotBelongTogether) {
  ExposureStack stack = good_stack();
  stack.frames[1] = std::make_shared<const FramePixels>(Image<Rgb8>(9, 16));
  expect_invalid(stack, "frame 2");
  stack.frames[1] = std::make_shared<const FramePixels>(Image<Rgb16>(16, 9));
  expect_invalid(stack, "frame 2");
  stack = good_stack();
  stack.exposures.pop_back();
  expect_invalid(stack, "exposure stack");
  expect_invalid(ExposureStack{}, "exposure stack");
  stack = good_stack();
  for (auto& f : stack.frames) f = std::make_shared<const FramePixels>(Image<Rgb8>());
  expect_invalid(stack, "frame 1");
}

}  // namespace
}  // namespace penumbra::capture
