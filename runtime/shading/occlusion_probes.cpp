#include "runtime/shading/occlusion_probes.h"

#include <cmath>

#include "core/conventions.h"
#include "core/parallel.h"
#include "lighting/sh/basis.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/rays.h"

namespace penumbra::runtime {

namespace {

constexpr int kRays = 256;  // a side
constexpr int kTries = 4;   // vertices that a direction is tried from until one is open to it
constexpr int kFloorTries = 2;
constexpr int kTerms = shadows::kMaxFieldBands * shadows::kMaxFieldBands;

// Even over the sphere.
glm::dvec3 direction_of(int k) {
  const double y = 1 - (2 * k + 1.) / kRays, s = std::sqrt(1 - y * y),
               a = k * 2.399963229728653;  // golden angle
  return {s * std::cos(a), y, s * std::sin(a)};
}

}  // namespace

OcclusionProbes::OcclusionProbes(const PreparedScene& scene)
    : scene_(&scene),
      vertices_(scene.objects.size()),
      belongs_(scene.objects.size()),
      views_(scene.objects.size()),
      by_real_(scene.objects.size()) {
  if (!any()) return;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const std::vector<glm::vec3>& normals = scene.objects[i].baked.mesh.normals;
    for (std::uint32_t v = 0; v < normals.size(); ++v) {
      std::size_t nearest = 0;
      float largest = 0;
      for (std::size_t side = 0; side < kProbeDirections; ++side) {
        const float weight = direction_weight(normals[v], static_cast<int>(side));
        if (weight <= 0) continue;
        belongs_[i][side].push_back({v, weight});
        if (weight > largest) largest = weight, nearest = side;
      }
      vertices_[i][nearest].push_back(v);
    }
  }
}

void OcclusionProbes::look(const shadows::RayOccluders& occluders, std::span<const Pose> poses) {
  if (!any() || std::ranges::equal(poses, poses_)) return;
  poses_.assign(poses.begin(), poses.end());
  parallel_for(std::size_t{0}, poses.size(),
               [&](std::size_t i) { look_from(i, occluders, poses[i]); });
}

void OcclusionProbes::look_from(std::size_t object, const shadows::RayOccluders& occluders,
                                const Pose& pose) {
  BlockedSh mean;
  for (int side = 0; side < kProbeDirections; ++side) {
    ProbeView& view = views_[object][static_cast<std::size_t>(side)];
    view = look_from_side(object, side, occluders, pose);
    for (std::size_t n = 0; n < mean.blocked.size(); ++n)
      mean.blocked[n] += view.by_real.blocked[n] / kProbeDirections;
    mean.fraction += view.by_real.fraction / kProbeDirections;
  }
  by_real_[object] = mean;
}

namespace {

// Rays from one side of an object.
class SideEyes {
 public:
  SideEyes(const prt::Mesh& mesh, std::span<const std::uint32_t> vertices, int own,
           const shadows::RayOccluders& occluders, bool has_real, const Pose& pose)
      : mesh_(mesh),
        vertices_(vertices),
        own_(own),
        occluders_(occluders),
        has_real_(has_real),
        turn_(pose.rotation_matrix()),
        shift_(pose.translation) {}

  enum class Sees {
    kNothing,
    kOpen,
    kReal,
    kVirtual
  };  // kNothing: faces away, or sees the object itself

  /// From one of the side's vertices, evenly chosen by `place` in 0..1.
  Sees look(double place, const glm::vec3& direction) {
    const auto v = vertices_[static_cast<std::size_t>(place * double(vertices_.size()))];
    const glm::vec3 n = turn_ * mesh_.normals[v];
    cosine = glm::dot(n, direction);
    if (cosine <= 0) return Sees::kNothing;
    from = turn_ * mesh_.positions[v] + shift_ + occluders_.near_m * n;
    ray_.ox[0] = from.x, ray_.oy[0] = from.y, ray_.oz[0] = from.z;
    ray_.dx[0] = direction.x, ray_.dy[0] = direction.y, ray_.dz[0] = direction.z;
    // What the object hides from itself is in its transfer.
    if (occluders_.virtual_things->occluded_by(own_, ray_, 1) != 0) return Sees::kNothing;
    if (has_real_ && occluders_.real_things->occluded_by(0, ray_, 1) != 0) return Sees::kReal;
    return occluders_.virtual_things->occluded(ray_, 1, own_) != 0 ? Sees::kVirtual : Sees::kOpen;
  }
  glm::vec3 up() const { return turn_[1]; }

