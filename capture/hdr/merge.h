// One HDR picture from a bracket.
// threads: reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "calib/camera/noise.h"
#include "calib/camera/response.h"
#include "calib/camera/response_table.h"
#include "core/half.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Registered pictures of one camera at different exposures.
struct ExposureStack {
  std::vector<std::shared_ptr<const FramePixels>> frames;
  std::vector<Exposure> exposures;
  calib::Response response;  // unused for float frames, which are linear
  calib::NoiseModel noise;
  double black_level = 0;
  /// Most trusted first: samples that contradict a more trusted one by more than the noise explains
  /// are left out.
  /// Empty: nothing moved between the exposures, and all count.
  std::vector<std::size_t> priority{};
  bool noise_known = true;  // of a guess, more has to be explained
  // Of the codes: those above count as clipped, as bright ones do anyway; those below say that the
  // light is at most as much as there, and count where nothing else does.
  double first_code = 0, last_code = 1;
  /// For each frame 1 where it shows anything; empty: everywhere. A frame's own may be empty, too.
  std::vector<Image<std::uint8_t>> valid{};
};

/// Code curve of a response at 8 or 16 bits.
ResponseTable make_response_table(const calib::Response& response, int bits, double black_level);

struct MergedImage {
  Image<HalfRgba> pixels;  // radiance / `scale`; fourth channel 0 where every exposure is clipped
  float scale = 1;         // relative radiance of a stored 1
  double clipped_fraction = 0;  // of the pixels
  double black_fraction = 0;    // of the samples: under twice the noise in the longest exposure
};

/// Merged radiance in floats, and which pixels are clipped in every exposure.
struct MergedFloat {
  Image<Rgb> radiance;
  Image<std::uint8_t> clipped;  // 1 where clipped in every exposure, in any channel
  double clipped_fraction = 0, black_fraction = 0;
};

/// Maximum-likelihood radiance x = sum w_k x_k / sum w_k with w_k = 1/var_k(x), two iterations from
/// the Poisson estimator sum y_k / sum e_k; codes above 95 % of full scale do not count, nor float
/// samples at the bracket's largest value where shorter exposures show more there. Negative results
/// are kept; a pixel that is clipped everywhere gets the lower bound of its shortest exposure.
/// errors:  kInvalid (no frames, sizes or kinds differ, exposure not positive and finite),
///          kUndetermined (all black, all clipped)
/// source:  Granados et al. 2010; start Hanji et al. 2020; weights Hasinoff et al. 2010
Result<MergedFloat> merge(const ExposureStack& stack);

}  // namespace penumbra::capture
#pragma GCC visibility pop
