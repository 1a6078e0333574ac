// The head of a headset, or one of its controllers, as a source of poses.
// threads: as capture::PoseSource
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "capture/poses/pose_source.h"
#include "service/headset/headset.h"

namespace penumbra::service {

/// A headset that only turns gives a place, too, but does not track it. That place is taken where
/// none was ever tracked within the first two seconds of frames, and state() says so; a place that
/// is lost for a while is not, nor is a controller's that is not tracked.
class HeadPoses : public capture::PoseSource {
 public:
  /// hand: of a controller, its grip; none: the head
  explicit HeadPoses(std::shared_ptr<const Headset> headset, std::optional<Hand> hand = {})
      : headset_(std::move(headset)), hand_(hand) {}

  std::optional<capture::FramePose> pose_of(const capture::Frame& frame) override;
  capture::PoseSourceState state() const override;

 private:
  std::string_view device_name() const;

  std::shared_ptr<const Headset> headset_;
  std::optional<Hand> hand_;
  bool follows_turns_alone(TimestampNs time);  // with mutex_ held, as the next
  void start_anew();

  mutable std::mutex mutex_;
  std::uint64_t taken_ = 0, missed_ = 0;  // guarded by mutex_, as is all below
  std::optional<TimestampNs> last_, asked_;
  std::optional<TimestampNs> untracked_since_;  // the place alone, and never tracked before
  std::optional<TimestampNs> gone_since_;       // no turn either, frame after frame
  std::string missing_;                         // why the last frame got no pose
  bool turns_alone_ = false;                    // that place is taken
  bool place_tracked_ = false;                  // it was at least once, of this headset
  std::string name_;                            // of the headset
};

}  // namespace penumbra::service
