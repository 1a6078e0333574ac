#include "prt/clip/light_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <map>
#include <numeric>

#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

using Corners = std::array<glm::vec2, 3>;

float cross(const glm::vec2& a, const glm::vec2& b) {
  return a.x * b.y - a.y * b.x;
}

struct Nearest {
  float square = std::numeric_limits<float>::max();  // distance, texels
  glm::vec3 weight{1, 0, 0};                         // barycentric
};

void try_edge(const glm::vec2& p, const Corners& t, int from, int to, Nearest& best) {
  const glm::vec2 &a = t[static_cast<std::size_t>(from)], &b = t[static_cast<std::size_t>(to)];
  const float length = glm::dot(b - a, b - a);
  const float s = length > 0 ? std::clamp(glm::dot(p - a, b - a) / length, 0.f, 1.f) : 0;
  const glm::vec2 away = p - (a + s * (b - a));
  if (const float square = glm::dot(away, away); square < best.square) {
    best.square = square;
    best.weight = glm::vec3(0);
    best.weight[from] = 1 - s;
    best.weight[to] = s;
  }
}

Nearest nearest_point(const glm::vec2& p, const Corners& t) {
  const float area = cross(t[1] - t[0], t[2] - t[0]);
  if (area != 0) {
    const glm::vec3 w(cross(t[1] - p, t[2] - p) / area, cross(t[2] - p, t[0] - p) / area,
                      cross(t[0] - p, t[1] - p) / area);
    if (w.x >= 0 && w.y >= 0 && w.z >= 0) return {0, w};
  }
  Nearest best;
  try_edge(p, t, 0, 1, best);
  try_edge(p, t, 1, 2, best);
  try_edge(p, t, 2, 0, best);
  return best;
}

Corners corners_of(const Character& c, std::size_t triangle, int width, int height) {
  const glm::vec2 size(static_cast<float>(width), static_cast<float>(height));
  Corners out;
  for (std::size_t k = 0; k < 3; ++k)
    out[k] = size * light_coordinates_of(c)[c.triangles[triangle][k]];
  return out;
}

// visit(x, y, nearest) for texels whose centre is no more than `reach` away from the triangle.
template <class Visit>
void for_texels_near(const Corners& t, float reach, int width, int height, const Visit& visit) {
  const glm::vec2 low = glm::min(glm::min(t[0], t[1]), t[2]) - reach,
                  high = glm::max(glm::max(t[0], t[1]), t[2]) + reach;
  const auto first = [](float v) {
    return static_cast<int>(std::ceil(std::clamp(v - .5f, 0.f, 1e6f)));
  };
  const auto last = [](float v, int size) {
    return std::min(size - 1, static_cast<int>(std::floor(std::clamp(v - .5f, -1.f, 1e6f))));
  };
  for (int y = first(low.y); y <= last(high.y, height); ++y)
    for (int x = first(low.x); x <= last(high.x, width); ++x) {
      const Nearest n =
          nearest_point({static_cast<float>(x) + .5f, static_cast<float>(y) + .5f}, t);
      if (n.square <= reach * reach) visit(x, y, n);
    }
}

float surface_area(const Character& c, std::size_t triangle) {
  const auto& t = c.triangles[triangle];
  return glm::length(
      glm::cross(c.positions[t[1]] - c.positions[t[0]], c.positions[t[2]] - c.positions[t[0]]));
}

}  // namespace

TextureUse texture_use(const Character& c, int width, int height) {
  TextureUse use;
  if (light_coordinates_of(c).empty()) return {1, 1, 1};
  constexpr float kInside = 1e-3f;  // of a triangle's weights: shared edges are no overlap
  std::vector<std::uint32_t> owner(
      static_cast<std::size_t>(width) * static_cast<std::size_t>(height), SurfaceLayout::kNone);
  std::size_t covered = 0, twice = 0, outside = 0;
  float all = 0, flat = 0;
  for (std::size_t i = 0; i < c.triangles.size(); ++i) {
    const Corners t = corners_of(c, i, width, height);
    all += surface_area(c, i);
    if (!(std::abs(cross(t[1] - t[0], t[2] - t[0])) > 1e-5f)) flat += surface_area(c, i);
    outside += std::ranges::any_of(c.triangles[i], [&](std::uint32_t v) {
      const glm::vec2 uv = light_coordinates_of(c)[v];
      return !(uv.x >= -1e-4f && uv.x <= 1.0001f && uv.y >= -1e-4f && uv.y <= 1.0001f);
    });
    for_texels_near(t, 0, width, height, [&](int x, int y, const Nearest& n) {
      if (std::min({n.weight.x, n.weight.y, n.weight.z}) < kInside) return;
      auto& known = owner[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                          static_cast<std::size_t>(x)];
      if (known == SurfaceLayout::kNone) {
        known = static_cast<std::uint32_t>(i);
        ++covered;
      } else {
        ++twice;
      }
    });
  }
  use.outside = static_cast<double>(outside) / static_cast<double>(c.triangles.size());
  use.overlap = covered > 0 ? static_cast<double>(twice) / static_cast<double>(covered) : 1;
  use.no_area = all > 0 ? double(flat) / double(all) : 1;
  return use;
}

Character for_light_map(Character c, int width, int height) {
  if (texture_use(c, width, height).usable()) return c;
  return with_atlas(c, width, height);
}

