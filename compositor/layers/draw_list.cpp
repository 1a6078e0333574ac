#include "compositor/layers/draw_list.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <numeric>
#include <optional>
#include <set>

namespace penumbra::compositor {

namespace {

constexpr float kColourTolerance = .02f, kSteepest = .25f;
constexpr int kMaxRounds = 8;
constexpr double kMinGain = .05;   // of the triangles; a round that takes fewer away is the last
constexpr float kMinCosine = .9f;  // between a triangle before and after

using DrawTriangle = DrawList::DrawTriangle;

// Six times the volume that the triangles enclose; negative when they face inwards.
double signed_volume(const prt::Mesh& mesh) {
  double sum = 0;
  for (const DrawTriangle& t : mesh.triangles)
    sum += glm::dot(glm::dvec3(mesh.positions[t[0]]),
                    glm::cross(glm::dvec3(mesh.positions[t[1]]), glm::dvec3(mesh.positions[t[2]])));
  return sum;
}

bool every_edge_is_shared(const prt::Mesh& mesh) {
  // Creases split a vertex in two; the place is what counts.
  const std::vector<std::uint32_t> place = prt::places_of(mesh.positions);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges, reversed;
  for (const DrawTriangle& t : mesh.triangles)
    for (std::size_t i = 0; i < 3; ++i) {
      const std::uint32_t a = place[t[i]], b = place[t[(i + 1) % 3]];
      if (a == b) continue;
      edges.emplace_back(a, b);
      reversed.emplace_back(b, a);
    }
  std::ranges::sort(edges);
  std::ranges::sort(reversed);
  return edges == reversed;
}

bool has(const DrawTriangle& t, std::uint32_t v) {
  return t[0] == v || t[1] == v || t[2] == v;
}

glm::vec3 area_normal(const prt::Mesh& mesh, const DrawTriangle& t) {
  const glm::vec3 &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
  return glm::cross(b - a, c - a);
}

float longest_edge(const prt::Mesh& mesh, const DrawTriangle& t) {
  const glm::vec3 &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
  return std::max({glm::distance(a, b), glm::distance(b, c), glm::distance(c, a)});
}

}  // namespace

/// Rounds of collapses that no colour forbids.
class DrawList::Finder {
 public:
  Finder(const prt::Mesh& mesh, float tolerance, std::span<const prt::Mesh> forms, DrawList& out)
      : mesh_(mesh),
        forms_(forms),
        tolerance_(tolerance),
        out_(out),
        triangles_(mesh.triangles),
        moved_(mesh.positions.size(), 0.f) {}

  void run() {
    for (int round = 0; round < kMaxRounds; ++round) {
      const std::size_t before = triangles_.size();
      collapse_round();
      if (static_cast<double>(before - triangles_.size()) < kMinGain * static_cast<double>(before))
        return;
    }
  }

 private:
  struct CollapseCandidate {
    Collapse collapse;
    float moved, longest;
  };

  void collapse_round() {
    list_fans();
    busy_.assign(mesh_.positions.size(), 0);
    into_.resize(mesh_.positions.size());
    std::iota(into_.begin(), into_.end(), 0u);
    for (std::uint32_t v = 0; v < mesh_.positions.size(); ++v) {
      if (busy_[v] || fan(v).empty() || !find_ring(v)) continue;
      std::optional<CollapseCandidate> best;
      for (const std::uint32_t into : ring_)
        if (auto c = candidate(v, into); c && (!best || c->longest < best->longest)) best = c;
      if (best) take(*best);
    }
    std::vector<DrawTriangle> kept;
    for (DrawTriangle t : triangles_) {
      for (std::uint32_t& v : t) v = into_[v];
      if (t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) kept.push_back(t);
    }
    triangles_ = std::move(kept);
  }

  void list_fans() {
    fan_begin_.assign(mesh_.positions.size() + 1, 0);
    for (const DrawTriangle& t : triangles_)
      for (const std::uint32_t v : t) ++fan_begin_[v + 1];
    std::partial_sum(fan_begin_.begin(), fan_begin_.end(), fan_begin_.begin());
    fans_.resize(triangles_.size() * 3);
    std::vector<std::uint32_t> next(fan_begin_.begin(), fan_begin_.end() - 1);
    for (std::uint32_t i = 0; i < triangles_.size(); ++i)
      for (const std::uint32_t v : triangles_[i]) fans_[next[v]++] = i;
  }
  std::span<const std::uint32_t> fan(std::uint32_t v) const {
    return std::span(fans_).subspan(fan_begin_[v], fan_begin_[v + 1] - fan_begin_[v]);
  }

