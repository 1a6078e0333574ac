// From radiance to codes: the model of a camera's sensor.
// threads: reentrant
#pragma once

#include <cstdint>

#include "calib/camera/noise.h"
#include "calib/camera/response.h"
#include "capture/frames.h"
#include "core/image.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// From radiance to codes: blur of the optics, exposure, vignetting, shot and read noise, black
/// level, clipping, response, quantisation.
struct Sensor {
  calib::Response response;
  calib::NoiseModel noise;
  double black_level = 0;
  double vignetting = 0;    // relative loss of light in the corners
  double psf_sigma_px = 0;  // Gaussian blur in linear light, before noise
  int bits = 8;             // 8..16; above 8 codes are spread over those of 16 bits
  bool noisy = true;
};

/// Blurs by a Gaussian of this sigma, 0 to kLargestPsfSigma; beyond its edges the picture goes on
/// as it is there.
void blur(Image<Rgb>& picture, double sigma_px);

/// out must have the size of `radiance`. The noise depends on (seed, pixel) alone.
/// source: Poisson shot noise and Gaussian read noise, Hasinoff et al. 2010
void expose(const Sensor& sensor, const Image<Rgb>& radiance, Exposure exposure, std::uint64_t seed,
            FramePixels& out);

}  // namespace penumbra::capture
#pragma GCC visibility pop