  glm::vec3 from{0};  // where the last look was from
  float cosine = 0;   // to its direction

 private:
  const prt::Mesh& mesh_;
  std::span<const std::uint32_t> vertices_;
  int own_;
  const shadows::RayOccluders& occluders_;
  bool has_real_;
  glm::mat3 turn_;
  glm::vec3 shift_;
  prt::RayWorld::Rays ray_;
};

// Several vertices are tried until one is open to the direction: how likely that is, the transfer
// knows.
void look_up(SideEyes& eyes, int k, const glm::dvec3& d, ProbeView& out) {
  for (int attempt = 0; attempt < kTries; ++attempt) {
    const double place = std::fmod((k * kTries + attempt) * .6180339887498949, 1.);
    const auto seen = eyes.look(place, glm::vec3(d));
    if (seen == SideEyes::Sees::kOpen) return;
    if (seen == SideEyes::Sees::kNothing) continue;
    BlockedSh& hidden = seen == SideEyes::Sees::kReal ? out.by_real : out.by_virtual;
    double basis[kTerms];
    lighting::evaluate_basis(shadows::kMaxFieldBands, d, basis);
    for (std::size_t i = 0; i < hidden.blocked.size(); ++i)
      hidden.blocked[i] += static_cast<float>(4 * kPi / kRays * basis[i]);
    hidden.fraction += 1.f / kRays;
    return;
  }
}

// Every try counts: with its cosine it is a sample of the side's irradiance.
void look_at_floor(SideEyes& eyes, int k, const glm::vec3& d, const glm::vec3& floor,
                   ProbeView& out) {
  const float drop = -glm::dot(d, eyes.up());
  for (int attempt = 0; attempt < kFloorTries; ++attempt) {
    const double place = std::fmod((k * kFloorTries + attempt) * .6180339887498949, 1.);
    const auto seen = eyes.look(place, d);
    if (seen == SideEyes::Sees::kNothing) continue;
    const float weight = 4 * eyes.cosine / (kRays * kFloorTries);
    if (seen == SideEyes::Sees::kReal) {
      out.floor_behind_real += weight;
    } else if (seen == SideEyes::Sees::kVirtual) {
      out.floor_behind_virtual += weight;
    } else {
      const float height = glm::dot(eyes.from - floor, eyes.up());
      out.floor += weight;
      out.floor_points.push_back({eyes.from + std::max(height, 0.f) / drop * d, weight});
    }
  }
}

}  // namespace

ProbeView OcclusionProbes::look_from_side(std::size_t object, int side,
                                          const shadows::RayOccluders& occluders,
                                          const Pose& pose) const {
  ProbeView out;
  const PreparedObject& o = scene_->objects[object];
  const Vertices& vertices = vertices_[object][static_cast<std::size_t>(side)];
  if (vertices.empty()) return out;
  SideEyes eyes(o.baked.mesh, vertices, static_cast<int>(object), occluders,
                !scene_->real_mesh.triangles.empty(), pose);
  const double height = o.baked.receiver ? double(o.baked.receiver->grid.height) : 0;
  const glm::vec3 floor(pose * glm::dvec3(0, height, 0));
  for (int k = 0; k < kRays; ++k) {
    const glm::dvec3 d = direction_of(k);
    const bool down = o.baked.receiver && glm::dot(glm::vec3(d), eyes.up()) <= -1e-3f;
    if (down)
      look_at_floor(eyes, k, glm::vec3(d), floor, out);
    else
      look_up(eyes, k, d, out);
  }
  return out;
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
