// A runtime of OpenXR and its headset: what lives as long as an instance.
// threads: const members thread-safe, else thread-bound
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"
#include "service/headset/internal/headset_graphics.h"
#include "service/headset/internal/openxr_headers.h"

namespace penumbra::service {

/// errors: kClosed (instance or session lost), kUnavailable; `what` says what was tried
Result<void> xr_try(XrResult result, const char* what);

Pose from_xr(const XrPosef& pose);
XrPosef to_xr(const Pose& pose);
/// Finite, and a rotation of unit length, which it need not be where its flags say so.
bool is_pose(const XrPosef& pose);

class XrRuntime {
 public:
  /// errors: kUnavailable (no runtime, no headset, an extension that it lacks)
  static Result<std::unique_ptr<XrRuntime>> open(const std::string& application,
                                                 HeadsetGraphics& graphics);
  /// Whether a runtime that is there now takes pictures of these graphics, and tells times. True
  /// where there is none.
  static bool takes(const HeadsetGraphics& graphics);
  /// Of the kind that a runtime that is there now takes: EGL's if it can.
  /// errors: kUnavailable (what it lacks, by name), as make_egl_graphics and make_glx_graphics
  static Result<std::unique_ptr<HeadsetGraphics>> make_graphics();
  ~XrRuntime();
  XrRuntime(const XrRuntime&) = delete;
  XrRuntime& operator=(const XrRuntime&) = delete;

  XrInstance instance() const { return instance_; }
  XrSystemId system() const { return system_; }
  const std::string& name() const { return name_; }  // with its version
  const std::string& headset() const { return headset_; }

  /// errors: kClosed, kUnavailable (a time that the runtime cannot tell)
  Result<XrTime> to_xr_time(TimestampNs time) const;
  Result<TimestampNs> from_xr_time(XrTime time) const;

 private:
  XrRuntime() = default;
  static std::optional<std::vector<std::string>> offered_extensions();
  static bool takes(const std::vector<const char*>& extensions);
  Result<void> find_functions();
  Result<void> find_headset();

  XrInstance instance_ = XR_NULL_HANDLE;
  XrSystemId system_ = XR_NULL_SYSTEM_ID;
  std::string name_, headset_;
  PFN_xrConvertTimespecTimeToTimeKHR time_of_timespec_ = nullptr;
  PFN_xrConvertTimeToTimespecTimeKHR timespec_of_time_ = nullptr;
};

/// CLOCK_MONOTONIC.
TimestampNs monotonic_now();

}  // namespace penumbra::service
