#include "runtime/surroundings/irradiance_cache.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "core/threads/parallel.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

namespace {

constexpr float kFinestRadii = .1f;  // spacing of the finest level, in radii of the smallest object
constexpr float kFinestEdges = 1.5f;  // but no less than this, in edges of the mesh
constexpr float kPerNormal = 2;       // a normal that is off by 1/2 is as far as a spacing
constexpr float kWeightEnd = 1.5f;    // weights fall to zero at so many spacings

// Distance of two vertices in spacings.
float distance(const prt::Mesh& mesh, std::size_t a, std::size_t b, float spacing_m) {
  const glm::vec3 place = (mesh.positions[a] - mesh.positions[b]) / spacing_m,
                  turn = kPerNormal * (mesh.normals[a] - mesh.normals[b]);
  return std::sqrt(glm::dot(place, place) + glm::dot(turn, turn));
}

// Points by the cube of space that they lie in.
class PointGrid {
 public:
  PointGrid(const prt::Mesh& mesh, float cell_m) : mesh_(mesh), per_m_(1 / cell_m) {}

  void add(std::size_t vertex, std::uint32_t point) {
    cells_[key(cell_of(vertex))].push_back({static_cast<std::uint32_t>(vertex), point});
  }
  // visit(vertex, point) of all within one cell's length.
  template <class Visit>
  void around(std::size_t vertex, const Visit& visit) const {
    const glm::ivec3 at = cell_of(vertex);
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) {
          const auto cell = cells_.find(key(at + glm::ivec3(x, y, z)));
          if (cell == cells_.end()) continue;
          for (const auto& [other, point] : cell->second) visit(other, point);
        }
  }

 private:
  glm::ivec3 cell_of(std::size_t vertex) const {
    return glm::ivec3(glm::floor(mesh_.positions[vertex] * per_m_));
  }
  // Cells that share a key are both looked at: distances decide.
  static std::uint64_t key(const glm::ivec3& c) {
    const auto part = [](int v) { return static_cast<std::uint64_t>(v) & 0x1fffff; };
    return part(c.x) << 42 | part(c.y) << 21 | part(c.z);
  }
  const prt::Mesh& mesh_;
  float per_m_;
  std::unordered_map<std::uint64_t, std::vector<std::pair<std::uint32_t, std::uint32_t>>> cells_;
};

// Every vertex has one within a spacing.
std::vector<std::uint32_t> spread_points(const prt::Mesh& mesh, float spacing_m, PointGrid& grid) {
  std::vector<std::uint32_t> out;
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    bool covered = false;
    grid.around(v, [&](std::size_t other, std::uint32_t) {
      covered |= distance(mesh, v, other, spacing_m) < 1;
    });
    if (covered) continue;
    grid.add(v, static_cast<std::uint32_t>(out.size()));
    out.push_back(static_cast<std::uint32_t>(v));
  }
  return out;
}

// Weights fall to zero at the first point that does not count.
// source: Franke & Nielson 1980 (modified Shepard interpolation)
template <class NearPoints>
NearPoints nearest_points(const prt::Mesh& mesh, std::size_t vertex, float spacing_m,
                          const PointGrid& grid) {
  constexpr std::size_t kCount = std::tuple_size_v<decltype(NearPoints::point)>;
  std::array<std::pair<float, std::uint32_t>, kCount + 1> best;  // nearness, point
  best.fill({0.f, 0});
  grid.around(vertex, [&](std::size_t other, std::uint32_t point) {
    const float near = 1 - distance(mesh, vertex, other, spacing_m) / kWeightEnd;
    std::size_t at = kCount;
    if (near <= best[at].first) return;
    for (; at > 0 && best[at - 1].first < near; --at) best[at] = best[at - 1];
    best[at] = {near, point};
  });
  NearPoints out{};
  float sum = 0;
  for (std::size_t k = 0; k < kCount; ++k) {
    const float off = best[k].first - best[kCount].first;
    out.point[k] = best[k].second;
    out.weight[k] = best[k].first > 0 ? off * off + 1e-6f : 0;
    sum += out.weight[k];
  }
  for (float& w : out.weight) w = sum > 0 ? w / sum : 0;
  return out;
}

float mean_edge_m(const prt::Mesh& mesh) {
  double area = 0;
  for (const auto& t : mesh.triangles) {
    const glm::vec3& a = mesh.positions[t[0]];
    area +=
        .5 * double(glm::length(glm::cross(mesh.positions[t[1]] - a, mesh.positions[t[2]] - a)));
  }
  // Of even triangles: sqrt(3)/4 edge^2 each.
  return static_cast<float>(std::sqrt(area / double(mesh.triangles.size()) * 4 / std::sqrt(3.)));
}

}  // namespace

