// Whether one sample a pixel does for the objects in view, and the contours that it takes.
#include <algorithm>
#include <glm/gtc/quaternion.hpp>
#include <glm/vector_relational.hpp>

#include "compositor/layers/layers.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"

namespace penumbra::compositor {

namespace {

// Of all triangles in the mean, as they are seen, whatever the light: rougher surfaces need the
// samples.
constexpr double kMinTriangle_px2 = .35;
// What is hidden by a plane may end there without a smooth edge.
constexpr double kMaxHidden_px = .5;

struct OrientedBox {
  glm::dvec3 centre, half;
};
OrientedBox around(const prt::Bounds& bounds, const Pose& world_from_bounds) {
  const glm::dmat3 turn = glm::mat3_cast(world_from_bounds.rotation);
  const glm::dvec3 half = .5 * glm::dvec3(bounds.high - bounds.low);
  return {world_from_bounds * glm::dvec3(bounds.centre()),
          glm::abs(turn[0]) * half.x + glm::abs(turn[1]) * half.y + glm::abs(turn[2]) * half.z};
}

bool meet(const OrientedBox& a, const OrientedBox& b) {
  return glm::all(glm::lessThan(glm::abs(a.centre - b.centre), a.half + b.half));
}

}  // namespace

// From the eye to the nearest point of the object's box, metres; 0 within.
double Layers::distance_to_box(const DrawnObject& o, const glm::dvec3& eye) {
  const glm::dvec3 there = o.world_from_bake.inverse() * eye;
  return glm::distance(there,
                       glm::clamp(there, glm::dvec3(o.bounds.low), glm::dvec3(o.bounds.high)));
}

// The black back of a closed surface shows only from within.
bool Layers::fronts_only(const DrawnObject& o, const glm::dvec3& eye) {
  return o.closed && distance_to_box(o, eye) > kNearPlane;
}

bool Layers::in_view(const DrawnObject& o, const ViewProjection& from_world) {
  return !reach_of(o, from_world).empty();
}

// Seen from behind a plane hides nothing, as in Receivers.
double Layers::hidden_m(const DrawnPlane& plane, const DrawnObject& o, const glm::dvec3& eye) {
  if (glm::dot(plane.normal, eye - plane.point) <= 0) return 0;
  const OrientedBox box = around(o.bounds, o.world_from_bake);
  const glm::dvec3 n = glm::inverse(o.world_from_bake.rotation) * plane.normal;
  const double reach = glm::dot(glm::abs(n), .5 * glm::dvec3(o.bounds.high - o.bounds.low));
  return reach - glm::dot(plane.normal, box.centre - plane.point);
}

// All edges in the picture are an object's own.
bool Layers::one_sample_does(const prt::PinholeView& camera,
                             const ViewProjection& from_world) const {
  if (fine_ || !occluders_.empty()) return false;
  for (auto o = objects_.begin(); o != objects_.end(); ++o) {
    if (!in_view(*o, from_world)) continue;
    if (!one_sample_does(*o, camera)) return false;
    const OrientedBox box = around(o->bounds, o->world_from_bake);
    if (std::any_of(objects_.begin(), o, [&](const DrawnObject& other) {
          return in_view(other, from_world) &&
                 meet(box, around(other.bounds, other.world_from_bake));
        }))
      return false;
  }
  return true;
}

bool Layers::one_sample_does(const DrawnObject& o, const prt::PinholeView& camera) const {
  if (!o.contour || !o.contour->serves()) return false;
  const glm::dvec3& eye = camera.world_from_camera.translation;
  const double px_per_metre =
      camera.focal_px.x / glm::distance(eye, o.world_from_bake * glm::dvec3(o.bounds.centre()));
  // Half of them face the other way, and what is seen of a closed form is a quarter of its surface.
  const double triangle_m2 = .5 * o.area_m2 / static_cast<double>(o.triangles.size());
  if (triangle_m2 * px_per_metre * px_per_metre < kMinTriangle_px2) return false;
  const double max_px_per_metre = camera.focal_px.x / std::max(distance_to_box(o, eye), kNearPlane);
  return std::ranges::all_of(planes_, [&](const DrawnPlane& p) {
    return hidden_m(p, o, eye) * max_px_per_metre < kMaxHidden_px;
  });
}

// Of the objects that reach into a region. And the triangles that can be seen: half of them, which
// is half of what their vertices cost. False where an object reaches behind the camera.
bool Layers::find_contours(const View& view, const ViewProjection& from_world, const Rect& region) {
  lines_.clear();
  glBindVertexArray(0);
  if (contours_from_ != view.camera || contours_through_ != view.lens.get())
    for (DrawnObject& o : objects_) o.contour_known = false;
  contours_from_ = view.camera;
  contours_through_ = view.lens.get();
  for (DrawnObject& o : objects_) {
    if (!meet(reach_of(o, from_world), region)) continue;
    if (!o.contour_known && !find_contour(o, from_world)) return false;
    lines_.insert(lines_.end(), o.lines.begin(), o.lines.end());
  }
  return true;
}

bool Layers::find_contour(DrawnObject& o, const ViewProjection& from_world) {
  o.lines.clear();
  if (!o.contour->find(o.positions, o.triangles,
                       fronts_only(o, contours_from_->world_from_camera.translation),
                       from_world.of(o.world_from_bake), o.lines))
    return false;
  const auto seen = o.contour->seen();
  o.seen_count = static_cast<GLsizei>(seen.size() * 3);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.seen.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(seen.size_bytes()), seen.data(),
               GL_STREAM_DRAW);
  o.contour_known = true;
  return true;
}

}  // namespace penumbra::compositor
