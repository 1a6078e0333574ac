#include "shadows/visibility/internal/soft_shadow_volume.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/silhouette_mesh.h"

namespace penumbra::shadows {

namespace {

// Seen from the place: what is at its height or lower is thrown away from the light, and cut off a
// little above.
glm::vec2 seen(const glm::vec3& end, const glm::vec3& other) {
  constexpr float kMin = 1e-3f;  // of the other end's height
  const float smallest = kMin * other.y;
  const glm::vec3 p =
      end.y >= smallest ? end : glm::mix(other, end, (other.y - smallest) / (other.y - end.y));
  return glm::vec2(p.x, p.z) / p.y;
}

}  // namespace

SoftShadowVolume::SoftShadowVolume(const SilhouetteGrid& silhouettes, const LightGrid& grid,
                                   std::span<const CasterFrame> caster_frames,
                                   const SampleSet& samples)
    : silhouettes_(silhouettes), caster_frames_(caster_frames) {
  assert(samples.directions.size() <= kMaxSamples);
  const glm::mat3 turn(grid.grid_from_world.rotation_matrix());
  samples_.count = samples.directions.size();
  for (std::size_t k = 0; k < samples_.count; ++k) {
    const glm::vec3& sample = samples.directions[k];
    samples_.towards_x[k] = sample.x, samples_.towards_y[k] = sample.y,
    samples_.towards_z[k] = sample.z;
    samples_.counted[k] = (samples.counted >> k & 1) != 0 ? 1 : 0;
    const glm::vec3 d = turn * sample;
    samples_.x[k] = d.x / (d.y * grid.cell_m), samples_.z[k] = d.z / (d.y * grid.cell_m);
    reach_ = std::max({reach_, std::abs(samples_.x[k]), std::abs(samples_.z[k])});
  }
  // What is right above a place in a scene of right angles goes through the middle, and through
  // samples beside it.
  middle_ = reach_ * glm::vec2(.0371f, .0237f);
  for (std::size_t k = 0; k < samples_.count; ++k)
    samples_.x[k] -= middle_.x, samples_.z[k] -= middle_.y;
}

void SoftShadowVolume::add(const SilhouetteLine& line, const glm::vec3& place) {
  const glm::vec3 a = line.from - place, b = line.to - place;
  if (std::max(a.y, b.y) <= 0) return;
  const glm::vec2 from = seen(a, b) - middle_, to = seen(b, a) - middle_, low = glm::min(from, to),
                  high = glm::max(from, to);
  const float largest = 1.05f * reach_;
  if (std::max(low.x, low.y) > largest || std::min(high.x, high.y) < -largest) return;
  const CasterFrame& caster_frame = caster_frames_[line.caster_frame];
  const SilhouetteMesh::Edge& edge = caster_frame.silhouette->edges()[line.edge];
  const auto faces = [&](std::uint32_t triangle) {
    const SilhouetteMesh::Normals& n = caster_frame.silhouette->normals();
    const glm::vec3 normal(n.x[triangle], n.y[triangle], n.z[triangle]);
    return glm::dot(caster_frame.turn_normals * normal, a) > 0;
  };
  const bool left = faces(edge.left), open = edge.right == SilhouetteMesh::kOpen;
  if (!open && faces(edge.right) == left) return;
  // The left triangle lies on the side of negative areas where it faces the light.
  add_layers({from, to, (open ? 1.f : 2.f) * (left ? -1.f : 1.f)}, samples_);
}

SoftShadowVolume::Answer SoftShadowVolume::find(const glm::vec3& place, const glm::vec3& lift,
                                                const glm::vec3& normal) {
  begin_place(normal, samples_);
  silhouettes_.each_over(place, [&](const SilhouetteLine& line) { add(line, place + lift); });
  const FewestLayers fewest = fewest_layers(samples_);
  const float fraction = 1 / static_cast<float>(samples_.count);
  return {fraction * fewest.open, fraction * fewest.seen, fewest.ask};
}

}  // namespace penumbra::shadows
