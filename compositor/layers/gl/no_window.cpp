// Built instead of window_context.cpp where GLFW is absent or switched off.
#include "compositor/layers/gl/gl.h"

namespace penumbra::compositor {

Result<std::unique_ptr<GlContext>> make_window_context(int, int, const std::string&) {
  return fail(ErrorCode::kUnavailable, "window", "is not part of this build");
}

}  // namespace penumbra::compositor
