// Where GL draws a layer: larger than it is shown, averaged and read back.
#pragma once

#include <array>
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
  std::vector<std::uint16_t> halves;     // both keep their capacity between frames
  std::vector<std::uint16_t> weights{};  // likewise, of a weighted canvas
  std::span<const std::uint16_t> row(int y) const { return row_of(halves, y); }
  std::span<const std::uint16_t> weights_row(int y) const { return row_of(weights, y); }

 private:
  std::span<const std::uint16_t> row_of(std::span<const std::uint16_t> all, int y) const {
    const auto stride = static_cast<std::size_t>(rect.width()) * 4;
    return all.subspan(static_cast<std::size_t>(y - rect.y0) * stride, stride);
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
  /// kMultisampled: four samples a pixel that are shaded once, for programs that take long;
  /// kWeighted: with a second picture, of weights.
  enum class CanvasKind { kPlain, kMultisampled, kWeighted };
  /// oversampling: samples a pixel along each axis, a power of two
  explicit Canvas(int oversampling, CanvasKind kind = CanvasKind::kPlain)
      : oversampling_(oversampling), kind_(kind) {}

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
    std::array<GlTexture, 2> pictures;  // colour and weights
    int scale;
  };
  bool fits(const Rect& rect) const;
  bool multisampled() const { return kind_ == CanvasKind::kMultisampled; }
  std::size_t picture_count() const { return kind_ == CanvasKind::kWeighted ? 2 : 1; }
  void attach_pictures(Target& target) const;
  void attach_fine(Target& target);
  void halve(std::size_t picture, const Rect& rect) const;
  void read(std::size_t picture, const Rect& rect, std::vector<std::uint16_t>& out) const;
  Result<void> make_targets();

  static constexpr GLsizei kSamples = 4;

  int oversampling_;
  CanvasKind kind_;
  int width_ = 0, height_ = 0;  // pixels that there is room for
  std::vector<Target> targets_;
  GlRenderbuffer fine_depth_, samples_;
};

}  // namespace penumbra::compositor
