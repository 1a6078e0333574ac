#include "runtime/shading/sent_radiance.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "core/conventions.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"

namespace penumbra::runtime {

namespace {

constexpr int kBands = 3;              // a cosine has little beyond
constexpr std::size_t kEnough = 2000;  // vertices, for a mean
constexpr float kMinFacing = .05f;     // of the mean: below, truncation decides

}  // namespace

std::vector<float> vertex_areas(const prt::Mesh& mesh) {
  std::vector<float> out(mesh.positions.size());
  for (const auto& t : mesh.triangles) {
    const glm::vec3& a = mesh.positions[t[0]];
    const float third =
        glm::length(glm::cross(mesh.positions[t[1]] - a, mesh.positions[t[2]] - a)) / 6;
    for (const auto v : t) out[v] += third;
  }
  return out;
}

SentRadiance::SentRadiance(const prt::Mesh& mesh, std::span<const float> areas,
                           std::span<const float> relit) {
  const std::size_t count = mesh.positions.size(), stride = relit.size() / 3;
  assert(areas.size() == count && stride >= count);
  RadianceSh sent(kBands), facing(kBands);
  double basis[kBands * kBands];
  // Texels of a light map follow the vertices and have no area.
  const auto counted =
      static_cast<std::size_t>(std::ranges::count_if(areas, [](float area) { return area > 0; }));
  const std::size_t step = std::max<std::size_t>(1, counted / kEnough);
  for (std::size_t i = 0, k = 0; i < count; ++i) {
    if (!(areas[i] > 0) || k++ % step != 0) continue;
    lighting::evaluate_basis(kBands, glm::dvec3(mesh.normals[i]), basis);
    const Rgb exit =
        Rgb{relit[i], relit[stride + i], relit[2 * stride + i]} * mesh.albedo[i] * areas[i];
    for (int n = 0; n < facing.size(); ++n) {
      sent[n] += exit * static_cast<float>(basis[n]);
      facing[n] += Rgb{1, 1, 1} * (areas[i] * static_cast<float>(basis[n]));
    }
  }
  sent_ = lighting::irradiance(sent);
  facing_ = lighting::irradiance(facing);
  // The mean over all directions: the first coefficient times Y_0.
  min_facing_ = kMinFacing * facing_[0].g / static_cast<float>(std::sqrt(4 * kPi));
}

Rgb SentRadiance::towards(const glm::vec3& to) const {
  const glm::dvec3 d = glm::normalize(glm::dvec3(to));
  const float facing = lighting::evaluate(facing_, d).g;
  Rgb out = lighting::evaluate(sent_, d) * (1 / std::max(facing, min_facing_));
  for (int c = 0; c < 3; ++c) out[c] = std::max(out[c], 0.f);
  return out;
}

}  // namespace penumbra::runtime
