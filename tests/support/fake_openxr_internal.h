// What the parts of the fake OpenXR runtime share.
// threads: all below `mutex` is guarded by it
#pragma once

#include <EGL/egl.h>
#include <GLES3/gl32.h>
#include <X11/Xlib.h>
#include <time.h>
// After Xlib.h, which it needs.
#include <GL/glx.h>

#define XR_USE_TIMESPEC
#define XR_USE_PLATFORM_EGL
#define XR_USE_GRAPHICS_API_OPENGL_ES
#define XR_USE_PLATFORM_XLIB
#define XR_USE_GRAPHICS_API_OPENGL
#include <openxr/openxr.h>
#include <openxr/openxr_platform.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/fake_openxr_runtime.h"

namespace fake_xr {

struct Knobs {
  XrQuaternionf local{0, 0, 0, 1};
  std::uint32_t views = 2, edge_px = 128;
  double rate_hz = 72, turn_deg_s = 0;
  int lose_after = 0, put_down = 0, put_up = 0;
  bool alpha = false, keep = false;
  std::string refuse;

  static Knobs read();
  [[nodiscard]] bool refuses(const char* word) const {
    return refuse.find(word) != std::string::npos;
  }
};

struct Space {
  XrReferenceSpaceType type = XR_REFERENCE_SPACE_TYPE_STAGE;
  int hand = -1;  // 0 or 1: a grip's, and `type` means nothing
  XrPosef pose{};
};

struct Swapchain {
  XrSwapchainCreateInfo info{};
  std::array<GLuint, 3> images{};  // names of no textures in a session without graphics
  std::uint32_t next = 0;
  int acquired = -1, released = -1;  // images
  bool waited = false, fresh = false;
};

struct Session {
  bool lives = false, has_graphics = false, has_glx = false;
  bool asked_for_gles = false, asked_for_gl = false;
  bool begun = false, lost = false, asked_to_exit = false, attached = false, synced = false;
  XrSessionState state = XR_SESSION_STATE_UNKNOWN;
  std::int64_t predicted_ns = 0, next_frame_ns = 0;
  std::deque<XrSessionState> events;
};

extern FakeOpenXrState state;
extern std::mutex mutex;
extern Knobs knobs;
extern Session session;
extern std::map<XrSpace, Space> spaces;
extern std::map<XrSwapchain, Swapchain> swapchains;
extern std::deque<FakeOpenXrFrame> frames;
extern std::set<XrAction> actions;
extern std::set<XrActionSet> action_sets;

template <class Handle>
Handle new_handle() {
  static std::uintptr_t last = 0x1000;
  return reinterpret_cast<Handle>(++last);
}
inline const XrSession kSession = reinterpret_cast<XrSession>(0x5e55);
inline const XrInstance kInstance = reinterpret_cast<XrInstance>(0x1257);
inline constexpr XrSystemId kSystem = 7;

std::int64_t monotonic_ns();
/// Notes a wrong call and gives the error for it.
XrResult fault(const std::string& what, XrResult error = XR_ERROR_VALIDATION_FAILURE);
/// Of the session: known and not lost; else the error.
XrResult alive(XrSession of);
bool is_pose(const XrPosef& pose);
XrViewConfigurationType view_type();
/// Whether a context of either kind is current.
bool has_context();
/// What a session's end or an instance's end leaves.
void end_session();

template <class Struct>
bool has_type(const Struct* s, XrStructureType type) {
  return s && s->type == type;
}

template <class Value, std::size_t N>
XrResult give(const std::array<Value, N>& values, std::size_t used, std::uint32_t capacity,
              std::uint32_t* count, Value* out) {
  *count = static_cast<std::uint32_t>(used);
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < used) return XR_ERROR_SIZE_INSUFFICIENT;
  for (std::size_t i = 0; i < used; ++i) {
    if constexpr (requires { values[i].type; })
      if (out[i].type != values[i].type) return fault("an output of another type");
    out[i] = values[i];
  }
  return XR_SUCCESS;
}

/// Functions of the other files, by name.
using Functions = std::map<std::string, PFN_xrVoidFunction>;
template <class Function>
PFN_xrVoidFunction any(Function* function) {
  return reinterpret_cast<PFN_xrVoidFunction>(function);
}
Functions space_functions();
Functions session_functions();
Functions swapchain_functions();
/// Keeps what a frame shows.
XrResult keep_layers(const XrFrameEndInfo& info);

}  // namespace fake_xr
