// The studio with things that really stand in it.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "capture/studio/world.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

/// A floor world in which matte things stand. Their light and the floor's around them is path
/// traced once: at their vertices, and on a grid of the floor (prt::GroundGrid) with cells of 1 cm
/// beside something half a metre large and 3 cm two radii further. Sharper real shadows come out
/// that soft.
/// threads: reentrant
class RealMeshWorld : public capture::RadianceWorld {
 public:
  /// `things`: world frame, metres. Floor and things light each other; to them the floor is evenly
  /// of its mean colour.
  /// errors: kInvalid (no triangles), kUnavailable (Embree), as EnvironmentLight::from_map
  static Result<std::shared_ptr<RealMeshWorld>> make(
      std::shared_ptr<const capture::FloorWorld> floor, prt::Mesh things,
      const std::function<void(double)>& progress);
  Rgb radiance(const glm::dvec3& origin, const glm::dvec3& direction) const override;
  Rgb far_radiance(const glm::dvec3& direction) const override {
    return floor_->far_radiance(direction);
  }
  /// Irradiance of the floor as a fraction of the open floor's.
  Rgb floor_fraction(const glm::dvec3& position) const;

 private:
  RealMeshWorld(std::shared_ptr<const capture::FloorWorld> floor, prt::Mesh things,
                prt::RayScene rays);
  Result<void> light(const std::function<void(double)>& progress);
  Rgb exit_radiance(const prt::Hit& hit) const;

  std::shared_ptr<const capture::FloorWorld> floor_;
  prt::Mesh things_;
  prt::RayScene rays_;
  prt::GroundGrid grid_;
  std::vector<Rgb> irradiance_;  // at the vertices
  Image<Rgb> left_;              // at the grid's texels
};

}  // namespace penumbra::runtime
