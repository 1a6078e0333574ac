// What the fake OpenXR runtime has seen, for the tests that put it below Debian's loader.
// threads: the numbers may be read at any time; functions are thread-safe
#pragma once

#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

// Knobs, read when an instance is created:
//   PENUMBRA_FAKE_XR_LOCAL       "w x y z", turn of the local space in the stage
//   PENUMBRA_FAKE_XR_VIEWS       1 or 2; 2 if unset
//   PENUMBRA_FAKE_XR_EDGE        width and height that views recommend, in pixels; 128 if unset
//   PENUMBRA_FAKE_XR_RATE_HZ     of xrWaitFrame; 72 if unset
//   PENUMBRA_FAKE_XR_TURN        degrees a second by which the head turns left; 0 if unset
//   PENUMBRA_FAKE_XR_LOSE_AFTER  so many frames, then XR_ERROR_INSTANCE_LOST
//   PENUMBRA_FAKE_XR_PUT_DOWN    "a b": from frame a to frame b nobody wears the headset
//   PENUMBRA_FAKE_XR_KEEP        set: keeps the pictures of submitted views
//   PENUMBRA_FAKE_XR_ALPHA       set: blends by alpha, too
//   PENUMBRA_FAKE_XR_REFUSE      words of: instance system stage clock egl glx tracking session
//                                ready
struct FakeOpenXrState {
  std::atomic<int> instances = 0, sessions = 0, spaces = 0, swapchains = 0;  // that live
  std::atomic<int> instances_made = 0;
  std::atomic<int> frames_waited = 0, frames_begun = 0, frames_ended = 0;  // of this session
  std::atomic<int> images_acquired = 0, images_released = 0;
  std::atomic<std::uint32_t> layers_of_last_frame = 0;
  std::atomic<int> structs_of_properties = 0;  // chained to the last xrGetSystemProperties
  std::atomic<int> sessions_left = 0;          // by request, end and destruction in this order
  std::atomic<bool> place_tracked = true;      // of the head; a test sets it
  char extensions[1024] = "";                  // of the last instance, a space after each
  static constexpr std::int64_t kTimeAhead_ns =
      1'000'000'000'000;  // of XrTime over CLOCK_MONOTONIC
};

/// One submitted view. Angles in radians: left, right, up, down.
struct FakeOpenXrView {
  std::array<double, 4> rotation{};  // x y z w, in the stage
  std::array<double, 3> position{};
  std::array<double, 4> fov{};
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;  // from the bottom row; empty where the image is the last frame's
};
struct FakeOpenXrFrame {
  std::int64_t display_ns = 0;  // by CLOCK_MONOTONIC
  std::vector<FakeOpenXrView> views;
};

/// The head turns about y as a closed form of the time.
/// time_ns: by CLOCK_MONOTONIC; out: radians, counter-clockwise from above
inline double fake_openxr_yaw(double degrees_a_second, std::int64_t time_ns) {
  const double turns = degrees_a_second / 360 * (static_cast<double>(time_ns) * 1e-9);
  return 2 * 3.14159265358979323846 * (turns - std::floor(turns));
}
inline constexpr double kFakeOpenXrEyeHeight_m = 1.6, kFakeOpenXrHalfIpd_m = .0315;

/// dlsym() by these names in the runtime's file, which is loaded once.
using FakeOpenXrStateFunction = FakeOpenXrState*();
inline constexpr const char* kFakeOpenXrStateFunction = "fake_openxr_state";
/// The newest frames with layers, at most 256, which are then forgotten.
using FakeOpenXrFramesFunction = void(std::vector<FakeOpenXrFrame>* out);
inline constexpr const char* kFakeOpenXrFramesFunction = "fake_openxr_take_frames";
/// What was called wrongly, a line for each kind, which is then forgotten.
using FakeOpenXrFaultsFunction = void(std::string* out);
inline constexpr const char* kFakeOpenXrFaultsFunction = "fake_openxr_take_faults";
