// Private to capture: the fewest exposures that tell a scene's light, from what the camera sees.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/noise.h"
#include "calib/camera/response_table.h"
#include "capture/device/cameras.h"
#include "capture/frames.h"
#include "capture/hdr/pixel_weights.h"

namespace penumbra::capture {

/// How much of the sphere sends how much light.
struct RadianceBin {
  double brightest;    // radiance of the channel that clips first
  double radiance;     // of green, which is most of the luminance
  double solid_angle;  // relative
  double pixels;
};

/// What an exposure can be.
struct ExposureLimits {
  Seconds shortest{1e-5}, longest{1. / 30};
  Gain max_gain{1};
};

/// A schedule and the errors of an irradiance that it leaves, relative to it. Noise and codes count
/// against the darker half of the sphere: what faces away from the light sees little else.
struct SchedulePlan {
  std::vector<Exposure> exposures;  // longest first
  double noise = 0;                 // two standard deviations
  double clipped = 0;               // light brighter than the shortest exposure can tell
  double codes = 0;                 // of codes too coarse for the dark
  double error() const { return noise + clipped + codes; }
};

class ExposurePlanner {
 public:
  ExposurePlanner(const CameraInfo& camera, int bits);
  /// What a schedule (longest first) leaves of the light's error; light from dark to bright;
  /// `headroom` of the clip level may be used.
  SchedulePlan judge(std::vector<Exposure> exposures, const std::vector<RadianceBin>& light,
                     double headroom = 1) const;
  /// The fewest exposures whose error is at most `budget`; where none are, those with the least.
  /// Times a whole number of half stops from the shortest possible one, so that a similar light
  /// gives the same ones.
  /// source: Hasinoff et al. 2010 (noise); exposures are dropped while the irradiance allows it
  SchedulePlan plan(const std::vector<RadianceBin>& light, const ExposureLimits& limits,
                    double budget) const;
  /// Brightest radiance that an exposure can tell.
  double clip(const Exposure& exposure) const;

 private:
  ResponseTable curve_;
  calib::NoiseModel noise_;
  double black_;
  double clip_signal_;  // of the channel that clips first
};

/// Gathers the light from the frames of a ring: each radiance counts as the longest exposure shows
/// it that it does not clip.
class LightHistogram {
 public:
  explicit LightHistogram(const CameraInfo& camera);
  /// Frames in their order; the newest of each exposure counts, of `max_count` of them.
  void add(const FramePixels& pixels, const Exposure& exposure, std::size_t max_count);
  void clear() { seen_.clear(); }
  /// Whether each of these was seen.
  bool holds(std::span<const Exposure> exposures) const;
  /// Fully saturated radiance is assumed kBeyond times its lower bound.
  std::vector<RadianceBin> light(const ExposurePlanner& planner) const;
  static constexpr double kBeyond = 16;

 private:
  struct CodeLight {
    double solid_angle = 0, green = 0, pixels = 0;
  };
  struct SeenExposure {
    Exposure exposure;
    std::array<CodeLight, 256> code;  // of the brightest channel
  };
  PixelWeights weights_;
  std::array<double, 256> decode_{};  // signal of a code
  std::deque<SeenExposure> seen_;     // oldest first
};

/// A camera's schedule that follows the light: anew as soon as the light's error passes the budget,
/// shorter only after a while.
class AutoSchedule {
 public:
  AutoSchedule(const CameraInfo& camera, double budget)
      : camera_(camera), histogram_(camera), budget_(budget) {}
  /// Before anything was seen: exposures that find out what is there.
  std::vector<Exposure> probe(const ExposureLimits& limits);
  /// After each frame with its applied exposure. True when plan() changed.
  bool see(const FramePixels& pixels, const Exposure& exposure, TimestampNs time);
  const SchedulePlan& plan() const { return plan_; }
  /// What the device makes of the plan; fewer where two become one.
  void use(std::vector<Exposure> exposures) { plan_.exposures = std::move(exposures); }

 private:
  CameraInfo camera_;
  LightHistogram histogram_;
  std::optional<ExposurePlanner> planner_;
  double budget_;
  ExposureLimits limits_;
  SchedulePlan plan_;
  bool probing_ = true;
  double min_error_ = 0;           // that no plan could mend
  std::size_t until_settled_ = 0;  // frames that may still show the last schedule
  TimestampNs planned_;
};

}  // namespace penumbra::capture
