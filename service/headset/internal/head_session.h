// One session with a headset: its states, spaces, frames and swapchains.
// threads: locate() thread-safe, all else bound to the session's thread
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "service/headset/headset.h"
#include "service/headset/internal/hand_poses.h"
#include "service/headset/internal/openxr_headers.h"
#include "service/headset/internal/xr_runtime.h"

namespace penumbra::service {

/// Where the eyes were and how far they see; both are finite.
struct EyeViews {
  std::array<XrView, 2> eyes;
};

struct EyeSwapchain {
  XrSwapchain handle = XR_NULL_HANDLE;
  int width = 0, height = 0;
  std::vector<unsigned> images;  // GL names
};

class HeadSession {
 public:
  /// errors: kClosed, kUnavailable
  static Result<std::unique_ptr<HeadSession>> open(XrRuntime& runtime, HeadsetGraphics& graphics);
  ~HeadSession();
  HeadSession(const HeadSession&) = delete;
  HeadSession& operator=(const HeadSession&) = delete;

  /// Takes the runtime's events and begins and ends the session as they ask.
  /// errors: kClosed, kUnavailable
  Result<void> poll();
  bool has_frames() const { return begun_; }  // between begin and end
  bool is_visible() const {
    return state_ == XR_SESSION_STATE_VISIBLE || state_ == XR_SESSION_STATE_FOCUSED;
  }
  bool over() const { return over_; }
  /// Whether the world's origin has moved since the last call.
  bool take_moved_origin() { return std::exchange(moved_origin_, false); }
  /// False where there is nothing to leave.
  bool request_exit();
  /// Nothing more may be asked of the runtime, which has gone.
  void abandon() { abandoned_ = true; }

  Result<XrFrameState> wait_frame();
  Result<void> begin_frame();
  /// views: one for each of the session's; empty: nothing is shown
  Result<void> end_frame(XrTime display,
                         const std::vector<XrCompositionLayerProjectionView>& views);

  bool on_stage() const { return on_stage_; }
  std::size_t view_count() const { return swapchains_.size(); }  // 1 or 2
  const EyeSwapchain& swapchain(std::size_t view) const { return swapchains_[view]; }
  /// Index of the image that may be drawn into until release_image().
  Result<std::uint32_t> acquire_image(std::size_t view);
  Result<void> release_image(std::size_t view);

  /// In the world, or against the head; nothing while the head is not tracked, or at a time of
  /// which the runtime knows nothing.
  Result<std::optional<EyeViews>> eyes_in_world(XrTime time) const;
  Result<std::optional<EyeViews>> eyes_in_head(XrTime time) const;
  /// The head's place in the world.
  std::optional<HeadPose> locate_head(XrTime time) const { return locate(view_, time); }
  std::optional<HeadPose> locate_hand(std::size_t hand, XrTime time) const;
  Result<void> sync_hands() const { return hands_->sync(session_); }

 private:
  explicit HeadSession(XrRuntime& runtime) : runtime_(runtime) {}
  Result<void> make_session(HeadsetGraphics& graphics);
  Result<void> make_spaces();
  Result<void> choose_views();
  Result<void> make_swapchains(HeadsetGraphics& graphics);
  Result<void> enter(XrSessionState state);
  std::optional<HeadPose> locate(XrSpace space, XrTime time) const;
  Result<std::optional<EyeViews>> eyes_in(XrSpace base, XrTime time) const;

  XrRuntime& runtime_;
  XrSession session_ = XR_NULL_HANDLE;
  XrSpace world_ = XR_NULL_HANDLE, view_ = XR_NULL_HANDLE;
  bool on_stage_ = false;
  XrViewConfigurationType views_ = XR_VIEW_CONFIGURATION_TYPE_PRIMARY_STEREO;
  XrEnvironmentBlendMode blend_ = XR_ENVIRONMENT_BLEND_MODE_OPAQUE;
  std::vector<EyeSwapchain> swapchains_;
  std::unique_ptr<HandPoses> hands_;
  XrSessionState state_ = XR_SESSION_STATE_UNKNOWN;
  bool begun_ = false, over_ = false, moved_origin_ = false, abandoned_ = false;
};

}  // namespace penumbra::service
