#include "runtime/surroundings/occlusion_probes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

namespace {

constexpr int kSphereRays = OcclusionProbes::kSphereRays;
constexpr int kTries = 4;  // vertices that a direction is tried from until one is open to it
constexpr std::size_t kGrain = 2048;  // vertices

// Squared distance of two vertices: a normal turned by 60 degrees is as far as half a radius.
class VertexDistance {
 public:
  explicit VertexDistance(const prt::Mesh& mesh) : mesh_(mesh), per_m_(1 / prt::radius_of(mesh)) {}
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

// What of the sphere around an object real things hide, as rays from all over its surface see it.
// Directions that the object hides from itself do not count: its transfer knows of them.
class HiddenSphere {
 public:
  // up: of the object's plane
  HiddenSphere(const PreparedScene& scene, std::size_t object, const Pose& pose,
               const glm::vec3& up, const shadows::RayOccluders& occluders, int own_plane)
      : scene_(scene),
        mesh_(scene.objects[object].baked.mesh),
        own_(static_cast<int>(object)),
        own_plane_(own_plane),
        up_(up),
        turn_(pose.rotation_matrix()),
        shift_(pose.translation),
        occluders_(occluders) {}

  void find_real(bool has_floor, std::vector<RealHit>& out) {
    out.clear();
    for (int k = 0; k < kSphereRays; ++k) {
      const glm::vec3 d(direction_of(k));
      if (has_floor && glm::dot(d, up_) <= -kLevelRay) continue;
      const auto from = open_place(k, d);
      if (!from) continue;
      set_ray(rays_, filled_++, *from, d);
      if (filled_ == prt::RayWorld::kPacket) flush(out);
    }
    flush(out);
  }

 private:
  std::optional<glm::vec3> open_place(int k, const glm::vec3& d) const {
    prt::RayWorld::Rays ray;
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const double place = std::fmod((k * kTries + attempt) * .6180339887498949, 1.);
      const auto v = static_cast<std::size_t>(place * double(mesh_.positions.size()));
      const glm::vec3 n = turn_ * mesh_.normals[v];
      if (glm::dot(n, d) <= 0) continue;
      const glm::vec3 from = turn_ * mesh_.positions[v] + shift_ + occluders_.near_m * n;
      set_ray(ray, 0, from, d);
      if (occluders_.virtual_things->occluded_by(own_, ray, 1) == 0) return from;
    }
    return {};
  }
  void flush(std::vector<RealHit>& out) {
    if (filled_ == 0) return;
    prt::RayWorld::Hits met;
    for (int i = filled_; i < prt::RayWorld::kPacket; ++i)
      set_ray(rays_, i, {rays_.ox[0], rays_.oy[0], rays_.oz[0]},
              {rays_.dx[0], rays_.dy[0], rays_.dz[0]});
    if (!scene_.real_mesh.triangles.empty()) occluders_.real_things->intersect(0, rays_, met);
    const int filled = std::exchange(filled_, 0);
    for (int i = 0; i < filled; ++i)
      if (const auto at = meet_real(scene_.planes, scene_.real_mesh, rays_, met, i, own_plane_))
        out.push_back({{rays_.dx[i], rays_.dy[i], rays_.dz[i]}, at->point});
  }

  const PreparedScene& scene_;
  const prt::Mesh& mesh_;
  int own_, own_plane_;
  glm::vec3 up_;
  glm::mat3 turn_;
  glm::vec3 shift_;
  const shadows::RayOccluders& occluders_;
  prt::RayWorld::Rays rays_;
  int filled_ = 0;
};

}  // namespace

OcclusionProbes::OcclusionProbes(const PreparedScene& scene)
    : scene_(&scene), objects_(scene.objects.size()) {
  if (!any()) return;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const prt::Mesh& mesh = scene.objects[i].baked.mesh;
    Object& o = objects_[i];
    o.probes = choose_probes(mesh);
    o.centre = prt::bounds_of(mesh).centre();
    o.radius = prt::radius_around(mesh, o.centre);
    o.blocks.resize((o.probes.size() + kPerBlock - 1) / kPerBlock);
    o.hits.reserve(kMaxHits);
    if (any_real()) o.open.reserve(kProbes * kRays);
    const VertexDistance distance(mesh);
    for (const bool fine : {false, true}) {
      std::vector<Nearby>& nearby = o.nearby_of[fine];
      const std::span<const std::uint32_t> probes = o.used_probes(fine);
      nearby.resize(mesh.positions.size());
      parallel_for(std::size_t{0}, nearby.size(), kGrain, [&](const auto& some) {
        for (std::size_t v = some.begin(); v < some.end(); ++v)
          nearby[v] = nearest_probes<Nearby>(distance, probes, v);
      });
    }
  }
}

