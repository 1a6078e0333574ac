// What vertices hold of a material's pictures: means over as much of them as lies around a vertex.
// threads: one thread at a time
#pragma once

#include <cstddef>
#include <glm/vec2.hpp>
#include <map>
#include <memory>
#include <tuple>

#include "core/image.h"
#include "prt/geometry/material.h"

namespace penumbra::prt::gltf {

/// Pictures reduced to box means, kept for all who ask for the same.
class MeanColours {
 public:
  /// Mean albedo around a vertex, one of `vertices` that the material has in a mesh: base colour.
  /// Texels count as far as they are opaque, where the material is not.
  /// in: coordinates of both sets
  Rgb albedo(const Material& material, const std::array<glm::vec2, 2>& coordinates,
             std::size_t vertices);

 private:
  enum class TexelCodes { kSrgb, kSrgbByAlpha };
  const Image<Rgb>& reduced(const Texture& texture, TexelCodes codes, std::size_t vertices);
  Rgb sample(const Texture& texture, TexelCodes codes, const std::array<glm::vec2, 2>& coordinates,
             std::size_t vertices);

  std::map<std::tuple<const TexturePicture*, TexelCodes, int>, Image<Rgb>> reduced_;
};

}  // namespace penumbra::prt::gltf
