#include "service/headset/internal/eye_mailbox.h"

#include <fmt/format.h>

#include <cmath>
#include <utility>
#include <variant>

namespace penumbra::service {

namespace {

// Cameras that one signal starts tell times that differ by less.
constexpr std::int64_t kOneTime_ns = 1'000'000;

bool finite(const glm::dvec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

}  // namespace

Result<void> check_picture(int eye, const EyePicture& picture) {
  const std::string where =
      eye < 0 ? "headset: the picture"
              : fmt::format("headset: the {} picture", eye == 0 ? "left" : "right");
  if (eye < -1 || eye > 1) return fail(ErrorCode::kInvalid, "headset", "has no such eye");
  if (!picture.pixels) return fail(ErrorCode::kInvalid, where, "has no pixels");
  const auto [width, height] = std::visit(
      [](const auto& image) { return std::pair(image.width(), image.height()); }, *picture.pixels);
  const calib::CameraModel& camera = picture.camera;
  if (width < 1 || width != camera.width || height != camera.height)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("has {}x{} pixels, but its camera has {}x{}", width, height,
                            camera.width, camera.height));
  const glm::dquat& q = picture.world_from_camera.rotation;
  if (!finite(picture.world_from_camera.translation) || !std::isfinite(glm::dot(q, q)))
    return fail(ErrorCode::kNonFinite, where, "has a pose that is not finite");
  if (!(std::abs(glm::dot(q, q) - 1) < 1e-3))
    return fail(ErrorCode::kInvalid, where, "has a rotation that is not of unit length");
  if (calib::has_intrinsics(camera.kind)) {
    const double focal = camera.focal_px.x * camera.focal_px.y;
    if (!(focal > 0) || !std::isfinite(focal + camera.principal_px.x + camera.principal_px.y))
      return fail(ErrorCode::kInvalid, where, "has a camera without focal lengths");
  }
  return {};
}

void EyeMailbox::make_ready(EyePicture left, EyePicture right) {
  if (ready_) ++counts_.overtaken;
  ready_.emplace(EyePair{std::move(left), std::move(right)});
}

void EyeMailbox::put(int eye, EyePicture picture) {
  const std::scoped_lock lock(mutex_);
  if (eye < 0) {
    for (auto& one : waiting_) counts_.unmatched += std::exchange(one, std::nullopt).has_value();
    EyePicture other = picture;
    return make_ready(std::move(picture), std::move(other));
  }
  auto& own = waiting_[static_cast<std::size_t>(eye)];
  auto& other = waiting_[static_cast<std::size_t>(1 - eye)];
  counts_.unmatched += own.has_value();
  own = std::move(picture);
  if (!other) return;
  const std::int64_t later_ns = own->captured.value - other->captured.value;
  if (std::abs(later_ns) <= kOneTime_ns) {
    make_ready(std::move(*waiting_[0]), std::move(*waiting_[1]));
    waiting_ = {};
    return;
  }
  // Times rise: the older one's other half does not come any more.
  ++counts_.unmatched;
  (later_ns > 0 ? other : own).reset();
}

std::optional<EyePair> EyeMailbox::take() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(ready_, std::nullopt);
}

EyeMailbox::EyeCounts EyeMailbox::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

}  // namespace penumbra::service