namespace {

std::uint16_t strongest_bone(const Character& c, const SurfaceLayout::Texel& texel) {
  const auto& t = c.triangles[texel.triangle];
  const float weight[3] = {1 - texel.u - texel.v, texel.u, texel.v};
  std::map<std::uint16_t, float> sums;
  for (std::size_t k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < Character::kInfluences; ++i)
      sums[c.influences[t[k]].bone[i]] += weight[k] * c.influences[t[k]].weight[i];
  return std::ranges::max_element(sums, {}, &std::pair<const std::uint16_t, float>::second)->first;
}

void add_light_map(const Character& c, SurfaceLayout& out) {
  constexpr float kReach = 1.415f;  // a bilinear lookup touches texels this far away
  struct Claim {
    std::uint32_t triangle = SurfaceLayout::kNone;
    Nearest nearest;
  };
  std::vector<Claim> claims(static_cast<std::size_t>(out.width) *
                            static_cast<std::size_t>(out.height));
  for (std::size_t i = 0; i < c.triangles.size(); ++i)
    for_texels_near(corners_of(c, i, out.width, out.height), kReach, out.width, out.height,
                    [&](int x, int y, const Nearest& n) {
                      Claim& claim =
                          claims[static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width) +
                                 static_cast<std::size_t>(x)];
                      if (n.square < claim.nearest.square)
                        claim = {static_cast<std::uint32_t>(i), n};
                    });
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x) {
      const Claim& claim =
          claims[static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width) +
                 static_cast<std::size_t>(x)];
      if (claim.triangle == SurfaceLayout::kNone) continue;
      out.texels.push_back({static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y),
                            claim.triangle, claim.nearest.weight.y, claim.nearest.weight.z});
    }
}

// Vertices from those of lower number that they share an edge with, texels from left, above, and
// between.
void find_neighbours(const Character& c, SurfaceLayout& out) {
  constexpr auto kNoPoint = SurfaceLayout::kNone;
  out.neighbours.assign(out.points(), {kNoPoint, kNoPoint, kNoPoint});
  const auto add = [&](std::uint32_t point, std::uint32_t earlier) {
    if (earlier >= point || out.bone[earlier] != out.bone[point]) return;
    for (std::uint32_t& n : out.neighbours[point]) {
      if (n == earlier) return;
      if (n == kNoPoint) {
        n = earlier;
        return;
      }
    }
  };
  for (const auto& t : c.triangles)
    for (std::size_t k = 0; k < 3; ++k) {
      add(t[k], t[(k + 1) % 3]);
      add(t[k], t[(k + 2) % 3]);
    }
  std::vector<std::uint32_t> at(
      static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height), kNoPoint);
  const auto point_at = [&](int x, int y, std::uint16_t bone) {
    if (x < 0 || y < 0) return kNoPoint;
    const std::uint32_t p = at[static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width) +
                               static_cast<std::size_t>(x)];
    return p != kNoPoint && out.bone[p] == bone ? p : kNoPoint;
  };
  for (std::size_t i = 0; i < out.texels.size(); ++i) {
    const auto point = static_cast<std::uint32_t>(out.vertices + i);
    const int x = out.texels[i].x, y = out.texels[i].y;
    const std::uint16_t bone = out.bone[point];
    out.neighbours[point] = {point_at(x - 1, y, bone), point_at(x, y - 1, bone),
                             point_at(x - 1, y - 1, bone)};
    at[static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width) +
       static_cast<std::size_t>(x)] = point;
  }
}

}  // namespace

SurfaceLayout lay_out(const Character& c, int width, int height) {
  SurfaceLayout out;
  out.width = width;
  out.height = height;
  out.vertices = c.positions.size();
  if (width > 0 && height > 0) add_light_map(c, out);
  for (const Character::Influence& f : c.influences) out.bone.push_back(f.bone[0]);
  for (const SurfaceLayout::Texel& t : out.texels) out.bone.push_back(strongest_bone(c, t));
  find_neighbours(c, out);
  return out;
}

void add_texels(const Character& c, const SurfaceLayout& layout, Mesh& mesh) {
  mesh.positions.resize(layout.points());
  mesh.normals.resize(layout.points());
  mesh.albedo.resize(layout.points());
  for (std::size_t i = 0; i < layout.texels.size(); ++i) {
    const SurfaceLayout::Texel& texel = layout.texels[i];
    // The character's own order of corners: a mirroring frame has turned the mesh's.
    const auto& t = c.triangles[texel.triangle];
    const float weight[3] = {1 - texel.u - texel.v, texel.u, texel.v};
    glm::vec3 p(0), n(0);
    Rgb albedo;
    for (std::size_t k = 0; k < 3; ++k) {
      p += weight[k] * mesh.positions[t[k]];
      n += weight[k] * mesh.normals[t[k]];
      albedo += mesh.albedo[t[k]] * weight[k];
    }
    glm::vec3 lifted = p;
    for (std::size_t k = 0; k < 3; ++k) {
      const glm::vec3& normal = mesh.normals[t[k]];
      lifted -= weight[k] * std::min(0.f, glm::dot(p - mesh.positions[t[k]], normal)) * normal;
    }
    const std::size_t point = layout.vertices + i;
    mesh.positions[point] = lifted;
    mesh.normals[point] = glm::length(n) > 1e-6f ? glm::normalize(n) : mesh.normals[t[0]];
    mesh.albedo[point] = albedo;
  }
}

}  // namespace penumbra::prt
