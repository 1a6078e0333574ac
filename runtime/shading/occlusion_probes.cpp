#include "runtime/shading/occlusion_probes.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/conventions.h"
#include "core/parallel.h"
#include "lighting/sh/basis.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/rays.h"

namespace penumbra::runtime {

namespace {

constexpr int kSphereRays = 256;  // of by_real
constexpr int kTries = 4;         // vertices that a direction is tried from until one is open to it
constexpr int kTerms = shadows::kMaxFieldBands * shadows::kMaxFieldBands;
constexpr float kLevelRay = 1e-3f;  // a ray that falls less never meets the floor

// Squared distance of two vertices: a normal turned by 60 degrees is as far as half a radius.
class VertexDistance {
 public:
  explicit VertexDistance(const prt::Mesh& mesh)
      : mesh_(mesh), per_m_(1 / prt::radius_around(mesh, prt::bounds_of(mesh).centre())) {}
  float operator()(std::size_t a, std::size_t b) const {
    const glm::vec3 place = (mesh_.positions[a] - mesh_.positions[b]) * per_m_,
                    turn = mesh_.normals[a] - mesh_.normals[b];
    return glm::dot(place, place) + .25f * glm::dot(turn, turn);
  }

 private:
  const prt::Mesh& mesh_;
  float per_m_;
};

// Each the farthest from those before it.
std::vector<std::uint32_t> choose_probes(const prt::Mesh& mesh) {
  const VertexDistance distance(mesh);
  std::vector<float> nearest(mesh.positions.size(), std::numeric_limits<float>::max());
  std::vector<std::uint32_t> out;
  std::size_t next = 0;
  while (out.size() < std::min<std::size_t>(OcclusionProbes::kProbes, nearest.size())) {
    out.push_back(static_cast<std::uint32_t>(next));
    for (std::size_t v = 0; v < nearest.size(); ++v)
      nearest[v] = std::min(nearest[v], distance(v, next));
    next = static_cast<std::size_t>(std::ranges::max_element(nearest) - nearest.begin());
  }
  return out;
}

// Weights fall to zero at the first probe that does not count.
// source: Franke & Nielson 1980 (modified Shepard interpolation)
template <class Nearby>
Nearby nearest_probes(const VertexDistance& distance, std::span<const std::uint32_t> probes,
                      std::size_t vertex) {
  std::array<std::pair<float, std::uint16_t>, OcclusionProbes::kProbes> all;
  for (std::size_t p = 0; p < probes.size(); ++p)
    all[p] = {std::sqrt(distance(vertex, probes[p])), static_cast<std::uint16_t>(p)};
  const std::size_t count = std::min<std::size_t>(OcclusionProbes::kNearest, probes.size()),
                    sorted = std::min(count + 1, probes.size());
  std::partial_sort(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(sorted),
                    all.begin() + static_cast<std::ptrdiff_t>(probes.size()));
  const float end = sorted > count ? all[count].first : 2 * all[count - 1].first;
  Nearby out{};
  float sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    const float t = end > 0 ? std::max(0.f, 1 - all[k].first / end) : 1;
    out.probe[k] = all[k].second;
    out.weight[k] = t * t + 1e-6f;
    sum += out.weight[k];
  }
  for (float& w : out.weight) w /= sum;
  return out;
}

// Even over the sphere.
glm::dvec3 direction_of(int k) {
  const double y = 1 - (2 * k + 1.) / kSphereRays, s = std::sqrt(1 - y * y),
               a = k * 2.399963229728653;  // golden angle
  return {s * std::cos(a), y, s * std::sin(a)};
}

void set_ray(prt::RayWorld::Rays& rays, int lane, const glm::vec3& from, const glm::vec3& to) {
  rays.ox[lane] = from.x, rays.oy[lane] = from.y, rays.oz[lane] = from.z;
  rays.dx[lane] = to.x, rays.dy[lane] = to.y, rays.dz[lane] = to.z;
}

std::uint32_t nearest_corner(const prt::Mesh& mesh, std::uint32_t triangle, float u, float v) {
  const auto& corners = mesh.triangles[triangle];
  const float w = 1 - u - v;
  return w >= u && w >= v ? corners[0] : u >= v ? corners[1] : corners[2];
}

// What of the sphere around an object real things hide, as rays from all over its surface see it.
// Directions that the object hides from itself do not count: its transfer knows of them.
BlockedSh hidden_by_real(const prt::Mesh& mesh, int own, bool has_floor, const Pose& pose,
                         const shadows::RayOccluders& occluders) {
  BlockedSh out;
  const glm::mat3 turn = pose.rotation_matrix();
  const glm::vec3 shift = pose.translation;
  prt::RayWorld::Rays ray;
  for (int k = 0; k < kSphereRays; ++k) {
    const glm::dvec3 d = direction_of(k);
    if (has_floor && glm::dot(glm::vec3(d), turn[1]) <= -kLevelRay) continue;
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const double place = std::fmod((k * kTries + attempt) * .6180339887498949, 1.);
      const auto v = static_cast<std::size_t>(place * double(mesh.positions.size()));
      const glm::vec3 n = turn * mesh.normals[v];
      if (glm::dot(n, glm::vec3(d)) <= 0) continue;
      set_ray(ray, 0, turn * mesh.positions[v] + shift + occluders.near_m * n, glm::vec3(d));
      if (occluders.virtual_things->occluded_by(own, ray, 1) != 0) continue;
      if (occluders.real_things->occluded_by(0, ray, 1) != 0) {
        double basis[kTerms];
        lighting::evaluate_basis(shadows::kMaxFieldBands, d, basis);
        for (std::size_t i = 0; i < out.blocked.size(); ++i)
          out.blocked[i] += static_cast<float>(4 * kPi / kSphereRays * basis[i]);
        out.fraction += 1.f / kSphereRays;
      }
      break;
    }
  }
  return out;
}

}  // namespace

