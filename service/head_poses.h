// The head of a headset as a source of poses.
// threads: as capture::PoseSource
#pragma once

#include <memory>
#include <mutex>

#include "capture/poses/pose_source.h"
#include "service/headset/headset.h"

namespace penumbra::service {

class HeadPoses : public capture::PoseSource {
 public:
  explicit HeadPoses(std::shared_ptr<const Headset> headset) : headset_(std::move(headset)) {}

  std::optional<capture::FramePose> pose_of(const capture::Frame& frame) override;
  capture::PoseSourceState state() const override;

 private:
  std::shared_ptr<const Headset> headset_;
  mutable std::mutex mutex_;
  std::uint64_t taken_ = 0, missed_ = 0;  // guarded by mutex_, as is all below
  std::optional<TimestampNs> last_, asked_;
};

}  // namespace penumbra::service
