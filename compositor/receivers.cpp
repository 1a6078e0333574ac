#include "compositor/receivers.h"

#include <algorithm>

namespace penumbra::compositor {

int Receivers::add(const prt::GroundGrid& grid) {
  receivers_.push_back({grid, {}, {}, {}, {}, false});
  return static_cast<int>(receivers_.size()) - 1;
}

void Receivers::set_pose(int receiver, const Pose& world_from_bake) {
  receivers_[static_cast<std::size_t>(receiver)].world_from_bake = world_from_bake;
}

void Receivers::set_shadow(int receiver, const shadows::PlanarShadow& shadow) {
  Receiver& r = receivers_[static_cast<std::size_t>(receiver)];
  r.visible = !shadow.empty();
  if (!r.visible) return;
  r.ratio = shadow.ratio;
  // One texel more on each side: bilinear reads reach half a texel out.
  const auto at = [&](int x, int y) {
    const auto size = static_cast<float>(r.grid.size);
    return glm::dvec2(r.grid.position({static_cast<float>(std::clamp(x, 0, r.grid.size)) / size,
                                       static_cast<float>(std::clamp(y, 0, r.grid.size)) / size}));
  };
  r.low = at(shadow.x0 - 1, shadow.y0 - 1);
  r.high = at(shadow.x1 + 1, shadow.y1 + 1);
}

namespace {

// Ray through pixel (px, py): d = R (a px + b, c py + e, -1) in the bake frame, all linear in the
// pixel. It meets the plane y = height at o + d (height - o.y)/d.y, hence x = (o.x d.y + (height -
// o.y) d.x)/d.y.
void set_homography(const prt::PinholeView& v, const Pose& bake_from_camera,
                    const prt::GroundGrid& g, PlaneLookup& out) {
  const glm::dmat3 r = bake_from_camera.rotation_matrix();
  const glm::dvec3 o = bake_from_camera.translation;
  const glm::dvec3 ray[3] = {
      r[0] / v.focal_px.x, r[1] * (-1 / v.focal_px.y),
      -r[0] * (v.principal_px.x / v.focal_px.x) + r[1] * (v.principal_px.y / v.focal_px.y) - r[2]};
  const double drop = g.height - o.y, sign = drop < 0 ? -1 : 1;
  for (int k = 0; k < 3; ++k) {
    const double w = sign * ray[k].y;  // positive in front of the camera
    out.h[0][k] =
        static_cast<float>(((o.x - g.centre.x) * w + sign * drop * ray[k].x) / g.half_extent);
    out.h[1][k] =
        static_cast<float>(((o.z - g.centre.y) * w + sign * drop * ray[k].z) / g.half_extent);
    out.h[2][k] = static_cast<float>(w);
  }
}

}  // namespace

Rect Receivers::prepare(const prt::PinholeView& view) {
  lookups_.clear();
  Rect all;
  const glm::dmat4 clip_from_world =
      clip_from_camera(view) * view.world_from_camera.inverse().matrix();
  for (const Receiver& r : receivers_) {
    if (!r.visible) continue;
    const double h = r.grid.height;
    const glm::dvec3 corners[4] = {{r.low.x, h, r.low.y},
                                   {r.high.x, h, r.low.y},
                                   {r.low.x, h, r.high.y},
                                   {r.high.x, h, r.high.y}};
    PlaneLookup lookup;
    lookup.area =
        reach(clip_from_world * r.world_from_bake.matrix(), corners, view.width, view.height);
    if (lookup.area.empty()) continue;
    lookup.ratio = &r.ratio.pixels()[0].r;
    lookup.size = r.grid.size;
    set_homography(view, r.world_from_bake.inverse() * view.world_from_camera, r.grid, lookup);
    lookups_.push_back(lookup);
    all = united(all, lookup.area);
  }
  return all;
}

bool Receivers::multiply_row(int y, const Rect& area, float* r, float* g, float* b) const {
  bool any = false;
  for (const PlaneLookup& plane : lookups_) {
    if (y < plane.area.y0 || y >= plane.area.y1) continue;
    const int skip = plane.area.x0 - area.x0;
    multiply_plane_ratios(plane, y, plane.area.x0, plane.area.x1, r + skip, g + skip, b + skip);
    any = true;
  }
  return any;
}

}  // namespace penumbra::compositor
