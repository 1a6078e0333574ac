#include "runtime/surroundings/floor_irradiance.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::runtime {

namespace {

constexpr float kOff_m = 1e-3f, kFar_m = 1e4f;
constexpr int kPacket = prt::RayScene::kPacket;
constexpr int kRays = 4 * kPacket;     // from a point of the floor
constexpr int kFurtherRays = kPacket;  // from where one of them meets a thing

template <int rays>
const prt::RayPatterns& patterns() {
  static const prt::RayPatterns made(rays);
  return made;
}

glm::dvec3 direction_of(const prt::RayScene::RayPacket& packet, int lane) {
  return {packet.x[lane], packet.y[lane], packet.z[lane]};
}

}  // namespace

// Radiance for each ray of a point.
struct FloorIrradiance::Sums {
  Rgb all, left;  // of light that is no source's
  Rgb beside;
  std::vector<Rgb> reflected;  // by source, of unit power
};

struct FloorIrradiance::Surface {
  glm::dvec3 point, normal;
  Rgb radiance_of_irradiance;  // albedo / pi; black from behind
};

Rgb FloorIrradiance::sky(const glm::dvec3& direction) const {
  Rgb out = lighting::evaluate(light_.light, direction);
  for (int c = 0; c < 3; ++c) out[c] = std::max(0.f, out[c]);
  return out;
}

FloorIrradiance::Surface FloorIrradiance::surface(const prt::Hit& hit, const glm::dvec3& at) const {
  const auto& t = things_.triangles[hit.triangle];
  const float weight[] = {1 - hit.u - hit.v, hit.u, hit.v};
  Rgb albedo;
  glm::vec3 normal(0);
  for (std::size_t k = 0; k < 3; ++k) {
    albedo += things_.albedo[t[k]] * weight[k];
    normal += things_.normals[t[k]] * weight[k];
  }
  const glm::dvec3 n(glm::normalize(normal));
  return {at + double(kOff_m) * n, n, hit.front ? albedo * static_cast<float>(1 / kPi) : Rgb{}};
}

bool FloorIrradiance::is_hidden(const glm::dvec3& point,
                                const lighting::DistantLight& light) const {
  return rays_.occluded(glm::vec3(point), glm::vec3(light.direction), kOff_m, kFar_m);
}

// What a surface sees of the floor in a direction below the horizon.
Rgb FloorIrradiance::floor_seen_from(const glm::dvec3& point, const glm::dvec3& direction) const {
  const double distance = glm::dot(floor_.point - point, floor_.normal) /
                          std::min(glm::dot(direction, floor_.normal), -1e-6);
  const glm::dvec3 there = point + std::min(distance, double(kFar_m)) * direction;
  std::uint32_t hidden = 0;
  for (std::size_t k = 0; k < sources_.size(); ++k)
    hidden |= std::uint32_t{is_hidden(there, *sources_[k])} << k;
  // Where no such shadow is in view: the darkest.
  const auto same = std::ranges::find(seen_, hidden, &FloorRadiance::hidden);
  if (same != seen_.end()) return same->radiance;
  return std::ranges::min(seen_, {}, [](const FloorRadiance& f) { return luminance(f.radiance); })
      .radiance;
}

// Onto the floor, from a thing that a ray meets: once.
void FloorIrradiance::add_reflected(const Surface& on, std::size_t turn, Sums& sums) const {
  const auto by_cosine = [&](const lighting::DistantLight& d) {
    const double cosine = glm::dot(on.normal, d.direction);
    return cosine > 0 && !is_hidden(on.point, d) ? static_cast<float>(cosine) : 0.f;
  };
  for (std::size_t k = 0; k < sources_.size(); ++k)
    sums.reflected[k] += on.radiance_of_irradiance * by_cosine(*sources_[k]);
  for (const lighting::DistantLight& d : light_.lights)
    if (std::ranges::find(sources_, &d) == sources_.end())
      sums.left += on.radiance_of_irradiance * d.radiance *
                   (static_cast<float>(d.solid_angle_sr()) * by_cosine(d));
  prt::RayScene::RayPacket packet;
  patterns<kFurtherRays>().cosine_block(prt::RayPatterns::turn_of(turn), 0,
                                        prt::frame_around(glm::vec3(on.normal)), packet);
  const std::uint32_t blocked = rays_.occluded(glm::vec3(on.point), kOff_m, packet);
  const Rgb sent_on = on.radiance_of_irradiance * static_cast<float>(kPi / kFurtherRays);
  for (int k = 0; k < kFurtherRays; ++k) {
    if (blocked >> k & 1) continue;
    const glm::dvec3 d = direction_of(packet, k);
    if (glm::dot(d, floor_.normal) < 0)
      sums.beside += sent_on * floor_seen_from(on.point, d);
    else
      sums.left += sent_on * sky(d);
  }
}

void FloorIrradiance::add_point(const glm::dvec3& point, std::size_t turn, Sums& sums) const {
  const glm::mat3 frame = prt::frame_around(glm::vec3(floor_.normal));
  for (int block = 0; block < kRays / kPacket; ++block) {
    prt::RayScene::RayPacket packet;
    patterns<kRays>().cosine_block(prt::RayPatterns::turn_of(turn), block, frame, packet);
    rays_.intersect(glm::vec3(point), kOff_m, packet);
    for (int k = 0; k < kPacket; ++k) {
      const glm::dvec3 d = direction_of(packet, k);
      const Rgb radiance = sky(d);
      sums.all += radiance;
      if (packet.triangle[k] == prt::RayScene::kMiss)
        sums.left += radiance;
      else
        add_reflected(surface({packet.triangle[k], packet.distance[k], packet.u[k], packet.v[k],
                               packet.front[k]},
                              point + double(packet.distance[k]) * d),
                      turn + static_cast<std::size_t>(k), sums);
    }
  }
  constexpr auto kRadianceOfIrradiance = static_cast<float>(kRays / kPi);
  for (const lighting::DistantLight& d : light_.lights) {
    if (std::ranges::find(sources_, &d) != sources_.end()) continue;
    const Rgb own = lighting::irradiance(d, floor_.normal) * kRadianceOfIrradiance;
    sums.all += own;
    if (!is_hidden(point, d)) sums.left += own;
  }
}

FloorIrradianceParts FloorIrradiance::at(std::span<const glm::dvec3> points) const {
  std::vector<Sums> by_point(points.size());
  parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
    by_point[i].reflected.resize(sources_.size());
    add_point(points[i], i, by_point[i]);
  });
  FloorIrradianceParts out{{1, 1, 1}, {}, std::vector<Rgb>(sources_.size())};
  Rgb all, left;
  const auto irradiance = static_cast<float>(kPi / kRays / static_cast<double>(points.size()));
  for (const Sums& sums : by_point) {
    all += sums.all, left += sums.left;
    out.beside += sums.beside * irradiance;
    for (std::size_t k = 0; k < sources_.size(); ++k)
      out.reflected[k] += sums.reflected[k] * irradiance;
  }
  for (int c = 0; c < 3; ++c)
    if (all[c] > 0) out.others[c] = left[c] / all[c];
  return out;
}

}  // namespace penumbra::runtime
