// Edges short enough for transfer at vertices, from as few triangles as that takes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

constexpr float kRadius = .04f, kHeight = .1f;

// A wall of facets that are as wide as the mesh has them and as high as the wall.
Mesh make_wall(int facets) {
  Mesh mesh;
  for (int i = 0; i < facets; ++i) {
    const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / float(facets);
    const glm::vec3 normal{std::cos(angle), 0, std::sin(angle)};
    for (const float y : {0.f, kHeight}) {
      mesh.positions.push_back(kRadius * normal + glm::vec3(0, y, 0));
      mesh.normals.push_back(normal);
      mesh.albedo.emplace_back(.5f, .5f, .5f);
    }
  }
  const auto count = static_cast<std::uint32_t>(2 * facets);
  for (std::uint32_t a = 0; a < count; a += 2) {
    const std::uint32_t b = (a + 2) % count;
    mesh.triangles.push_back({a, a + 1, b});
    mesh.triangles.push_back({b, a + 1, b + 1});
  }
  return mesh;
}

// A flat round cake.
Mesh make_fan(int slices) {
  Mesh mesh;
  mesh.positions.emplace_back(0.f);
  for (int i = 0; i < slices; ++i) {
    const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / float(slices);
    mesh.positions.emplace_back(kRadius * std::cos(angle), 0, kRadius * std::sin(angle));
  }
  mesh.normals.assign(mesh.positions.size(), {0, 1, 0});
  mesh.albedo.assign(mesh.positions.size(), {.5f, .5f, .5f});
  const auto count = static_cast<std::uint32_t>(slices);
  for (std::uint32_t i = 0; i < count; ++i)
    mesh.triangles.push_back({0, 1 + (i + 1) % count, 1 + i});
  return mesh;
}

glm::vec3 area_vector(const Mesh& mesh, const std::array<std::uint32_t, 3>& t) {
  const glm::vec3& a = mesh.positions[t[0]];
  return .5f * glm::cross(mesh.positions[t[1]] - a, mesh.positions[t[2]] - a);
}
double area_of(const Mesh& mesh) {
  double sum = 0;
  for (const auto& t : mesh.triangles) sum += double(glm::length(area_vector(mesh, t)));
  return sum;
}
float longest_edge(const Mesh& mesh) {
  float longest = 0;
  for (const auto& t : mesh.triangles)
    for (std::size_t k = 0; k < 3; ++k)
      longest =
          std::max(longest, glm::distance(mesh.positions[t[k]], mesh.positions[t[(k + 1) % 3]]));
  return longest;
}
// Edges with a triangle on one side alone; 1000 more for one that two go round the same way.
std::size_t open_edges(const Mesh& mesh) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> count;
  for (const auto& t : mesh.triangles)
    for (std::size_t k = 0; k < 3; ++k) ++count[{t[k], t[(k + 1) % 3]}];
  std::size_t open = 0;
  for (const auto& [edge, times] : count)
    open += (times > 1 ? 1000u : 0u) + (count.contains({edge.second, edge.first}) ? 0u : 1u);
  return open;
}

// Cutting every long edge of a narrow facet cuts its diagonal, too, and brings a row of vertices
// between its sides in every round: 8 to 35 times what is needed here.
TEST(Subdivide, NarrowFacetsTakeAsManyVerticesAsTheirAreaNeeds) {
  for (const float longest : {.006f, .003f, .0015f})
    for (const bool wall : {true, false}) {
      Mesh mesh = wall ? make_wall(100) : make_fan(100);
      const double area = area_of(mesh);
      const std::size_t open = open_edges(mesh);
      subdivide(mesh, longest);
      const double needed = area / double(longest * longest);
      std::printf("%g mm: %zu vertices, %.2f of what is needed\n", 1e3 * double(longest),
                  mesh.positions.size(), double(mesh.positions.size()) / needed);
      EXPECT_LE(longest_edge(mesh), longest);
      EXPECT_NEAR(area_of(mesh), area, 1e-5 * area);
      EXPECT_GE(open_edges(mesh), open);
      EXPECT_LT(open_edges(mesh), 1000u);
      EXPECT_LT(double(mesh.positions.size()), 6 * needed);
    }
}

}  // namespace
}  // namespace penumbra::prt