  // The neighbours; false where the triangles around the vertex do not close to one ring.
  bool find_ring(std::uint32_t v) {
    ring_.clear();
    std::vector<std::uint32_t>& ends = ends_;
    ends.clear();
    for (const std::uint32_t i : fan(v))
      for (const std::uint32_t u : triangles_[i])
        if (u != v) ends.push_back(u);
    std::ranges::sort(ends);
    if (ends.size() < 6) return false;
    for (std::size_t i = 0; i < ends.size(); i += 2) {
      if (i + 1 == ends.size() || ends[i] != ends[i + 1]) return false;
      if (i > 0 && ends[i] == ends[i - 1]) return false;
      ring_.push_back(ends[i]);
    }
    return true;
  }

  // More than the two triangles at the edge in common would fold the surface onto itself.
  bool joins_cleanly(std::uint32_t v, std::uint32_t into) const {
    std::set<std::uint32_t> around;
    for (const std::uint32_t i : fan(into))
      for (const std::uint32_t u : triangles_[i])
        if (u != into && u != v) around.insert(into_[u]);
    return std::ranges::count_if(ring_, [&](auto u) { return around.contains(u); }) == 2;
  }

  std::optional<CollapseCandidate> candidate(std::uint32_t v, std::uint32_t into) const {
    CollapseCandidate c{{v, into, {}, {}, 0, 0}, HUGE_VALF, 0};
    for (const std::uint32_t i : fan(v)) {
      const DrawTriangle& before = triangles_[i];
      if (has(before, into)) continue;
      DrawTriangle after = before;
      std::ranges::replace(after, v, into);
      if (!faces_alike(mesh_, before, after)) return {};
      const glm::vec3 n1 = area_normal(mesh_, after);
      const float l1 = glm::length(n1);
      c.longest = std::max(c.longest, longest_edge(mesh_, after));
      // A sliver shows nothing but its noise.
      if (l1 < .1f * c.longest * c.longest) return {};
      settle(c, after, n1 / (l1 * l1));
    }
    for (const prt::Mesh& form : forms_) {
      if (!(c.moved <= tolerance_)) return {};
      c.moved = std::max(c.moved, moved_in(form, c.collapse));
    }
    c.moved += moved_[v];
    if (!(c.moved <= tolerance_) || !joins_cleanly(v, into)) return {};
    for (const prt::Mesh& form : forms_)
      for (const std::uint32_t i : fan(v)) {
        DrawTriangle after = triangles_[i];
        if (has(after, into)) continue;
        std::ranges::replace(after, v, into);
        if (!faces_alike(form, triangles_[i], after)) return {};
      }
    return c;
  }

  static bool faces_alike(const prt::Mesh& mesh, const DrawTriangle& before,
                          const DrawTriangle& after) {
    const glm::vec3 n0 = area_normal(mesh, before), n1 = area_normal(mesh, after);
    const float l0 = glm::length(n0), l1 = glm::length(n1);
    return l0 > 0 && l1 > 0 && glm::dot(n0, n1) >= kMinCosine * l0 * l1;
  }

  static float moved_in(const prt::Mesh& form, const Collapse& c) {
    glm::vec3 over(0);
    for (int k = 0; k < 3; ++k)
      over += c.weights[k] * form.positions[c.corners[static_cast<std::size_t>(k)]];
    return glm::distance(form.positions[c.vertex], over);
  }

  // Keeps the triangle over the vertex: where its projection has no negative weight.
  void settle(CollapseCandidate& c, const DrawTriangle& t, const glm::vec3& normal_by_area) const {
    const glm::vec3 &p = mesh_.positions[c.collapse.vertex], &a = mesh_.positions[t[0]],
                    &b = mesh_.positions[t[1]], &d = mesh_.positions[t[2]];
    glm::vec3 w(glm::dot(glm::cross(b - p, d - p), normal_by_area),
                glm::dot(glm::cross(d - p, a - p), normal_by_area),
                glm::dot(glm::cross(a - p, b - p), normal_by_area));
    w = glm::max(w, 0.f);
    w /= w.x + w.y + w.z;
    const float away = glm::distance(p, w.x * a + w.y * b + w.z * d);
    if (away >= c.moved) return;
    c.moved = away;
    c.collapse.corners = t;
    c.collapse.weights = w;
  }