OcclusionProbes::OcclusionProbes(const PreparedScene& scene)
    : scene_(&scene), objects_(scene.objects.size()) {
  if (!any()) return;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const prt::Mesh& mesh = scene.objects[i].baked.mesh;
    Object& o = objects_[i];
    o.probes = choose_probes(mesh);
    o.nearby.resize(mesh.positions.size());
    o.hits.reserve(kMaxHits);
    const VertexDistance distance(mesh);
    parallel_for(std::size_t{0}, o.nearby.size(), [&](std::size_t v) {
      o.nearby[v] = nearest_probes<Nearby>(distance, o.probes, v);
    });
  }
}

void OcclusionProbes::look(const shadows::RayOccluders& occluders, std::span<const Pose> poses) {
  if (!any() || std::ranges::equal(poses, poses_)) return;
  poses_.assign(poses.begin(), poses.end());
  parallel_for(std::size_t{0}, poses.size(),
               [&](std::size_t i) { look_from(i, occluders, poses[i]); });
}

// What stands around one object, for the rays of its probes.
struct OcclusionProbes::Surroundings {
  const PreparedScene& scene;
  const shadows::RayOccluders& occluders;
  std::size_t object;
  glm::mat3 turn;  // world from bake frame
  glm::vec3 shift;
  std::optional<float> floor_height;  // in the bake frame

  const prt::Mesh& mesh() const { return scene.objects[object].baked.mesh; }
  float above_floor(const glm::vec3& world) const {
    return glm::dot(world - shift, turn[1]) - *floor_height;
  }
};

// Sixteen rays of one origin.
struct OcclusionProbes::Met {
  prt::RayWorld::Rays rays;
  prt::RayWorld::Hits by_itself, by_virtual, by_real;

  void trace(const Surroundings& in) {
    const int own = static_cast<int>(in.object);
    const prt::RayWorld& others = *in.occluders.virtual_things;
    others.intersect(own, rays, by_itself);
    for (int k = 0; k < static_cast<int>(in.scene.objects.size()); ++k)
      if (k != own) others.intersect(k, rays, by_virtual);
    if (!in.scene.real_mesh.triangles.empty())
      in.occluders.real_things->intersect(0, rays, by_real);
  }
};

std::optional<ProbeHit> OcclusionProbes::hit_of(const Met& met, int lane, std::size_t probe,
                                                const Surroundings& in) {
  ProbeHit hit{static_cast<std::uint16_t>(probe),
               ProbeHit::kFloor,
               false,
               0,
               {met.rays.dx[lane], met.rays.dy[lane], met.rays.dz[lane]},
               {}};
  const auto vertex_of = [lane](const prt::RayWorld::Hits& hits, const prt::Mesh& mesh) {
    return nearest_corner(mesh, hits.triangle[lane], hits.u[lane], hits.v[lane]);
  };
  if (met.by_itself.mesh[lane] >= 0) {  // whatever stands in between: that is in no bake
    hit.thing = ProbeHit::kItself;
    hit.vertex = vertex_of(met.by_itself, in.mesh());
    return hit;
  }
  float distance = std::numeric_limits<float>::max();
  const float drop = -glm::dot(hit.direction, in.turn[1]);
  hit.above_floor = in.floor_height && drop > kLevelRay;
  if (hit.above_floor) {
    const glm::vec3 from(met.rays.ox[lane], met.rays.oy[lane], met.rays.oz[lane]);
    distance = std::max(in.above_floor(from), 0.f) / drop;
    hit.point = from + distance * hit.direction;
  }
  if (const int k = met.by_virtual.mesh[lane]; k >= 0 && met.by_virtual.distance[lane] < distance) {
    distance = met.by_virtual.distance[lane];
    hit.thing = static_cast<std::int16_t>(k);
    hit.vertex =
        vertex_of(met.by_virtual, in.scene.objects[static_cast<std::size_t>(k)].baked.mesh);
  }
  if (met.by_real.mesh[lane] >= 0 && met.by_real.distance[lane] < distance) {
    hit.thing = ProbeHit::kReal;
    hit.vertex = vertex_of(met.by_real, in.scene.real_mesh);
  }
  if (hit.thing == ProbeHit::kFloor && !hit.above_floor) return {};  // open sky
  return hit;
}

