// The head of a headset as a source of poses.
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
/// is lost for a while is not.
class HeadPoses : public capture::PoseSource {
 public:
  explicit HeadPoses(std::shared_ptr<const Headset> headset) : headset_(std::move(headset)) {}

  std::optional<capture::FramePose> pose_of(const capture::Frame& frame) override;
  capture::PoseSourceState state() const override;

 private:
  std::shared_ptr<const Headset> headset_;
  bool follows_turns_alone(TimestampNs time);  // with mutex_ held, as the next
  void start_anew();

  mutable std::mutex mutex_;
  std::uint64_t taken_ = 0, missed_ = 0;  // guarded by mutex_, as is all below
  std::optional<TimestampNs> last_, asked_;
  std::optional<TimestampNs> untracked_since_;  // the place alone, and never tracked before
  std::optional<TimestampNs> gone_since_;       // no turn either, frame after frame
  std::string_view missing_;                    // why the last frame got no pose
  bool turns_alone_ = false;                    // that place is taken
  bool place_tracked_ = false;                  // it was at least once, of this headset
  std::string name_;                            // of the headset
};

}  // namespace penumbra::service
