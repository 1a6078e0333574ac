#include "prt/transfer/visibility_map.h"

#include <bit>
#include <cassert>
#include <glm/geometric.hpp>

#include "prt/geometry/mesh.h"
#include "prt/rays/ray_pattern.h"
#include "prt/transfer/internal/visibility_kernel.h"

namespace penumbra::prt {

HemiOctFrame HemiOctFrame::of(std::size_t vertex, const glm::vec3& normal) {
  const RayPatterns::Turn turn = RayPatterns::turn_of(vertex);
  const glm::mat3 frame = frame_around(normal + glm::vec3(0));  // -0 would turn it
  // Neighbours differ most along a sequence of the plane's golden ratio.
  constexpr double kFirst = .7548776662466927, kSecond = .5698402909980532;
  const auto within = [&](double step) {
    return std::fmod(.5 + step * static_cast<double>(vertex), 1.) < .5 ? .25f : .75f;
  };
  return {turn.cosine * frame[0] + turn.sine * frame[1],
          turn.cosine * frame[1] - turn.sine * frame[0],
          frame[2],
          {within(kFirst), within(kSecond)}};
}

glm::vec3 HemiOctFrame::direction(int x, int y, int cells) const {
  const glm::vec2 at = 2.f * (glm::vec2(x, y) + shift(cells)) / static_cast<float>(cells) - 1.f;
  const float across = .5f * (at.x + at.y), along = .5f * (at.x - at.y);
  return glm::normalize(across * first + along * second +
                        (1 - std::abs(across) - std::abs(along)) * normal);
}

glm::ivec2 HemiOctFrame::cell(const glm::vec3& d, int cells) const {
  const float across = glm::dot(d, first), along = glm::dot(d, second);
  const float sum = std::max(glm::dot(d, normal), 1e-20f) + std::abs(across) + std::abs(along);
  const glm::vec2 at = glm::vec2(across + along, across - along) / sum;
  const auto largest = static_cast<float>(cells);
  return glm::ivec2(
      glm::clamp(.5f * largest * (at + 1.f) + .5f - shift(cells), 0.f, largest - .5f));
}

VisibilityLookup::VisibilityLookup(const VisibilityMap& visibility, const Mesh& mesh)
    : visibility_(&visibility), samples_(mesh) {
  const std::vector<glm::vec3>& normals = mesh.normals;
  assert(!visibility.empty() && visibility.refined.size() == normals.size());
  heads_.reserve(normals.size());
  std::size_t first = 0;
  for (std::size_t i = 0; i < normals.size(); ++i) {
    heads_.push_back({HemiOctFrame::of(i, normals[i]), static_cast<std::uint32_t>(first),
                      visibility.refined[i]});
    first += static_cast<std::size_t>(std::popcount(visibility.refined[i]));
  }
  assert(first == visibility.fine.size());
}

void VisibilityLookup::look_up(const VisibilitySamples& directions_used,
                               std::span<const std::uint32_t> vertices, std::size_t first,
                               std::size_t last, std::span<CosineSums> out) const {
  assert(directions_used.turns() > 0 &&
         last <= (vertices.empty() ? heads_.size() : vertices.size()));
  assert((directions_used.cells() == VisibilityMap::kCells &&
          directions_used.each() % VisibilitySamples::kMax == 0) ||
         (directions_used.cells() == VisibilityMap::kFineCells &&
          directions_used.each() % VisibilitySamples::kFew == 0));
  const VisibilityRows rows{heads_.data(),
                            visibility_->open.data(),
                            visibility_->fine.data(),
                            directions_used.x().data(),
                            directions_used.y().data(),
                            directions_used.z().data(),
                            directions_used.counts().data(),
                            directions_used.each(),
                            directions_used.turns(),
                            vertices.empty() ? nullptr : vertices.data()};
  if (directions_used.cells() == VisibilityMap::kCells)
    look_coarse(rows, first, last, out.data());
  else
    look_fine(rows, first, last, out.data());
}

}  // namespace penumbra::prt
