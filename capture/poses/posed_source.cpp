#include "capture/poses/posed_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace penumbra::capture {

namespace {

constexpr Seconds kFadeOut{.25}, kFadeIn{.1}, kLargestOffset{3600};

bool is_finite_pose(const Pose& p) {
  const glm::dquat& q = p.rotation;
  const glm::dvec3& t = p.translation;
  return std::ranges::all_of(std::initializer_list<double>{q.w, q.x, q.y, q.z, t.x, t.y, t.z},
                             [](double v) { return std::isfinite(v); });
}

}  // namespace

Result<std::vector<MovingCamera>> moving_cameras(const std::vector<CameraInfo>& cameras,
                                                 const calib::PoseFile& file,
                                                 const std::filesystem::path& path) {
  if (file.poses_in == calib::PosesIn::kWorld)
    return fail(ErrorCode::kInvalid, path.string(),
                "has poses in the world: calibrate the rig with --tracker, or without "
                "--board-plane");
  std::vector<MovingCamera> out;
  for (std::size_t i = 0; i < cameras.size(); ++i)
    if (const auto found =
            std::ranges::find(file.cameras, cameras[i].name, &calib::PoseFile::NamedPose::name);
        found != file.cameras.end())
      out.push_back({static_cast<int>(i), found->pose});
  if (out.empty())
    return fail(ErrorCode::kNotFound, path.string(), "has none of the cameras that are opened");
  return out;
}

Result<std::unique_ptr<PosedSource>> PosedSource::create(std::unique_ptr<FrameSource> frames,
                                                         std::unique_ptr<PoseSource> poses,
                                                         const PosedSourceOptions& options) {
  const auto refuse = [](ErrorCode code, std::string why) {
    return fail(code, "poses of frames", std::move(why));
  };
  if (options.cameras.empty()) return refuse(ErrorCode::kInvalid, "there is no camera that moves");
  if (!std::isfinite(options.tracker_offset.count()))
    return refuse(ErrorCode::kNonFinite, "the tracker's offset is not finite");
  if (std::abs(options.tracker_offset.count()) > kLargestOffset.count())
    return refuse(ErrorCode::kInvalid, "the tracker's offset is beyond an hour");
  std::unique_ptr<PosedSource> out(new PosedSource(std::move(frames), std::move(poses)));
  const auto& infos = out->frames_->cameras();
  out->offset_ = options.tracker_offset;
  out->movers_.resize(infos.size());
  for (const MovingCamera& moving : options.cameras) {
    const auto index = static_cast<std::size_t>(moving.camera);
    if (moving.camera < 0 || index >= infos.size())
      return refuse(ErrorCode::kInvalid, fmt::format("there is no camera {}", moving.camera));
    if (out->movers_[index])
      return refuse(ErrorCode::kInvalid, fmt::format("{} is named twice", infos[index].name));
    if (!is_finite_pose(moving.body_from_camera))
      return refuse(ErrorCode::kNonFinite,
                    fmt::format("{} has a pose that is not finite", infos[index].name));
    Mover mover;
    mover.body_from_camera = moving.body_from_camera;
    mover.world_from_camera = infos[index].world_from_camera;
    out->movers_[index] = mover;
  }
  return out;
}

// By frame time alone, so that a replay shows the same.
double PosedSource::fade(Mover& mover, TimestampNs time, bool known) {
  const Seconds step = mover.seen ? std::max(Seconds(0), time - *mover.seen) : Seconds(0);
  mover.seen = mover.seen ? std::max(*mover.seen, time) : time;
  if (known) {
    mover.opacity = std::min(1., mover.opacity + step / kFadeIn);
    mover.known = time;
    mover.opacity_known = mover.opacity;
  } else if (!mover.known) {
    mover.opacity = 0;
  } else {
    const Seconds old = std::max(Seconds(0), time - *mover.known);
    mover.opacity = std::clamp(mover.opacity_known - old / kFadeOut, 0., mover.opacity);
  }
  return mover.opacity;
}

Result<std::optional<Frame>> PosedSource::next() {
  while (true) {
    PENUMBRA_ASSIGN(frame, frames_->next());
    if (!frame) return std::optional<Frame>();
    const auto camera = static_cast<std::size_t>(frame->camera);
    if (frame->camera < 0 || camera >= movers_.size() || !movers_[camera]) return std::move(frame);
    Mover& mover = *movers_[camera];
    const TimestampNs time = frame->time;
    frame->time = time + offset_;  // what the source of poses is asked for
    const auto pose = poses_->pose_of(*frame);
    frame->time = time;
    if (pose) {
      mover.world_from_camera = pose->pose * mover.body_from_camera;
      const std::scoped_lock lock(last_mutex_);
      last_ = pose;
    }
    if (frames_->cameras()[camera].role == Role::kView) {
      frame->opacity = static_cast<float>(fade(mover, time, pose.has_value()));
    } else if (!pose) {
      left_out_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    frame->world_from_camera = mover.world_from_camera;
    return std::move(frame);
  }
}

}  // namespace penumbra::capture
