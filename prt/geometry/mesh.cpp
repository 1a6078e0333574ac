#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <map>
#include <numbers>
#include <numeric>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

Bounds bounds_of(const Mesh& mesh) {
  Bounds b{glm::vec3(HUGE_VALF), glm::vec3(-HUGE_VALF)};
  for (const glm::vec3& p : mesh.positions) {
    b.low = glm::min(b.low, p);
    b.high = glm::max(b.high, p);
  }
  return b;
}

std::vector<std::uint32_t> places_of(std::span<const glm::vec3> positions) {
  std::vector<std::uint32_t> order(positions.size()), first(positions.size());
  std::iota(order.begin(), order.end(), 0u);
  const auto key = [&](std::uint32_t v) {
    const glm::vec3& p = positions[v];
    return std::tuple(p.x, p.y, p.z);
  };
  std::ranges::sort(order, {}, [&](std::uint32_t v) { return std::pair(key(v), v); });
  for (std::size_t i = 0; i < order.size(); ++i) {
    const bool again = i > 0 && key(order[i]) == key(order[i - 1]);
    first[order[i]] = again ? first[order[i - 1]] : order[i];
  }
  return first;
}

std::uint32_t nearest_corner(const Mesh& mesh, std::size_t triangle, float u, float v) {
  const auto& corners = mesh.triangles[triangle];
  const float w = 1 - u - v;
  return w >= u && w >= v ? corners[0] : u >= v ? corners[1] : corners[2];
}

float radius_around(const Mesh& mesh, const glm::vec3& centre) {
  float largest = 0;
  for (const glm::vec3& p : mesh.positions) largest = std::max(largest, glm::distance(p, centre));
  return largest;
}

float radius_of(const Mesh& mesh) {
  return radius_around(mesh, bounds_of(mesh).centre());
}

float likely_unit_m(const Mesh& mesh) {
  // Of the largest extent. At the second one centimetres make it as much too large as millimetres
  // make it too small, for what stands on a table or a floor.
  constexpr float kLikelyCentimetres = 7, kLikelyMillimetres = 316;
  const Bounds b = bounds_of(mesh);
  const glm::vec3 size = b.high - b.low;
  const float largest = std::max({size.x, size.y, size.z});
  if (!(largest > kLikelyCentimetres)) return 1;
  return largest > kLikelyMillimetres ? .001f : .01f;
}

void transform(Mesh& mesh, const glm::dmat4& matrix) {
  const glm::dmat3 normal_matrix = glm::transpose(glm::inverse(glm::dmat3(matrix)));
  for (glm::vec3& p : mesh.positions) p = glm::vec3(matrix * glm::dvec4(p, 1));
  for (glm::vec3& n : mesh.normals) n = glm::vec3(glm::normalize(normal_matrix * glm::dvec3(n)));
  if (glm::determinant(glm::dmat3(matrix)) < 0)
    for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
}

void append(Mesh& mesh, const Mesh& other) {
  const auto first = static_cast<std::uint32_t>(mesh.positions.size());
  mesh.positions.insert(mesh.positions.end(), other.positions.begin(), other.positions.end());
  mesh.normals.insert(mesh.normals.end(), other.normals.begin(), other.normals.end());
  mesh.albedo.insert(mesh.albedo.end(), other.albedo.begin(), other.albedo.end());
  for (const auto& t : other.triangles)
    mesh.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
}

namespace {

class Subdivider {
 public:
  Subdivider(Mesh& mesh, float longest) : mesh_(mesh), longest_(longest) {}

  // One round: every edge that is too long gets its midpoint, but for those that are flipped
  // afterwards; each triangle is cut by how many it has.
  bool round() {
    midpoints_.clear();
    find_flips();
    std::vector<Triangle> out;
    out.reserve(mesh_.triangles.size() * 2);
    const std::size_t before = mesh_.triangles.size();
    for (const Triangle& t : mesh_.triangles) split(t, out);
    mesh_.triangles = std::move(out);
    flip();
    return mesh_.triangles.size() != before;
  }
  // Of what edge each new vertex is the middle.
  std::vector<std::array<std::uint32_t, 2>> ends() && { return std::move(ends_); }

 private:
  using Triangle = std::array<std::uint32_t, 3>;
  using EdgeKey = std::pair<std::uint32_t, std::uint32_t>;  // the lesser vertex first
  static constexpr std::uint32_t kNone = 0xffffffffu;
  static constexpr float kThin = .5f;        // shortest edge over the longest
  static constexpr float kFlat = .99985f;    // cosine: 1 degree
  static constexpr float kShorter = .9999f;  // a flip that only rounding would tell