void OcclusionProbes::update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
                             std::span<const Pose> floors) {
  if (!any() || objects_.empty()) return;
  floors_.assign(floors.begin(), floors.end());
  const bool still = std::ranges::equal(poses, poses_);
  if (!still) {
    std::swap(poses_, poses_before_);
    poses_.assign(poses.begin(), poses.end());
    still_frames_ = 0;
    const auto moved = [&](std::size_t k) {
      return poses_before_.empty() || poses_before_[k] != poses_[k];
    };
    for (std::size_t i = 0; i < objects_.size(); ++i)
      for (std::size_t k = 0; k < objects_.size(); ++k)
        if (moved(k)) objects_[i].missed += moved(i) ? 1 : swept(i, k, poses_before_[k]);
  }
  constexpr double kAtOnce = .05, kVisible = .01;  // as kVisibleChange of runtime/direct
  // Of those that can wait.
  const auto next = std::ranges::max_element(
      objects_, {}, [](const Object& o) { return o.missed < kAtOnce ? o.missed : 0; });
  const bool any_turn = next->missed < kAtOnce && next->missed > (still ? 0 : kVisible);
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    Object& o = objects_[i];
    if (o.missed < kAtOnce && !(any_turn && &o == &*next)) continue;
    o.missed = 0;
    o.is_fine = false;
    look_from(i, occluders);
  }
}

// How much of what one object sees at most has changed by the way of another, as a fraction of a
// surface's view by the cosine: the area that its outline went over.
double OcclusionProbes::swept(std::size_t index, std::size_t moved, const Pose& before) const {
  constexpr double kForm = .3;  // of its radius, what an outline changes by a radian of turn
  const Object &here = objects_[index], &there = objects_[moved];
  const glm::dvec3 centre(there.centre), from = before * centre, to = poses_[moved] * centre,
                                         at = poses_[index] * glm::dvec3(here.centre);
  const double radius = double(there.radius),
               cosine = std::abs(glm::dot(before.rotation, poses_[moved].rotation)),
               turn = 2 * std::acos(std::min(cosine, 1.)),
               way = std::min(glm::length(to - from) + kForm * radius * turn, 2 * radius),
               distance =
                   std::min(glm::length(from - at), glm::length(to - at)) - double(here.radius) / 2,
               nearest = std::max(distance, radius);
  return 2 * radius * way / (kPi * nearest * nearest);
}

bool OcclusionProbes::refine(const shadows::RayOccluders& occluders, bool at_once) {
  if (still_frames_ < kStillFrames) ++still_frames_;
  if (still_frames_ < kStillFrames && !at_once) return false;
  bool any = false;
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    Object& o = objects_[i];
    if (!o.wants_fine || o.is_fine) continue;
    o.is_fine = true;
    look_from(i, occluders);
    any = true;
  }
  return any;
}

struct OcclusionProbes::Other {
  int object;
  glm::vec3 centre;  // world
  float radius;
};

// What stands around one object, for the rays of its probes.
struct OcclusionProbes::Surroundings {
  const PreparedScene& scene;
  const shadows::RayOccluders& occluders;
  std::size_t object;
  glm::mat3 turn;  // world from bake frame
  glm::vec3 shift;
  std::optional<float> floor_height;   // along `up`
  glm::vec3 up, on_floor;              // of its plane
  std::span<const prt::Plane> planes;  // empty where nothing is real but one
  int own_plane;                       // that is this floor
  std::span<const Other> others;       // that are not this one

  const prt::Mesh& mesh() const { return scene.objects[object].baked.mesh; }
  float above_floor(const glm::vec3& world) const {
    return glm::dot(world - on_floor, up) - *floor_height;
  }
};

