#include "runtime/scene/internal/standing.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <limits>
#include <memory>
#include <utility>

#include "prt/geometry/receiver.h"
#include "runtime/scene/animated.h"

namespace penumbra::runtime {

namespace {

// Rotations and heights that differ by rounding alone are one bake.
double rounded(double value, double step) {
  return std::round(value / step) * step;
}

// The turn that leans the mesh as it stands, without the turn about the plane's normal.
glm::dquat tilt_of(const glm::dquat& rotation, const glm::dvec3& normal) {
  constexpr double kStep = 1e-9;
  const glm::dvec3 exact = glm::conjugate(rotation) * normal;
  const glm::dvec3 own_up = glm::normalize(
      glm::dvec3(rounded(exact.x, kStep), rounded(exact.y, kStep), rounded(exact.z, kStep)));
  if (own_up.y > 1 - 1e-12) return {1, 0, 0, 0};
  return glm::rotation(own_up, glm::dvec3(0, 1, 0));
}

glm::dquat turn_about_y(const glm::dquat& rotation) {
  return glm::normalize(glm::dquat(rotation.w, 0, rotation.y, 0));
}

double lowest(const prt::Mesh& mesh, const glm::dquat& tilt) {
  double low = std::numeric_limits<double>::infinity();
  for (const glm::vec3& p : mesh.positions) low = std::min(low, (tilt * glm::dvec3(p)).y);
  return low;
}

}  // namespace

Standing standing_of(const Placement& p, const prt::Mesh& mesh, const prt::Plane* plane) {
  constexpr double kStep = 1e-4;  // of the radius: less lifts nothing
  const glm::dvec3 normal = plane ? plane->normal : glm::dvec3(0, 1, 0);
  const glm::dmat4 world = world_from_mesh(p, mesh, normal);
  Standing out;
  out.scale = glm::length(glm::dvec3(world[0]));
  out.tilt = tilt_of(p.rotation, normal);
  const Pose frame = plane ? frame_on_plane(*plane, p.position) : Pose{{1, 0, 0, 0}, p.position};
  const glm::dquat turn =
      turn_about_y(glm::conjugate(frame.rotation) * p.rotation * glm::conjugate(out.tilt));
  out.world_from_bake = {frame.rotation * turn, frame.translation};
  out.shift = (out.world_from_bake.inverse() * glm::dvec3(world[3])) / out.scale;
  if (!plane) return out;
  const double low = lowest(mesh, out.tilt), radius = prt::radius_of(mesh);
  const bool stands = std::abs(-out.shift.y - low) < kStep * radius;
  const double height = stands ? low : rounded(-out.shift.y, kStep * std::max(radius, 1e-30));
  out.height = static_cast<float>(height);
  out.shift.y = -height;
  return out;
}

float standing_height(std::vector<float> lows, float height) {
  constexpr float kSame = .01f;  // of the height
  std::ranges::sort(lows);
  const auto shared = static_cast<std::ptrdiff_t>((lows.size() + 3) / 4);
  for (auto low = lows.begin(); low != lows.end(); ++low)
    if (std::upper_bound(low, lows.end(), *low + kSame * height) - low >= shared) return *low;
  return lows.front();
}

void put_in_place(prt::BakedObject& baked, double scale, const glm::dvec3& shift) {
  glm::dmat4 place{glm::dmat3(scale)};
  place[3] = glm::dvec4(scale * shift, 1);
  prt::transform(baked.mesh, place);
  if (baked.fine) {
    auto fine = std::make_shared<prt::FineForm>(*baked.fine);
    prt::transform(fine->mesh, place);
    baked.fine = std::move(fine);
  }
  if (!baked.receiver) return;
  prt::GroundGrid& grid = baked.receiver->grid;
  const auto k = static_cast<float>(scale);
  grid.centre = k * (grid.centre + glm::vec2(shift.x, shift.z));
  grid.half_extent *= k;
  grid.height = 0;
}

}  // namespace penumbra::runtime
