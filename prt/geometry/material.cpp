#include "prt/geometry/material.h"

#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

namespace penumbra::prt {

void SurfaceMaterials::extend(std::span<const std::array<std::uint32_t, 2>> middles) {
  for (const auto& [a, b] : middles) {
    material.push_back(material[a]);
    for (std::vector<glm::vec2>& set : coordinates)
      if (!set.empty()) set.push_back(.5f * (set[a] + set[b]));
    if (!tint.empty()) tint.push_back((tint[a] + tint[b]) * .5f);
    if (tangents.empty()) continue;
    const glm::vec3 mean = glm::vec3(tangents[a]) + glm::vec3(tangents[b]);
    const float length = glm::length(mean);
    tangents.emplace_back(length > 1e-6f ? mean / length : glm::vec3(tangents[a]), tangents[a].w);
  }
}

}  // namespace penumbra::prt
