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
#include "core/median.h"
#include "core/threads/background_task.h"

namespace penumbra::capture {

namespace {

cv::Mat as_matrix(const Image<Rgb8>& picture) {
  return {picture.height(), picture.width(), CV_8UC3, const_cast<Rgb8*>(picture.pixels().data())};
}

// Grey pictures of about one brightness, whatever the exposure: features are found in what both
// show.
cv::Mat even_grey(const cv::Mat& picture) {
  cv::Mat grey, even;
  cv::cvtColor(picture, grey, cv::COLOR_RGB2GRAY);
  cv::createCLAHE(4, {16, 16})->apply(grey, even);
  return even;
}

struct PictureFeatures {
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
};
PictureFeatures find_features(const cv::Mat& picture, int max_count) {
  PictureFeatures out;
  cv::SIFT::create(max_count)->detectAndCompute(even_grey(picture), {}, out.points,
                                                out.descriptors);
  return out;
}

struct PointPairs {
  std::vector<cv::Point2f> reference, picture;
};
// Adds the points that look alike, in pixels that are `scale` of the pictures' and begin there.
void match(const PictureFeatures& reference, const PictureFeatures& picture, double scale,
           const cv::Point2d& reference_begin, const cv::Point2d& picture_begin, PointPairs& out) {
  constexpr double kDistinct = .75;  // Lowe 2004: nearest over second nearest
  if (reference.descriptors.empty() || picture.descriptors.empty()) return;
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(reference.descriptors, picture.descriptors, matches, 2);
  // Centres of pixels are whole numbers to OpenCV.
  const auto to_picture = [&](const cv::Point2f& p, const cv::Point2d& begin) {
    return cv::Point2f(static_cast<float>((double(p.x) + .5) / scale - .5 + begin.x),
                       static_cast<float>((double(p.y) + .5) / scale - .5 + begin.y));
  };
  for (const auto& m : matches) {
    if (m.size() < 2 || double(m[0].distance) > kDistinct * double(m[1].distance)) continue;
    out.reference.push_back(
        to_picture(reference.points[static_cast<std::size_t>(m[0].queryIdx)].pt, reference_begin));
    out.picture.push_back(
        to_picture(picture.points[static_cast<std::size_t>(m[0].trainIdx)].pt, picture_begin));
  }
}

// From the reference's pixels to the picture's; nothing when too few points agree.
cv::Mat homography_through(const PointPairs& pairs, double inlier_px) {
  constexpr int kFewest = 20;
  if (pairs.reference.size() < kFewest) return {};
  cv::Mat inliers;
  cv::setRNGSeed(1);  // the same pictures, the same result
  cv::Mat h = cv::findHomography(pairs.reference, pairs.picture, cv::RANSAC, inlier_px, inliers,
                                 5000, .999);
  return !h.empty() && cv::countNonZero(inliers) >= kFewest ? h : cv::Mat();
}

constexpr double kInlier_px = 2;

// Finds pictures on the reference: all of them at a moderate size, and where that is coarser than
// their pixels once more in tiles of the full size. Time and memory stay those of some megapixels.
class Aligner {
 public:
  explicit Aligner(const Image<Rgb8>& reference)
      : reference_(as_matrix(reference)),
        scale_(scale_of(static_cast<double>(reference.area()))),
        features_(find_features(at_moderate_size(reference_), kMaxFeatures)) {
    for (int tile = 0; tile < kAcross * kAcross && scale_ < 1; ++tile)
      tiles_.push_back(find_features(reference_(tile_at(tile_centre(tile))), kMaxOfATile));
  }

