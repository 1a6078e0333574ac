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

constexpr int kBlock = 4;  // pixels a side
constexpr std::size_t kFewestBlocks = 50, kMaxBlocks = 4000;

struct LogRatio {
  double value;
  double signal;  // of the first picture
};
// Of a block's signals in one channel, if no pixel of either picture clips or comes near black.
std::optional<LogRatio> log_ratio(const Image<Rgb8>& a, const Image<Rgb8>& b,
                                  const ResponseTable& curve, int channel, int left, int top) {
  constexpr double kClipped = .9;
  constexpr unsigned kDarkCode = 8;  // below, codes and noise reduction bend the curve
  const auto code = [&](const Rgb8& p) { return channel == 0 ? p.r : channel == 1 ? p.g : p.b; };
  double sum_a = 0, sum_b = 0;
  for (int y = top; y < top + kBlock; ++y)
    for (int x = left; x < left + kBlock; ++x) {
      const unsigned code_a = code(a.at(x, y)), code_b = code(b.at(x, y));
      const auto ya = static_cast<double>(curve.decode(channel, code_a)),
                 yb = static_cast<double>(curve.decode(channel, code_b));
      if (ya > kClipped || yb > kClipped || std::min(code_a, code_b) < kDarkCode)
        return std::nullopt;
      sum_a += ya, sum_b += yb;
    }
  return LogRatio{std::log(sum_b / sum_a), sum_a};
}

}  // namespace

Result<ExposureRatio> estimate_exposure_ratio(const Image<Rgb8>& a, const Image<Rgb8>& b,
                                              const ResponseTable& curve) {
  if (!a.same_size(b))
    return fail(ErrorCode::kInvalid, "exposure ratio", "the two pictures differ in size");
  std::vector<LogRatio> all;
  for (int y = 0; y + kBlock <= a.height(); y += kBlock)
    for (int x = 0; x + kBlock <= a.width(); x += kBlock)
      for (int c = 0; c < 3; ++c)
        if (const auto l = log_ratio(a, b, curve, c, x, y)) all.push_back(*l);
  if (all.size() < kFewestBlocks)
    return fail(ErrorCode::kUndetermined, "exposure ratio",
                fmt::format("only {} blocks are neither clipped nor dark in both pictures: take "
                            "exposures that lie closer together",
                            all.size()));
  // Neighbours are alike: as many as are independent, evenly over the picture.
  std::vector<LogRatio> some;
  const std::size_t apart = (all.size() + kMaxBlocks - 1) / kMaxBlocks;
  for (std::size_t i = 0; i < all.size(); i += apart) some.push_back(all[i]);
  std::vector<double> logs;
  for (const LogRatio& l : some) logs.push_back(l.value);
  ExposureRatio out;
  out.fraction =
      static_cast<double>(all.size()) * kBlock * kBlock / (3. * static_cast<double>(a.area()));
  out.blocks = logs.size();
  out.ratio = std::exp(median(logs));
  constexpr int kDraws = 200;
  std::mt19937 rng(1);
  std::uniform_int_distribution<std::size_t> pick(0, logs.size() - 1);
  std::vector<double> medians, drawn(logs.size());
  for (int n = 0; n < kDraws; ++n) {
    for (double& d : drawn) d = logs[pick(rng)];
    medians.push_back(std::exp(median(drawn)));
  }
  std::ranges::sort(medians);
  out.low = medians[kDraws / 40], out.high = medians[kDraws - 1 - kDraws / 40];
  // Under a wrong curve the dark third and the bright third tell two ratios: then both are
  // possible.
  std::ranges::sort(some, {}, &LogRatio::signal);
  const std::size_t third = some.size() / 3;
  for (const std::size_t first : {std::size_t{0}, some.size() - third}) {
    std::vector<double> part;
    for (std::size_t i = first; i < first + third; ++i) part.push_back(some[i].value);
    const double ratio = std::exp(median(part));
    const double noise = (out.high - out.low) * std::sqrt(3.);  // of a third
    if (std::abs(ratio - out.ratio) <= noise) continue;
    out.low = std::min(out.low, ratio), out.high = std::max(out.high, ratio);
  }
  return out;
}

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
