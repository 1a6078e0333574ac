// Errors of luminance: as it is, and as an eye takes it.
// threads: reentrant
#pragma once

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

struct LuminanceError {
  double mse = 0;
  // Over the reference's range of luminance; infinite where nothing differs, minus infinity where
  // the reference has no range.
  double psnr_db = 0;  // NaN where the reference has one luminance, infinite where nothing differs
};

/// Mean square error of luminance and the ratio of the reference's range to it.
/// errors:  kInvalid (sizes differ, empty), kNonFinite (first bad pixel)
/// source:  Xu 2005, equation 4.4
Result<LuminanceError> luminance_error(const Image<Rgb>& reference, const Image<Rgb>& test);

/// Luminance of a display, cd/m^2, as a number whose steps look alike: 0 at 0.005, about 256 at 100
/// and 595.4 at 10000, beyond which the luminance is cut.
/// source:  Mantiuk & Azimi 2021, "PU21: A novel perceptually uniform encoding for adapting
///          existing quality metrics for HDR", the variant for banding and glare
double pu21(double luminance_cd_m2);

struct Pu21Error {
  double psnr_db = 0;  // over 256, the range of an ordinary display; infinite where nothing differs
  double ssim = 1;
  Image<float> difference;  // of the encoded luminance, its magnitude
};

/// PSNR and SSIM of luminance encoded by pu21().
/// in:      linear pictures; cd_m2: luminance of a value of 1, above 0
/// errors:  kInvalid (sizes differ, empty, cd_m2), kNonFinite (first bad pixel)
/// source:  Mantiuk & Azimi 2021; Wang et al. 2004 for SSIM, with its Gaussian of 1.5 pixels
Result<Pu21Error> pu21_error(const Image<Rgb>& reference, const Image<Rgb>& test, double cd_m2);

}  // namespace penumbra::tools
