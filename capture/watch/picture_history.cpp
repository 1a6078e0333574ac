#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "capture/watch/picture_history.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kMaxExposures = 16;
constexpr float kNewFraction = .02f;        // of the mean, once it holds so many frames
constexpr double kSameRotation = 1 - 5e-7;  // cosine of half the angle: within .1 degrees

}  // namespace

std::size_t PictureHistory::usual_of(const Exposure& nominal) {
  const auto same = std::ranges::find_if(usual_, [&](const Usual& u) {
    return u.nominal.time == nominal.time && u.nominal.gain == nominal.gain;
  });
  if (same != usual_.end()) return static_cast<std::size_t>(same - usual_.begin());
  if (usual_.size() >= kMaxExposures)
    usual_.erase(std::ranges::min_element(usual_, {}, &Usual::last));
  usual_.push_back({nominal, numbers_++});
  return usual_.size() - 1;
}

const PictureHistory::Comparison& PictureHistory::compare(const Frame& frame,
                                                          const Exposure& nominal) {
  std::vector<Rgb>& now = comparison_.now;
  meter_.measure(*frame.pixels, kGrid, now);
  const auto scale = static_cast<float>(nominal.product() / frame.exposure.product());
  for (Rgb& cell : now) cell = cell * scale;
  compared_ = usual_of(nominal);
  Usual& usual = usual_[compared_];
  usual.last = ++taken_;
  // From elsewhere every cell shows something else.
  const glm::dquat& rotation = frame.world_from_camera.rotation;
  if (std::abs(glm::dot(usual.rotation, rotation)) < kSameRotation) usual.frames = 0;
  if (usual.signal.size() != now.size()) usual.frames = 0;
  if (usual.frames == 0) usual.rotation = rotation;
  comparison_.exposure = usual.number;
  comparison_.frames = usual.frames;
  comparison_.time = frame.time;
  comparison_.usual = usual.signal;
  return comparison_;
}

void PictureHistory::keep(std::span<const double> row_logs) {
  constexpr auto kColumns = static_cast<std::size_t>(kGrid.columns);
  Usual& usual = usual_[compared_];
  if (usual.frames == 0) usual.signal = comparison_.now;
  ++usual.frames;
  const float fraction = std::max(kNewFraction, 1 / static_cast<float>(usual.frames));
  for (std::size_t i = 0; i < comparison_.now.size(); ++i) {
    const auto scale =
        row_logs.empty() ? 1.f : static_cast<float>(std::exp(-row_logs[i / kColumns]));
    const Rgb now = comparison_.now[i] * scale;
    Rgb& mean = usual.signal[i];
    mean = std::isnan(mean.g) || std::isnan(now.g) ? now : mean + (now - mean) * fraction;
  }
}

void PictureHistory::begin_anew() {
  usual_[compared_].frames = 0;
}

void PictureHistory::scale_to_now() {
  Rgb usual, now;
  for (std::size_t i = 0; i < comparison_.now.size(); ++i) {
    if (std::isnan(comparison_.now[i].g) || std::isnan(comparison_.usual[i].g)) continue;
    usual += comparison_.usual[i];
    now += comparison_.now[i];
  }
  if (!(std::min({usual.r, usual.g, usual.b}) > 0)) return;
  const Rgb factor{now.r / usual.r, now.g / usual.g, now.b / usual.b};
  for (Rgb& cell : usual_[compared_].signal) cell = cell * factor;
}

}  // namespace penumbra::capture
