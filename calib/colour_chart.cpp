#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/mcc.hpp>

#include "calib/colour_calibration.h"

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
std::vector<Rgb> patch_means(const Image<Rgb>& radiance, const cv::Mat& picture_from_chart) {
  constexpr int kSamples = 9;  // a side
  constexpr double kMiddle = .4;
  std::vector<Rgb> out;
  for (int row = 0; row < kRows; ++row)
    for (int column = 0; column < kColumns; ++column) {
      std::vector<cv::Point2d> chart, picture;
      for (int i = 0; i < kSamples * kSamples; ++i)
        chart.emplace_back(column + .5 + kMiddle * ((i % kSamples + .5) / kSamples - .5),
                           row + .5 + kMiddle * ((double(i / kSamples) + .5) / kSamples - .5));
      cv::perspectiveTransform(chart, picture, picture_from_chart);
      Rgb sum{};
      for (const cv::Point2d& p : picture)
        sum = sum + radiance.at(std::clamp(static_cast<int>(p.x), 0, radiance.width() - 1),
                                std::clamp(static_cast<int>(p.y), 0, radiance.height() - 1));
      out.push_back(sum * (1.f / (kSamples * kSamples)));
    }
  return out;
}

}  // namespace

Result<std::vector<Rgb>> find_colour_chart(const Image<Rgb>& radiance, const std::string& picture) {
  const auto not_found = [&] {
    return fail(
        ErrorCode::kUndetermined, picture,
        "no ColorChecker of 24 patches found: hold it flat, filling a tenth of the picture at "
        "least, evenly lit");
  };
  const auto detector = cv::mcc::CCheckerDetector::create();
  if (!detector->process(for_detector(radiance), cv::mcc::MCC24)) return not_found();
  const auto chart = detector->getBestColorChecker();
  if (!chart || chart->getBox().size() != 4) return not_found();
  const auto corners = chart->getBox();  // of the chart's frame, from dark skin clockwise
  const std::vector<cv::Point2f> unit = {{0, 0}, {kColumns, 0}, {kColumns, kRows}, {0, kRows}};
  return patch_means(radiance, cv::getPerspectiveTransform(unit, corners));
}

}  // namespace penumbra::calib