  /// Nothing when they have too little in common.
  cv::Mat homography(const Image<Rgb8>& of) const {
    const cv::Mat picture = as_matrix(of);
    PointPairs pairs;
    match(features_, find_features(at_moderate_size(picture), kMaxFeatures), scale_, {}, {}, pairs);
    cv::Mat coarse = homography_through(pairs, kInlier_px / scale_);
    if (coarse.empty() || scale_ == 1) return coarse;
    PointPairs in_tiles = match_tiles(picture, coarse);
    // With the others, which hold it where a tile shows nothing to find.
    in_tiles.reference.insert(in_tiles.reference.end(), pairs.reference.begin(),
                              pairs.reference.end());
    in_tiles.picture.insert(in_tiles.picture.end(), pairs.picture.begin(), pairs.picture.end());
    const cv::Mat fine = homography_through(in_tiles, kInlier_px);
    return fine.empty() || farthest(fine, coarse) > 2 * kInlier_px / scale_ ? coarse : fine;
  }

 private:
  // Between what two homographies make of the picture's corners, pixels.
  double farthest(const cv::Mat& a, const cv::Mat& b) const {
    const auto w = static_cast<double>(reference_.cols), h = static_cast<double>(reference_.rows);
    const std::vector<cv::Point2d> corners{{0, 0}, {w, 0}, {0, h}, {w, h}};
    std::vector<cv::Point2d> by_a, by_b;
    cv::perspectiveTransform(corners, by_a, a);
    cv::perspectiveTransform(corners, by_b, b);
    double out = 0;
    for (std::size_t i = 0; i < corners.size(); ++i)
      out = std::max(out, cv::norm(by_a[i] - by_b[i]));
    return out;
  }

  // Small enough for features of all of it at once; above, a small picture is the tiles' start.
  static double scale_of(double area_px) {
    constexpr double kMax_px = 3e6, kSmall_px = 1.5e6;
    return area_px > kMax_px ? std::sqrt(kSmall_px / area_px) : 1;
  }

  static constexpr int kMaxFeatures = 4000;
  static constexpr int kAcross = 4, kSide_px = 384, kMaxOfATile = 300;  // tiles

  cv::Mat at_moderate_size(const cv::Mat& picture) const {
    if (scale_ == 1) return picture;
    cv::Mat out;
    cv::resize(picture, out, {}, scale_, scale_, cv::INTER_AREA);
    return out;
  }

  cv::Rect tile_at(const cv::Point2d& centre) const {
    const int half = kSide_px / 2;
    return cv::Rect(cv::saturate_cast<int>(centre.x) - half,
                    cv::saturate_cast<int>(centre.y) - half, kSide_px, kSide_px) &
           cv::Rect(0, 0, reference_.cols, reference_.rows);
  }
  cv::Point2d tile_centre(int tile) const {
    return {(tile % kAcross + .5) * reference_.cols / kAcross,
            (tile / kAcross + .5) * reference_.rows / kAcross};
  }

  PointPairs match_tiles(const cv::Mat& picture, const cv::Mat& coarse) const {
    PointPairs pairs;
    const cv::Rect whole(0, 0, picture.cols, picture.rows);
    for (int tile = 0; tile < kAcross * kAcross; ++tile) {
      std::vector<cv::Point2d> there;
      cv::perspectiveTransform(std::vector{tile_centre(tile)}, there, coarse);
      if (!whole.contains(
              cv::Point(cv::saturate_cast<int>(there[0].x), cv::saturate_cast<int>(there[0].y))))
        continue;
      const cv::Rect here = tile_at(tile_centre(tile)), other = tile_at(there[0]);
      match(tiles_[static_cast<std::size_t>(tile)], find_features(picture(other), kMaxOfATile), 1,
            here.tl(), other.tl(), pairs);
    }
    return pairs;
  }

  cv::Mat reference_;
  double scale_;  // of the pictures, at which they are found first
  PictureFeatures features_;
  std::vector<PictureFeatures> tiles_;  // of the reference at its full size
};

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
  const auto aligned_to = stack.frames[reference];  // lives as long as the aligner
  const Aligner aligner(std::get<Image<Rgb8>>(*aligned_to));
  Alignment out{std::vector<double>(stack.frames.size(), 0)};
  stack.valid.assign(stack.frames.size(), {});
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    if (k == reference) continue;
    const cv::Mat h = aligner.homography(picture(k));
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
