// Stacks of pictures as people take them: by hand, with exposures that the metadata tells wrong or
// not at all.
// threads: reentrant
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/response_table.h"
#include "capture/hdr/merge.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct ExposureStack;

/// Exposure of `b` over that of `a` by the pixels that both tell.
struct ExposureRatio {
  double ratio = 1;
  double low = 1, high = 1;   // 95 % within
  double fraction = 0;        // of the pictures' patches
  std::size_t blocks = 0;     // of 4x4 pixels that took part
  double moved_fraction = 0;  // of the patches that both tell: they show something else
};
/// Standard deviation of the exponent of a curve that was estimated from a bracket.
inline constexpr double kEstimatedExponentSigma = .055;

/// A robust line through the signals of blocks of 4x4 pixels in which neither clips nor is dark. So
/// what moved has no say, and neither has light that is added to both, as the base of a film.
/// The interval holds chance (blocks drawn in tiles), what dark and bright parts tell apart,
/// and the curve's exponent. The ratio holds under the given curve: another
/// curve, another ratio. What is far off the line and off all that is as bright has moved.
/// in:     exponent_sigma: of the curve, relative; 0 where it is known
/// errors: kInvalid (sizes differ), kUndetermined (fewer than fifty blocks that both tell, or no
///         line through them)
/// source: Hanji & Mantiuk 2023 (ratios from overlaps); Deming 1943 (errors in both); gauge:
///         Grossberg & Nayar 2003
Result<ExposureRatio> estimate_exposure_ratio(const Image<Rgb8>& a, const Image<Rgb8>& b,
                                              const ResponseTable& curve,
                                              double exponent_sigma = 0);

/// Where a picture shows what another one shows, pixels to the right and down.
struct CameraShift {
  std::array<double, 2> moved_px;
  double sigma_px;  // about
  bool moved() const { return std::hypot(moved_px[0], moved_px[1]) > 1.5 * sigma_px; }
};
/// Up to an eighth of the picture. Nothing where they have too little in common, are smooth, or are
/// smaller than 32 pixels.
/// source: Lewis 1995 (normalised cross-correlation), of local differences over their spread
std::optional<CameraShift> find_camera_shift(const Image<Rgb8>& a, const Image<Rgb8>& b);

/// How far the pictures of a hand-held stack lay from the reference, pixels in the mean.
struct Alignment {
  std::vector<double> moved_px;
};
/// Brings the pictures (8 bits) of a stack onto the reference by a homography each; what a picture
/// does not show is marked as not valid. Parallax and what moved on its own remain: a merge with an
/// order of trust leaves them out.
/// errors: kInvalid (not 8 bits, no such reference), kUndetermined (too little in common: the
/// picture's number)
/// source: SIFT, Lowe 2004; consensus, Fischler & Bolles 1981
Result<Alignment> align_stack(ExposureStack& stack, std::size_t reference);

}  // namespace penumbra::capture
#pragma GCC visibility pop