  float length(std::uint32_t a, std::uint32_t b) const {
    return glm::distance(mesh_.positions[a], mesh_.positions[b]);
  }
  glm::vec3 normal(const Triangle& t) const {
    const glm::vec3& a = mesh_.positions[t[0]];
    const glm::vec3 n = glm::cross(mesh_.positions[t[1]] - a, mesh_.positions[t[2]] - a);
    const float size = glm::length(n);
    return size > 0 ? n / size : n;
  }

  // The place of the longest edge of a thin triangle that has another one to cut.
  std::optional<std::size_t> longest_of_thin(const Triangle& t) const {
    const std::array<float, 3> sizes{length(t[0], t[1]), length(t[1], t[2]), length(t[2], t[0])};
    const auto longest = static_cast<std::size_t>(std::ranges::max_element(sizes) - sizes.begin());
    const float one = sizes[(longest + 1) % 3], other = sizes[(longest + 2) % 3];
    if (std::min(one, other) > kThin * sizes[longest] || std::max(one, other) <= longest_)
      return std::nullopt;
    return longest;
  }

  // An edge that is the longest of two thin triangles in one plane is their diagonal. Cut, it
  // would bring a row of vertices between its triangles' sides in every round: it is flipped once
  // its neighbours are cut.
  void find_flips() {
    flips_.clear();
    std::map<EdgeKey, std::size_t> first;
    for (std::size_t i = 0; i < mesh_.triangles.size(); ++i) {
      const Triangle& t = mesh_.triangles[i];
      const auto longest = longest_of_thin(t);
      if (!longest) continue;
      const EdgeKey edge = std::minmax(t[*longest], t[(*longest + 1) % 3]);
      const auto [found, fresh] = first.try_emplace(edge, i);
      if (!fresh && glm::dot(normal(t), normal(mesh_.triangles[found->second])) > kFlat)
        flips_.try_emplace(edge);
    }
  }

  // The triangles on both sides of each edge of flips_: cut by now, they have new corners.
  void flip() {
    if (flips_.empty()) return;
    for (std::size_t i = 0; i < mesh_.triangles.size(); ++i)
      for (std::size_t k = 0; k < 3; ++k) {
        const Triangle& t = mesh_.triangles[i];
        const auto found = flips_.find(std::minmax(t[k], t[(k + 1) % 3]));
        if (found != flips_.end()) found->second[t[k] < t[(k + 1) % 3] ? 0 : 1] = {i, k};
      }
    for (const auto& [edge, sides] : flips_)
      if (sides[0].triangle != sides[1].triangle) flip(sides[0], sides[1]);
  }

  struct Side {
    std::size_t triangle = 0, edge = 0;
  };
  void flip(const Side& left, const Side& right) {
    Triangle &one = mesh_.triangles[left.triangle], &two = mesh_.triangles[right.triangle];
    const std::uint32_t a = one[left.edge], b = one[(left.edge + 1) % 3],
                        c = one[(left.edge + 2) % 3], d = two[(right.edge + 2) % 3];
    // Another edge of the triangle may have been flipped meanwhile.
    if (two[right.edge] != b || two[(right.edge + 1) % 3] != a) return;
    if (length(c, d) > kShorter * length(a, b)) return;
    const Triangle first{a, d, c}, second{d, b, c};
    const glm::vec3 before = normal(one);
    if (glm::dot(normal(first), before) <= 0 || glm::dot(normal(second), before) <= 0) return;
    one = first, two = second;
  }

  std::uint32_t midpoint(std::uint32_t a, std::uint32_t b) {
    if (length(a, b) <= longest_ || flips_.contains(std::minmax(a, b))) return kNone;
    const auto [found, fresh] = midpoints_.try_emplace(std::minmax(a, b), kNone);
    if (!fresh) return found->second;
    const auto index = static_cast<std::uint32_t>(mesh_.positions.size());
    mesh_.positions.push_back(.5f * (mesh_.positions[a] + mesh_.positions[b]));
    const glm::vec3 n = mesh_.normals[a] + mesh_.normals[b];
    mesh_.normals.push_back(glm::length(n) > 1e-6f ? glm::normalize(n) : mesh_.normals[a]);
    mesh_.albedo.push_back((mesh_.albedo[a] + mesh_.albedo[b]) * .5f);
    ends_.push_back({a, b});
    return found->second = index;
  }

