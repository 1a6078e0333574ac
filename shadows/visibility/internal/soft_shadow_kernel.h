// What silhouettes do to the directions of a light, with run-time choice of the vector
// instructions.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/pose.h"
#include "shadows/silhouette/light_rays.h"

namespace penumbra::shadows {

// threads: reentrant

/// By direction; zeros beyond the last one.
struct LayerSamples {
  using Floats = std::array<float, kMaxSamples>;
  std::size_t count = 0;
  alignas(64) Floats x{}, z{};                               // where rays go, cells a metre
  alignas(64) Floats towards_x{}, towards_y{}, towards_z{};  // unit
  alignas(64) Floats counted{};  // 1 where light counts that is seen, else 0
  alignas(64) Floats cosine{}, layers{};
};

/// No layers yet, and the cosines to a normal.
void begin_place(const glm::vec3& normal, LayerSamples& samples);

/// A silhouette on the ways from the origin to the directions.
struct SilhouetteCrossing {
  glm::vec2 from, to;
  float layers;  // more to the left of it
};
/// To each direction on whose way it lies.
void add_layers(const SilhouetteCrossing& line, LayerSamples& samples);

/// Sums of cosines over the directions: all, and those that have the fewest layers and count.
/// Directions behind the surface have no layers; where all are, nothing is seen.
struct FewestLayers {
  float open = 0, seen = 0;
  std::uint32_t ask = 0;  // amid those with the fewest layers
};
FewestLayers fewest_layers(const LayerSamples& samples);

}  // namespace penumbra::shadows
