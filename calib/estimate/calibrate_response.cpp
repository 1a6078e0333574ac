// How sure an estimated response is, by what parts of the pictures say of it.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "calib/estimate/estimate_response.h"

namespace penumbra::calib {

namespace {

std::unexpected<Error> undetermined(std::string detail) {
  return fail(ErrorCode::kUndetermined, "bracket", std::move(detail));
}

// Every second row or column of squares of a picture: parts that see the same scene, or different
// places of it.
enum class PictureHalf { kEvenRows, kOddRows, kLeft, kRight };

Picture part_of(const Picture& whole, PictureHalf part) {
  const bool rows = part == PictureHalf::kEvenRows || part == PictureHalf::kOddRows;
  const int half = whole.width() / 2;
  Picture out(rows ? whole.width() : half, rows ? whole.height() / 2 : whole.height());
  const int x0 = part == PictureHalf::kRight ? half : 0, y0 = part == PictureHalf::kOddRows ? 1 : 0;
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) out.at(x, y) = whole.at(x + x0, rows ? 2 * y + y0 : y);
  return out;
}

Result<Response> estimate_from(Pictures pictures, std::span<const Seconds> times,
                               PictureHalf part) {
  std::vector<Picture> parts;
  std::vector<const Picture*> pointers;
  for (const Picture* p : pictures) parts.push_back(part_of(*p, part));
  for (const Picture& p : parts) pointers.push_back(&p);
  return estimate_response(pointers, times);
}

constexpr int kFirst = static_cast<int>(kFirstReliableCode * 255 + .5),
              kLast = static_cast<int>(kLastReliableCode * 255 + .5);

struct CodeRange {
  int low = kFirst, high = kLast;
};

// What a part's pictures hold, without the outermost hundredth: beyond it its curve is a guess.
CodeRange codes_of(Pictures pictures, PictureHalf part) {
  std::array<std::size_t, 256> counts{};
  std::size_t all = 0;
  for (const Picture* whole : pictures)
    for (const Rgb8& p : part_of(*whole, part).pixels())
      for (const int code : {p.r, p.g, p.b})
        if (code >= kFirst && code <= kLast) ++counts[static_cast<std::size_t>(code)], ++all;
  CodeRange range;
  for (std::size_t seen = 0; range.low < kLast; ++range.low)
    if ((seen += counts[static_cast<std::size_t>(range.low)]) * 100 > all) break;
  for (std::size_t seen = 0; range.high > kFirst; --range.high)
    if ((seen += counts[static_cast<std::size_t>(range.high)]) * 100 > all) break;
  return range;
}

// RMS over the codes that can be told, of full scale, after the best common factor.
double difference(const Response& a, const Response& b, const CodeRange& range = {}) {
  double sum = 0;
  int count = 0;
  for (int c = 0; c < 3; ++c) {
    double ab = 0, bb = 0;
    const auto at = [&](const Response& r, int code) { return r.decode(code / 255., c); };
    for (int code = range.low; code <= range.high; ++code) {
      ab += at(a, code) * at(b, code);
      bb += at(b, code) * at(b, code);
    }
    for (int code = range.low; code <= range.high; ++code, ++count)
      sum += std::pow(at(a, code) - at(b, code) * ab / bb, 2);
  }
  return std::sqrt(sum / count);
}

}  // namespace

Result<ResponseCalibration> calibrate_response(Pictures pictures, std::span<const Seconds> times) {
  PENUMBRA_ASSIGN(whole, estimate_response(pictures, times));
  ResponseCalibration out{std::move(whole), 0, {}};
  const auto even = estimate_from(pictures, times, PictureHalf::kEvenRows),
             odd = estimate_from(pictures, times, PictureHalf::kOddRows);
  if (!even || !odd)
    return undetermined(
        "there are too few pixels to estimate the uncertainty of the curve: take larger pictures");
  // The mean of two halves is half as uncertain as their difference.
  out.sigma = difference(*even, *odd) / 2;
  const auto left = estimate_from(pictures, times, PictureHalf::kLeft),
             right = estimate_from(pictures, times, PictureHalf::kRight);
  const CodeRange l = codes_of(pictures, PictureHalf::kLeft),
                  r = codes_of(pictures, PictureHalf::kRight);
  const CodeRange both{std::max(l.low, r.low), std::min(l.high, r.high)};
  constexpr int kTooFew = 64;  // codes
  if (!left || !right || both.high - both.low < kTooFew) return out;
  out.between_places = difference(*left, *right, both);
  constexpr double kMax = .05;
  if (*out.between_places > kMax && *out.between_places > 4 * out.sigma)
    return undetermined(
        fmt::format("the curves of the left and the right half differ by {:.0f} %: switch local "
                    "tone mapping (\"HDR\", \"dynamic contrast\") off, or keep the scene still",
                    100 * *out.between_places));
  return out;
}

}  // namespace penumbra::calib