// A virtual thing where it stands.
struct IrradianceCache::Neighbour {
  glm::vec3 centre;
  float radius;
  std::vector<glm::vec3> surface;  // points all over it
};

IrradianceCache::IrradianceCache(const PreparedScene& scene) : scene_(&scene) {
  const prt::Mesh& mesh = scene.real_mesh;
  if (mesh.triangles.empty() || scene.objects.empty()) return;
  float smallest = std::numeric_limits<float>::max(), largest = 0;
  for (const PreparedObject& o : scene.objects) {
    const float radius = prt::radius_of(o.baked.mesh);
    smallest = std::min(smallest, radius);
    largest = std::max(largest, radius);
  }
  float spacing = std::max(kFinestRadii * smallest, kFinestEdges * mean_edge_m(mesh));
  const float coarsest = kSpacing * kReach * largest;
  do {
    PointGrid grid(mesh, kWeightEnd * spacing);
    Level& level = levels_.emplace_back();
    level.spacing_m = spacing;
    level.points = spread_points(mesh, spacing, grid);
    level.nearby.resize(mesh.positions.size());
    parallel_for(std::size_t{0}, level.nearby.size(), [&](std::size_t v) {
      level.nearby[v] = nearest_points<NearPoints>(mesh, v, spacing, grid);
    });
    level.used.assign(level.points.size(), GatherHit::kNone);
    spacing *= 2;
  } while (spacing < coarsest);
}

IrradianceCache::Wanted IrradianceCache::wanted_at(std::size_t vertex,
                                                   std::span<const Neighbour> neighbours) const {
  const glm::vec3& at = scene_->real_mesh.positions[vertex];
  const glm::vec3& normal = scene_->real_mesh.normals[vertex];
  Wanted out;
  float nearest = std::numeric_limits<float>::max();
  for (const Neighbour& n : neighbours) {
    const glm::vec3 to = n.centre - at;
    // What lies wholly behind, with the shadow around it, changes nothing.
    const float off = glm::length(to);
    const float above = glm::dot(to, normal) / n.radius;
    if (off >= kReach * n.radius || above <= -2) continue;
    float here = std::numeric_limits<float>::max();
    for (const glm::vec3& p : n.surface) here = std::min(here, glm::dot(p - at, p - at));
    nearest = std::min(nearest, std::sqrt(here));
    const float fade =
        std::clamp(kReach - off / n.radius, 0.f, 1.f) * std::clamp(above + 2, 0.f, 1.f);
    out.fade = std::max(out.fade, fade * fade * (3 - 2 * fade));
  }
  if (out.fade == 0) return out;
  const float steps = std::log2(std::max(kSpacing * nearest / levels_[0].spacing_m, 1.f)),
              last = static_cast<float>(levels_.size() - 1);
  out.level = static_cast<std::uint8_t>(std::min(std::floor(steps), last));
  out.finer = out.level == static_cast<std::uint8_t>(last)
                  ? 1
                  : 1 - (steps - static_cast<float>(out.level));
  return out;
}

void IrradianceCache::mark_used() {
  for (Level& l : levels_) std::ranges::fill(l.used, GatherHit::kNone);
  used_.clear();
  const auto use = [&](std::size_t level, std::size_t vertex) {
    const NearPoints& nearby = levels_[level].nearby[vertex];
    for (std::size_t k = 0; k < kNearest; ++k) {
      std::int32_t& place = levels_[level].used[nearby.point[k]];
      if (nearby.weight[k] <= 0 || place != GatherHit::kNone) continue;
      place = static_cast<std::int32_t>(used_.size());
      used_.push_back({level, nearby.point[k]});
    }
  };
  for (std::size_t v = 0; v < wanted_.size(); ++v) {
    if (wanted_[v].fade == 0) continue;
    use(wanted_[v].level, v);
    if (wanted_[v].finer < 1) use(wanted_[v].level + 1u, v);
  }
}

void IrradianceCache::update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
                             const OcclusionProbes& around, bool other_form) {
  if (levels_.empty() || (!other_form && std::ranges::equal(poses, poses_))) return;
  poses_.assign(poses.begin(), poses.end());
  std::vector<Neighbour> neighbours(poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const prt::Mesh& mesh = scene_->objects[i].baked.mesh;
    neighbours[i].radius = around.radius(i);
    neighbours[i].centre = glm::vec3(poses[i] * glm::dvec3(around.centre(i)));
    for (const std::uint32_t v : around.probes(i))
      neighbours[i].surface.emplace_back(poses[i] * glm::dvec3(mesh.positions[v]));
  }
  wanted_.resize(scene_->real_mesh.positions.size());
  parallel_for(std::size_t{0}, wanted_.size(),
               [&](std::size_t v) { wanted_[v] = wanted_at(v, neighbours); });
  mark_used();
  if (hits_.size() < used_.size()) hits_.resize(used_.size());
  parallel_for(std::size_t{0}, used_.size(),
               [&](std::size_t p) { gather(p, occluders, neighbours); });
}

