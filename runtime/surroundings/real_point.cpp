#include "runtime/surroundings/real_point.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra::runtime {

namespace {
constexpr double kAligned = .99999;
}  // namespace

float meet_planes(std::span<const prt::Plane> planes, const glm::vec3& from,
                  const glm::vec3& direction, int except, RealPoint& met) {
  float distance = std::numeric_limits<float>::max();
  for (int p = 0; p < static_cast<int>(planes.size()); ++p) {
    const prt::Plane& plane = planes[static_cast<std::size_t>(p)];
    const glm::vec3 normal(plane.normal);
    const float drop = -glm::dot(direction, normal),
                height = glm::dot(from - glm::vec3(plane.point), normal);
    if (p == except || drop <= kLevelRay || height < -kLevelRay || height > distance * drop)
      continue;
    distance = std::max(height, 0.f) / drop;
    met.plane = static_cast<std::int16_t>(p);
  }
  if (met.plane != RealPoint::kMesh) met.on_plane = from + distance * direction;
  return distance;
}

std::optional<MetReal> meet_real(std::span<const prt::Plane> planes, const prt::Mesh& mesh,
                                 const prt::RayWorld::Rays& rays,
                                 const prt::RayWorld::Hits& by_mesh, int lane, int except) {
  const glm::vec3 direction(rays.dx[lane], rays.dy[lane], rays.dz[lane]);
  MetReal out{};
  out.distance = meet_planes(planes, {rays.ox[lane], rays.oy[lane], rays.oz[lane]}, direction,
                             except, out.point);
  if (by_mesh.mesh[lane] >= 0 && by_mesh.distance[lane] < out.distance) {
    const std::uint32_t vertex =
        prt::nearest_corner(mesh, by_mesh.triangle[lane], by_mesh.u[lane], by_mesh.v[lane]);
    out.point = {RealPoint::kMesh, glm::dot(mesh.normals[vertex], direction) > 0, vertex, {}};
    out.distance = by_mesh.distance[lane];
  } else if (out.point.plane == RealPoint::kMesh) {
    return {};
  }
  return out;
}

int plane_at(std::span<const prt::Plane> planes, const glm::dvec3& foot, const glm::dvec3& up) {
  const auto at = std::ranges::find_if(planes, [&](const prt::Plane& p) {
    return glm::dot(p.normal, up) > kAligned &&
           std::abs(glm::dot(foot - p.point, p.normal)) < kOnPlane_m;
  });
  return at == planes.end() ? RealPoint::kMesh : static_cast<int>(at - planes.begin());
}

}  // namespace penumbra::runtime
