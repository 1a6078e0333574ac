// From the picture of a depth camera, or a mask, to that of a view: which pixels something covers,
// and how far away it is.
// threads: plain values
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "compositor/projection.h"
#include "compositor/view_lens.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "prt/geometry/plane.h"

namespace penumbra::runtime {

/// Where a depth camera's pixels look: (x, y, -1) times the depth is the point in its frame.
struct DepthRays {
  Image<float> x, y;  // not a number where a pixel has no depth
  float focal_px = 0;

  /// errors: kInvalid (it sees more than 170 degrees)
  static Result<DepthRays> create(const calib::CameraModel& camera);
};

/// What covers a view's pixels.
struct Silhouettes {
  static constexpr float kNothing = std::numeric_limits<float>::infinity();
  static constexpr float kMaxBlur_px = 30;

  Image<float> distance_m;  // kNothing where nothing is in front
  Image<float> cover;       // 0..1, of masks, where there is one
  bool has_mask = false, has_depth = false;
  compositor::Rect area;  // of all that is covered
  float blur_px = 0;      // how far an edge may lie off

  void reset(int width, int height);
};

/// What a depth camera sees that is in front of known planes.
struct DepthFront {
  Image<float> depth_m;   // along the camera's axis; 0: nothing
  compositor::Rect area;  // where there is anything
  Pose world_from_camera;
  Image<float> scratch;
};

/// codes: of unit_m each, along the camera's axis; 0: none. A hole gets the depth of what is
/// farther of both sides.
void find_front(const Image<Rgb16>& codes, float unit_m, const DepthRays& rays,
                const Pose& world_from_camera, std::span<const prt::Plane> planes, DepthFront& out);

struct SplatView {
  const calib::CameraModel& camera;
  const compositor::ViewLens* lens;  // null: a pinhole
  Pose world_from_camera;
  float max_distance_m;  // from the eye; what lies beyond hides nothing
};

/// Of one row of depth.
struct SplatRow {
  std::vector<float> x_px, y_px, distance_m;
};

/// Adds what is in front.
void splat_depth(const DepthFront& front, const DepthRays& rays, const SplatView& view,
                 SplatRow& scratch, Silhouettes& out);

/// Adds what a mask of the view's own picture covers, before all else. Of another size it is
/// stretched over it.
template <class Pixel>
void lay_mask(const Image<Pixel>& mask, Silhouettes& out);

}  // namespace penumbra::runtime