namespace {

using Rays = prt::RayWorld::Rays;
using Hits = prt::RayWorld::Hits;
constexpr int kRaysAtOnce = prt::RayWorld::kPacket;

glm::vec3 direction_of(const Rays& rays, int lane) {
  return {rays.dx[lane], rays.dy[lane], rays.dz[lane]};
}

}  // namespace

void IrradianceCache::gather(std::size_t point, const shadows::RayOccluders& occluders,
                             std::span<const Neighbour> neighbours) {
  const prt::Mesh& real = scene_->real_mesh;
  const std::size_t vertex = levels_[used_[point].level].points[used_[point].point];
  const glm::vec3 normal = real.normals[vertex],
                  from = real.positions[vertex] + occluders.near_m * normal;
  const glm::mat3 frame = prt::frame_around(normal);
  std::vector<GatherHit>& out = hits_[point];
  out.clear();
  prt::RayScene::RayPacket directions;
  Rays rays;
  std::fill_n(rays.ox, kRaysAtOnce, from.x);
  std::fill_n(rays.oy, kRaysAtOnce, from.y);
  std::fill_n(rays.oz, kRaysAtOnce, from.z);
  for (int block = 0; block < kRays / kRaysAtOnce; ++block) {
    patterns_.cosine_block(prt::RayPatterns::turn_of(vertex), block, frame, directions);
    std::copy_n(directions.x, kRaysAtOnce, rays.dx);
    std::copy_n(directions.y, kRaysAtOnce, rays.dy);
    std::copy_n(directions.z, kRaysAtOnce, rays.dz);
    Hits by_virtual, by_real;
    for (std::size_t k = 0; k < neighbours.size(); ++k)
      occluders.virtual_things->intersect(static_cast<int>(k), rays, by_virtual);
    occluders.real_things->intersect(0, rays, by_real);
    for (int i = 0; i < kRaysAtOnce; ++i) {
      GatherHit hit;
      hit.direction = direction_of(rays, i);
      float behind = std::numeric_limits<float>::max();
      if (const auto met = meet_real(scene_->planes, real, rays, by_real, i, RealPoint::kMesh)) {
        hit.real = true;
        hit.behind = met->point;
        behind = met->distance;
      }
      if (const int k = by_virtual.mesh[i]; k >= 0 && by_virtual.distance[i] < behind) {
        hit.object = static_cast<std::int16_t>(k);
        hit.vertex = prt::nearest_corner(scene_->objects[static_cast<std::size_t>(k)].baked.mesh,
                                         by_virtual.triangle[i], by_virtual.u[i], by_virtual.v[i]);
      }
      const auto near_plane_point = [&](const Neighbour& n) {
        const glm::vec3 off = hit.behind.on_plane - n.centre;
        return glm::dot(off, off) < kReach * kReach * n.radius * n.radius;
      };
      if (hit.object != GatherHit::kNone || (hit.behind.plane != RealPoint::kMesh &&
                                             std::ranges::any_of(neighbours, near_plane_point)))
        out.push_back(hit);
    }
  }
}

void IrradianceCache::interpolate(std::span<const Rgb> of_points, std::span<Rgb> out) const {
  const auto at_level = [&](std::size_t level, std::size_t vertex) {
    const NearPoints& nearby = levels_[level].nearby[vertex];
    Rgb sum;
    for (std::size_t k = 0; k < kNearest; ++k)
      if (nearby.weight[k] > 0)
        sum += of_points[static_cast<std::size_t>(levels_[level].used[nearby.point[k]])] *
               nearby.weight[k];
    return sum;
  };
  if (wanted_.empty()) {
    std::ranges::fill(out, Rgb{});
    return;
  }
  parallel_for(std::size_t{0}, out.size(), [&](std::size_t v) {
    const Wanted& w = wanted_[v];
    out[v] = {};
    if (w.fade == 0) return;
    out[v] = at_level(w.level, v) * w.finer;
    if (w.finer < 1) out[v] += at_level(w.level + 1u, v) * (1 - w.finer);
    out[v] = out[v] * w.fade;
  });
}

}  // namespace penumbra::runtime
