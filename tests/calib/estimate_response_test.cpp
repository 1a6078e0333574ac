#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

struct Bracket {
  std::vector<Image<Rgb8>> pictures;
  std::vector<Seconds> times;

  Result<Response> estimate() const {
    std::vector<const Image<Rgb8>*> pointers;
    for (const auto& p : pictures) pointers.push_back(&p);
    return estimate_response(pointers, times);
  }
};

using EncodeSignal = std::function<double(double)>;

std::uint8_t quantise(double code) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(code, 0., 1.) * 255));
}

/// Smooth scene over eight stops, seen through `encode` with the given times; noise in codes.
Bracket simulate(const EncodeSignal& encode, const std::vector<double>& times, double noise = 0) {
  constexpr int width = 160, height = 120;
  Bracket b;
  std::mt19937 random(3);
  std::normal_distribution<double> grain(0, noise > 0 ? noise / 255 : 1);
  for (const double t : times) {
    Image<Rgb8> picture(width, height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double light = std::exp2(-6 + 8 * (x + 20 * std::sin(y * .1)) / width);
        const auto code = [&](double gain) {
          return quantise(encode(std::min(1., light * gain * t)) + (noise > 0 ? grain(random) : 0));
        };
        picture.at(x, y) = {code(1), code(.8), code(.6)};
      }
    }
    b.pictures.push_back(std::move(picture));
    b.times.emplace_back(t);
  }
  return b;
}

const std::vector<double> kTimes{1. / 16, 1. / 8, 1. / 4, 1. / 2, 1, 2, 4};

double gamma22(double x) {
  return std::pow(x, 1 / 2.2);
}

/// The scale of a curve is free (its value at code 255 is a convention that clipped pixels cannot
/// confirm), so curves are compared up to their best common factor. Returns the largest relative
/// error.
double error_up_to_scale(const Response& found, const Response& truth, int from, int to,
                         int channel) {
  double log_factor = 0;
  for (int code = from; code <= to; ++code)
    log_factor += std::log(found.decode(code / 255., channel) / truth.decode(code / 255., channel));
  const double factor = std::exp(log_factor / (to - from + 1));
  double worst = 0;
  for (int code = from; code <= to; ++code)
    worst = std::max(worst, std::abs(found.decode(code / 255., channel) /
                                         (factor * truth.decode(code / 255., channel)) -
                                     1));
  return worst;
}

void expect_recovers(const Bracket& bracket, const Response& truth, double tolerance) {
  const auto found = bracket.estimate();
  ASSERT_TRUE(found.has_value()) << found.error().detail;
  for (int c = 0; c < 3; ++c) {
    EXPECT_LT(error_up_to_scale(*found, truth, 20, 240, c), tolerance) << "channel " << c;
    EXPECT_NEAR(found->decode(128 / 255., c) / found->decode(240 / 255., c),
                truth.decode(128 / 255., c) / truth.decode(240 / 255., c), .005)
        << "channel " << c;
    EXPECT_EQ(found->decode(1, c), 1);
    const std::vector<float> table = found->decode_table(8, c);
    EXPECT_TRUE(std::ranges::is_sorted(table));
  }
}

TEST(EstimateResponse, RecoversGammaFromABracket) {
  expect_recovers(simulate(gamma22, kTimes), Response::gamma(2.2), .005);
}

TEST(EstimateResponse, RecoversSrgbFromABracket) {
  expect_recovers(simulate([](double x) { return Response::srgb().encode(x, 0); }, kTimes),
                  Response::srgb(), .005);
}

TEST(EstimateResponse, RecoversALinearSensor) {
  expect_recovers(simulate([](double x) { return x; }, kTimes), Response::linear(), .005);
}

TEST(EstimateResponse, RecoversGammaFromThreePicturesWithNoise) {
  expect_recovers(simulate(gamma22, {.125, .5, 2}, 1), Response::gamma(2.2), .02);
}

TEST(EstimateResponse, IgnoresTheOrderOfThePictures) {
  const Bracket b = simulate(gamma22, kTimes);
  Bracket reversed;
  for (std::size_t k = b.pictures.size(); k-- > 0;) {
    reversed.pictures.push_back(b.pictures[k]);
    reversed.times.push_back(b.times[k]);
  }
  const auto one = b.estimate(), other = reversed.estimate();
  ASSERT_TRUE(one && other);
  for (int code = 0; code < 256; ++code)
    EXPECT_NEAR(one->decode(code / 255., 1), other->decode(code / 255., 1), 2e-3);
}

TEST(EstimateResponse, IgnoresPureBlueRegistrationBorders) {
  Bracket b = simulate(gamma22, kTimes);
  for (std::size_t k = 0; k < b.pictures.size(); ++k) {
    auto& p = b.pictures[k];
    for (int y = 0; y < p.height(); ++y)
      for (int x = 0; x < p.width(); ++x)
        if (x < 12 + static_cast<int>(k) || y >= p.height() - 9) p.at(x, y) = {0, 0, 255};
  }
  expect_recovers(b, Response::gamma(2.2), .005);
}

