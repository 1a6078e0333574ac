#include "service/headset/headset.h"

#include <cmath>
#include <thread>

#include "service/headset/internal/session_thread.h"

namespace penumbra::service {

namespace {

Result<void> check_distance(const HeadsetOptions& options, double distance_m) {
  if (!(distance_m > options.near_m && distance_m < options.far_m))
    return fail(ErrorCode::kInvalid, "headset: picture_distance_m",
                "is not between near_m and far_m");
  return {};
}

Result<void> check_floor(std::optional<double> height_m) {
  constexpr double kHighest_m = 100;
  if (height_m && !(std::abs(*height_m) <= kHighest_m))
    return fail(ErrorCode::kInvalid, "headset: floor_height_m", "is not within -100..100");
  return {};
}

Result<void> check_headset_options(const HeadsetOptions& o) {
  constexpr std::size_t kLongest = 127;  // bytes that OpenXR has room for
  if (o.application.empty() || o.application.size() > kLongest ||
      o.application.find('\0') != std::string::npos)
    return fail(ErrorCode::kInvalid, "headset: application", "is not a name of 1 to 127 bytes");
  constexpr double kNearest_m = 1e-3, kFarthest_m = 1e5;
  if (!(o.near_m >= kNearest_m && o.far_m <= kFarthest_m && o.near_m < o.far_m))
    return fail(ErrorCode::kInvalid, "headset: near_m and far_m",
                "do not rise within 0.001..100000");
  PENUMBRA_TRY(check_distance(o, o.picture_distance_m));
  return check_floor(o.floor_height_m);
}

}  // namespace

class Headset::Impl {
 public:
  explicit Impl(const HeadsetOptions& given) : options(given), session(given) {}

  // Waits until the thread knows whether it can draw at all.
  Result<void> start() {
    std::promise<Result<void>> ready;
    auto known = ready.get_future();
    thread = std::jthread([this, told = std::move(ready)](const std::stop_token& stop) mutable {
      session.run(stop, told);
    });
    return known.get();
  }

  const HeadsetOptions options;
  SessionThread session;
  std::jthread thread;  // the last: it uses all above
};

Result<std::unique_ptr<Headset>> Headset::create(const HeadsetOptions& options) {
  PENUMBRA_TRY(check_headset_options(options));
  auto impl = std::make_unique<Impl>(options);
  PENUMBRA_TRY(impl->start());
  return std::unique_ptr<Headset>(new Headset(std::move(impl)));
}

Headset::Headset(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Headset::~Headset() = default;

void Headset::show(int eye, EyePicture picture) {
  impl_->session.show(eye, std::move(picture));
}

Result<void> Headset::set_picture_distance(double distance_m) {
  PENUMBRA_TRY(check_distance(impl_->options, distance_m));
  impl_->session.set_distance(distance_m);
  return {};
}

Result<void> Headset::set_floor_height(std::optional<double> height_m) {
  PENUMBRA_TRY(check_floor(height_m));
  impl_->session.set_floor(height_m);
  return {};
}

std::optional<HeadPose> Headset::head_at(TimestampNs time) const {
  return impl_->session.device_at(SessionThread::kHead, time);
}

std::optional<HeadPose> Headset::controller_at(Hand hand, TimestampNs time) const {
  return impl_->session.device_at(hand == Hand::kLeft ? 0 : 1, time);
}

HeadsetState Headset::state() const {
  return impl_->session.state();
}

}  // namespace penumbra::service