void OcclusionProbes::look_from(std::size_t index, const shadows::RayOccluders& occluders,
                                const Pose& pose) {
  Object& o = objects_[index];
  const prt::BakedObject& baked = scene_->objects[index].baked;
  Surroundings in{*scene_, occluders, index, pose.rotation_matrix(), pose.translation, {}};
  if (baked.receiver) in.floor_height = baked.receiver->grid.height;
  if (!scene_->real_mesh.triangles.empty())
    o.by_real = hidden_by_real(baked.mesh, static_cast<int>(index), baked.receiver.has_value(),
                               pose, occluders);
  o.hits.clear();
  constexpr int kPacket = prt::RayWorld::kPacket;
  prt::RayScene::RayPacket packet;
  for (std::size_t p = 0; p < o.probes.size(); ++p) {
    const std::uint32_t v = o.probes[p];
    const glm::vec3 n = in.turn * baked.mesh.normals[v],
                    from = in.turn * baked.mesh.positions[v] + in.shift + occluders.near_m * n;
    const glm::mat3 frame = prt::frame_around(n);
    o.hits.push_back({static_cast<std::uint16_t>(p), ProbeHit::kProbe, false, v, n, {}});
    for (int block = 0; block < kRays / kPacket; ++block) {
      patterns_.cosine_block(prt::RayPatterns::turn_of(p), block, frame, packet);
      Met met;
      for (int i = 0; i < kPacket; ++i)
        set_ray(met.rays, i, from, {packet.x[i], packet.y[i], packet.z[i]});
      met.trace(in);
      for (int i = 0; i < kPacket; ++i)
        if (const auto hit = hit_of(met, i, p, in)) o.hits.push_back(*hit);
    }
  }
}

void OcclusionProbes::spread(std::size_t object, std::span<const Rgb> of_probes,
                             std::span<float> out) const {
  const std::vector<Nearby>& nearby = objects_[object].nearby;
  const std::size_t stride = out.size() / 3;
  for (std::size_t v = 0; v < nearby.size(); ++v) {
    Rgb sum;
    for (std::size_t k = 0; k < kNearest; ++k)
      sum += of_probes[nearby[v].probe[k]] * nearby[v].weight[k];
    for (std::size_t c = 0; c < 3; ++c) out[c * stride + v] += sum[static_cast<int>(c)];
  }
}

void OcclusionProbes::take_missing(std::size_t object, const Values& part, const Values& whole,
                                   std::span<const float> in, std::span<float> out) const {
  const std::vector<Nearby>& nearby = objects_[object].nearby;
  const std::size_t stride = out.size() / 3;
  for (std::size_t v = 0; v < nearby.size(); ++v) {
    float left = 0, all = 0;
    for (std::size_t k = 0; k < kNearest; ++k) {
      const std::size_t p = nearby[v].probe[k];
      left += part[p] * nearby[v].weight[k];
      all += whole[p] * nearby[v].weight[k];
    }
    if (all <= 0) continue;
    const float missing = 1 - left / all;
    for (std::size_t c = 0; c < 3; ++c) out[c * stride + v] -= missing * in[c * stride + v];
  }
}

RadianceSh with_occluder_radiance(const RadianceSh& light, const BlockedSh& hidden,
                                  const Rgb& radiance) {
  if (hidden.fraction == 0) return light;
  RadianceSh out = shadows::FieldLight(light, shadows::kMaxFieldBands).seen_through(hidden.blocked);
  for (int n = 0; n < out.size() && n < kTerms; ++n)
    out[n] += radiance * hidden.blocked[static_cast<std::size_t>(n)];
  return out;
}

}  // namespace penumbra::runtime
