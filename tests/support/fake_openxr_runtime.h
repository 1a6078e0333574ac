// What the fake OpenXR runtime has seen, for the tests that put it below Debian's loader.
// threads: the numbers may be read at any time
#pragma once

#include <atomic>
#include <cstdint>

// Knobs, read when an instance is created:
//   PENUMBRA_FAKE_XR_LOCAL       "w x y z", turn of the local space in the stage
//   PENUMBRA_FAKE_XR_VIEWS       1 or 2; 2 if unset
//   PENUMBRA_FAKE_XR_RATE_HZ     of xrWaitFrame; 72 if unset
//   PENUMBRA_FAKE_XR_LOSE_AFTER  so many frames, then XR_ERROR_INSTANCE_LOST
//   PENUMBRA_FAKE_XR_ALPHA       set: blends by alpha, too
//   PENUMBRA_FAKE_XR_REFUSE      words of: instance system stage clock tracking session
struct FakeOpenXrState {
  std::atomic<int> instances = 0, sessions = 0, spaces = 0, swapchains = 0;  // that live
  std::atomic<int> instances_made = 0;
  std::atomic<int> frames_waited = 0, frames_begun = 0, frames_ended = 0;
  std::atomic<int> images_acquired = 0, images_released = 0;
  std::atomic<std::uint32_t> layers_of_last_frame = 0;
  std::atomic<int> structs_of_properties = 0;  // chained to the last xrGetSystemProperties
  char extensions[1024] = "";                  // of the last instance, a space after each
  static constexpr std::int64_t kTimeAhead_ns =
      1'000'000'000'000;  // of XrTime over CLOCK_MONOTONIC
};

/// dlsym() by this name in the runtime's file, which is loaded once.
using FakeOpenXrStateFunction = FakeOpenXrState*();
inline constexpr const char* kFakeOpenXrStateFunction = "fake_openxr_state";