void expect_refused(const Result<Response>& result, ErrorCode code, const std::string& reason) {
  ASSERT_FALSE(result.has_value()) << reason;
  EXPECT_EQ(result.error().code, code) << result.error().detail;
  EXPECT_NE(result.error().detail.find(reason), std::string::npos) << result.error().detail;
}

TEST(EstimateResponse, RefusesBadArguments) {
  const Bracket good = simulate(gamma22, kTimes);
  expect_refused(Bracket{}.estimate(), ErrorCode::kInvalid, "fewer than 2 pictures");
  Bracket b = simulate(gamma22, {1});
  expect_refused(b.estimate(), ErrorCode::kInvalid, "fewer than 2 pictures");
  b = good;
  b.times.pop_back();
  expect_refused(b.estimate(), ErrorCode::kInvalid, "7 pictures but 6 exposure times");
  b = good;
  b.pictures[2] = Image<Rgb8>(10, 10);
  expect_refused(b.estimate(), ErrorCode::kInvalid, "picture 3 is 10x10");
  b = good;
  b.pictures[0] = {};
  expect_refused(b.estimate(), ErrorCode::kInvalid, "picture 1 is empty");
  for (const double t : {0., -1., std::nan(""), std::numeric_limits<double>::infinity()}) {
    b = good;
    b.times[3] = Seconds(t);
    expect_refused(b.estimate(), ErrorCode::kInvalid, "exposure time 4");
  }
}

Bracket constant(const std::vector<Rgb8>& colours) {
  Bracket b;
  for (std::size_t k = 0; k < colours.size(); ++k) {
    b.pictures.emplace_back(40, 30, colours[k]);
    b.times.emplace_back(std::exp2(static_cast<double>(k)));
  }
  return b;
}

TEST(EstimateResponse, RefusesEqualTimes) {
  Bracket b = simulate(gamma22, kTimes);
  std::ranges::fill(b.times, Seconds(.5));
  expect_refused(b.estimate(), ErrorCode::kUndetermined, "all exposure times are equal");
}

TEST(EstimateResponse, RefusesBlackClippedAndMaskedPictures) {
  expect_refused(constant({{0, 0, 0}, {1, 1, 1}}).estimate(), ErrorCode::kUndetermined,
                 "every picture is black");
  expect_refused(constant({{255, 255, 255}, {255, 255, 255}}).estimate(), ErrorCode::kUndetermined,
                 "every picture is clipped");
  expect_refused(constant({{0, 0, 255}, {0, 0, 255}}).estimate(), ErrorCode::kUndetermined,
                 "outside one of the aligned pictures");
}

TEST(EstimateResponse, RefusesPicturesWithoutOverlap) {
  expect_refused(constant({{0, 0, 0}, {255, 255, 255}}).estimate(), ErrorCode::kUndetermined,
                 "do not overlap");
  // Ten stops apart: nothing is well exposed in both.
  expect_refused(simulate(gamma22, {1. / 1024, 1024}).estimate(), ErrorCode::kUndetermined,
                 "do not overlap");
}

// A curve would call the pile at 235 so much light, and a sun would never be clipped.
TEST(EstimateResponse, RefusesACameraThatSaturatesBelowFullScaleByName) {
  for (const double last : {250., 235.}) {
    const auto found =
        simulate([last](double x) { return std::min(gamma22(x), last / 255); }, kTimes).estimate();
    ASSERT_FALSE(found) << last;
    EXPECT_EQ(found.error().code, ErrorCode::kUndetermined);
    EXPECT_NE(found.error().detail.find("saturates at code " + std::to_string(int(last))),
              std::string::npos)
        << found.error().detail;
  }
}

// Somebody walks through the exposures: an eighth of the pixels tells another curve.
TEST(EstimateResponse, WhatMovedHasNoSay) {
  Bracket b = simulate(gamma22, kTimes);
  for (std::size_t k = 0; k < b.pictures.size(); ++k)
    for (int y = 0; y < 15; ++y)
      for (int x = 0; x < 160; ++x) {
        Rgb8& p = b.pictures[k].at(x, y);
        if ((x / 20 + static_cast<int>(k)) % 3 == 0)
          p = {std::uint8_t(p.r / 2), std::uint8_t(p.g / 2), std::uint8_t(p.b / 2)};
      }
  expect_recovers(b, Response::gamma(2.2), .03);
}

TEST(EstimateResponse, RefusesOneColour) {
  expect_refused(constant({{50, 50, 50}, {90, 90, 90}, {150, 150, 150}}).estimate(),
                 ErrorCode::kUndetermined, "too even");
}

TEST(EstimateResponse, RefusesPicturesThatDoNotFollowTheirTimes) {
  Bracket b = simulate(gamma22, kTimes);
  for (auto& p : b.pictures) p = b.pictures[3];
  expect_refused(b.estimate(), ErrorCode::kUndetermined, "does not change with the exposure");
  b = simulate(gamma22, kTimes);
  std::ranges::reverse(b.times);
  expect_refused(b.estimate(), ErrorCode::kUndetermined, "darker than one with a shorter exposure");
}

}  // namespace
}  // namespace penumbra::calib
