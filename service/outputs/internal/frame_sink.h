// What differs between outputs. An output's thread alone calls it.
// threads: thread-bound
#pragma once

#include <optional>
#include <stop_token>
#include <string>
#include <variant>

#include "codec/display.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::service {

/// How long a wait may last before it looks whether the output is to stop.
inline constexpr int kPatience_ms = 50;

class FrameSink {
 public:
  virtual ~FrameSink() = default;

  /// Called before each frame and at least ten times a second: for what needs care without frames.
  /// out:    what it waits for; empty: nothing
  /// errors: end the output
  virtual Result<std::string> tend() { return std::string(); }

  /// May wait for its consumer, but returns within a tenth of a second once `stop` is requested.
  /// out:    whether the frame was handed on
  /// errors: end the output
  virtual Result<bool> put(const FramePixels& pixels, TimestampNs captured,
                           const std::stop_token& stop) = 0;
};

/// A frame as eight-bit RGB, without a copy where it is that already.
class DisplayPicture {
 public:
  /// pixels: outlive it
  explicit DisplayPicture(const FramePixels& pixels) : given_(std::get_if<Image<Rgb8>>(&pixels)) {
    if (!given_) made_ = codec::to_display(pixels);
  }
  const Image<Rgb8>& operator*() const { return given_ ? *given_ : *made_; }

 private:
  const Image<Rgb8>* given_;
  std::optional<Image<Rgb8>> made_;
};

/// A rate as the fraction that formats state, to a thousandth of a frame a second.
struct FrameRate {
  int numerator = 30, denominator = 1;

  /// rate_hz: 0 counts as 30
  /// errors:  kInvalid (not between 0.1 and 1000), naming the output
  static Result<FrameRate> from(double rate_hz, const std::string& output);
};

}  // namespace penumbra::service
