#include "prt/clip/internal/seams.h"

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <optional>
#include <tuple>

#include "core/threads/background_task.h"
#include "core/threads/parallel.h"

namespace penumbra::prt {

namespace {

constexpr float kSmooth = .95f;  // cosine between the normals of two sides of one surface
constexpr float kSamples = 2;    // lookups a texel of an edge's length
// What a texel's own value weighs beside a lookup that must meet
constexpr double kStiffness = .02;

using Place = std::tuple<float, float, float>;
Place place_of(const glm::vec3& p) {
  return {p.x, p.y, p.z};
}

struct SeamEdge {
  std::uint32_t a, b;
};

// The texels that a bilinear lookup reads.
class TexelMap {
 public:
  TexelMap(const Character& c, const SurfaceLayout& layout)
      : coordinates_(light_coordinates_of(c)),
        width_(layout.width),
        height_(layout.height),
        at_(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_),
            SurfaceLayout::kNone) {
    for (std::size_t i = 0; i < layout.texels.size(); ++i)
      at_[slot(layout.texels[i].x, layout.texels[i].y)] =
          static_cast<std::uint32_t>(layout.vertices + i);
  }

  glm::vec2 texel(std::uint32_t vertex) const {
    return coordinates_[vertex] *
           glm::vec2(static_cast<float>(width_), static_cast<float>(height_));
  }
  float length(const SeamEdge& e) const { return glm::distance(texel(e.a), texel(e.b)); }

  // Writes four points and weights; false where one is missing that counts.
  bool look_up(const SeamEdge& e, float fraction, float sign, std::uint32_t* points,
               float* weights) const {
    const glm::vec2 at = glm::mix(texel(e.a), texel(e.b), fraction) - .5f;
    const glm::vec2 low = glm::floor(at), part = at - low;
    for (int k = 0; k < 4; ++k) {
      const int x = std::clamp(static_cast<int>(low.x) + k % 2, 0, width_ - 1),
                y = std::clamp(static_cast<int>(low.y) + k / 2, 0, height_ - 1);
      const float w = (k % 2 ? part.x : 1 - part.x) * (k / 2 ? part.y : 1 - part.y);
      points[k] = at_[slot(x, y)];
      weights[k] = sign * w;
      if (points[k] != SurfaceLayout::kNone) continue;
      if (w > 0) return false;
      points[k] = points[0];
    }
    return points[0] != SurfaceLayout::kNone;
  }

 private:
  std::size_t slot(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }
  const std::vector<glm::vec2>& coordinates_;
  int width_, height_;
  std::vector<std::uint32_t> at_;
};

}  // namespace

Seams::Seams(const Character& c, const SurfaceLayout& layout) {
  if (layout.texels.empty()) return;
  const TexelMap map(c, layout);
  const auto smooth = [&](std::uint32_t v, std::uint32_t w) {
    return glm::dot(glm::normalize(c.normals[v]), glm::normalize(c.normals[w])) > kSmooth;
  };
  const auto meet = [&](const SeamEdge& one, const SeamEdge& other) {
    const auto count =
        static_cast<int>(std::ceil(kSamples * std::max({map.length(one), map.length(other), .5f})));
    for (int i = 0; i < count; ++i) {
      const float fraction = (static_cast<float>(i) + .5f) / static_cast<float>(count);
      Lookup l;
      if (map.look_up(one, fraction, 1, &l.point[0], &l.weight[0]) &&
          map.look_up(other, fraction, -1, &l.point[4], &l.weight[4]))
        lookups_.push_back(l);
    }
  };
  // By the places of their ends: vertices at a seam stand twice.
  std::map<std::pair<Place, Place>, SeamEdge> open;
  for (const auto& t : c.triangles)
    for (std::size_t k = 0; k < 3; ++k) {
      const SeamEdge e{t[k], t[(k + 1) % 3]};
      const Place a = place_of(c.positions[e.a]), b = place_of(c.positions[e.b]);
      const auto other = open.find({b, a});
      if (other == open.end()) {
        open.try_emplace({a, b}, e);
        continue;
      }
      const SeamEdge back{other->second.b, other->second.a};  // the same way round
      open.erase(other);
      const bool apart = glm::distance(map.texel(e.a), map.texel(back.a)) > 1e-3f ||
                         glm::distance(map.texel(e.b), map.texel(back.b)) > 1e-3f;
      if (apart && smooth(e.a, back.a) && smooth(e.b, back.b)) meet(e, back);
    }
  variable_.assign(layout.points(), SurfaceLayout::kNone);
  for (const Lookup& l : lookups_)
    for (const std::uint32_t p : l.point)
      if (variable_[p] == SurfaceLayout::kNone) {
        variable_[p] = static_cast<std::uint32_t>(points_.size());
        points_.push_back(p);
      }
}

void Seams::equalise(std::span<const char> hidden, std::size_t stride,
                     std::span<float> maps) const {
  if (empty()) return;
  using Sparse = Eigen::SparseMatrix<double>;
  std::vector<Eigen::Triplet<double>> terms;
  std::vector<const Lookup*> used;
  for (const Lookup& l : lookups_) {
    if (std::ranges::any_of(l.point, [&](auto p) { return hidden[p] != 0; })) continue;
    used.push_back(&l);
    for (std::size_t i = 0; i < 8; ++i)
      for (std::size_t j = 0; j < 8; ++j)
        terms.emplace_back(variable_[l.point[i]], variable_[l.point[j]],
                           double(l.weight[i]) * l.weight[j]);
  }
  const auto count = static_cast<Eigen::Index>(points_.size());
  for (Eigen::Index i = 0; i < count; ++i) terms.emplace_back(i, i, kStiffness);
  Sparse normal(count, count);
  normal.setFromTriplets(terms.begin(), terms.end());
  const Eigen::SimplicialLDLT<Sparse> solver(normal);  // positive definite by the stiffness
  if (solver.info() != Eigen::Success) return;
  parallel_for(std::size_t{0}, maps.size() / stride, [&](std::size_t m) {
    const std::span<float> map = maps.subspan(m * stride, stride);
    Eigen::VectorXd wanted = Eigen::VectorXd::Zero(count);
    for (const Lookup* l : used) {
      double apart = 0;
      for (std::size_t i = 0; i < 8; ++i) apart += double(l->weight[i]) * map[l->point[i]];
      for (std::size_t i = 0; i < 8; ++i) wanted[variable_[l->point[i]]] -= l->weight[i] * apart;
    }
    const Eigen::VectorXd change = solver.solve(wanted);
    for (Eigen::Index i = 0; i < count; ++i)
      map[points_[static_cast<std::size_t>(i)]] += static_cast<float>(change[i]);
  });
}

}  // namespace penumbra::prt
