// Charts of a mesh without texture coordinates that a light map could use.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <numeric>
#include <queue>
#include <set>

#include "prt/clip/light_map.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

constexpr std::uint32_t kNone = 0xffffffffu;
constexpr float kMinCosine = .6f;  // between a chart's direction and its triangles
constexpr int kGap = 2;            // texels between charts: lookups of one touch nothing of another

struct Chart {
  std::vector<std::uint32_t> triangles;
  glm::vec3 direction;
  glm::vec2 low{0}, size{0};  // in its plane, metres at rest
  glm::vec2 corner{0};        // in the atlas, texels
};

glm::vec3 area_normal(const Character& c, std::uint32_t triangle) {
  const auto& t = c.triangles[triangle];
  return glm::cross(c.positions[t[1]] - c.positions[t[0]], c.positions[t[2]] - c.positions[t[0]]);
}

// Across edges, by the places of their ends: vertices that stand twice join what they belong to.
std::vector<std::array<std::uint32_t, 3>> neighbours_of(const Character& c) {
  const std::vector<std::uint32_t> place = places_of(c.positions);
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::pair<std::uint32_t, std::size_t>> open;
  std::vector<std::array<std::uint32_t, 3>> out(c.triangles.size(), {kNone, kNone, kNone});
  for (std::uint32_t i = 0; i < c.triangles.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = place[c.triangles[i][k]], b = place[c.triangles[i][(k + 1) % 3]];
      if (const auto other = open.find({b, a}); other != open.end()) {
        out[i][k] = other->second.first;
        out[other->second.first][other->second.second] = i;
        open.erase(other);
      } else {
        open.try_emplace({a, b}, i, k);
      }
    }
  return out;
}

struct Plane2 {
  glm::vec3 x, y;
};
Plane2 plane_of(const glm::vec3& direction) {
  const glm::vec3 any = std::abs(direction.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0);
  const glm::vec3 x = glm::normalize(glm::cross(any, direction));
  return {x, glm::cross(direction, x)};
}

// What of a chart's plane is taken: surfaces that wind around come back over themselves.
class Occupied {
 public:
  Occupied(const Character& c, const glm::vec3& direction, float cell)
      : character_(c), plane_(plane_of(direction)), cell_(cell) {}

  /// False, and nothing taken, where the triangle would lie on another.
  bool take(std::uint32_t triangle) {
    std::vector<std::pair<int, int>> cells;
    glm::vec2 p[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const glm::vec3& at = character_.positions[character_.triangles[triangle][k]];
      p[k] = glm::vec2(glm::dot(at, plane_.x), glm::dot(at, plane_.y)) / cell_;
    }
    const glm::vec2 low = glm::floor(glm::min(glm::min(p[0], p[1]), p[2])),
                    high = glm::ceil(glm::max(glm::max(p[0], p[1]), p[2]));
    // A sliver across the whole mesh: not worth its box of cells.
    constexpr float kMaxCells = 1 << 16;
    if (!((high.x - low.x) * (high.y - low.y) < kMaxCells)) return true;
    for (int y = static_cast<int>(low.y); y < static_cast<int>(high.y); ++y)
      for (int x = static_cast<int>(low.x); x < static_cast<int>(high.x); ++x) {
        const glm::vec2 at(static_cast<float>(x) + .5f, static_cast<float>(y) + .5f);
        if (!inside(p, at)) continue;
        if (taken_.contains({x, y})) return false;
        cells.emplace_back(x, y);
      }
    taken_.insert(cells.begin(), cells.end());
    return true;
  }

 private:
  static bool inside(const glm::vec2* p, const glm::vec2& at) {
    for (int k = 0; k < 3; ++k) {
      const glm::vec2 edge = p[(k + 1) % 3] - p[k], to = at - p[k];
      if (edge.x * to.y - edge.y * to.x <= 0) return false;
    }
    return true;
  }
  const Character& character_;
  Plane2 plane_;
  float cell_;
  std::set<std::pair<int, int>> taken_;
};

// Cells as small as a few to a triangle.
float cell_of(const std::vector<glm::vec3>& area_normals) {
  double sum = 0;
  for (const glm::vec3& n : area_normals) sum += glm::length(n) / 2;
  return std::max(
      1e-9f, static_cast<float>(std::sqrt(sum / static_cast<double>(area_normals.size())) / 4));
}

// Grown from the largest triangle left, as far as all face about one way at rest and none covers
// another.
std::vector<Chart> find_charts(const Character& c) {
  const auto neighbours = neighbours_of(c);
  std::vector<std::uint32_t> order(c.triangles.size());
  std::iota(order.begin(), order.end(), 0u);
  std::vector<glm::vec3> normal;
  for (std::uint32_t i = 0; i < order.size(); ++i) normal.push_back(area_normal(c, i));
  std::ranges::stable_sort(order, std::ranges::greater(),
                           [&](auto i) { return glm::length(normal[i]); });
  const float cell = cell_of(normal);
  std::vector<char> taken(c.triangles.size());
  std::vector<Chart> charts;
  for (const std::uint32_t seed : order) {
    if (taken[seed]) continue;
    Chart chart;
    const float length = glm::length(normal[seed]);
    chart.direction = length > 0 ? normal[seed] / length : glm::vec3(0, 1, 0);
    Occupied occupied(c, chart.direction, cell);
    std::queue<std::uint32_t> next;
    next.push(seed);
    taken[seed] = 1;
    occupied.take(seed);
    while (!next.empty()) {
      const std::uint32_t i = next.front();
      next.pop();
      chart.triangles.push_back(i);
      for (const std::uint32_t n : neighbours[i]) {
        if (n == kNone || taken[n]) continue;
        if (glm::dot(normal[n], chart.direction) <= kMinCosine * glm::length(normal[n])) continue;
        if (!occupied.take(n)) continue;
        taken[n] = 1;
        next.push(n);
      }
    }
    charts.push_back(std::move(chart));
  }
  return charts;
}

