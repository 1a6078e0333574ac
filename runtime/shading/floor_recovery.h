// What sources that are saturated in every exposure really send, read off a real floor in the view
// camera's picture: by its albedo, or by the shadow that a known real thing casts on it.
// threads: thread-bound
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "lighting/light_estimate.h"
#include "lighting/saturation_recovery.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"
#include "runtime/direct/open_planes.h"
#include "runtime/scene/scene.h"
#include "runtime/surroundings/floor_irradiance.h"

namespace penumbra::runtime {

class FloorRecovery {
 public:
  /// Around each object the floor counts for so far.
  static constexpr double kNear_m = 1.5;
  /// A measurement is repeated after this time and passed on when it differs by kMinChange.
  static constexpr Seconds kInterval{1};
  static constexpr float kMinChange = .03f;

  /// A given albedo is believed while a known thing's shadow does not contradict it by this factor.
  static constexpr float kAlbedoFactor = 1.6f, kAgreeingFactor = 1.4f;

  /// Idle in a scene without a plane that an object stands on, and where neither the plane's albedo
  /// nor a real mesh is known. The scene must outlive it.
  /// errors: kUnavailable (Embree)
  static Result<FloorRecovery> create(const PreparedScene& scene);
  bool idle() const { return floor_ == nullptr; }

  /// in:  a view frame of `camera`, its light on the scale of the environment camera's; curve as
  /// compositor::View
  /// out: recoveries of the light's clipped lights; empty when there is nothing (new) to say
  /// errors: as recover_from_shadows; kUndetermined when too little of the floor is in view or it
  /// is overexposed, or its albedo is unknown and no known thing's shadow is in view
  /// A frame taken for light counts at once, others once kInterval.
  /// source: Debevec, Graham, Busch & Bolas 2012 with the floor as the known reflector
  Result<std::vector<lighting::SaturationRecovery>> observe(const capture::Frame& frame,
                                                            const capture::CameraInfo& camera,
                                                            const ResponseTable* curve,
                                                            const lighting::LightEstimate& light);

  /// Enough of the floor was in view at the last attempt, and most of it overexposed: a darker
  /// frame would tell.
  bool overexposed() const { return overexposed_; }
  /// The last frame was measured; others are passed over for some time.
  bool looked() const { return looked_; }

 private:
  // The floor in the picture, what is in a known thing's shadow apart.
  struct SeenFloor;
  SeenFloor measure(const capture::Frame& frame, const capture::CameraInfo& camera,
                    const ResponseTable* curve,
                    std::span<const lighting::DistantLight* const> clipped) const;
  void take_in(const FloorIrradianceParts& light, std::uint32_t hidden,
               std::span<const lighting::DistantLight* const> clipped,
               lighting::ShadowRegion& region) const;
  // The lit floor first, then what lies in shadows of known things.
  std::vector<lighting::ShadowRegion> regions_of(
      SeenFloor& floor, const Rgb& lit, const lighting::LightEstimate& light,
      std::span<const lighting::DistantLight* const> clipped) const;
  Result<std::vector<lighting::SaturationRecovery>> recover(
      SeenFloor floor, const lighting::LightEstimate& light,
      std::span<const lighting::DistantLight* const> clipped, const std::string& camera);
  bool contradicts_albedo(float measured, const std::string& camera);
  bool is_near_an_object(const glm::dvec3& point) const;
  bool differs_from_said(const std::vector<lighting::SaturationRecovery>& found,
                         const lighting::LightEstimate& light) const;

  const PreparedScene* scene_ = nullptr;
  const prt::Plane* floor_ = nullptr;
  std::optional<OpenPlanes> planes_;   // where there is a floor
  std::optional<prt::RayScene> real_;  // may stand before the floor, or before a light
  std::optional<TimestampNs> last_;
  std::vector<int> tried_;  // lights of the last attempt
  std::vector<lighting::SaturationRecovery> said_;
  bool overexposed_ = false, by_shadow_ = false, looked_ = false;  // last time
  bool warned_ = false;                                            // of the albedo
};

}  // namespace penumbra::runtime
