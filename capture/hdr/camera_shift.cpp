#include <algorithm>
#include <opencv2/imgproc.hpp>

#include "capture/hdr/stacks.h"

namespace penumbra::capture {

namespace {

// What each place of a small copy differs from its surroundings by, over how much they vary, and 0
// where they are clipped or smooth: exposures of one scene look alike so. Brightness itself does
// not tell a place: the clipped part of a slope moves with the exposure. Empty without such places.
cv::Mat structure_of(const Image<Rgb8>& picture, double scale) {
  constexpr int kAround = 15;      // px
  constexpr double kSmooth = 4;    // codes
  constexpr double kFewest = .02;  // of all places
  const cv::Scalar dark(6), bright(250);
  const cv::Mat whole(picture.height(), picture.width(), CV_8UC3,
                      const_cast<Rgb8*>(picture.pixels().data()));
  cv::Mat small, codes, told, mean, square;
  cv::resize(whole, small, {}, scale, scale, cv::INTER_AREA);
  cv::extractChannel(small, codes, 1);
  cv::inRange(codes, dark, bright, told);
  cv::erode(told, told, cv::getStructuringElement(cv::MORPH_RECT, {kAround, kAround}));
  codes.convertTo(codes, CV_32F);
  cv::boxFilter(codes, mean, CV_32F, {kAround, kAround});
  cv::Mat out = codes - mean;
  cv::boxFilter(out.mul(out), square, CV_32F, {kAround, kAround});
  told.setTo(0, square < kSmooth * kSmooth);
  if (cv::countNonZero(told) < kFewest * static_cast<double>(told.total())) return {};
  cv::sqrt(square, square);
  out /= square;
  out.setTo(0, ~told);
  return out;
}

// Whether what all of the picture shows has moved so, and not one thing in it: most parts in which
// anything can be told are more alike with the shift than without, and they are many.
bool moved_everywhere(const cv::Mat& first, const cv::Mat& second, const cv::Rect& middle,
                      const cv::Point& shift) {
  constexpr int kAcross = 6, kDown = 4, kFewest = 16;  // parts
  constexpr double kTold = .05, kMost = .65;           // of a part's places; of the parts
  int moved = 0, all = 0;
  for (int part = 0; part < kAcross * kDown; ++part) {
    const cv::Rect here(middle.x + part % kAcross * middle.width / kAcross,
                        middle.y + part / kAcross * middle.height / kDown, middle.width / kAcross,
                        middle.height / kDown);
    const cv::Mat a = first(here);
    if (cv::countNonZero(a != 0) < kTold * here.area()) continue;
    ++all;
    moved += a.dot(second(here + shift)) > a.dot(second(here));
  }
  return all >= kFewest && moved >= kMost * all;
}

}  // namespace

std::optional<CameraShift> find_camera_shift(const Image<Rgb8>& a, const Image<Rgb8>& b) {
  constexpr double kSide = 512, kFarthest = .12;  // px; of the picture
  constexpr int kSmallest = 32;                   // px
  constexpr double kAlike = .25, kUnmoved = .6;   // correlation; of the best one
  if (!a.same_size(b) || std::min(a.width(), a.height()) < kSmallest) return std::nullopt;
  const double scale = std::min(1., kSide / std::max(a.width(), a.height()));
  const cv::Mat first = structure_of(a, scale), second = structure_of(b, scale);
  if (first.empty() || second.empty()) return std::nullopt;
  const cv::Point margin(cvRound(kFarthest * first.cols), cvRound(kFarthest * first.rows));
  const cv::Rect middle(margin, first.size() - cv::Size(2 * margin));
  cv::Mat alike;  // by how far the second is moved
  cv::matchTemplate(second, first(middle), alike, cv::TM_CCOEFF_NORMED);
  cv::Point best;
  double most = 0;
  cv::minMaxLoc(alike, nullptr, &most, nullptr, &best);
  if (!(most > kAlike)) return std::nullopt;
  if (double(alike.at<float>(margin)) > kUnmoved * most) best = margin;
  if (best != margin && !moved_everywhere(first, second, middle, best - margin))
    return std::nullopt;
  return CameraShift{{(best.x - margin.x) / scale, (best.y - margin.y) / scale}, 1 / scale};
}

}  // namespace penumbra::capture
