#include "prt/geometry/internal/weld.h"

#include <array>
#include <bit>
#include <unordered_map>
#include <utility>

namespace penumbra::prt {

namespace {

// All that a vertex has, as bits; what a mesh lacks is 0.
using VertexBits = std::array<std::uint32_t, 21>;

struct VertexHash {
  std::size_t operator()(const VertexBits& key) const {
    std::uint64_t hash = 0xcbf29ce484222325u;  // FNV-1a, by words
    for (const std::uint32_t word : key) hash = (hash ^ word) * 0x100000001b3u;
    return hash ^ hash >> 29;
  }
};

VertexBits bits_of(const Mesh& mesh, const SurfaceMaterials* surface, std::uint32_t i) {
  VertexBits out{};
  std::size_t at = 0;
  const auto put = [&](float v) { out[at++] = std::bit_cast<std::uint32_t>(v + 0.f); };
  const glm::vec3 &p = mesh.positions[i], &n = mesh.normals[i];
  const Rgb& a = mesh.albedo[i];
  for (const float v : {p.x, p.y, p.z, n.x, n.y, n.z, a.r, a.g, a.b}) put(v);
  if (!surface) return out;
  for (const auto& set : surface->coordinates)
    if (!set.empty()) put(set[i].x), put(set[i].y);
  if (!surface->tangents.empty())
    for (int k = 0; k < 4; ++k) put(surface->tangents[i][k]);
  if (!surface->tint.empty())
    for (int k = 0; k < 3; ++k) put(surface->tint[i][k]);
  out[at] = surface->material[i];
  return out;
}

template <class T>
void keep(std::vector<T>& list, const std::vector<std::uint32_t>& kept) {
  if (list.empty()) return;
  std::vector<T> out;
  out.reserve(kept.size());
  for (const std::uint32_t i : kept) out.push_back(list[i]);
  list = std::move(out);
}

}  // namespace

// Assimp's own joining merges what lies within 1e-5 of a unit, which destroys small models.
void weld(Mesh& mesh, SurfaceMaterials* surface) {
  std::unordered_map<VertexBits, std::uint32_t, VertexHash> known;
  std::vector<std::uint32_t> kept;
  for (auto& t : mesh.triangles)
    for (auto& i : t) {
      const auto [found, fresh] =
          known.try_emplace(bits_of(mesh, surface, i), static_cast<std::uint32_t>(kept.size()));
      if (fresh) kept.push_back(i);
      i = found->second;
    }
  keep(mesh.positions, kept);
  keep(mesh.normals, kept);
  keep(mesh.albedo, kept);
  if (!surface) return;
  keep(surface->material, kept);
  for (auto& set : surface->coordinates) keep(set, kept);
  keep(surface->tangents, kept);
  keep(surface->tint, kept);
}

}  // namespace penumbra::prt
