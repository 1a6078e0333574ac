#include "shadows/silhouette/silhouette_cache.h"

#include <hwy/cache_control.h>

#include <algorithm>
#include <cmath>

namespace penumbra::shadows {

namespace {

// Whether triangles with such normals face all of the directions, or none.
bool see_alike(const SilhouetteMesh::Patch& patch, const glm::vec3& towards, float sine,
               float cosine) {
  constexpr float kRounding = 1e-5f;
  return patch.cosine * cosine > patch.sine * sine &&
         std::abs(glm::dot(patch.axis, towards)) >
             patch.sine * cosine + patch.cosine * sine + kRounding;
}

// Few patches are unlike, here and there: their edges are asked for a few patches ahead.
void prefetch(std::span<const SilhouetteMesh::Edge> edges) {
  constexpr std::size_t kLine = 64 / sizeof(SilhouetteMesh::Edge);
  for (std::size_t i = 0; i < edges.size(); i += kLine) hwy::Prefetch(&edges[i]);
}

void find_edges(const SilhouetteMesh& silhouette, const glm::vec3& towards, float sine,
                std::vector<std::uint32_t>& unlike, std::vector<std::uint8_t>& faces,
                std::vector<std::uint32_t>& out) {
  constexpr std::size_t kAhead = 4;
  out.clear();
  const SilhouetteMesh::Normals& n = silhouette.normals();
  faces.resize(n.x.size());
  find_facing_all({n.x, n.y, n.z}, {towards.x, towards.y, towards.z, sine}, faces);
  const float cosine = std::sqrt(1 - sine * sine);
  unlike.clear();
  for (std::uint32_t p = 0; p < silhouette.patches().size(); ++p)
    if (!see_alike(silhouette.patches()[p], towards, sine, cosine)) unlike.push_back(p);
  for (std::size_t u = 0; u < unlike.size(); ++u) {
    if (u + kAhead < unlike.size()) prefetch(silhouette.edges_of(unlike[u + kAhead]));
    const std::size_t p = unlike[u];
    const std::span<const SilhouetteMesh::Edge> edges = silhouette.edges_of(p);
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const auto [from, to, left, right] = edges[i];
      const bool alike =
          right != SilhouetteMesh::kOpen && faces[left] == faces[right] && faces[left] != kUnsure;
      if (!alike) out.push_back(static_cast<std::uint32_t>(p * SilhouetteMesh::kTogether + i));
    }
  }
}

}  // namespace

std::span<const std::uint32_t> SilhouetteCache::find(const SilhouetteMesh& silhouette,
                                                     const Pose& world_from_mesh,
                                                     const DirectionCone& cone) {
  // Those who ask compute facing by sums of their own.
  constexpr double kRounding = 1e-5;
  const glm::vec3 towards(glm::transpose(world_from_mesh.rotation_matrix()) * cone.towards);
  const auto sine = static_cast<float>(std::min(1., cone.sine + kRounding));
  for (const KnownSilhouette& k : std::span(known_).first(used_))
    if (k.silhouette == &silhouette && k.towards == towards && k.sine == sine) return k.edges;
  if (used_ == known_.size()) known_.emplace_back();
  KnownSilhouette& k = known_[used_++];
  k.silhouette = &silhouette, k.towards = towards, k.sine = sine;
  find_edges(silhouette, towards, sine, unlike_, faces_, k.edges);
  return k.edges;
}

}  // namespace penumbra::shadows
