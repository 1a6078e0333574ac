// The form of a source, as points of equal energy.
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "lighting/lights/distant_light.h"

namespace penumbra::lighting {

/// A part of a source's energy.
struct EnergyPiece {
  double weight = 0;        // above 0
  glm::dvec3 direction{0};  // of its middle
  double along = 0;         // for the split
};

/// DistantLight::kShapePoints unit directions, neighbours in neighbouring places at every power of
/// two: the energy is halved across its longest axis again and again.
/// in: at least one piece, in any order; left in another one
DistantLight::Shape shape_points(std::span<EnergyPiece> pieces);

}  // namespace penumbra::lighting
