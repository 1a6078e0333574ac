// Where GL draws a layer: larger than it is shown, averaged and read back.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "compositor/layers/gl/gl.h"
#include "compositor/projection.h"
#include "core/result.h"

namespace penumbra::compositor {

/// A drawn layer: half-float RGBA of the rectangle, row by row from the top.
struct Layer {
  Rect rect;
  std::vector<std::uint16_t> halves;  // keeps its capacity between frames
  std::span<const std::uint16_t> row(int y) const {
    const auto stride = static_cast<std::size_t>(rect.width()) * 4;
    return std::span(halves).subspan(static_cast<std::size_t>(y - rect.y0) * stride, stride);
  }
};

/// A layer that others may still read while the next one is drawn.
/// threads: one decides and hands out; those who read neither copy nor drop their pointer
struct CommonLayer {
  std::shared_ptr<Layer> now = std::make_shared<Layer>();
  std::shared_ptr<Layer> spare;  // somebody's earlier one, whose room serves again

  /// To draw into: `now`, or in its place one that nobody reads.
  Layer& renewed() {
    if (spare == now) spare.reset();
    if (now.use_count() > 1) {
      const bool free = spare && spare.use_count() == 1;
      now = free ? std::move(spare) : std::make_shared<Layer>();
    }
    return *now;
  }
};

/// Follows the rectangle's size, since clearing all of a framebuffer is much faster than a part of
/// it.
class Canvas {
 public:
  /// oversampling: samples a pixel along each axis, a power of two; multisampled: four samples a
  /// pixel that are shaded once, for programs that take long.
  explicit Canvas(int oversampling, bool multisampled = false)
      : oversampling_(oversampling), multisampled_(multisampled) {}

  /// Cleared to nothing, with the viewport of a frame of that size placed so that the rectangle
  /// lies in the corner.
  Result<void> begin(const Rect& rect, int frame_width, int frame_height);
  int oversampling() const { return oversampling_; }
  /// The mean of each pixel's samples.
  void finish(Layer& out);

 private:
  // The fine picture first, each following one half as large, the last at one sample a pixel.
  struct Target {
    GlFramebuffer framebuffer;
    GlTexture colour;
    int scale;
  };
  bool fits(const Rect& rect) const;
  void attach_fine(Target& target);
  Result<void> make_targets();

  static constexpr GLsizei kSamples = 4;

  int oversampling_;
  bool multisampled_;
  int width_ = 0, height_ = 0;  // pixels that there is room for
  std::vector<Target> targets_;
  GlRenderbuffer fine_depth_, samples_;
};

}  // namespace penumbra::compositor
