// What sources that are saturated in every exposure really send, read off a real floor of known
// albedo in the view camera's picture.
// threads: thread-bound
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "lighting/light_estimate.h"
#include "lighting/saturation_recovery.h"
#include "prt/geometry/plane.h"
#include "prt/geometry/rays.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

class FloorRecovery {
 public:
  /// Around each object the floor counts for so far.
  static constexpr double kNear_m = 1.5;
  /// A measurement is repeated after this time and passed on when it differs by kMinChange.
  static constexpr Seconds kAgain{1};
  static constexpr float kMinChange = .03f;

  /// Idle in a scene without a plane of known albedo that an object stands on. The scene must
  /// outlive it.
  /// errors: kUnavailable (Embree)
  static Result<FloorRecovery> create(const PreparedScene& scene);

  /// in:  a view frame of `camera`, its light on the scale of the environment camera's; curve as
  /// compositor::View
  /// out: completions of the light's clipped lights; empty when there is nothing (new) to say
  /// errors: as recover_jointly; kUndetermined when too little of the floor is in view or it is
  /// overexposed
  /// source: Debevec, Graham, Busch & Bolas 2012 with the floor as the known reflector
  Result<std::vector<lighting::SaturationRecovery>> observe(const capture::Frame& frame,
                                                            const capture::CameraInfo& camera,
                                                            const ResponseTable* curve,
                                                            const lighting::LightEstimate& light);

 private:
  std::optional<lighting::ReflectancePatch> measure(const capture::Frame& frame,
                                                    const capture::CameraInfo& camera,
                                                    const ResponseTable* curve,
                                                    std::span<const glm::dvec3> towards) const;
  bool is_seen_and_lit(const glm::dvec3& eye, const glm::dvec3& direction, double distance,
                       std::span<const glm::dvec3> towards) const;
  bool is_near_an_object(const glm::dvec3& point) const;
  bool is_news(const std::vector<lighting::SaturationRecovery>& found) const;

  const PreparedScene* scene_ = nullptr;
  const prt::Plane* floor_ = nullptr;
  std::optional<prt::RayScene> real_;  // may stand before the floor, or before a light
  std::optional<TimestampNs> last_;
  std::vector<int> tried_;  // lights of the last attempt
  std::vector<lighting::SaturationRecovery> said_;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