  void take(CollapseCandidate& c) {
    c.collapse.ring_begin = static_cast<std::uint32_t>(out_.rings_.size());
    out_.rings_.insert(out_.rings_.end(), ring_.begin(), ring_.end());
    c.collapse.ring_end = static_cast<std::uint32_t>(out_.rings_.size());
    out_.collapses_.push_back(c.collapse);
    into_[c.collapse.vertex] = c.collapse.into;
    for (const std::uint32_t u : ring_) {
      busy_[u] = 1;
      moved_[u] = std::max(moved_[u], c.moved);
    }
  }

  const prt::Mesh& mesh_;
  const std::span<const prt::Mesh> forms_;
  const float tolerance_;
  DrawList& out_;
  std::vector<DrawTriangle> triangles_;
  std::vector<float> moved_;  // what earlier rounds moved around each vertex
  std::vector<std::uint32_t> fan_begin_, fans_, ring_, ends_, into_;
  std::vector<char> busy_;
};

DrawList::DrawList(const prt::Mesh& mesh, float tolerance, std::span<const prt::Mesh> forms)
    : triangles_(mesh.triangles),
      stands_for_(mesh.positions.size()),
      needed_(mesh.positions.size()),
      closed_(every_edge_is_shared(mesh) && signed_volume(mesh) > 0) {
  if (tolerance > 0) Finder(mesh, tolerance, forms, *this).run();
}

bool DrawList::keeps_colour(const Collapse& c, std::span<const Rgb> colours, float floor) const {
  const Rgb &was = colours[c.vertex], &x = colours[c.corners[0]], &y = colours[c.corners[1]],
            &z = colours[c.corners[2]];
  const auto near = [&](float v, float a, float b, float d) {
    const float is = c.weights.x * a + c.weights.y * b + c.weights.z * d;
    return std::abs(is - v) <= kColourTolerance * std::max(v, floor);
  };
  if (!near(was.r, x.r, y.r, z.r) || !near(was.g, x.g, y.g, z.g) || !near(was.b, x.b, y.b, z.b))
    return false;
  // Triangles across an edge of shadow must not grow over vertices that went before.
  const auto level = [&](float v, float u) {
    return std::abs(u - v) <= kSteepest * std::max(v, floor);
  };
  return std::all_of(&rings_[c.ring_begin], &rings_[c.ring_end], [&](std::uint32_t i) {
    const Rgb& u = colours[i];
    return level(was.r, u.r) && level(was.g, u.g) && level(was.b, u.b);
  });
}

std::span<const DrawTriangle> DrawList::select(std::span<const Rgb> colours) {
  double sum = 0;
  for (const Rgb& c : colours) sum += c.r + c.g + c.b;
  const float floor = .25f * static_cast<float>(sum / (3. * static_cast<double>(colours.size())));
  std::ranges::fill(needed_, char{0});
  std::iota(stands_for_.begin(), stands_for_.end(), 0u);
  for (const Collapse& c : collapses_) {
    if (!needed_[c.vertex] && keeps_colour(c, colours, floor)) {
      stands_for_[c.vertex] = c.into;
    } else {
      for (std::uint32_t i = c.ring_begin; i < c.ring_end; ++i) needed_[rings_[i]] = 1;
    }
  }
  // From the last round back: what a vertex went into may have gone itself.
  for (auto c = collapses_.rbegin(); c != collapses_.rend(); ++c)
    stands_for_[c->vertex] = stands_for_[stands_for_[c->vertex]];
  selected_.clear();
  for (const DrawTriangle& t : triangles_) {
    const DrawTriangle s{stands_for_[t[0]], stands_for_[t[1]], stands_for_[t[2]]};
    if (s[0] != s[1] && s[1] != s[2] && s[2] != s[0]) selected_.push_back(s);
  }
  return selected_;
}

}  // namespace penumbra::compositor
