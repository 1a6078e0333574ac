// Estimation of a camera's noise from frames of a still scene (photon transfer).
// source: Janesick, Photon Transfer, 2007; noise model of Hasinoff et al. 2010
// threads: reentrant
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/noise.h"
#include "calib/camera/response.h"
#include "core/image.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Codes of some thirty thousand pixels, evenly over the picture, through many frames of one
/// exposure.
class StillSeries {
 public:
  /// time: of all series in one unit; 0: unknown
  explicit StillSeries(double gain, double time = 0) : gain_(gain), time_(time) {}
  /// 8 or 16 bits; frames beyond the first 64 are passed over.
  /// errors: kInvalid (float pixels, another size or depth than the first)
  Result<void> add(const FramePixels& frame, const std::string& name);
  std::size_t frames() const { return codes_.size(); }
  double gain() const { return gain_; }
  double product() const { return gain_ * time_; }
  int bits() const { return bits_; }
  /// Of one frame: r, g, b of each pixel in turn.
  const std::vector<std::vector<std::uint16_t>>& codes() const { return codes_; }
  /// Likewise, green of the pixel beside each.
  const std::vector<std::vector<std::uint16_t>>& beside() const { return beside_; }

 private:
  double gain_, time_;
  int bits_ = 0, width_ = 0, height_ = 0;
  std::vector<std::vector<std::uint16_t>> codes_, beside_;
};

/// Mean of many samples of about one brightness.
struct NoisePoint {
  double signal = 0, gain = 1;
  double variance = 0;  // through time, without the rounding of codes
  double samples = 0;
};

struct NoiseCalibration {
  NoiseModel model;
  double full_well_sigma = 0, read_sigma = 0;  // one standard deviation
  double black_level = 0;                      // of full scale
  bool black_measured = false;  // by the capped lens or by two exposures; else as it was given
  double error = 0;             // of the model's standard deviation, RMS over the points, relative
  // Of neighbouring pixels' noise, and of one pixel's from frame to frame; a sensor's is 0.
  double neighbour_correlation = 0, frame_correlation = 0;
  std::vector<NoisePoint> points;
};

/// Beyond, the frames do not have the noise of a sensor: the camera smoothed or sharpened them.
inline constexpr double kMaxNoiseModelError = .12;
/// Beyond, the full well is that of pictures that were smoothed, sharpened, compressed or made of
/// a mosaic, and not of the sensor.
inline constexpr double kMaxNoiseCorrelation = .1;

/// From series of a still scene, best with everything from dark to bright, and of the capped lens
/// if there are any: those tell the black level. Without them two exposures of a factor of two
/// tell it by what does not grow with the exposure, and with one exposure it is `black_level`. Slow
/// changes of the light are taken out, and samples that are clipped, at code 0 or too quiet for
/// their codes (a third of a step) are left out.
/// errors: kUndetermined (says what to capture instead: fewer than 8 frames, one brightness, no
/// noise above the codes)
Result<NoiseCalibration> calibrate_noise(std::span<const StillSeries> still,
                                         std::span<const StillSeries> capped,
                                         const Response& response, double black_level);

/// "version = 1" and [noise]: full_well_electrons, read_noise, black_level, how sure they are.
std::string print_noise_file(const NoiseCalibration& calibration);
}  // namespace penumbra::calib
#pragma GCC visibility pop
