// Hands, people, a cup: real things before which nothing virtual is to be seen, as depth cameras and
// masks tell of them.
// threads: thread-bound
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "compositor/foreground.h"
#include "compositor/view_lens.h"
#include "core/result.h"
#include "prt/geometry/plane.h"

namespace penumbra::runtime {

/// What a depth camera sees is in front but for the scene's planes, to 2 % of the distance or
/// 1.5 cm. Where a mask covers the picture something stands before all that is virtual.
class ForegroundStage {
 public:
  /// What is older than this tells nothing of a view frame.
  static constexpr Seconds kOldest{.25};

  /// errors: kInvalid (a depth camera that sees more than 170 degrees)
  static Result<ForegroundStage> create(const std::vector<capture::CameraInfo>& cameras,
                                        std::span<const prt::Plane> planes);
  ~ForegroundStage();
  ForegroundStage(ForegroundStage&&) noexcept;
  ForegroundStage& operator=(ForegroundStage&&) noexcept;

  /// Whether there is a depth camera or a mask.
  bool any() const;
  /// The newest frame of each counts.
  /// errors: kInvalid (another camera, another size, depth that is not of 16 bits, a mask of floats)
  Result<void> add(const capture::Frame& frame);

  /// What stands in front in a view frame; null: nothing.
  /// curve: of the frame; null for float frames
  std::shared_ptr<const compositor::Foreground> in_front_of(const capture::Frame& view,
                                                            const calib::CameraModel& camera,
                                                            const compositor::ViewLens* lens,
                                                            const ResponseTable* curve);

 private:
  struct Impl;
  explicit ForegroundStage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::runtime
