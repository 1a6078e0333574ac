// The camera's look on what is inserted: the blur of its optics and the noise of its sensor.
#pragma once

#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "compositor/projection.h"
#include "compositor/view.h"

namespace penumbra::compositor {

/// Rows of floats of the look are padded to a multiple of this, so that kernels need no remainder.
inline constexpr std::size_t kSensorLanes = 16;
inline std::size_t padded_row(int width) {
  return (static_cast<std::size_t>(width) + kSensorLanes - 1) / kSensorLanes * kSensorLanes;
}

/// Discrete Gaussian exp(-t) I_n(t), t = sigma^2, whose variance is t even far below one pixel,
/// where a sampled Gaussian is too sharp; cut at 3 sigma, its sum 1, its length odd.
/// source: Lindeberg 1990, scale-space for discrete signals
std::vector<float> psf_weights(double sigma_px);

/// out[i] = sum over k of weights[k] rows[k][i]; count a multiple of kSensorLanes.
void weighted_sum(const float* const* rows, const float* weights, std::size_t samples,
                  std::size_t count, float* out);

/// One channel of one row. Real signal y of variance g y + r^2 + q becomes V + T y. It gets noise
/// of the variance that it lacks to a pixel which has this signal by nature:
///   g (V + T y) + r^2 - T^2 (g y + r^2 + q), 0 at least.
/// That is g V + r^2 where an object covers the pixel, and g T y (1 - T) + r^2 (1 - T^2) - T^2 q
/// where a shadow lies on it. Lanes past the end may hold anything finite.
struct NoisyRow {
  const float *added, *deficit;  // V and 1 - T
  const float* real;             // y
  const float* rounding;         // q, the variance that quantisation has left in y
  std::uint32_t key[2];          // of frame, row and channel
  std::uint32_t first;           // column of the first sample
};
void add_with_noise(const NoisyRow& row, float shot_gain, float read_variance, std::size_t count,
                    float* out);

/// Of six planes, `stride` apart: 0 where all are 0. Returns the pixels [first, last) outside which
/// all are; empty where nothing is touched. Up to kSensorLanes - 1 floats past the width are read,
/// whatever they are, and written.
std::pair<std::size_t, std::size_t> mark_touched(const float* planes, std::size_t stride,
                                                 std::size_t width, std::uint32_t* touched);

/// Keys of the noise of a row; those of different frames, rows and channels have nothing in common.
std::array<std::uint32_t, 2> noise_key(std::uint64_t frame, int y, int channel);

/// Three planes of a rectangle, blurred: 0 around it. Keeps its capacity between frames.
class BlurPlanes {
 public:
  void prepare(const Rect& rect, double sigma_px, int frame_width, int frame_height);

  /// The rectangle, wider by 3 sigma, within the frame.
  const Rect& area() const { return area_; }

  /// First pass, for each row of the rectangle: planes at `in`, `stride` apart, from its first
  /// column on. Rows of zeros need no call.
  /// threads: rows may come from different threads
  void set_row(int y, const float* in, std::size_t stride);
  /// Second pass, when all rows are set: planes to `out`, from the area's first column on; each
  /// takes up to kSensorLanes - 1 samples more than the area is wide. False, and nothing written,
  /// when the row is empty.
  bool load_row(int y, float* out, std::size_t stride) const;

 private:
  Rect rect_, area_;
  int width_ = 0, height_ = 0, radius_ = 0;
  std::size_t stride_ = 0;
  std::vector<float> weights_, blurred_, nothing_;
  std::vector<std::uint8_t> filled_;  // by row of the rectangle
};

/// Of one frame: what the virtual things add to the picture, V, and the fraction of the real light
/// that they take, 1 - T.
struct SensorPlanes {
  BlurPlanes added, deficit;
};

struct Layered;

/// Composites with view.look; returns the number of pixels written.
std::size_t composite_effects(const View& view, FramePixels& frame, const Layered& in,
                              SensorPlanes& planes);

}  // namespace penumbra::compositor
