// Response curves of simulated cameras: ours, and OpenCV's two estimators on the same pictures.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <opencv2/photo.hpp>
#include <random>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

struct CodingCurve {
  std::string name;
  std::function<double(double)> encode;  // linear 0..1 -> code 0..1
};

double srgb(double x) {
  return x <= .0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - .055;
}
double s_curve(double x, double toe, double pivot) {
  const double a = std::pow(x, toe);
  return a / (a + std::pow(pivot * (1 - x), toe));
}
double logarithm(double x, double k) {
  return std::log1p(k * x) / std::log1p(k);
}

// The shapes of the curves that Grossberg & Nayar 2004 collected: video gammas, films with a toe
// and a shoulder, cameras with a knee, logarithmic sensors.
std::vector<CodingCurve> curves() {
  return {
      {"gamma 2.2", [](double x) { return std::pow(x, 1 / 2.2); }},
      {"sRGB", srgb},
      {"gamma 1.6", [](double x) { return std::pow(x, 1 / 1.6); }},
      {"gamma 2.6 over a toe",
       [](double x) {
         return std::pow((x + .002) / 1.002, 1 / 2.6) - std::pow(.002 / 1.002, 1 / 2.6) * (1 - x);
       }},
      {"film, soft", [](double x) { return s_curve(std::pow(x, .6), 1.3, .8); }},
      {"film, hard", [](double x) { return s_curve(std::pow(x, .5), 1.8, 1.1); }},
      {"slide film", [](double x) { return s_curve(std::pow(x, .45), 1.5, .6); }},
      {"knee",
       [](double x) {
         return .85 * std::pow(std::min(1., x / .5), 1 / 2.2) + .15 * std::max(0., (x - .5) / .5);
       }},
      {"logarithmic 30", [](double x) { return logarithm(x, 30); }},
      {"logarithmic 200", [](double x) { return logarithm(x, 200); }},
      {"sRGB, contrast raised", [](double x) { return s_curve(srgb(x), 1.25, 1); }},
      {"sine shoulder", [](double x) { return std::sin(std::pow(x, 1 / 1.8) * M_PI / 2); }},
  };
}

constexpr std::size_t kFirst = 4, kLast = 240;
const std::vector<double> kBracketTimes{1 / 240., 1 / 120., 1 / 60., 1 / 30.,
                                        1 / 15.,  1 / 8.,   1 / 4.};

std::vector<Image<Rgb8>> bracket(const CodingCurve& curve, std::uint32_t seed) {
  std::mt19937 random(seed);
  constexpr int kW = 96, kH = 64;
  // Radiance over four decades, smooth as a scene is, its channels apart.
  Image<Rgb> scene(kW, kH);
  for (int y = 0; y < kH; ++y)
    for (int x = 0; x < kW; ++x)
      for (int c = 0; c < 3; ++c)
        scene.at(x, y)[c] =
            static_cast<float>(.05 * std::pow(10., 4. * (x + .5) / kW - .3 * y / kH + .1 * c));
  std::normal_distribution<double> noise(1, .01);
  std::vector<Image<Rgb8>> out;
  for (const double t : kBracketTimes) {
    Image<Rgb8> picture(kW, kH);
    for (int y = 0; y < kH; ++y)
      for (int x = 0; x < kW; ++x) {
        const auto code = [&](int c) {
          const double linear = std::clamp(scene.at(x, y)[c] * t * noise(random), 0., 1.);
          return static_cast<std::uint8_t>(
              std::lround(255 * std::clamp(curve.encode(linear), 0., 1.)));
        };
        picture.at(x, y) = {code(0), code(1), code(2)};
      }
    out.push_back(std::move(picture));
  }
  return out;
}

double decode(const CodingCurve& curve, double code) {
  double low = 0, high = 1;
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (curve.encode(middle) < code / 255. ? low : high) = middle;
  }
  return (low + high) / 2;
}

// RMS over the codes that a merge uses, of full scale, after the best common factor.
double rms(const std::array<double, 256>& found, const CodingCurve& curve) {
  std::array<double, 256> truth{};
  for (int code = 0; code < 256; ++code)
    truth[static_cast<std::size_t>(code)] = decode(curve, code);
  double xy = 0, xx = 0;
  for (std::size_t i = kFirst; i <= kLast; ++i) {
    xy += found[i] * truth[i];
    xx += found[i] * found[i];
  }
  double sum = 0;
  for (std::size_t i = kFirst; i <= kLast; ++i) sum += std::pow(found[i] * xy / xx - truth[i], 2);
  return std::sqrt(sum / (kLast - kFirst + 1));
}

