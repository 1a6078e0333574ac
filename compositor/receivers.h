// Shadow ratios on receiving planes, evaluated pixel by pixel on the CPU: a plane seen by a pinhole
// is one homography, so a row costs a division, a lookup and no drawing. Without a GPU this takes a
// fifth of the time of a textured quad; with one it takes the same.
#pragma once

#include <span>
#include <vector>

#include "compositor/projection.h"
#include "core/pose.h"
#include "shadows/shadows.h"

namespace penumbra::compositor {

/// The homography of one plane and its ratios, as the kernel wants them.
struct PlaneLookup {
  // Homogeneous plane position in half extents from the centre: (x, z, w) = h * (px, py, 1), w > 0
  // in front.
  float h[3][3];
  const float* ratio;  // RGB, size x size
  int size;
  Rect area;  // pixels that the visible part can reach
};

class Receivers {
 public:
  int add(const prt::GroundGrid& grid);
  void set_pose(int receiver, const Pose& world_from_bake);
  void set_shadow(int receiver, const shadows::PlanarShadow& shadow);

  /// Prepares for one view; returns the pixels that any shadow can reach.
  Rect prepare(const prt::PinholeView& view);
  /// Multiplies the ratios of row y, pixels [area.x0, area.x1) of prepare()'s rectangle, into r, g,
  /// b, which hold 1 on entry. False when no shadow reaches the row.
  bool multiply_row(int y, const Rect& area, float* r, float* g, float* b) const;

 private:
  struct Receiver {
    prt::GroundGrid grid;
    Pose world_from_bake;
    Image<Rgb> ratio;
    glm::dvec2 low{0, 0}, high{0, 0};  // visible part, metres
    bool visible = false;
  };
  std::vector<Receiver> receivers_;
  std::vector<PlaneLookup> lookups_;
};

/// Multiplies ratios of pixels [x0, x1) of row y into r[0 .. x1-x0) and so on.
void multiply_plane_ratios(const PlaneLookup& plane, int y, int x0, int x1, float* r, float* g,
                           float* b);

}  // namespace penumbra::compositor
