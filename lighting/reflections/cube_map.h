// An environment map as a cube.
// threads: reentrant
#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <utility>
#include <vector>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Brings lat-long maps of one size to cubes of one size. Faces in the order +x, -x, +y, -y, +z and
/// -z, with the axes of OpenGL's cube maps. Each pixel of the map goes whole into one texel, so
/// that a sun of one pixel keeps its power; texels that get none take the pixel that they look at.
/// source: OpenGL ES 3.2, table 8.27, for the axes
class CubeMap {
 public:
  /// size: edge of a face in texels
  CubeMap(int map_width, int map_height, int size);
  bool fits(const Image<Rgb>& map) const {
    return map.width() == width_ && map.height() == height_;
  }
  /// in:  a map that fits
  /// out: face by face, row by row
  std::vector<Rgb> apply(const Image<Rgb>& map) const;

 private:
  int width_, height_;
  std::vector<std::uint32_t> texels_;  // by pixel
  std::vector<float> row_weights_, inverse_weights_;
  std::vector<std::pair<std::size_t, glm::ivec2>> empty_;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
