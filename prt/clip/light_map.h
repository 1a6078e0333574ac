// Where on a character transfer is baked: its vertices, and the texels of a light map.
// threads: free functions reentrant
#pragma once

#include <cstdint>
#include <vector>

#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Mesh;

/// Of its vertices in a light map: its own for that, or else its texture coordinates.
inline const std::vector<glm::vec2>& light_coordinates_of(const Character& c) {
  return c.light_coordinates.empty() ? c.texture_coordinates : c.light_coordinates;
}

/// What a character's texture coordinates are worth as those of a light map.
struct TextureUse {
  double outside = 0;  // fraction of triangles that leave 0..1
  double overlap = 0;  // fraction of covered texels that two triangles claim
  double no_area = 0;  // fraction of the surface whose triangles have none in the texture plane
  bool usable() const { return outside == 0 && overlap < .01 && no_area < .01; }
};
TextureUse texture_use(const Character& character, int width, int height);

/// The same character with coordinates of its own for a light map: charts of triangles that face
/// one way, flattened along it, side by side with room between. Vertices on charts' borders stand
/// once for each chart.
/// errors: none; very small charts share texels when the map is too small for all
Character with_atlas(const Character& character, int width, int height);
/// With an atlas where its texture coordinates are not usable.
Character for_light_map(Character character, int width, int height);

/// Every texel that bilinear lookups on the surface can touch stands for the nearest point of the
/// surface.
struct SurfaceLayout {
  struct Texel {
    std::uint16_t x, y;
    std::uint32_t triangle;
    float u, v;  // point = (1 - u - v) a + u b + v c
  };
  int width = 0, height = 0;  // 0: vertices alone
  std::size_t vertices = 0;
  std::vector<Texel> texels;        // row by row
  std::vector<std::uint16_t> bone;  // of every point (vertices, then texels): its strongest
  // Of every point, earlier ones to predict it from; kNone
  std::vector<std::array<std::uint32_t, 3>> neighbours;
  static constexpr std::uint32_t kNone = 0xffffffffu;
  std::size_t points() const { return vertices + texels.size(); }
};
SurfaceLayout lay_out(const Character& character, int width, int height);

/// Puts texels behind the deformed mesh's vertices as points that no triangle uses. Where a coarse
/// triangle stands for a curved surface they are lifted onto the curve, so that it doesn't shade
/// itself.
/// source: Hanika 2021, Hacking the Shadow Terminator
void add_texels(const Character& character, const SurfaceLayout& layout, Mesh& mesh);

}  // namespace penumbra::prt
#pragma GCC visibility pop
