#include "prt/geometry/luminous.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <glm/geometric.hpp>
#include <utility>

#include "core/conventions.h"

namespace penumbra::prt {

namespace {

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

// Mean over a triangle.
Rgb emission_of(const Mesh& mesh, const SurfaceMaterials& surface,
                const std::array<std::uint32_t, 3>& corners) {
  constexpr float kSixth = 1.f / 6, kMost = 2.f / 3, kThird = 1.f / 3;
  Rgb sum;
  for (const auto& [u, v] :
       {std::pair(kThird, kThird), {kSixth, kSixth}, {kMost, kSixth}, {kSixth, kMost}}) {
    const LocalMaterial here = local_material(mesh, surface, {corners, u, v, true});
    sum += here.emission * here.opacity;
  }
  return sum * .25f;
}

// What a part's triangles send, one after another.
struct SentByTriangles {
  std::vector<std::size_t> triangles;
  std::vector<double> up_to;  // sum of luminance times area, that triangle's with it
  double square = 0;          // sum of squared luminance times area

  void add(std::size_t triangle, double power, double m2) {
    triangles.push_back(triangle);
    up_to.push_back((up_to.empty() ? 0 : up_to.back()) + power);
    square += power * power / m2;
  }
  // Of an even part that sends as much, as bright as this one is on average over its light.
  double lit_area() const { return up_to.back() * up_to.back() / square; }
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
  std::vector<LuminousPart> parts(surface.materials.size());
  std::vector<SentByTriangles> sent(parts.size());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto& corners = mesh.triangles[t];
    const std::size_t m = surface.material[corners[0]];
    const Material& material = surface.materials[m];
    if (material.unlit || !(luminance(material.emission) > 0)) continue;
    const double m2 = area_of(mesh, corners);
    const Rgb emitted = emission_of(mesh, surface, corners) * static_cast<float>(m2);
    const double power = luminance(emitted);
    if (!(power > 0)) continue;
    parts[m].emission_m2 += emitted;
    sent[m].add(t, power, m2);
  }
  std::vector<LuminousPart> out;
  for (std::size_t m = 0; m < parts.size(); ++m) {
    if (sent[m].triangles.empty()) continue;
    LuminousPart& part = parts[m];
    part.material = surface.materials[m].name;
    part.double_sided = surface.materials[m].double_sided;
    part.point_m2 = static_cast<float>(sent[m].lit_area() / points);
    place_points(mesh, sent[m], points, part);
    out.push_back(std::move(part));
  }
  std::ranges::stable_sort(out, std::greater<>(),
                           [](const LuminousPart& p) { return luminance(p.emission_m2); });
  return out;
}

}  // namespace penumbra::prt
