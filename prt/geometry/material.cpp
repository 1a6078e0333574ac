#include "prt/geometry/material.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

#include "codec/display.h"

namespace penumbra::prt {

int texel_at(float place, int size, Texture::Wrap wrap) {
  const float t = std::isfinite(place) ? place : 0, turns = std::floor(t);
  float inside = t - turns;
  if (wrap == Texture::Wrap::kClamp) inside = std::clamp(t, 0.f, 1.f);
  if (wrap == Texture::Wrap::kMirror && std::fmod(turns, 2.f) != 0) inside = 1 - inside;
  return std::clamp(static_cast<int>(inside * static_cast<float>(size)), 0, size - 1);
}

const std::array<float, 256>& linear_of_srgb() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> out{};
    for (std::size_t i = 0; i < out.size(); ++i)
      out[i] = codec::linear_from_srgb(static_cast<float>(i) / 255);
    return out;
  }();
  return table;
}

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
