// The light of real planes at places on them, without and with what virtual things do to it: what
// the compositor has by pixels, here by the nearest texel and without a plane's texture.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "compositor/composite/compositor.h"
#include "core/image.h"
#include "core/pose.h"
#include "prt/geometry/plane.h"
#include "prt/geometry/receiver.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

/// What one thing takes of the residual on the plane that it stands on.
struct ShadowOnPlane {
  const shadows::PlanarShadow* shadow;
  const prt::GroundGrid* grid;
  Pose grid_from_world;
  bool real = false;
  Rgb of_open{1, 1, 1};  // as Compositor::set_light
};

class PlaneLight {
 public:
  /// in: open, irradiance of each open plane, lights included; lights as
  /// DirectLightStage::shadows gives them. All that is referred to must outlive it.
  PlaneLight(std::span<const prt::Plane> planes, std::span<const Rgb> open,
             std::span<const compositor::ShadowMapOnPlane> lights,
             std::vector<ShadowOnPlane> shadows);

  struct Radiance {
    Rgb before, now;
  };
  /// Exit radiance of a plane. Light of virtual lamps is left out.
  Radiance at(std::size_t plane, const glm::vec3& point) const;

 private:
  struct ShadowOfLight {
    const Image<float>* virtual_occlusion;
    Pose map_from_world;
    float per_cell;
    Rgb fraction;
    bool real;
  };
  std::span<const prt::Plane> planes_;
  std::span<const Rgb> open_;
  std::vector<ShadowOfLight> lights_;
  std::vector<ShadowOnPlane> shadows_;
};

}  // namespace penumbra::runtime
