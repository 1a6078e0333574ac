#include "runtime/surroundings/ground_probes.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/threads/parallel.h"
#include "prt/geometry/receiver.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

GroundProbes::GroundProbes(const PreparedScene& scene)
    : scene_(&scene), objects_(scene.objects.size()) {}

void GroundProbes::update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
                          std::span<const Pose> floors, bool other_form) {
  floors_.assign(floors.begin(), floors.end());
  if (!any()) {
    poses_.assign(poses.begin(), poses.end());
    return;
  }
  const std::vector<Pose> before = std::exchange(poses_, {poses.begin(), poses.end()});
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const PreparedObject& object = scene_->objects[i];
    const bool same =
        before.size() == poses.size() && before[i] == poses[i] && !(other_form && object.animation);
    if (!same && object.baked.receiver) look_from(i, occluders);
  }
}

void GroundProbes::look_once(std::size_t object, const shadows::RayOccluders& occluders) {
  if (!any() && !objects_[object].looked) look_from(object, occluders);
}

void GroundProbes::look_from(std::size_t object, const shadows::RayOccluders& occluders) {
  GroundObject& o = objects_[object];
  o.looked = true;
  o.hits.clear();
  parallel_for(0, kSize, [&](int row) { look_from_row(object, row, occluders); });
  for (const std::vector<GroundHit>& row : rows_)
    o.hits.insert(o.hits.end(), row.begin(), row.end());
}

glm::dvec3 GroundProbes::place(std::size_t object, std::size_t point) const {
  const prt::GroundGrid& grid = scene_->objects[object].baked.receiver->grid;
  const glm::vec2 at = grid.position({(static_cast<float>(point % kSize) + .5f) / kSize,
                                      (static_cast<float>(point / kSize) + .5f) / kSize});
  return floors_[object] * glm::dvec3(at.x, grid.height, at.y);
}

void GroundProbes::look_from_row(std::size_t object, int row,
                                 const shadows::RayOccluders& occluders) {
  constexpr int kPacket = prt::RayWorld::kPacket;
  std::vector<GroundHit>& out = rows_[static_cast<std::size_t>(row)];
  out.clear();
  const glm::dvec3 up = floors_[object].rotation * glm::dvec3(0, 1, 0);
  const glm::mat3 frame = prt::frame_around(glm::vec3(up));
  const prt::Mesh& mesh = scene_->objects[object].baked.mesh;
  const glm::quat bake_from_world(glm::conjugate(poses_[object].rotation));
  prt::RayScene::RayPacket directions;
  prt::RayWorld::Rays rays;
  for (int x = 0; x < kSize; ++x) {
    const auto point = static_cast<std::size_t>(row * kSize + x);
    const glm::vec3 from(place(object, point) + double(occluders.near_m) * up);
    std::fill_n(rays.ox, kPacket, from.x);
    std::fill_n(rays.oy, kPacket, from.y);
    std::fill_n(rays.oz, kPacket, from.z);
    int behind = 0;  // rays that meet the back of a real thing
    for (int block = 0; block < kRays / kPacket; ++block) {
      patterns_.cosine_block(prt::RayPatterns::turn_of(point), block, frame, directions);
      std::copy_n(directions.x, kPacket, rays.dx);
      std::copy_n(directions.y, kPacket, rays.dy);
      std::copy_n(directions.z, kPacket, rays.dz);
      prt::RayWorld::Hits own, real;
      occluders.virtual_things->intersect(static_cast<int>(object), rays, own);
      if (!scene_->real_mesh.triangles.empty()) occluders.real_things->intersect(0, rays, real);
      for (int i = 0; i < kPacket; ++i) {
        GroundHit hit;
        hit.point = static_cast<std::uint16_t>(point);
        hit.bake_blocks = hit.object_first = own.mesh[i] >= 0;
        hit.direction = {rays.dx[i], rays.dy[i], rays.dz[i]};
        if (hit.bake_blocks) {
          hit.vertex = prt::nearest_corner(mesh, own.triangle[i], own.u[i], own.v[i]);
          hit.inside = glm::dot(bake_from_world * hit.direction, mesh.normals[hit.vertex]) > 0;
        }
        if (const auto met =
                meet_real(scene_->planes, scene_->real_mesh, rays, real, i, RealPoint::kMesh)) {
          hit.real = true;
          hit.at = met->point;
          hit.object_first = hit.bake_blocks && own.distance[i] < met->distance;
          behind += met->point.back;
        }
        if (hit.bake_blocks || hit.real) out.push_back(hit);
      }
    }
    objects_[object].open[point] = behind < kRays / 4;
  }
}

void GroundProbes::spread(std::size_t object, std::span<const Rgb, kPoints> of_points, int size,
                          std::span<float> out) const {
  const std::size_t stride = out.size() / 3;
  const auto in_points = [size](int texel) {
    return (static_cast<float>(texel) + .5f) * kSize / static_cast<float>(size) - .5f;
  };
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float fx = in_points(x), fy = in_points(y);
      const int i = static_cast<int>(std::floor(fx)), j = static_cast<int>(std::floor(fy));
      const float u = fx - static_cast<float>(i), v = fy - static_cast<float>(j);
      Rgb sum;
      float weight = 0;
      for (int k = 0; k < 4; ++k) {
        const auto point = static_cast<std::size_t>(std::clamp(j + k / 2, 0, kSize - 1) * kSize +
                                                    std::clamp(i + k % 2, 0, kSize - 1));
        if (!objects_[object].open[point]) continue;
        const float w = (k / 2 ? v : 1 - v) * (k % 2 ? u : 1 - u);
        sum += of_points[point] * w;
        weight += w;
      }
      if (weight <= 0) continue;
      const auto texel = static_cast<std::size_t>(y * size + x);
      for (std::size_t c = 0; c < 3; ++c)
        out[c * stride + texel] += sum[static_cast<int>(c)] / weight;
    }
}

}  // namespace penumbra::runtime