  void split(const Triangle& t, std::vector<Triangle>& out) {
    const Triangle m{midpoint(t[0], t[1]), midpoint(t[1], t[2]), midpoint(t[2], t[0])};
    const auto cuts = std::ranges::count_if(m, [](auto i) { return i != kNone; });
    if (cuts == 0) return out.push_back(t);
    if (cuts == 3) {
      out.insert(out.end(),
                 {{t[0], m[0], m[2]}, {m[0], t[1], m[1]}, {m[2], m[1], t[2]}, {m[0], m[1], m[2]}});
      return;
    }
    // Turn the triangle so that its first edge is cut and, with two cuts, its third is not.
    std::size_t first = 0;
    while (m[first] == kNone || (cuts == 2 && m[(first + 2) % 3] != kNone)) ++first;
    const auto a = t[first], b = t[(first + 1) % 3], c = t[(first + 2) % 3];
    const auto ab = m[first], bc = m[(first + 1) % 3];
    if (cuts == 1) {
      out.insert(out.end(), {{a, ab, c}, {ab, b, c}});
    } else {
      out.insert(out.end(), {{ab, b, bc}, {a, ab, bc}, {a, bc, c}});
    }
  }

  Mesh& mesh_;
  float longest_;
  std::vector<std::array<std::uint32_t, 2>> ends_;
  std::map<EdgeKey, std::uint32_t> midpoints_;
  std::map<EdgeKey, std::array<Side, 2>> flips_;  // by the way that their triangles go round
};

}  // namespace

namespace {

// Each edge between two triangles that run along it in opposite ways.
bool is_closed_surface(const Mesh& mesh) {
  const std::vector<std::uint32_t> place = places_of(mesh.positions);
  std::vector<std::uint64_t> edges;  // smaller place, larger place, direction
  edges.reserve(3 * mesh.triangles.size());
  for (const auto& t : mesh.triangles)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint64_t a = place[t[k]], b = place[t[(k + 1) % 3]];
      edges.push_back(std::min(a, b) << 33 | std::max(a, b) << 1 | (a < b ? 0u : 1u));
    }
  std::ranges::sort(edges);
  for (std::size_t i = 0; i + 1 < edges.size(); i += 2)
    if (edges[i + 1] != (edges[i] | 1) || edges[i] & 1) return false;
  for (std::size_t i = 2; i < edges.size(); i += 2)
    if (edges[i] >> 1 == edges[i - 1] >> 1) return false;
  return edges.size() % 2 == 0 && !edges.empty();
}

}  // namespace

bool turn_outwards(Mesh& mesh) {
  const auto& p = mesh.positions;
  double volume = 0, agree = 0;
  for (const auto& t : mesh.triangles) {
    const glm::dvec3 a(p[t[0]] - p[0]), b(p[t[1]] - p[0]), c(p[t[2]] - p[0]),
        across = glm::cross(b - a, c - a);
    volume += glm::dot(a, across);
    agree += glm::dot(across, glm::dvec3(mesh.normals[t[0]]));
  }
  if (volume >= 0 || !is_closed_surface(mesh)) return false;
  for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
  if (agree > 0)
    for (glm::vec3& n : mesh.normals) n = -n;
  return true;
}

std::vector<std::array<std::uint32_t, 2>> subdivide(Mesh& mesh, float longest_edge,
                                                    std::size_t triangle_limit) {
  Subdivider subdivider(mesh, longest_edge);
  while (mesh.triangles.size() * 2 < triangle_limit && subdivider.round()) {
  }
  return std::move(subdivider).ends();
}