void measure(const Character& c, Chart& chart) {
  const Plane2 plane = plane_of(chart.direction);
  glm::vec2 low(HUGE_VALF), high(-HUGE_VALF);
  for (const std::uint32_t i : chart.triangles)
    for (const std::uint32_t v : c.triangles[i]) {
      const glm::vec2 p(glm::dot(c.positions[v], plane.x), glm::dot(c.positions[v], plane.y));
      low = glm::min(low, p);
      high = glm::max(high, p);
    }
  chart.low = low;
  chart.size = high - low;
}

// Tall ones first, in rows. False when they don't fit.
bool pack(std::vector<Chart>& charts, float scale, int width, int height) {
  std::vector<std::size_t> order(charts.size());
  std::iota(order.begin(), order.end(), 0u);
  std::ranges::stable_sort(order, std::ranges::greater(), [&](auto i) { return charts[i].size.y; });
  int x = kGap, y = kGap, row = 0;
  for (const std::size_t i : order) {
    const int w = static_cast<int>(std::ceil(charts[i].size.x * scale)) + kGap,
              h = static_cast<int>(std::ceil(charts[i].size.y * scale)) + kGap;
    if (x + w > width) {
      x = kGap;
      y += row;
      row = 0;
    }
    if (x + w > width || y + h > height) return false;
    charts[i].corner = glm::vec2(static_cast<float>(x), static_cast<float>(y));
    x += w;
    row = std::max(row, h);
  }
  return true;
}

float best_scale(std::vector<Chart>& charts, int width, int height) {
  float low = 0, high = 1;
  while (pack(charts, high, width, height) && high < 1e12f) low = high, high *= 2;
  for (int i = 0; i < 40; ++i) {
    const float middle = .5f * (low + high);
    (pack(charts, middle, width, height) ? low : high) = middle;
  }
  pack(charts, low, width, height);
  return low;
}

}  // namespace

Character with_atlas(const Character& c, int width, int height) {
  std::vector<Chart> charts = find_charts(c);
  for (Chart& chart : charts) measure(c, chart);
  const float scale = best_scale(charts, width, height);
  Character out = c;
  out.light_coordinates.assign(c.positions.size(), glm::vec2(0));
  std::vector<std::uint32_t> first_use(c.positions.size(), kNone);
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> copies;  // of a vertex, by chart
  std::vector<std::uint32_t> original(c.positions.size());
  std::iota(original.begin(), original.end(), 0u);
  const auto vertex_for = [&](std::uint32_t v, std::uint32_t chart) {
    if (first_use[v] == kNone) first_use[v] = chart;
    if (first_use[v] == chart) return v;
    const auto [found, fresh] =
        copies.try_emplace({v, chart}, static_cast<std::uint32_t>(original.size()));
    if (fresh) original.push_back(v);
    return found->second;
  };
  const glm::vec2 texels(static_cast<float>(width), static_cast<float>(height));
  for (std::uint32_t k = 0; k < charts.size(); ++k) {
    const Plane2 plane = plane_of(charts[k].direction);
    for (const std::uint32_t i : charts[k].triangles)
      for (std::size_t j = 0; j < 3; ++j) {
        const std::uint32_t v = vertex_for(c.triangles[i][j], k);
        out.triangles[i][j] = v;
        out.light_coordinates.resize(original.size());
        const glm::vec3& p = c.positions[c.triangles[i][j]];
        const glm::vec2 flat(glm::dot(p, plane.x), glm::dot(p, plane.y));
        out.light_coordinates[v] = (charts[k].corner + scale * (flat - charts[k].low)) / texels;
      }
  }
  for (std::size_t v = c.positions.size(); v < original.size(); ++v) {
    out.positions.push_back(c.positions[original[v]]);
    out.normals.push_back(c.normals[original[v]]);
    out.albedo.push_back(c.albedo[original[v]]);
    out.influences.push_back(c.influences[original[v]]);
    if (!c.texture_coordinates.empty())
      out.texture_coordinates.push_back(c.texture_coordinates[original[v]]);
    if (!c.tint.empty()) out.tint.push_back(c.tint[original[v]]);
  }
  for (Character::MorphTarget& t : out.morph_targets) {
    const auto widen = [&](std::vector<glm::vec3>& deltas) {
      if (deltas.empty()) return;
      std::vector<glm::vec3> all(original.size(), glm::vec3(0));
      for (std::size_t v = 0; v < original.size(); ++v)
        if (original[v] >= t.first && original[v] < t.first + deltas.size())
          all[v] = deltas[original[v] - t.first];
      deltas = std::move(all);
    };
    widen(t.positions);
    widen(t.normals);
    t.first = 0;
  }
  return out;
}

}  // namespace penumbra::prt
