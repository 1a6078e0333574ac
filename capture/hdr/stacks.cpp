#include "capture/hdr/stacks.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "capture/hdr/merge_math.h"
#include "core/background_task.h"
#include "core/median.h"

namespace penumbra::capture {

namespace {

cv::Mat as_matrix(const Image<Rgb8>& picture) {
  return {picture.height(), picture.width(), CV_8UC3, const_cast<Rgb8*>(picture.pixels().data())};
}

// Grey pictures of about one brightness, whatever the exposure: features are found in what both
// show.
cv::Mat features_of(const Image<Rgb8>& picture) {
  cv::Mat grey, even;
  cv::cvtColor(as_matrix(picture), grey, cv::COLOR_RGB2GRAY);
  cv::createCLAHE(4, {16, 16})->apply(grey, even);
  return even;
}

struct PictureFeatures {
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
};
PictureFeatures find_features(const Image<Rgb8>& picture) {
  constexpr int kMax = 4000;
  PictureFeatures out;
  cv::SIFT::create(kMax)->detectAndCompute(features_of(picture), {}, out.points, out.descriptors);
  return out;
}

// From the reference's pixels to the picture's; nothing when too few points agree.
cv::Mat homography_between(const PictureFeatures& reference, const PictureFeatures& picture) {
  constexpr double kDistinct = .75;  // Lowe 2004: nearest over second nearest
  constexpr double kInlier_px = 2;
  constexpr int kFewest = 20;
  if (reference.descriptors.empty() || picture.descriptors.empty()) return {};
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(reference.descriptors, picture.descriptors, matches, 2);
  std::vector<cv::Point2f> from, to;
  for (const auto& m : matches) {
    if (m.size() < 2 || double(m[0].distance) > kDistinct * double(m[1].distance)) continue;
    from.push_back(reference.points[static_cast<std::size_t>(m[0].queryIdx)].pt);
    to.push_back(picture.points[static_cast<std::size_t>(m[0].trainIdx)].pt);
  }
  if (from.size() < kFewest) return {};
  cv::Mat inliers;
  cv::setRNGSeed(1);  // the same pictures, the same result
  cv::Mat h = cv::findHomography(from, to, cv::RANSAC, kInlier_px, inliers, 5000, .999);
  return !h.empty() && cv::countNonZero(inliers) >= kFewest ? h : cv::Mat();
}

double mean_shift(const cv::Mat& h, int width, int height) {
  std::vector<cv::Point2d> grid, moved;
  for (int y = 0; y <= 8; ++y)
    for (int x = 0; x <= 8; ++x) grid.emplace_back(x * width / 8., y * height / 8.);
  cv::perspectiveTransform(grid, moved, h);
  double sum = 0;
  for (std::size_t i = 0; i < grid.size(); ++i) sum += cv::norm(moved[i] - grid[i]);
  return sum / static_cast<double>(grid.size());
}

// Resampled, and where the picture shows anything. A resampled pixel to which a clipped one
// contributes is clipped.
struct Warped {
  Image<Rgb8> picture;
  Image<std::uint8_t> valid;
};
Warped warp(const Image<Rgb8>& picture, const cv::Mat& h) {
  constexpr double kClippedCode = 245;
  const cv::Mat in = as_matrix(picture);
  Warped out{Image<Rgb8>(picture.width(), picture.height()),
             Image<std::uint8_t>(picture.width(), picture.height())};
  cv::Mat target = as_matrix(out.picture), seen(in.size(), CV_8UC1, out.valid.pixels().data());
  const auto resample = [&](const cv::Mat& from, cv::Mat& to, int border) {
    cv::warpPerspective(from, to, h, in.size(), cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, border, 0);
  };
  resample(in, target, cv::BORDER_REPLICATE);
  resample(cv::Mat(in.size(), CV_8UC1, cv::Scalar(255)), seen, cv::BORDER_CONSTANT);
  seen = seen == 255;
  cv::Mat clipped, fraction;
  cv::threshold(in, clipped, kClippedCode, 255, cv::THRESH_BINARY);
  resample(clipped, fraction, cv::BORDER_REPLICATE);
  cv::threshold(fraction, fraction, 0, 255, cv::THRESH_BINARY);
  cv::bitwise_or(target, fraction, target);
  return out;
}

}  // namespace

Result<Alignment> align_stack(ExposureStack& stack, std::size_t reference) {
  if (reference >= stack.frames.size())
    return fail(ErrorCode::kInvalid, "reference",
                fmt::format("is picture {}, but there are {} pictures", reference + 1,
                            stack.frames.size()));
  for (const auto& f : stack.frames)
    if (!std::holds_alternative<Image<Rgb8>>(*f))
      return fail(ErrorCode::kInvalid, "exposure stack",
                  "has pictures that are not 8-bit, and only those can be aligned");
  const auto picture = [&](std::size_t k) -> const Image<Rgb8>& {
    return std::get<Image<Rgb8>>(*stack.frames[k]);
  };
  const PictureFeatures first = find_features(picture(reference));
  Alignment out{std::vector<double>(stack.frames.size(), 0)};
  stack.valid.assign(stack.frames.size(), {});
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    if (k == reference) continue;
    const cv::Mat h = homography_between(first, find_features(picture(k)));
    if (h.empty())
      return fail(ErrorCode::kUndetermined, fmt::format("picture {}", k + 1),
                  "has too little in common with the reference to be aligned: take exposures that "
                  "lie closer together");
    out.moved_px[k] = mean_shift(h, picture(k).width(), picture(k).height());
    constexpr double kStill = .3;  // of a pixel: resampling would cost more than it mends
    if (out.moved_px[k] <= kStill) continue;
    Warped warped = warp(picture(k), h);
    stack.frames[k] = std::make_shared<const FramePixels>(std::move(warped.picture));
    stack.valid[k] = std::move(warped.valid);
  }
  return out;
}

}  // namespace penumbra::capture
