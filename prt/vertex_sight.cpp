#include "prt/vertex_sight.h"

#include <cassert>
#include <glm/geometric.hpp>

#include "prt/ray_pattern.h"
#include "prt/sight_kernel.h"

namespace penumbra::prt {

SightFrame SightFrame::of(std::size_t vertex, const glm::vec3& normal) {
  const RayPatterns::Turn turn = RayPatterns::turn_of(vertex);
  const glm::mat3 frame = frame_around(normal + glm::vec3(0));  // -0 would turn it
  // Neighbours differ most along a sequence of the plane's golden ratio.
  constexpr double kFirst = .7548776662466927, kSecond = .5698402909980532;
  const auto within = [&](double step) {
    return static_cast<float>(std::fmod(.5 + step * static_cast<double>(vertex), 1.));
  };
  return {turn.cosine * frame[0] + turn.sine * frame[1],
          turn.cosine * frame[1] - turn.sine * frame[0],
          frame[2],
          {within(kFirst), within(kSecond)}};
}

glm::vec3 SightFrame::direction(int x, int y, int cells) const {
  const glm::vec2 at = 2.f * (glm::vec2(x, y) + shift) / static_cast<float>(cells) - 1.f;
  const float across = .5f * (at.x + at.y), along = .5f * (at.x - at.y);
  return glm::normalize(across * first + along * second +
                        (1 - std::abs(across) - std::abs(along)) * normal);
}

SightLookup::SightLookup(const VertexSight& sight, std::span<const glm::vec3> normals)
    : sight_(&sight) {
  assert(!sight.empty() && sight.open.size() == sight.words() * normals.size());
  frames_.reserve(normals.size());
  for (std::size_t i = 0; i < normals.size(); ++i) frames_.push_back(SightFrame::of(i, normals[i]));
}

void SightLookup::look(const SightTaps& taps, std::size_t first, std::size_t last,
                       std::span<CosineSums> out) const {
  assert(taps.turns() > 0 && last <= frames_.size());
  prt::look({frames_.data(), sight_->open.data(), sight_->words(), sight_->cells, taps.x().data(),
             taps.y().data(), taps.z().data(), taps.counts().data(), taps.turns()},
            first, last, out.data());
}

}  // namespace penumbra::prt
