// Lines in the picture where what is seen of an object ends. The pixels that they cut are divided
// by area: edges are as smooth as of many samples a pixel where GL took one.
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "compositor/layers/canvas.h"
#include "compositor/projection.h"
#include "prt/geometry/mesh.h"

namespace penumbra::compositor {

/// An edge of a surface, in pixels of the frame, x to the right and y down. Who goes from `from` to
/// `to` in the picture has the surface at the left hand.
struct ContourLine {
  glm::vec2 from, to;
};

/// Whether every edge joins two triangles that face the same side, outwards (vertices in one place
/// count as one): back faces are never seen from outside.
bool is_closed(const prt::Mesh& mesh);

/// The contour of a mesh in a view. One thread at a time.
class Contour {
 public:
  using ContourTriangle = std::array<std::uint32_t, 3>;

  /// Vertices in one place count as one, in every form.
  explicit Contour(const prt::Mesh& mesh);

  /// False where parts of different albedo may go through each other: no triangle has that edge. It
  /// is looked for in the form given here, and taken for granted of more than 256 parts. False also
  /// with so many creases that finding lines takes too long.
  bool serves() const { return serves_; }

  /// Appends the edges of `triangles` between front and back, at borders and at creases (where the
  /// two sides have vertices of their own), also those that other surfaces hide. False, and nothing
  /// seen, where a triangle reaches behind the camera.
  /// fronts_only: triangles seen from behind are not drawn
  bool find(std::span<const glm::vec3> positions, std::span<const ContourTriangle> triangles,
            bool fronts_only, const ViewProjection& from_object, std::vector<ContourLine>& out);
  /// The triangles that can be seen, of the last find().
  std::span<const ContourTriangle> seen() const { return seen_; }

 private:
  struct ContourEdge {
    std::uint32_t from, to;
    std::int32_t next;  // of the same lower place
    bool front, inner;  // inner: a triangle that continues it is at the other side
  };
  void project(std::span<const glm::vec3> positions, const ViewProjection& from_object);
  bool see_facings(std::span<const ContourTriangle> triangles);
  void meet(std::uint32_t from, std::uint32_t to, bool front);

  // Triangles around a place, one bit each; no edge between two places without all bits is a line.
  enum Facing : std::uint8_t { kFront = 1, kBack = 2, kBoth = 3 };

  std::vector<std::uint32_t> place_;  // by vertex, the first one there
  std::vector<std::uint8_t> rim_;     // by place, kBoth at borders and creases
  std::vector<std::uint8_t> around_;  // by place, in this view
  std::vector<std::uint8_t> facing_;  // by triangle
  std::vector<glm::vec3> projected_;  // pixels and 1/metre
  std::vector<std::int32_t> first_;   // by place, of the edges that have it as their lower one
  std::vector<ContourEdge> edges_;
  std::vector<ContourTriangle> seen_;
  bool serves_ = true;
};

/// Lines pass between the middles of neighbouring pixels. What lies beyond a line, of a pixel that
/// it cuts, goes to the neighbour across. It is measured along the column (or row, for steep lines)
/// through the middles. Of several lines in one gap the outermost counts. The layer holds one
/// sample a pixel.
/// source: Persson 2011, Geometric Post-process Anti-Aliasing
class ContourSmoother {
 public:
  /// False, the layer being good for nothing, where parts before the background are so thin that
  /// samples missed too much of them.
  bool smooth(std::span<const ContourLine> lines, Layer& layer);

 private:
  // Of a pixel to the next one along an axis, right or down.
  struct GapCrossing {
    std::uint32_t gap;  // twice the pixel's index in the layer, one more: down
    float at;           // 0..1 from the one middle to the other
    bool surface_before;
  };
  struct PixelCoverage {
    std::size_t pixel;
    float of_neighbour;
    std::array<std::uint16_t, 4> neighbour;  // as it was drawn
  };
  void collect(const ContourLine& line, const Rect& rect);
  void decide(std::span<const GapCrossing> gap, const Layer& layer);

  std::vector<GapCrossing> crossings_;
  std::vector<PixelCoverage> fractions_;
  std::size_t at_background_ = 0, missed_ = 0;  // gaps
};

}  // namespace penumbra::compositor
