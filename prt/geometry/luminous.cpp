#include "prt/geometry/luminous.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>

#include "core/conventions.h"

namespace penumbra::prt {

namespace {

constexpr float kThird = 1.f / 3;

float area_of(const Mesh& mesh, const std::array<std::uint32_t, 3>& corners) {
  const glm::vec3 &a = mesh.positions[corners[0]], &b = mesh.positions[corners[1]],
                  &c = mesh.positions[corners[2]];
  return glm::length(glm::cross(b - a, c - a)) / 2;
}

// The k-th place of an even sequence over a triangle (Roberts 2018), its far half folded back.
TrianglePlace place_in(const std::array<std::uint32_t, 3>& corners, int k) {
  const double whole_u = .5 + .7548776662466927 * k, whole_v = .5 + .5698402909980532 * k;
  auto u = static_cast<float>(whole_u - std::floor(whole_u)),
       v = static_cast<float>(whole_v - std::floor(whole_v));
  if (u + v > 1) u = 1 - u, v = 1 - v;
  return {corners, u, v, true};
}

// What a part's triangles send, one after another.
struct SentByTriangles {
  std::vector<std::size_t> triangles;
  std::vector<double> up_to;  // sum of luminance times area, that triangle's with it
};

// Even steps through the sum: neighbours in the mesh's order follow each other, so that points lie
// apart.
void place_points(const Mesh& mesh, const SentByTriangles& sent, int points, LuminousPart& out) {
  std::size_t at = 0;
  for (int k = 0; k < points; ++k) {
    const double target = (k + .5) / points * sent.up_to.back();
    while (at + 1 < sent.up_to.size() && sent.up_to[at] < target) ++at;
    out.points.push_back(place_in(mesh.triangles[sent.triangles[at]], k));
  }
}

}  // namespace

std::vector<LuminousPart> luminous_parts(const Mesh& mesh, const SurfaceMaterials& surface,
                                         int points) {
  std::vector<LuminousPart> out;
  for (std::size_t m = 0; m < surface.materials.size(); ++m) {
    const Material& material = surface.materials[m];
    if (material.unlit || !(luminance(material.emission) > 0)) continue;
    LuminousPart part;
    part.material = material.name;
    part.double_sided = material.double_sided;
    SentByTriangles sent;
    double all = 0, area = 0;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      const auto& corners = mesh.triangles[t];
      if (surface.material[corners[0]] != m) continue;
      const LocalMaterial middle = local_material(mesh, surface, {corners, kThird, kThird, true});
      const float m2 = area_of(mesh, corners);
      const Rgb emitted = middle.emission * (m2 * middle.opacity);
      if (!(luminance(emitted) > 0)) continue;
      part.emission_m2 += emitted;
      all += luminance(emitted), area += m2;
      sent.triangles.push_back(t), sent.up_to.push_back(all);
    }
    if (sent.triangles.empty()) continue;
    place_points(mesh, sent, points, part);
    part.point_m2 = static_cast<float>(area / points);
    out.push_back(std::move(part));
  }
  return out;
}

}  // namespace penumbra::prt
