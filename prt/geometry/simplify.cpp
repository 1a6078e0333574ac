#include <meshoptimizer.h>

#include <algorithm>
#include <limits>

#include "prt/geometry/fine_form.h"

namespace penumbra::prt {

namespace {

constexpr float kAnyError = 1e3f;

// The triangles' vertices alone, in the order of their first use.
Simplified compacted(const Mesh& mesh, std::span<const std::uint32_t> indices, float error) {
  constexpr auto kNone = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> place(mesh.positions.size(), kNone);
  Simplified out{.mesh = {}, .from = {}, .error = error};
  const auto place_of = [&](std::uint32_t i) {
    if (place[i] == kNone) {
      place[i] = static_cast<std::uint32_t>(out.from.size());
      out.from.push_back(i);
      out.mesh.positions.push_back(mesh.positions[i]);
      out.mesh.normals.push_back(mesh.normals[i]);
      out.mesh.albedo.push_back(mesh.albedo[i]);
    }
    return place[i];
  };
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3)
    out.mesh.triangles.push_back(
        {place_of(indices[i]), place_of(indices[i + 1]), place_of(indices[i + 2])});
  return out;
}

}  // namespace

Simplified simplify(const Mesh& mesh, std::size_t max_vertices) {
  const std::uint32_t* const from = mesh.triangles[0].data();
  const std::size_t from_count = 3 * mesh.triangles.size();
  // A closed mesh has twice as many triangles as vertices.
  const std::size_t target = std::min(6 * max_vertices, from_count);
  std::vector<std::uint32_t> indices(from_count);
  float error = 0;
  const std::size_t kept =
      meshopt_simplify(indices.data(), from, from_count, &mesh.positions[0].x,
                       mesh.positions.size(), sizeof(glm::vec3), target, kAnyError, 0, &error);
  Simplified out = compacted(mesh, std::span(indices).first(kept), error);
  if (out.from.size() <= max_vertices + max_vertices / 4) return out;
  const std::size_t merged = meshopt_simplifySloppy(
      indices.data(), from, from_count, &mesh.positions[0].x, mesh.positions.size(),
      sizeof(glm::vec3), target / 2, kAnyError, &error);
  return merged == 0 ? out : compacted(mesh, std::span(indices).first(merged), error);
}

SurfaceMaterials picked(const SurfaceMaterials& surface, std::span<const std::uint32_t> from) {
  SurfaceMaterials out;
  out.materials = surface.materials;
  const auto pick = [&](const auto& values, auto& to) {
    if (values.empty()) return;
    for (const std::uint32_t i : from) to.push_back(values[i]);
  };
  pick(surface.material, out.material);
  for (std::size_t k = 0; k < 2; ++k) pick(surface.coordinates[k], out.coordinates[k]);
  pick(surface.tint, out.tint);
  pick(surface.tangents, out.tangents);
  return out;
}

}  // namespace penumbra::prt