template <class Calibrate>
double peer(const std::vector<Image<Rgb8>>& pictures, const CodingCurve& curve,
            Calibrate&& calibrate) {
  std::vector<cv::Mat> mats;
  for (const auto& p : pictures)
    mats.emplace_back(p.height(), p.width(), CV_8UC3, const_cast<Rgb8*>(p.pixels().data()));
  std::vector<float> times(kBracketTimes.begin(), kBracketTimes.end());
  cv::Mat response;
  calibrate->process(mats, response, times);
  std::array<double, 256> found{};
  for (int i = 0; i < 256; ++i) found[static_cast<std::size_t>(i)] = response.at<cv::Vec3f>(i)[1];
  return rms(found, curve);
}

std::vector<Seconds> seconds() {
  return {kBracketTimes.begin(), kBracketTimes.end()};
}

std::vector<const Image<Rgb8>*> pointers_to(const std::vector<Image<Rgb8>>& pictures) {
  std::vector<const Image<Rgb8>*> out;
  for (const auto& p : pictures) out.push_back(&p);
  return out;
}

TEST(ResponseCurves, RecoveredToHalfAPercentBesideOpenCv) {
  std::printf("%-24s %8s %8s %10s   RMS, %% of full scale\n", "curve", "ours", "Debevec",
              "Robertson");
  for (const CodingCurve& curve : curves()) {
    const auto pictures = bracket(curve, 7);
    const auto response = estimate_response(pointers_to(pictures), seconds());
    ASSERT_TRUE(response) << curve.name << ": " << response.error().detail;
    std::array<double, 256> found{};
    for (int i = 0; i < 256; ++i)
      found[static_cast<std::size_t>(i)] = response->decode(i / 255., 1);
    const double ours = rms(found, curve);
    std::printf("%-24s %8.2f %8.2f %10.2f\n", curve.name.c_str(), 100 * ours,
                100 * peer(pictures, curve, cv::createCalibrateDebevec()),
                100 * peer(pictures, curve, cv::createCalibrateRobertson()));
    EXPECT_LE(ours, .005) << curve.name;
  }
}

// A camera's light must not depend on where its curve came from: 1 is what just saturates. A scale
// of its own made objects 9 % too bright beside a camera of given curve.
TEST(ResponseCurves, EstimatedOnesHaveTheScaleOfGivenOnes) {
  for (const CodingCurve& curve : curves()) {
    const auto pictures = bracket(curve, 7);
    const auto response = estimate_response(pointers_to(pictures), seconds());
    ASSERT_TRUE(response) << curve.name << ": " << response.error().detail;
    const double scale = response->decode(160 / 255., 1) / decode(curve, 160);
    // Code 255 begins below full scale, of a steep shoulder by a good deal.
    const double saturates = decode(curve, 254.5);
    std::printf("%-24s scale %.3f, times what just reads 255 %.3f\n", curve.name.c_str(), scale,
                scale * saturates);
    EXPECT_NEAR(scale * saturates, 1, .02) << curve.name;
  }
}

TEST(ResponseCurves, StatedUncertaintyIsOfTheErrorsSize) {
  for (const CodingCurve& curve : curves()) {
    const auto pictures = bracket(curve, 3);
    const auto result = calibrate_response(pointers_to(pictures), seconds());
    ASSERT_TRUE(result) << curve.name << ": " << result.error().detail;
    EXPECT_LT(result->sigma, .003) << curve.name;
    ASSERT_TRUE(result->between_places);
    EXPECT_LT(*result->between_places, .04) << curve.name;
  }
}

// A phone that lifts the shadows of one half.
TEST(ResponseCurves, LocalToneMappingIsRefusedByName) {
  auto pictures = bracket(curves()[1], 3);
  const auto lifted = bracket({"lifted", [](double x) { return std::pow(x, 1 / 3.2); }}, 3);
  // Both halves see all of the scene, mapped in two ways.
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    Image<Rgb8> both(2 * pictures[k].width(), pictures[k].height());
    for (int y = 0; y < both.height(); ++y)
      for (int x = 0; x < pictures[k].width(); ++x) {
        both.at(x, y) = pictures[k].at(x, y);
        both.at(x + pictures[k].width(), y) = lifted[k].at(x, y);
      }
    pictures[k] = std::move(both);
  }
  const auto result = calibrate_response(pointers_to(pictures), seconds());
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kUndetermined);
  EXPECT_NE(result.error().detail.find("local tone mapping"), std::string::npos)
      << result.error().detail;
}

}  // namespace
}  // namespace penumbra::calib
