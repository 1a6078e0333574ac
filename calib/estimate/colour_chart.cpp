#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/mcc.hpp>

#include "calib/estimate/colour_calibration.h"

namespace penumbra::calib {

namespace {

constexpr int kColumns = 6, kRows = 4;

// As a screen would show it, which is what the detector knows: nine of ten pixels below white.
cv::Mat for_detector(const Image<Rgb>& radiance) {
  std::vector<float> brightest;
  for (const Rgb& p : radiance.pixels()) brightest.push_back(std::max({p.r, p.g, p.b}));
  const auto white = brightest.begin() + std::ssize(brightest) * 9 / 10;
  std::ranges::nth_element(brightest, white);
  const float scale = *white > 0 ? 1 / *white : 1;
  cv::Mat out(radiance.height(), radiance.width(), CV_8UC3);
  for (int y = 0; y < out.rows; ++y)
    for (int x = 0; x < out.cols; ++x) {
      const Rgb& p = radiance.at(x, y);
      const auto code = [&](float v) {
        return cv::saturate_cast<std::uint8_t>(255 * std::pow(std::max(0.f, v * scale), 1 / 2.2f));
      };
      out.at<cv::Vec3b>(y, x) = {code(p.b), code(p.g), code(p.r)};
    }
  return out;
}

// Over the middle of each patch, away from the frame between them.
std::vector<std::optional<Rgb>> patch_means(const Image<Rgb>& radiance,
                                            const Image<std::uint8_t>& clipped,
                                            const cv::Mat& picture_from_chart) {
  constexpr int kSamples = 9;  // a side
  constexpr double kMiddle = .4;
  std::vector<std::optional<Rgb>> out;
  for (int row = 0; row < kRows; ++row)
    for (int column = 0; column < kColumns; ++column) {
      std::vector<cv::Point2d> chart, picture;
      for (int i = 0; i < kSamples * kSamples; ++i)
        chart.emplace_back(column + .5 + kMiddle * ((i % kSamples + .5) / kSamples - .5),
                           row + .5 + kMiddle * ((double(i / kSamples) + .5) / kSamples - .5));
      cv::perspectiveTransform(chart, picture, picture_from_chart);
      Rgb sum{};
      bool good = true;
      for (const cv::Point2d& p : picture) {
        const int x = static_cast<int>(p.x), y = static_cast<int>(p.y);
        good &= x >= 0 && y >= 0 && x < radiance.width() && y < radiance.height() &&
                (clipped.empty() || !clipped.at(x, y));
        if (good) sum = sum + radiance.at(x, y);
      }
      good &= sum.r > 0 && sum.g > 0 && sum.b > 0;
      out.push_back(good ? std::optional(sum * (1.f / (kSamples * kSamples))) : std::nullopt);
    }
  return out;
}

}  // namespace

// The detector's exceptions end here. It brings the short side to a size of its own: of a strip it
// would make a huge picture.
Result<std::vector<std::optional<Rgb>>> find_colour_chart(const Image<Rgb>& radiance,
                                                          const Image<std::uint8_t>& clipped,
                                                          const std::string& picture) {
  constexpr int kShortest = 100, kLongest = 4;  // pixels of a side; long side over short side
  const auto not_found = [&] {
    return fail(ErrorCode::kUndetermined, picture,
                "shows no ColorChecker of 24 patches: hold it flat and evenly lit, so that it "
                "fills at least a tenth of the picture");
  };
  const auto [low, high] = std::minmax({radiance.width(), radiance.height()});
  if (low < kShortest || high > kLongest * low) return not_found();
  try {
    const auto detector = cv::mcc::CCheckerDetector::create();
    if (!detector->process(for_detector(radiance), cv::mcc::MCC24)) return not_found();
    const auto chart = detector->getBestColorChecker();
    if (!chart || chart->getBox().size() != 4) return not_found();
    const auto corners = chart->getBox();  // of the chart's frame, from dark skin clockwise
    const std::vector<cv::Point2f> unit = {{0, 0}, {kColumns, 0}, {kColumns, kRows}, {0, kRows}};
    return patch_means(radiance, clipped, cv::getPerspectiveTransform(unit, corners));
  } catch (const cv::Exception&) {
    return not_found();
  }
}

}  // namespace penumbra::calib
