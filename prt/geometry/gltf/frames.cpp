#include "prt/geometry/gltf/internal/frames.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <span>
#include <utility>
#include <vector>

#include "prt/geometry/mesh.h"

namespace penumbra::prt::gltf {

namespace {

constexpr float kSmoothCosine = .17364818f;  // of 80 degrees
constexpr std::size_t kMaxFaces = 256;       // at one place; where more meet, all are averaged

struct FaceCorner {
  glm::vec3 normal{0};  // of its face
  float angle = 0;      // between the face's edges
};

FaceCorner corner_of(const glm::vec3& at, const glm::vec3& next, const glm::vec3& other) {
  const glm::vec3 a = next - at, b = other - at;
  const glm::vec3 n = glm::cross(a, b);
  const float size = glm::length(n);
  if (!(size > 0) || !std::isfinite(size)) return {};
  return {n / size, std::atan2(size, glm::dot(a, b))};
}

// Each triangle gets vertices of its own.
template <class T>
void by_corners(std::vector<T>& list, const std::vector<std::array<std::uint32_t, 3>>& triangles) {
  if (list.empty()) return;
  std::vector<T> out;
  out.reserve(triangles.size() * 3);
  for (const auto& t : triangles)
    for (const auto i : t) out.push_back(list[i]);
  list = std::move(out);
}

// Positions may differ by rounding where squares leave the range of floats.
glm::vec3 unit_or(const glm::vec3& v, const glm::vec3& other) {
  const float length = glm::length(v);
  return length > 1e-12f && std::isfinite(length) ? v / length : other;
}

}  // namespace

glm::vec3 perpendicular(const glm::vec3& along, const glm::vec3& normal) {
  const glm::vec3 across = along - normal * glm::dot(along, normal);
  const glm::vec3 axis = std::abs(normal.x) < .7f ? glm::vec3(1, 0, 0) : glm::vec3(0, 1, 0);
  return unit_or(across, glm::normalize(axis - normal * glm::dot(axis, normal)));
}

void make_normals(Primitive& p) {
  by_corners(p.positions, p.triangles);
  by_corners(p.coordinates[0], p.triangles);
  by_corners(p.coordinates[1], p.triangles);
  by_corners(p.tint, p.triangles);
  std::vector<FaceCorner> corners(p.positions.size());
  for (std::size_t t = 0; t < p.triangles.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t first = 3 * t;
      p.triangles[t][k] = static_cast<std::uint32_t>(first + k);
      corners[first + k] = corner_of(p.positions[first + k], p.positions[first + (k + 1) % 3],
                                     p.positions[first + (k + 2) % 3]);
    }
  // Corners by the place that they share.
  const std::vector<std::uint32_t> places = places_of(p.positions);
  std::vector<std::uint32_t> begin(p.positions.size() + 1), sorted(p.positions.size());
  for (const std::uint32_t place : places) ++begin[place + 1];
  for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (std::uint32_t i = 0; i < places.size(); ++i) sorted[next[places[i]]++] = i;
  p.normals.assign(p.positions.size(), glm::vec3(0, 1, 0));
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const std::span<const std::uint32_t> here(&sorted[begin[places[i]]],
                                              begin[places[i] + 1] - begin[places[i]]);
    glm::vec3 sum(0);
    if (here.size() <= kMaxFaces) {
      for (const std::uint32_t other : here)
        if (glm::dot(corners[other].normal, corners[i].normal) > kSmoothCosine)
          sum += corners[other].normal * corners[other].angle;
    } else if (here[0] == i) {
      for (const std::uint32_t other : here) sum += corners[other].normal * corners[other].angle;
    } else {
      sum = p.normals[here[0]];
    }
    const glm::vec3 own = corners[i].angle > 0 ? corners[i].normal : glm::vec3(0, 1, 0);
    p.normals[i] = unit_or(sum, own);
  }
}

void make_tangents(Primitive& p, const Texture& map) {
  const auto& uv = p.coordinates[static_cast<std::size_t>(map.set)];
  const auto place = [&](std::uint32_t i) {
    return uv.empty() ? glm::vec2(0) : map.transform * glm::vec3(uv[i].x, uv[i].y, 1);
  };
  // By the way round that the map is shown: [0] as it is, [1] mirrored.
  std::array<std::vector<glm::vec3>, 2> sums;
  for (auto& s : sums) s.assign(p.positions.size(), glm::vec3(0));
  std::vector<int> way(p.triangles.size(), -1);
  for (std::size_t k = 0; k < p.triangles.size(); ++k) {
    const auto& t = p.triangles[k];
    const glm::vec3 e1 = p.positions[t[1]] - p.positions[t[0]],
                    e2 = p.positions[t[2]] - p.positions[t[0]];
    const glm::vec2 d1 = place(t[1]) - place(t[0]), d2 = place(t[2]) - place(t[0]);
    // v points down in pictures, and the map's y axis up: the bitangent goes against v.
    const float area = d1.x * d2.y - d2.x * d1.y;
    if (area == 0 || !std::isfinite(area)) continue;
    way[k] = area < 0 ? 0 : 1;
    const glm::vec3 along = unit_or((e1 * d2.y - e2 * d1.y) / area, glm::vec3(0));
    const float weight = glm::length(glm::cross(e1, e2));
    for (const auto i : t) sums[static_cast<std::size_t>(way[k])][i] += along * weight;
  }
  std::vector<std::array<std::uint32_t, 2>> vertex(p.positions.size());
  std::vector<std::array<bool, 2>> used(p.positions.size(), {false, false});
  for (std::size_t k = 0; k < way.size(); ++k)
    for (const auto i : p.triangles[k])
      if (way[k] >= 0) used[i][static_cast<std::size_t>(way[k])] = true;
  const std::size_t count = p.positions.size();
  for (std::uint32_t i = 0; i < count; ++i) {
    vertex[i] = {i, i};
    const std::size_t first = used[i][0] || !used[i][1] ? 0 : 1;
    const auto tangent = [&](std::size_t w) {
      return glm::vec4(perpendicular(sums[w][i], p.normals[i]), w == 0 ? 1.f : -1.f);
    };
    p.tangents.push_back(tangent(first));
    if (!used[i][0] || !used[i][1]) continue;
    vertex[i][1] = static_cast<std::uint32_t>(p.positions.size());
    p.positions.push_back(p.positions[i]);
    p.normals.push_back(p.normals[i]);
    for (auto& set : p.coordinates)
      if (!set.empty()) set.push_back(set[i]);
    if (!p.tint.empty()) p.tint.push_back(p.tint[i]);
  }
  for (std::uint32_t i = 0; i < count; ++i)
    if (vertex[i][1] != i) p.tangents.emplace_back(perpendicular(sums[1][i], p.normals[i]), -1.f);
  for (std::size_t k = 0; k < way.size(); ++k)
    for (auto& i : p.triangles[k]) i = vertex[i][way[k] == 1 ? 1 : 0];
}

}  // namespace penumbra::prt::gltf