Mesh make_sphere(const glm::vec3& centre, float radius, int subdivisions, Rgb albedo) {
  constexpr float g = std::numbers::phi_v<float>;
  Mesh mesh;
  mesh.positions = {{-1, g, 0},  {1, g, 0},  {-1, -g, 0}, {1, -g, 0}, {0, -1, g},  {0, 1, g},
                    {0, -1, -g}, {0, 1, -g}, {g, 0, -1},  {g, 0, 1},  {-g, 0, -1}, {-g, 0, 1}};
  mesh.triangles = {{0, 11, 5}, {0, 5, 1},  {0, 1, 7},   {0, 7, 10}, {0, 10, 11},
                    {1, 5, 9},  {5, 11, 4}, {11, 10, 2}, {10, 7, 6}, {7, 1, 8},
                    {3, 9, 4},  {3, 4, 2},  {3, 2, 6},   {3, 6, 8},  {3, 8, 9},
                    {4, 9, 5},  {2, 4, 11}, {6, 2, 10},  {8, 6, 7},  {9, 8, 1}};
  for (glm::vec3& p : mesh.positions) p = glm::normalize(p);
  mesh.normals = mesh.positions;
  mesh.albedo.assign(mesh.positions.size(), albedo);
  for (int i = 0; i < subdivisions; ++i) {
    Subdivider(mesh, 0).round();
    for (glm::vec3& p : mesh.positions) p = glm::normalize(p);
  }
  mesh.normals = mesh.positions;
  for (glm::vec3& p : mesh.positions) p = centre + radius * p;
  return mesh;
}

Mesh make_box(const glm::vec3& low, const glm::vec3& high, int n, Rgb albedo) {
  Mesh mesh;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      const auto first = static_cast<std::uint32_t>(mesh.positions.size());
      glm::vec3 normal(0);
      normal[axis] = side ? 1.f : -1.f;
      for (int j = 0; j <= n; ++j)
        for (int i = 0; i <= n; ++i) {
          glm::vec3 p;
          p[axis] = side ? high[axis] : low[axis];
          p[u] = low[u] + (high[u] - low[u]) * static_cast<float>(i) / static_cast<float>(n);
          p[v] = low[v] + (high[v] - low[v]) * static_cast<float>(j) / static_cast<float>(n);
          mesh.positions.push_back(p);
          mesh.normals.push_back(normal);
          mesh.albedo.push_back(albedo);
        }
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
          const auto a = first + static_cast<std::uint32_t>(j * (n + 1) + i);
          const auto b = a + 1, c = a + static_cast<std::uint32_t>(n) + 1, d = c + 1;
          if (side) {
            mesh.triangles.insert(mesh.triangles.end(), {{a, b, d}, {a, d, c}});
          } else {
            mesh.triangles.insert(mesh.triangles.end(), {{a, d, b}, {a, c, d}});
          }
        }
    }
  return mesh;
}

Mesh make_knot(float height, int segments, int sides, Rgb albedo) {
  // Centre line of the (2, 3) torus knot, standing upright. The torus' own normal frames the tube:
  // it is periodic, so the last ring meets the first.
  const auto line = [](double t) {
    const double r = 2 + std::cos(3 * t);
    return glm::dvec3(r * std::cos(2 * t), r * std::sin(2 * t), std::sin(3 * t));
  };
  constexpr double kTube = .52;
  Mesh mesh;
  const double step = 2 * std::numbers::pi / segments;
  for (int i = 0; i < segments; ++i) {
    const double t = i * step;
    const glm::dvec3 c = line(t), tangent = glm::normalize(line(t + 1e-4) - line(t - 1e-4));
    const glm::dvec3 outward(std::cos(3 * t) * std::cos(2 * t), std::cos(3 * t) * std::sin(2 * t),
                             std::sin(3 * t));
    const glm::dvec3 side = glm::normalize(outward - tangent * glm::dot(outward, tangent));
    const glm::dvec3 up = glm::cross(tangent, side);
    for (int j = 0; j < sides; ++j) {
      const double a = 2 * std::numbers::pi * j / sides;
      const glm::dvec3 n = std::cos(a) * side + std::sin(a) * up;
      mesh.positions.emplace_back(c + kTube * n);
      mesh.normals.emplace_back(n);
      mesh.albedo.push_back(albedo);
    }
  }
  const auto rings = static_cast<std::uint32_t>(segments), n = static_cast<std::uint32_t>(sides);
  for (std::uint32_t i = 0; i < rings; ++i)
    for (std::uint32_t j = 0; j < n; ++j) {
      const std::uint32_t here = i * n, next = (i + 1) % rings * n, k = (j + 1) % n;
      mesh.triangles.insert(mesh.triangles.end(),
                            {{here + j, next + k, next + j}, {here + j, here + k, next + k}});
    }
  const Bounds b = bounds_of(mesh);
  const float scale = height / (b.high.y - b.low.y);
  glm::dmat4 m(scale);
  m[3] = glm::dvec4(-scale * b.centre().x, -scale * b.low.y, -scale * b.centre().z, 1);
  transform(mesh, m);
  return mesh;
}

}  // namespace penumbra::prt
