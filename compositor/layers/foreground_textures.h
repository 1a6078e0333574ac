// What stands in front of all that is drawn, where fragments look it up.
// threads: thread-bound, to the one of the GL context
#pragma once

#include <memory>
#include <optional>

#include "compositor/foreground.h"
#include "compositor/layers/gl/gl.h"

namespace penumbra::compositor {

struct CoverTextures {
  GlTexture cover{}, distance{};
  int width = 0, height = 0;  // pixels that there is room for
};

class ForegroundTextures {
 public:
  /// Units of its textures; those of other pictures are below.
  static constexpr int kCoverUnit = 13, kDistanceUnit = 14;

  /// Null, or one of no pixels: nothing stands in front.
  void set(const std::shared_ptr<const Foreground>& foreground);
  bool any() const { return foreground_ != nullptr; }
  /// Of the canvas: its corner in the picture, and its samples a pixel along each axis.
  void place(const Rect& canvas, int scale);
  /// For a program that is current and looks it up.
  void bind(GLuint program) const;

 private:
  void make_room(int width, int height);

  std::shared_ptr<const Foreground> foreground_;
  std::optional<CoverTextures> textures_;
  Rect canvas_;
  int scale_ = 1;
};

/// GLSL of fragments: `vec4 with_foreground(vec4 c)` is a premultiplied colour as it is seen past
/// what stands in front, `float seen_past_foreground()` the fraction of it that is seen.
extern const char* const kBehindForeground;
extern const char* const kNoForeground;

}  // namespace penumbra::compositor
