// What a session draws with. A runtime takes one kind of graphics only by its own extension, so all
// that differs between EGL and others stands behind this.
// threads: thread-bound, to the thread that makes it
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/result.h"
#include "service/headset/internal/openxr_headers.h"

namespace penumbra::service {

class HeadsetGraphics {
 public:
  virtual ~HeadsetGraphics() = default;

  /// Of the runtime, without which it cannot take this kind of graphics.
  virtual std::vector<const char*> extensions() const = 0;
  /// The system has taken the graphics away: others have to be made.
  virtual bool is_lost() const { return false; }
  /// Asks the runtime what it needs, as OpenXR demands before a session is made.
  /// errors: kUnavailable (another version of the graphics)
  virtual Result<void> check_requirements(XrInstance instance, XrSystemId system) = 0;
  /// For XrSessionCreateInfo::next; lives as long as this.
  virtual const void* binding() const = 0;
  /// The runtime's textures of a swapchain, as GL names.
  /// errors: kUnavailable
  virtual Result<std::vector<unsigned>> images(XrSwapchain swapchain) const = 0;
};

std::vector<const char*> egl_extensions();
std::vector<const char*> glx_extensions();
/// OpenGL ES on a surfaceless EGL context, which is current on the calling thread from then on.
/// errors: kUnavailable (no OpenGL ES 3.1)
Result<std::unique_ptr<HeadsetGraphics>> make_egl_graphics();
/// OpenGL on a GLX context of the X display that DISPLAY names, current as well.
/// errors: kUnavailable (no X display, no OpenGL 4.5)
Result<std::unique_ptr<HeadsetGraphics>> make_glx_graphics();

}  // namespace penumbra::service
