#include "lighting/reflections/ggx.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>

#include "core/conventions.h"

namespace penumbra::lighting {

namespace {

constexpr int kTableSamples = 512;

// Van der Corput's sequence in base 2.
float radical_inverse(std::uint32_t i) {
  std::uint32_t reversed = 0;
  for (int bit = 0; bit < 32; ++bit) reversed |= (i >> bit & 1u) << (31 - bit);
  return static_cast<float>(reversed) * 0x1p-32f;
}

}  // namespace

std::vector<glm::vec3> ggx_half_vectors(float alpha, int count) {
  std::vector<glm::vec3> out;
  for (int i = 0; i < count; ++i) {
    const float u = (static_cast<float>(i) + .5f) / static_cast<float>(count),
                phi = 2 * static_cast<float>(kPi) * radical_inverse(static_cast<std::uint32_t>(i));
    const float cosine = std::sqrt((1 - u) / (1 + (alpha * alpha - 1) * u)),
                sine = std::sqrt(std::max(0.f, 1 - cosine * cosine));
    out.emplace_back(sine * std::cos(phi), sine * std::sin(phi), cosine);
  }
  return out;
}

float ggx_density(float alpha, float n_dot_m) {
  const float a2 = alpha * alpha, t = n_dot_m * n_dot_m * (a2 - 1) + 1;
  return a2 / (static_cast<float>(kPi) * t * t);
}

float ggx_visibility(float alpha, float n_dot_l, float n_dot_v) {
  const float a2 = alpha * alpha;
  const auto way = [&](float across, float along) {
    return across * std::sqrt(a2 + (1 - a2) * along * along);
  };
  return .5f / (way(n_dot_l, n_dot_v) + way(n_dot_v, n_dot_l));
}

glm::vec2 reflected_of_even(float n_dot_v, float roughness) {
  const float alpha = std::max(roughness * roughness, 1e-4f);
  const float cosine = std::clamp(n_dot_v, 1e-4f, 1.f);
  const glm::vec3 v(std::sqrt(1 - cosine * cosine), 0, cosine);
  glm::vec2 sum(0);
  for (const glm::vec3& m : ggx_half_vectors(alpha, kTableSamples)) {
    const float v_dot_m = glm::dot(v, m);
    const float n_dot_l = 2 * v_dot_m * m.z - v.z;
    if (n_dot_l <= 0 || v_dot_m <= 0) continue;
    // f n.l / pdf, without F: the pdf of l is D m.z / (4 v.m)
    const float weight = ggx_visibility(alpha, n_dot_l, cosine) * n_dot_l * 4 * v_dot_m / m.z;
    const float grazing = std::pow(1 - v_dot_m, 5.f);
    sum += glm::vec2(1 - grazing, grazing) * weight;
  }
  return sum / static_cast<float>(kTableSamples);
}

const Image<glm::vec2>& reflected_of_even_table() {
  // On one core: within another parallel loop one could wait for itself.
  static const Image<glm::vec2> table = [] {
    constexpr float kStep = 1.f / (kReflectedTable - 1);
    Image<glm::vec2> out(kReflectedTable, kReflectedTable);
    for (int y = 0; y < kReflectedTable; ++y)
      for (int x = 0; x < kReflectedTable; ++x)
        out.at(x, y) =
            reflected_of_even(kStep * static_cast<float>(x), kStep * static_cast<float>(y));
    return out;
  }();
  return table;
}

}  // namespace penumbra::lighting
