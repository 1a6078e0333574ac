// Tone mapping of a video that does not flicker.
// threads: thread-bound
#pragma once

#include <optional>

#include "codec/tone/tone_mapping.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::tone {

/// Maps the pictures of a video, adapted to light that follows the pictures' own with a time
/// constant, as an eye does: the logarithms of ToneStatistics pass a low pass of first order. A
/// step of the light is answered by 63 % after the constant and 95 % after three. Flicker at f
/// hertz gets through as 1 / sqrt(1 + (2 pi f constant)^2). Black pictures leave the adaptation as
/// it is. The first picture, and one after a gap of 20 constants, is taken as it is.
/// threads: thread-bound
class TemporalTone {
 public:
  /// time_constant: 0 or above; 0 adapts to each picture by itself
  explicit TemporalTone(const ToneOptions& options, Seconds time_constant = Seconds(.4));

  /// errors:  as tone_map(); kInvalid (a time before the last one, a time constant below 0), which
  ///          leave the adaptation as it is
  Result<ToneMapped> map(const Image<Rgb>& radiance, TimestampNs time);

  /// What the last picture was adapted to; nothing before the first.
  [[nodiscard]] const std::optional<ToneStatistics>& adaptation() const { return adaptation_; }

  /// The next picture is another scene: it is taken as it is.
  void restart() { adaptation_.reset(); }

 private:
  ToneOptions options_;
  Seconds time_constant_;
  std::optional<ToneStatistics> adaptation_;
  TimestampNs time_;
};

}  // namespace penumbra::tone
#pragma GCC visibility pop
