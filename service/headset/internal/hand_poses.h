// The grip poses of the two controllers, by OpenXR's actions.
// threads: locate() thread-safe, else thread-bound
#pragma once

#include <array>
#include <memory>

#include "core/result.h"
#include "service/headset/internal/openxr_headers.h"

namespace penumbra::service {

class HandPoses {
 public:
  /// For the profiles of the known controllers; a runtime maps others to them.
  /// errors: kClosed, kUnavailable (the runtime refuses actions)
  static Result<std::unique_ptr<HandPoses>> make(XrInstance instance, XrSession session);

  /// Once a frame. While the session has no focus, hands are not seen.
  /// errors: kClosed, kUnavailable
  Result<void> sync(XrSession session) const;
  XrSpace grip(std::size_t hand) const { return grips_[hand]; }  // 0 left, 1 right

 private:
  // Both end with the session and the instance.
  XrActionSet set_ = XR_NULL_HANDLE;
  XrAction action_ = XR_NULL_HANDLE;
  std::array<XrSpace, 2> grips_{};
};

}  // namespace penumbra::service
