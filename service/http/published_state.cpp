#include "service/http/published_state.h"

#include <algorithm>

namespace penumbra::service {

namespace {

constexpr std::chrono::seconds kRateOver(2), kWantedFor(3);
constexpr std::chrono::milliseconds kBetweenMaps(200);
constexpr std::size_t kMaxCame = 2048;

}  // namespace

void PublishedState::describe_source(std::vector<capture::CameraInfo> cameras, double view_rate) {
  const std::scoped_lock lock(mutex_);
  state_.sources = std::move(cameras);
  state_.view_rate_hz = view_rate;
}

void PublishedState::publish_light(const lighting::LightEstimate& light) {
  const std::scoped_lock lock(mutex_);
  state_.light = light;
}

void PublishedState::publish(TimestampNs now, std::shared_ptr<const FramePixels> frame,
                             const runtime::OvertakenFrames& overtaken) {
  {
    const std::scoped_lock lock(mutex_);
    state_.now = now;
    state_.frame = std::move(frame);
    ++state_.frames;
    state_.overtaken = overtaken;
    published_ = Clock::now();
    came_.push_back(published_);
    while (came_.size() > kMaxCame || came_.front() < published_ - kRateOver) came_.pop_front();
  }
  changed_.notify_all();
}

void PublishedState::publish_progress(const std::string& work, double done) {
  const std::scoped_lock lock(mutex_);
  if (done < 1)
    state_.preparing[work] = done;
  else
    state_.preparing.erase(work);
}

void PublishedState::publish_cameras(const std::vector<capture::CameraInfo>& cameras,
                                     std::vector<capture::CameraCounts> counts) {
  const std::scoped_lock lock(mutex_);
  state_.cameras.clear();
  for (std::size_t i = 0; i < std::min(cameras.size(), counts.size()); ++i)
    state_.cameras.emplace_back(cameras[i].name, std::move(counts[i]));
}

void PublishedState::publish_outputs(std::vector<OutputState> outputs) {
  const std::scoped_lock lock(mutex_);
  state_.outputs = std::move(outputs);
}

void PublishedState::publish_pose(PoseState pose) {
  const std::scoped_lock lock(mutex_);
  state_.pose = std::move(pose);
}

void PublishedState::publish_headset(HeadsetView headset) {
  const std::scoped_lock lock(mutex_);
  state_.headset = std::move(headset);
}

void PublishedState::publish_environment(const Environment& environment) {
  const auto now = Clock::now();
  {
    const std::scoped_lock lock(mutex_);
    const bool wanted = !environment_ || environment_wanted_ > now - kWantedFor;
    if (!wanted || environment_begun_ > now - kBetweenMaps) return;
    environment_begun_ = now;
  }
  auto copy = std::make_shared<const Environment>(environment);
  {
    const std::scoped_lock lock(mutex_);
    environment_ = std::move(copy);
    environment_made_ = now;
  }
  changed_.notify_all();
}

std::shared_ptr<const Environment> PublishedState::environment() const {
  constexpr std::chrono::milliseconds kPatience(500);
  std::unique_lock lock(mutex_);
  const auto now = Clock::now();
  const bool is_old = environment_made_ < now - 2 * kBetweenMaps;
  environment_wanted_ = now;
  if (environment_ && is_old)
    changed_.wait_for(lock, kPatience, [&] { return environment_made_ >= now; });
  return environment_;
}

PublishedState::Snapshot PublishedState::snapshot() const {
  const std::scoped_lock lock(mutex_);
  Snapshot out = state_;
  const auto now = Clock::now();
  out.idle_s = std::chrono::duration<double>(now - published_).count();
  out.uptime_s = std::chrono::duration<double>(now - started_).count();
  const auto lately =
      std::ranges::count_if(came_, [&](Clock::time_point t) { return t >= now - kRateOver; });
  const double over_s = std::min(out.uptime_s, std::chrono::duration<double>(kRateOver).count());
  out.frame_rate_hz = over_s > 0 ? static_cast<double>(lately) / over_s : 0;
  return out;
}

bool PublishedState::wait_beyond(std::uint64_t frames, std::chrono::milliseconds timeout) const {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, timeout, [&] { return state_.frames > frames; });
}

double PublishedState::Snapshot::light_age_s() const {
  // A light may be newer than the newest view frame.
  return std::max(0., light.age(now).count()) + idle_s;
}

std::string PublishedState::Snapshot::status(double stale_after_s) const {
  constexpr double kEnough = .8, kSettled_s = 5;
  if (!light.valid) return "starting";
  if (light_age_s() > stale_after_s) return "stale";
  const bool is_slow = uptime_s > kSettled_s && frame_rate_hz < kEnough * view_rate_hz;
  return is_slow ? "slow" : "ok";
}

}  // namespace penumbra::service
