// Built instead of window_context.cpp where GLFW is absent or switched off.
#include "compositor/internal/gl.h"

namespace penumbra::compositor {

Result<std::unique_ptr<GlContext>> make_window_context(int, int, const std::string&) {
  return fail(ErrorCode::kUnavailable, "window", "this build has no window output");
}

}  // namespace penumbra::compositor
