#include "prt/geometry/masked.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra::prt {

namespace {

bool is_masked(const SurfaceMaterials& m, std::uint32_t vertex) {
  return m.materials[m.material[vertex]].alpha == Material::Alpha::kMask;
}

// Mean over the corners, the middles of the sides and of the whole.
float mean_opacity(const SurfaceMaterials& m, const std::array<std::uint32_t, 3>& t) {
  const Material& material = m.materials[m.material[t[0]]];
  const auto& set = m.coordinates[static_cast<std::size_t>(material.base_colour_map.set)];
  if (set.empty()) return material.opacity;
  const glm::vec2 a = set[t[0]], b = set[t[1]], c = set[t[2]];
  float sum = 0;
  const glm::vec2 places[] = {
      a, b, c, (a + b) / 2.f, (b + c) / 2.f, (c + a) / 2.f, (a + b + c) / 3.f};
  for (const glm::vec2& place : places) sum += opacity_at(material, place);
  return sum / static_cast<float>(std::size(places));
}

template <class Value>
void pick(std::vector<Value>& values, const std::vector<std::uint32_t>& which) {
  if (values.empty()) return;
  std::vector<Value> out;
  out.reserve(which.size());
  for (const std::uint32_t i : which) out.push_back(values[i]);
  values = std::move(out);
}

// The vertices that triangles use, in their order.
void drop_unused(Mesh& mesh, SurfaceMaterials& m) {
  constexpr auto kUnused = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> now(mesh.positions.size(), kUnused), kept;
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t v : t) now[v] = 0;
  for (std::uint32_t v = 0; v < now.size(); ++v)
    if (now[v] != kUnused) {
      now[v] = static_cast<std::uint32_t>(kept.size());
      kept.push_back(v);
    }
  for (auto& t : mesh.triangles)
    for (std::uint32_t& v : t) v = now[v];
  pick(mesh.positions, kept);
  pick(mesh.normals, kept);
  pick(mesh.albedo, kept);
  pick(m.material, kept);
  for (auto& set : m.coordinates) pick(set, kept);
  pick(m.tint, kept);
  pick(m.tangents, kept);
}

}  // namespace

float opacity_at(const Material& material, const glm::vec2& coordinates) {
  const Texture& map = material.base_colour_map;
  if (!map) return material.opacity;
  const glm::vec2 place = map.transform * glm::vec3(coordinates, 1);
  const Image<Rgba8>& codes = map.picture->codes;
  const int x = texel_at(place.x, codes.width(), map.wrap_s),
            y = texel_at(place.y, codes.height(), map.wrap_t);
  return material.opacity * static_cast<float>(codes.at(x, y).a) / 255;
}

bool cut_masked_away(Mesh& mesh, SurfaceMaterials& m, float longest_edge,
                     std::size_t triangle_limit) {
  const auto whole = [&](const auto& t) { return !is_masked(m, t[0]); };
  const auto first_masked = std::ranges::partition(mesh.triangles, whole).begin();
  if (first_masked == mesh.triangles.end()) return false;
  // Vertices have one material, so the masked part shares none with the rest.
  std::vector<std::array<std::uint32_t, 3>> rest(mesh.triangles.begin(), first_masked);
  mesh.triangles.erase(mesh.triangles.begin(), first_masked);
  m.extend(subdivide(mesh, longest_edge, triangle_limit));
  std::erase_if(mesh.triangles, [&](const auto& t) {
    return mean_opacity(m, t) < m.materials[m.material[t[0]]].alpha_cutoff;
  });
  mesh.triangles.insert(mesh.triangles.begin(), rest.begin(), rest.end());
  drop_unused(mesh, m);
  return true;
}

}  // namespace penumbra::prt
