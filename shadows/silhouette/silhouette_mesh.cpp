#include "shadows/silhouette/silhouette_mesh.h"

#include <meshoptimizer.h>
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <tuple>

namespace penumbra::shadows {

namespace {

struct HalfEdge {
  std::uint32_t low, high;  // vertices
  bool back;                // the triangle goes from high to low
  std::uint32_t triangle;
  auto key() const { return std::tuple(high, low, back, triangle); }
};

std::vector<HalfEdge> half_edges(std::span<const SilhouetteMesh::Triangle> triangles) {
  std::vector<HalfEdge> out;
  out.reserve(3 * triangles.size());
  for (std::uint32_t t = 0; t < triangles.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = triangles[t][k], b = triangles[t][(k + 1) % 3];
      out.push_back({std::min(a, b), std::max(a, b), a > b, t});
    }
  std::ranges::sort(out, {}, &HalfEdge::key);
  return out;
}

// Of the vertices that are used alone: others in the same place would count as a seam, which stays.
std::vector<SilhouetteMesh::Triangle> simplified(
    const std::vector<SilhouetteMesh::Triangle>& triangles, const std::vector<glm::vec3>& positions,
    float max_off_m) {
  constexpr std::uint32_t kUnused = 0xffffffffu;
  std::vector<std::uint32_t> place(positions.size(), kUnused), used, from, to;
  std::vector<glm::vec3> used_positions;
  for (const SilhouetteMesh::Triangle& t : triangles)
    for (const std::uint32_t v : t) {
      if (place[v] == kUnused) {
        place[v] = static_cast<std::uint32_t>(used.size());
        used.push_back(v);
        used_positions.push_back(positions[v]);
      }
      from.push_back(place[v]);
    }
  const float* const first = &used_positions[0].x;
  constexpr std::size_t kStride = sizeof(used_positions[0]);
  const float extent_m = meshopt_simplifyScale(first, used.size(), kStride);
  if (!(extent_m > 0)) return triangles;
  to.resize(from.size());
  to.resize(meshopt_simplify(to.data(), from.data(), from.size(), first, used.size(), kStride, 0,
                             max_off_m / extent_m));
  std::vector<SilhouetteMesh::Triangle> out(to.size() / 3);
  for (std::size_t i = 0; i < to.size(); ++i) out[i / 3][i % 3] = used[to[i]];
  return out;
}

// Of the triangles at one edge those that go forth with those that go back, two by two; the others
// alone.
void pair_up(std::span<const HalfEdge> at_edge, std::vector<SilhouetteMesh::Edge>& out) {
  const auto middle = std::ranges::find(at_edge, true, &HalfEdge::back) - at_edge.begin();
  const std::span forth = at_edge.first(static_cast<std::size_t>(middle)),
                  back = at_edge.subspan(static_cast<std::size_t>(middle));
  for (std::size_t i = 0; i < std::max(forth.size(), back.size()); ++i) {
    if (i < forth.size())
      out.push_back({forth[i].low, forth[i].high, forth[i].triangle,
                     i < back.size() ? back[i].triangle : SilhouetteMesh::kOpen});
    else
      out.push_back({back[i].high, back[i].low, back[i].triangle, SilhouetteMesh::kOpen});
  }
}

void set_sphere(std::span<const SilhouetteMesh::Edge> edges,
                const std::vector<glm::vec3>& positions, SilhouetteMesh::Patch& out) {
  glm::vec3 low(1e30f), high(-1e30f);
  for (const SilhouetteMesh::Edge& e : edges)
    for (const std::uint32_t v : {e.from, e.to})
      low = glm::min(low, positions[v]), high = glm::max(high, positions[v]);
  out.centre = .5f * (low + high);
  out.radius_m = .5f * glm::distance(low, high);
}

void set_cone(std::span<const SilhouetteMesh::Edge> edges, const SilhouetteMesh::Normals& normals,
              SilhouetteMesh::Patch& out) {
  out.sine = SilhouetteMesh::kAnywhere, out.cosine = 0;
  std::array<glm::vec3, 2 * SilhouetteMesh::kTogether> units;
  std::size_t count = 0;
  glm::vec3 sum(0);
  for (const SilhouetteMesh::Edge& e : edges) {
    if (e.right == SilhouetteMesh::kOpen) return;
    for (const std::uint32_t t : {e.left, e.right}) {
      const glm::vec3 n(normals.x[t], normals.y[t], normals.z[t]);
      const float length = glm::length(n);
      if (!(length > 0)) return;  // faces nothing, whatever is around it
      sum += units[count++] = n / length;
    }
  }
  const float length = glm::length(sum);
  if (!(length > 0)) return;
  // A sine from the cosine of a small angle would be lost in rounding.
  constexpr float kRounding = 4e-6f;
  float sine = 0;
  out.axis = sum / length;
  for (const glm::vec3& n : std::span(units).first(count)) {
    if (glm::dot(n, out.axis) <= 0) return;
    sine = std::max(sine, glm::length(glm::cross(n, out.axis)) + kRounding);
  }
  if (sine < 1) out.sine = sine, out.cosine = std::sqrt(1 - sine * sine);
}

}  // namespace

SilhouetteMesh::SilhouetteMesh(const prt::Mesh& mesh, float max_off_m) {
  const std::vector<std::uint32_t> first = prt::places_of(mesh.positions);
  for (const auto& [a, b, c] : mesh.triangles) {
    const Triangle t{first[a], first[b], first[c]};
    if (t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) triangles_.push_back(t);
  }
  if (max_off_m > 0 && !triangles_.empty())
    triangles_ = simplified(triangles_, mesh.positions, max_off_m);
  const std::vector<HalfEdge> all = half_edges(triangles_);
  for (auto at = all.begin(); at != all.end();) {
    const auto end = std::find_if(
        at, all.end(), [&](const HalfEdge& h) { return h.low != at->low || h.high != at->high; });
    pair_up({at, end}, edges_);
    at = end;
  }
  update_vertices(mesh);
}

void SilhouetteMesh::update_vertices(const prt::Mesh& mesh) {
  for (auto* v : {&normals_.x, &normals_.y, &normals_.z}) v->resize(triangles_.size());
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    const auto& [a, b, c] = triangles_[t];
    const glm::vec3 n =
        glm::cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]);
    normals_.x[t] = n.x, normals_.y[t] = n.y, normals_.z[t] = n.z;
  }
  patches_.resize((edges_.size() + kTogether - 1) / kTogether);
  for (std::size_t p = 0; p < patches_.size(); ++p) {
    set_sphere(edges_of(p), mesh.positions, patches_[p]);
    set_cone(edges_of(p), normals_, patches_[p]);
  }
  bounds_ = prt::bounds_of(mesh);
  radius_m_ = prt::radius_around(mesh, bounds_.centre());
  float sum = 0;
  for (const Edge& e : edges_) sum += glm::distance(mesh.positions[e.from], mesh.positions[e.to]);
  mean_length_m_ = edges_.empty() ? 0 : sum / static_cast<float>(edges_.size());
}

}  // namespace penumbra::shadows
