#include "service/surroundings.h"

#include <oneapi/tbb/parallel_for.h>

#include <cmath>

#include "core/conventions.h"
#include "lighting/lighting.h"

namespace penumbra::service {

namespace {

constexpr int kRays = 512;  // a side
constexpr int kTries = 4;   // vertices that a direction is tried from until one is open to it
constexpr int kTerms = shadows::kMaxFieldBands * shadows::kMaxFieldBands;

// Even over the sphere.
glm::dvec3 direction_of(int k) {
  const double y = 1 - (2 * k + 1.) / kRays, s = std::sqrt(1 - y * y),
               a = k * 2.399963229728653;  // golden angle
  return {s * std::cos(a), y, s * std::sin(a)};
}

}  // namespace

Surroundings::Surroundings(const PreparedScene& scene)
    : scene_(&scene),
      vertices_(scene.objects.size()),
      views_(scene.objects.size()),
      by_real_(scene.objects.size()) {
  if (!any()) return;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const std::vector<glm::vec3>& normals = scene.objects[i].baked.mesh.normals;
    for (std::uint32_t v = 0; v < normals.size(); ++v) {
      int most = 0;
      for (int side = 1; side < kSides; ++side)
        if (belongs_to(normals[v], side) > belongs_to(normals[v], most)) most = side;
      vertices_[i][static_cast<std::size_t>(most)].push_back(v);
    }
  }
}

void Surroundings::look(const shadows::Blockers& blockers, std::span<const Pose> poses) {
  if (!any() || std::ranges::equal(poses, poses_)) return;
  poses_.assign(poses.begin(), poses.end());
  tbb::parallel_for(std::size_t{0}, poses.size(),
                    [&](std::size_t i) { look_from(i, blockers, poses[i]); });
}

void Surroundings::look_from(std::size_t object, const shadows::Blockers& blockers,
                             const Pose& pose) {
  Hidden mean;
  for (int side = 0; side < kSides; ++side) {
    SideView& view = views_[object][static_cast<std::size_t>(side)];
    view = look_from_side(object, side, blockers, pose);
    for (std::size_t n = 0; n < mean.blocked.size(); ++n)
      mean.blocked[n] += view.by_real.blocked[n] / kSides;
    mean.share += view.by_real.share / kSides;
  }
  by_real_[object] = mean;
}

SideView Surroundings::look_from_side(std::size_t object, int side,
                                      const shadows::Blockers& blockers, const Pose& pose) const {
  SideView out;
  const PreparedObject& o = scene_->objects[object];
  const prt::Mesh& mesh = o.baked.mesh;
  const Vertices& vertices = vertices_[object][static_cast<std::size_t>(side)];
  if (vertices.empty()) return out;
  const glm::mat3 turn(pose.rotation_matrix());
  const glm::vec3 shift(pose.translation), up = turn[1];
  const int own = static_cast<int>(object);
  const bool has_real = !scene_->real_mesh.triangles.empty();
  prt::RayWorld::Rays ray;
  for (int k = 0; k < kRays; ++k) {
    const glm::dvec3 d = direction_of(k);
    const glm::vec3 df(d);
    if (o.baked.receiver && glm::dot(df, up) <= 0)
      continue;  // the floor is there; the bake knows it
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const double place = std::fmod((k * kTries + attempt) * .6180339887498949, 1.);
      const auto v =
          vertices[static_cast<std::size_t>(place * static_cast<double>(vertices.size()))];
      const glm::vec3 n = turn * mesh.normals[v];
      if (glm::dot(n, df) <= 0) continue;
      const glm::vec3 from = turn * mesh.positions[v] + shift + blockers.near_m * n;
      ray.ox[0] = from.x, ray.oy[0] = from.y, ray.oz[0] = from.z;
      ray.dx[0] = df.x, ray.dy[0] = df.y, ray.dz[0] = df.z;
      // What the object hides from itself is in its transfer.
      if (blockers.virtual_things->occluded_by(own, ray, 1) != 0) continue;
      const bool by_real = has_real && blockers.real_things->occluded_by(0, ray, 1) != 0;
      if (!by_real && blockers.virtual_things->occluded(ray, 1, own) == 0) break;
      Hidden& hidden = by_real ? out.by_real : out.by_virtual;
      double basis[kTerms];
      lighting::evaluate_basis(shadows::kMaxFieldBands, d, basis);
      for (std::size_t i = 0; i < hidden.blocked.size(); ++i)
        hidden.blocked[i] += static_cast<float>(4 * kPi / kRays * basis[i]);
      hidden.share += 1.f / kRays;
      break;
    }
  }
  return out;
}

RadianceSh seen_behind(const RadianceSh& light, const Hidden& hidden, const Rgb& radiance) {
  if (hidden.share == 0) return light;
  RadianceSh out = shadows::FieldLight(light, shadows::kMaxFieldBands).seen_through(hidden.blocked);
  for (int n = 0; n < out.size() && n < kTerms; ++n)
    out[n] += radiance * hidden.blocked[static_cast<std::size_t>(n)];
  return out;
}

}  // namespace penumbra::service
