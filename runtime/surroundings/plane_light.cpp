#include "runtime/surroundings/plane_light.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/conventions.h"
#include "runtime/surroundings/real_point.h"

namespace penumbra::runtime {

namespace {

// Bilinear between nodes; 0 outside.
float value_at(const Image<float>& nodes, double x, double y) {
  if (!(x >= 0 && y >= 0 && x < nodes.width() - 1 && y < nodes.height() - 1)) return 0;
  const int i = static_cast<int>(x), j = static_cast<int>(y);
  const float u = static_cast<float>(x - i), v = static_cast<float>(y - j);
  return (1 - v) * ((1 - u) * nodes.at(i, j) + u * nodes.at(i + 1, j)) +
         v * ((1 - u) * nodes.at(i, j + 1) + u * nodes.at(i + 1, j + 1));
}

}  // namespace

PlaneLight::PlaneLight(std::span<const prt::Plane> planes, std::span<const Rgb> open,
                       std::span<const compositor::ShadowMapOnPlane> lights,
                       std::vector<ShadowOnPlane> shadows)
    : planes_(planes), open_(open), shadows_(std::move(shadows)) {
  std::vector<const shadows::ShadowMap*> real;
  const auto add = [&](const shadows::ShadowMap& map, const Rgb& fraction, bool is_real) {
    if (map.empty()) return;
    lights_.push_back(
        {&map.virtual_occlusion, map.world_from_map.inverse(), 1 / map.cell_m, fraction, is_real});
  };
  for (const compositor::ShadowMapOnPlane& l : lights) {
    if (l.part.r < 0 || l.part.g < 0 || l.part.b < 0) continue;  // of a virtual lamp
    add(*l.shadow, l.part, false);
    if (!l.real || std::ranges::find(real, l.real) != real.end()) continue;
    real.push_back(l.real);
    add(*l.real, l.part, true);
  }
}

PlaneLight::Radiance PlaneLight::at(std::size_t plane, const glm::vec3& point) const {
  const glm::dvec3 world(point);
  Rgb residual{1, 1, 1}, objects{1, 1, 1}, real_occlusion, virtual_occlusion;
  for (const ShadowOnPlane& s : shadows_) {
    const glm::dvec3 p = s.grid_from_world * world;
    if (std::abs(p.y - double(s.grid->height)) > kOnPlane_m) continue;
    const Rgb ratio = shadows::ratio_at(*s.shadow, *s.grid, {p.x, p.z});
    if (s.real)
      residual = residual * ratio;
    else
      objects = objects * (Rgb{1, 1, 1} - s.of_open * (Rgb{1, 1, 1} - ratio));
  }
  for (const ShadowOfLight& l : lights_) {
    const glm::dvec3 p = l.map_from_world * world;
    if (std::abs(p.y) > kOnPlane_m) continue;
    const float value =
        value_at(*l.virtual_occlusion, p.x * double(l.per_cell), p.z * double(l.per_cell));
    (l.real ? real_occlusion : virtual_occlusion) += l.fraction * value;
  }
  const Rgb open = planes_[plane].albedo * open_[plane] * static_cast<float>(1 / kPi);
  Radiance out;
  for (int c = 0; c < 3; ++c) {
    const float left = std::max(residual[c] - real_occlusion[c], 0.f);
    out.before[c] = open[c] * left;
    out.now[c] = open[c] * std::max(left - (1 - objects[c]) - virtual_occlusion[c], 0.f);
  }
  return out;
}

}  // namespace penumbra::runtime
