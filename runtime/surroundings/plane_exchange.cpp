#include "runtime/surroundings/plane_exchange.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <memory_resource>

#include "core/conventions.h"
#include "core/threads/scratch.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/geometry/rays.h"
#include "runtime/surroundings/real_point.h"

namespace penumbra::runtime {

namespace {

// Even in the disc under the hemisphere, which is by the cosine above it.
glm::vec3 cosine_direction(int i) {
  const double r2 = (i + .5) / PlaneExchange::kRays, turn = i * kPi * (3 - std::sqrt(5.));
  return {std::sqrt(r2) * std::cos(turn), std::sqrt(r2) * std::sin(turn), std::sqrt(1 - r2)};
}

}  // namespace

PlaneExchange::PlaneExchange(std::span<const prt::Plane> planes, const glm::dvec3& middle)
    : planes_(planes) {
  for (std::size_t p = 0; p < planes.size(); ++p) {
    const prt::Plane& plane = planes[p];
    feet_.emplace_back(middle - glm::dot(middle - plane.point, plane.normal) * plane.normal);
    const glm::mat3 frame = prt::frame_around(glm::vec3(plane.normal));
    for (int i = 0; i < kRays; ++i) {
      const glm::vec3 direction = frame * cosine_direction(i);
      RealPoint met;
      meet_planes(planes, feet_[p], direction, static_cast<int>(p), met);
      if (met.plane != RealPoint::kMesh)
        hidden_.push_back(
            {static_cast<std::uint16_t>(p), static_cast<std::uint16_t>(met.plane), direction});
    }
  }
}

bool PlaneExchange::is_lit(std::size_t plane, const glm::dvec3& towards) const {
  RealPoint met;
  meet_planes(planes_, feet_[plane], glm::vec3(towards), static_cast<int>(plane), met);
  return met.plane == RealPoint::kMesh;
}

void PlaneExchange::changes(std::span<const RadianceSh* const> residuals,
                            std::span<const lighting::DistantLight> lights,
                            std::span<Rgb> out) const {
  const Scratch::Scope scope;
  // By plane: irradiance where no other plane is, and what others change, over pi.
  std::pmr::vector<Rgb> open(planes_.size(), scope.memory()),
      hidden(planes_.size(), scope.memory()), change(planes_.size(), scope.memory());
  for (std::size_t p = 0; p < planes_.size(); ++p) {
    open[p] = lighting::evaluate(lighting::irradiance(*residuals[p]), planes_[p].normal);
    for (const lighting::DistantLight& light : lights)
      if (is_lit(p, light.direction)) open[p] += lighting::irradiance(light, planes_[p].normal);
  }
  for (const HiddenRay& ray : hidden_)
    hidden[ray.from] +=
        lighting::evaluate(*residuals[ray.from], glm::dvec3(ray.direction)) * kOfRay;
  constexpr auto kInversePi = static_cast<float>(1 / kPi);
  const auto exit_of = [&](std::size_t p) {
    const Rgb e = open[p] * kInversePi + change[p];
    return planes_[p].albedo * Rgb{std::max(e.r, 0.f), std::max(e.g, 0.f), std::max(e.b, 0.f)};
  };
  std::pmr::vector<Rgb> sent(planes_.size(), scope.memory());
  for (int bounce = 0; bounce < kBounces; ++bounce) {
    for (std::size_t p = 0; p < planes_.size(); ++p) sent[p] = exit_of(p);
    for (std::size_t p = 0; p < planes_.size(); ++p) change[p] = hidden[p] * -1.f;
    for (const HiddenRay& ray : hidden_) change[ray.from] += sent[ray.to] * kOfRay;
  }
  for (std::size_t p = 0; p < planes_.size(); ++p) out[p] = change[p] * static_cast<float>(kPi);
}

}  // namespace penumbra::runtime