// Sixteen rays of one origin.
struct OcclusionProbes::Met {
  prt::RayWorld::Rays rays;
  prt::RayWorld::Hits by_itself, by_virtual, by_real;

  // in: where the rays start, and what way the surface faces there
  void trace(const Surroundings& in, const glm::vec3& from, const glm::vec3& normal) {
    const prt::RayWorld& things = *in.occluders.virtual_things;
    things.intersect(static_cast<int>(in.object), rays, by_itself);
    for (const Other& o : in.others)
      if (glm::dot(o.centre - from, normal) > -o.radius)
        things.intersect(o.object, rays, by_virtual);
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
    return prt::nearest_corner(mesh, hits.triangle[lane], hits.u[lane], hits.v[lane]);
  };
  if (met.by_itself.mesh[lane] >= 0) {  // whatever stands in between: that is in no bake
    hit.thing = ProbeHit::kItself;
    hit.vertex = vertex_of(met.by_itself, in.mesh());
    return hit;
  }
  float distance = std::numeric_limits<float>::max();
  const float drop = -glm::dot(hit.direction, in.up);
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
  if (const auto real =
          meet_real(in.planes, in.scene.real_mesh, met.rays, met.by_real, lane, in.own_plane);
      real && real->distance < distance) {
    hit.thing = ProbeHit::kReal;
    hit.real = real->point;
  }
  if (hit.thing == ProbeHit::kFloor && !hit.above_floor) return {};  // open sky
  return hit;
}

void OcclusionProbes::look_from(std::size_t index, const shadows::RayOccluders& occluders) {
  Object& o = objects_[index];
  const Pose& pose = poses_[index];
  const prt::BakedObject& baked = scene_->objects[index].baked;
  std::vector<Other> others;
  for (std::size_t k = 0; k < objects_.size(); ++k)
    if (k != index)
      others.push_back({static_cast<int>(k), glm::vec3(poses_[k] * glm::dvec3(objects_[k].centre)),
                        objects_[k].radius});
  const auto planes = any_real() ? std::span(scene_->planes) : std::span<const prt::Plane>();
  const Pose& floor = floors_[index];
  const glm::dvec3 up = floor.rotation * glm::dvec3(0, 1, 0);
  Surroundings in{*scene_,
                  occluders,
                  index,
                  pose.rotation_matrix(),
                  pose.translation,
                  {},
                  glm::vec3(up),
                  glm::vec3(floor.translation),
                  planes,
                  RealPoint::kMesh,
                  others};
  if (baked.receiver) {
    in.floor_height = baked.receiver->grid.height;
    in.own_plane = plane_at(scene_->planes, floor * glm::dvec3(0, *in.floor_height, 0), up);
  }
  if (any_real())
    HiddenSphere(*scene_, index, pose, in.up, occluders, in.own_plane)
        .find_real(baked.receiver.has_value(), o.by_real);
  const std::size_t blocks = (o.used_probes(o.is_fine).size() + kPerBlock - 1) / kPerBlock;
  parallel_for(std::size_t{0}, blocks, [&](std::size_t block) { look_from_block(o, block, in); });
  ++o.hits_version;
  o.hits.clear();
  o.parts.clear();
  o.open.clear();
  for (const ProbeBlock& b : std::span(o.blocks).first(blocks)) {
    o.parts.push_back({o.hits.size(), o.hits.size() + b.hits.size(), o.open.size(),
                       o.open.size() + b.open.size()});
    o.hits.insert(o.hits.end(), b.hits.begin(), b.hits.end());
    o.open.insert(o.open.end(), b.open.begin(), b.open.end());
  }
}

