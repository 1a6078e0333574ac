// Hands, people, a cup: real things before which nothing virtual is to be seen, as depth cameras
// and masks tell of them.
// threads: thread-bound
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "capture/frames.h"
#include "compositor/foreground.h"
#include "compositor/view_lens.h"
#include "core/result.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::runtime {

/// What a depth camera sees is in front but for the scene's planes, to 2 % of the distance or
/// 1.5 cm. Where a mask covers the picture something stands before all that is virtual.
class ForegroundStage {
 public:
  /// What is older than this tells nothing of a view frame.
  static constexpr Seconds kOldest{.25};

  /// planes, mesh: real things that the scene knows; the mesh may be empty
  /// errors: kInvalid (a depth camera that sees more than 170 degrees, a mask and several view
  ///         cameras), kUnavailable (Embree)
  static Result<ForegroundStage> create(const std::vector<capture::CameraInfo>& cameras,
                                        std::span<const prt::Plane> planes,
                                        const prt::Mesh& mesh = {});
  ~ForegroundStage();
  ForegroundStage(ForegroundStage&&) noexcept;
  ForegroundStage& operator=(ForegroundStage&&) noexcept;

  /// Whether there is a depth camera or a mask.
  bool any() const;
  /// The newest frame of each counts.
  /// errors: kInvalid (another camera or size, depth that is not of 16 bits, a mask of floats)
  Result<void> add(const capture::Frame& frame);

  /// Takes over the newest frames of another one of the same cameras.
  void go_on_from(const ForegroundStage& before);

  /// The camera of a view frame.
  struct ViewOptics {
    const calib::CameraModel& camera;
    const compositor::ViewLens* lens = nullptr;  // null: a pinhole
    const ResponseTable* curve = nullptr;        // of the frame; null for float frames
    const Vignetting& vignetting;
  };
  /// What stands in front of anything in the spheres in a view frame; null: nothing.
  /// in: a frame of the camera's size
  std::shared_ptr<const compositor::Foreground> in_front_of(
      const capture::Frame& view, const ViewOptics& optics,
      std::span<const shadows::BoundingSphere> spheres);

  /// Whether a depth camera's newest frame is of about that time.
  bool tells_of(TimestampNs time) const;
  /// Counts the frames of depth cameras.
  std::uint64_t depth_frames() const;
  /// The surface of what stands in front, as far as it is within a metre of one of the spheres and
  /// is not the scene's own mesh; of one depth camera, the first that tells of `time`. Without
  /// triangles: nothing.
  prt::Mesh surface_near(std::span<const shadows::BoundingSphere> spheres, TimestampNs time) const;

 private:
  struct Impl;
  explicit ForegroundStage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::runtime
