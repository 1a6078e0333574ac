#include "runtime/surroundings/plane_exchange.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <memory_resource>

#include "core/conventions.h"
#include "core/threads/scratch.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"
#include "runtime/surroundings/real_point.h"

namespace penumbra::runtime {

namespace {

// On a plane, near a point and in front of all planes that it runs into: beyond them it is not to
// be seen.
glm::dvec3 place_on(std::span<const prt::Plane> planes, std::size_t index, glm::dvec3 near) {
  constexpr int kRounds = 8;
  constexpr double kBefore_m = .05, kParallel = 1e-3;
  const glm::dvec3 normal = planes[index].normal;
  near -= glm::dot(near - planes[index].point, normal) * normal;
  for (int round = 0; round < kRounds; ++round)
    for (std::size_t q = 0; q < planes.size(); ++q) {
      const glm::dvec3 along = planes[q].normal - glm::dot(planes[q].normal, normal) * normal;
      const double height = glm::dot(near - planes[q].point, planes[q].normal);
      if (q == index || height >= kBefore_m || glm::length(along) < kParallel) continue;
      near += (kBefore_m - height) / glm::dot(along, along) * along;
    }
  return near;
}

int plane_in(std::span<const prt::Plane> planes, const glm::vec3& from, const glm::vec3& direction,
             std::size_t except) {
  RealPoint met;
  meet_planes(planes, from, direction, static_cast<int>(except), met);
  const bool known = met.plane != RealPoint::kMesh &&
                     luminance(planes[static_cast<std::size_t>(met.plane)].albedo) > 0;
  return known ? met.plane : RealPoint::kMesh;
}

}  // namespace

PlaneExchange::PlaneExchange(std::span<const prt::Plane> planes, const glm::dvec3& middle)
    : planes_(planes), seen_(planes.size()) {
  constexpr float kOfRay = 1.f / kRays;
  const prt::RayPatterns patterns(kRays);
  prt::RayScene::RayPacket directions;
  for (std::size_t p = 0; p < planes.size(); ++p) {
    SeenByPlane& seen = seen_[p];
    seen.from = glm::vec3(place_on(planes, p, middle));
    seen.factors.resize(planes.size());
    const glm::mat3 frame = prt::frame_around(glm::vec3(planes[p].normal));
    for (int ray = 0; ray < kRays; ++ray) {
      const int lane = ray % prt::RayScene::kPacket;
      if (lane == 0)
        patterns.cosine_block(prt::RayPatterns::turn_of(p), ray / prt::RayScene::kPacket, frame,
                              directions);
      const glm::vec3 direction(directions.x[lane], directions.y[lane], directions.z[lane]);
      const int met = plane_in(planes, seen.from, direction, p);
      if (met == RealPoint::kMesh) continue;
      any_ = true;
      seen.factors[static_cast<std::size_t>(met)] += kOfRay;
      double basis[kMaxCoefficients];
      lighting::evaluate_basis(kMaxBands, glm::dvec3(direction), basis);
      for (std::size_t n = 0; n < seen.hidden.size(); ++n)
        seen.hidden[n] += static_cast<float>(basis[n]) * kOfRay;
    }
  }
}

float PlaneExchange::lit_fraction(std::size_t plane, const lighting::DistantLight& light) const {
  const auto is_lit = [&](const glm::dvec3& towards) {
    return plane_in(planes_, seen_[plane].from, glm::vec3(towards), plane) == RealPoint::kMesh;
  };
  if (light.shape.empty()) return is_lit(light.direction) ? 1.f : 0.f;
  const auto lit = std::ranges::count_if(light.shape, is_lit);
  return static_cast<float>(lit) / static_cast<float>(light.shape.size());
}

void PlaneExchange::changes(std::span<const RadianceSh* const> residuals,
                            std::span<const lighting::DistantLight> lights,
                            std::span<Rgb> out) const {
  const Scratch::Scope scope;
  const std::size_t count = planes_.size();
  // By plane, over pi: irradiance where no other plane is, what others hide of it, what they
  // change.
  std::pmr::vector<Rgb> open(count, scope.memory()), hidden(count, scope.memory()),
      change(count, scope.memory()), sent(count, scope.memory());
  constexpr auto kInversePi = static_cast<float>(1 / kPi);
  for (std::size_t p = 0; p < count; ++p) {
    const RadianceSh& residual = *residuals[p];
    open[p] = lighting::evaluate(lighting::irradiance(residual), planes_[p].normal);
    for (const lighting::DistantLight& light : lights)
      open[p] += lighting::irradiance(light, planes_[p].normal) * lit_fraction(p, light);
    open[p] = open[p] * kInversePi;
    for (int n = 0; n < residual.size(); ++n)
      hidden[p] += residual[n] * seen_[p].hidden[static_cast<std::size_t>(n)];
  }
  for (int bounce = 0; bounce < kBounces; ++bounce) {
    for (std::size_t p = 0; p < count; ++p) {
      const Rgb e = open[p] + change[p];
      sent[p] = planes_[p].albedo * Rgb{std::max(e.r, 0.f), std::max(e.g, 0.f), std::max(e.b, 0.f)};
    }
    for (std::size_t p = 0; p < count; ++p) {
      change[p] = hidden[p] * -1.f;
      for (std::size_t q = 0; q < count; ++q) change[p] += sent[q] * seen_[p].factors[q];
    }
  }
  for (std::size_t p = 0; p < count; ++p) out[p] = change[p] * static_cast<float>(kPi);
}

}  // namespace penumbra::runtime