void OcclusionProbes::look_from_block(Object& o, std::size_t block, const Surroundings& in) const {
  constexpr int kPacket = prt::RayWorld::kPacket;
  ProbeBlock& out = o.blocks[block];
  out.hits.clear();
  out.open.clear();
  const std::span<const std::uint32_t> probes = o.used_probes(o.is_fine);
  const std::size_t first = block * kPerBlock, last = std::min(first + kPerBlock, probes.size());
  prt::RayScene::RayPacket packet;
  const prt::RayPatterns& patterns = o.is_fine ? fine_patterns_ : patterns_;
  const int packets = (o.is_fine ? kFineRays : kRays) / kPacket;
  for (std::size_t p = first; p < last; ++p) {
    const std::uint32_t v = probes[p];
    const glm::vec3 n = in.turn * in.mesh().normals[v],
                    from = in.turn * in.mesh().positions[v] + in.shift + in.occluders.near_m * n;
    const glm::mat3 frame = prt::frame_around(n);
    out.hits.push_back({static_cast<std::uint16_t>(p), ProbeHit::kProbe, false, v, n, {}});
    for (int block_of_rays = 0; block_of_rays < packets; ++block_of_rays) {
      patterns.cosine_block(prt::RayPatterns::turn_of(p), block_of_rays, frame, packet);
      Met met;
      for (int i = 0; i < kPacket; ++i)
        set_ray(met.rays, i, from, {packet.x[i], packet.y[i], packet.z[i]});
      met.trace(in, from, n);
      for (int i = 0; i < kPacket; ++i) {
        if (const auto hit = hit_of(met, i, p, in))
          out.hits.push_back(*hit);
        else if (!o.by_real.empty())
          out.open.push_back(
              {static_cast<std::uint16_t>(p), {packet.x[i], packet.y[i], packet.z[i]}});
      }
    }
  }
}

void OcclusionProbes::spread(std::size_t object, std::span<const Rgb> of_probes,
                             std::span<float> out) const {
  const std::vector<Nearby>& nearby = objects_[object].nearby();
  const std::size_t stride = out.size() / 3;
  parallel_for(std::size_t{0}, nearby.size(), kGrain, [&](const auto& part) {
    for (std::size_t v = part.begin(); v < part.end(); ++v) {
      const Rgb here = at_vertex(object, of_probes, v);
      for (std::size_t c = 0; c < 3; ++c) out[c * stride + v] += here[static_cast<int>(c)];
    }
  });
}

// What is left of a whole around a vertex, as a fraction.
std::optional<float> OcclusionProbes::left_at(const Nearby& nearby, const Values& part,
                                              const Values& whole) {
  float left = 0, all = 0;
  for (std::size_t k = 0; k < kNearest; ++k) {
    left += part[nearby.probe[k]] * nearby.weight[k];
    all += whole[nearby.probe[k]] * nearby.weight[k];
  }
  if (all <= 0) return {};
  return left / all;
}

void OcclusionProbes::take_missing(std::size_t object, const Values& part, const Values& whole,
                                   std::span<const float> in, std::span<float> out) const {
  const std::vector<Nearby>& nearby = objects_[object].nearby();
  const std::size_t stride = out.size() / 3;
  parallel_for(std::size_t{0}, nearby.size(), kGrain, [&](const auto& vertices) {
    for (std::size_t v = vertices.begin(); v < vertices.end(); ++v) {
      const float hidden = 1 - left_at(nearby[v], part, whole).value_or(1);
      for (std::size_t c = 0; c < 3; ++c) out[c * stride + v] -= hidden * in[c * stride + v];
    }
  });
}

Rgb OcclusionProbes::at_vertex(std::size_t object, std::span<const Rgb> of_probes,
                               std::size_t vertex) const {
  const Nearby& near = objects_[object].nearby()[vertex];
  Rgb sum;
  for (std::size_t k = 0; k < kNearest; ++k) sum += of_probes[near.probe[k]] * near.weight[k];
  return sum;
}

void OcclusionProbes::replace_shaded(std::size_t object, const Values& part, const Values& whole,
                                     std::span<const Rgb> gathered, std::span<const float> in,
                                     std::span<float> out) const {
  const std::vector<Nearby>& nearby = objects_[object].nearby();
  const std::size_t stride = out.size() / 3;
  parallel_for(std::size_t{0}, nearby.size(), kGrain, [&](const auto& vertices) {
    for (std::size_t v = vertices.begin(); v < vertices.end(); ++v) {
      const float lit = std::min(left_at(nearby[v], part, whole).value_or(1), 1.f);
      const Rgb instead = at_vertex(object, gathered, v);
      for (std::size_t c = 0; c < 3; ++c) {
        const float by_bake = in[c * stride + v];
        const float blend = lit * (lit * by_bake) + (1 - lit) * instead[static_cast<int>(c)];
        out[c * stride + v] += blend - by_bake;
      }
    }
  });
}

}  // namespace penumbra::runtime
