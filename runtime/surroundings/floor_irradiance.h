// What known things beside a floor do to its light: they keep some out and send some on.
// threads: const members reentrant, parallel inside
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

/// Means over some points of the floor.
struct FloorIrradianceParts {
  Rgb others{1, 1, 1};  // of the irradiance by all light but the sources, what arrives
  Rgb beside{};         // irradiance that the floor sends there by way of the things
  // By source: irradiance that things reflect there, for each unit of its power (radiance times
  // solid angle)
  std::vector<Rgb> reflected{};
};

/// By one bounce from the things, which are lit by the sources, the sky and the floor around.
class FloorIrradiance {
 public:
  /// Radiance of the floor as a camera sees it, by the sources that things keep from it (bit by
  /// source).
  struct FloorRadiance {
    std::uint32_t hidden;
    Rgb radiance;
  };
  /// All must outlive it. `sources`: at most 32 lights of `light`, whose power is not known;
  /// `seen`: at least one.
  FloorIrradiance(const prt::RayScene& rays, const prt::Mesh& things, const prt::Plane& floor,
                  const lighting::LightEstimate& light,
                  std::span<const lighting::DistantLight* const> sources,
                  std::span<const FloorRadiance> seen)
      : rays_(rays),
        things_(things),
        floor_(floor),
        light_(light),
        sources_(sources),
        seen_(seen) {}

  /// in: at least one point of the floor
  FloorIrradianceParts at(std::span<const glm::dvec3> points) const;

 private:
  struct Sums;
  struct Surface;
  Rgb sky(const glm::dvec3& direction) const;
  Surface surface(const prt::Hit& hit, const glm::dvec3& at) const;
  bool is_hidden(const glm::dvec3& point, const lighting::DistantLight& light) const;
  void add_point(const glm::dvec3& point, std::size_t turn, Sums& sums) const;
  void add_reflected(const Surface& surface, std::size_t turn, Sums& sums) const;
  Rgb floor_seen_from(const glm::dvec3& point, const glm::dvec3& direction) const;

  const prt::RayScene& rays_;
  const prt::Mesh& things_;
  const prt::Plane& floor_;
  const lighting::LightEstimate& light_;
  std::span<const lighting::DistantLight* const> sources_;
  std::span<const FloorRadiance> seen_;
};

}  // namespace penumbra::runtime
