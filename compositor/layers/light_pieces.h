// The lights as a surface mirrors them.
// threads: plain values
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <span>

#include "compositor/surroundings.h"
#include "core/conventions.h"
#include "prt/geometry/material.h"

namespace penumbra::compositor {

/// A light about as large as the surface's lobe comes in four parts: seen slantwise a single lobe
/// that is wider by all of it has another form. Fitted to balls under a lamp of three degrees.
struct LightPieces {
  static constexpr std::size_t kMost = 8;
  std::array<glm::vec4, kMost> places{};  // direction, and sine of the radius
  std::array<glm::vec3, kMost> irradiances{};
  std::array<int, kMost> lights{};  // by piece
  int count = 0;

  LightPieces(std::span<const MirroredLight> all, const prt::Material& m) {
    constexpr float kSmall = .5f, kLarge = 2;  // of the lobe: larger ones would show the parts
    float alpha = m.metallic_roughness_map ? 0 : m.roughness * m.roughness;
    if (m.clearcoat > 0) alpha = std::min(alpha, m.clearcoat_roughness * m.clearcoat_roughness);
    const std::size_t used = std::min(all.size(), Surroundings::kMaxLights);
    for (std::size_t i = 0; i < used; ++i) {
      const auto radius = static_cast<float>(all[i].radius_rad);
      const bool fits = static_cast<std::size_t>(count) + 4 + (used - i - 1) <= kMost;
      if (fits && radius > kSmall * alpha && radius < kLarge * alpha)
        add_quarters(all[i], static_cast<int>(i));
      else
        add(all[i].direction, all[i].radius_rad, all[i].irradiance, static_cast<int>(i));
    }
  }

 private:
  void add(const glm::dvec3& direction, double radius_rad, const Rgb& irradiance, int light) {
    const auto at = static_cast<std::size_t>(count++);
    places[at] = glm::vec4(glm::vec3(direction),
                           static_cast<float>(std::sin(std::min(radius_rad, kPi / 2))));
    irradiances[at] = {irradiance.r, irradiance.g, irradiance.b};
    lights[at] = light;
  }
  void add_quarters(const MirroredLight& all, int light) {
    constexpr double kFromMiddle = .6;  // of the radius: the mean distance of a quarter's
    const glm::dvec3 d = all.direction,
                     x = glm::normalize(glm::cross(
                         d, std::abs(d.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0))),
                     y = glm::cross(d, x);
    for (const glm::dvec2 way : {glm::dvec2(1, 1), {-1, 1}, {-1, -1}, {1, -1}}) {
      const double off = kFromMiddle * std::sin(all.radius_rad) / std::sqrt(2.);
      add(glm::normalize(d + off * (way.x * x + way.y * y)), all.radius_rad / 2,
          all.irradiance * .25f, light);
    }
  }
};

}  // namespace penumbra::compositor
