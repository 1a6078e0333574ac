// The fewest of a mesh's triangles that show its form and its present colours: a bake is as fine as
// its finest shadow edge needs, a picture only there.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "prt/geometry/mesh.h"

namespace penumbra::compositor {

/// Vertices are taken away by half-edge collapses in independent rounds (Hoppe 1996, Progressive
/// Meshes, with the refinement rule of a vertex hierarchy: a vertex goes only if everything finer
/// around it went). Which collapses keep the form is found once, which keep the colours at each
/// `select`. One thread at a time.
class DrawList {
 public:
  using DrawTriangle = std::array<std::uint32_t, 3>;

  /// `tolerance`: how far the surface may move, in metres of the mesh, by a bound; 0: not at all,
  /// every triangle stays. Borders and creases keep all their vertices. `forms`: others that the
  /// same mesh takes, in which the surface may not move further either.
  DrawList(const prt::Mesh& mesh, float tolerance, std::span<const prt::Mesh> forms = {});

  /// Triangles of the mesh's own vertices whose interpolated colours leave what they are by 2 % in
  /// each round of collapses at most (of a quarter of the mean where they are darker). `colours`:
  /// one a vertex. Valid until the next call.
  std::span<const DrawTriangle> select(std::span<const Rgb> colours);
  std::span<const DrawTriangle> all() const { return triangles_; }
  /// Every edge joins two triangles that face the same side, outwards (vertices in one place count
  /// as one): back faces are never seen from outside.
  bool closed() const { return closed_; }

 private:
  struct Collapse {
    std::uint32_t vertex, into;
    std::array<std::uint32_t, 3> corners;  // of the triangle that lies over the vertex afterwards
    glm::vec3 weights;
    std::uint32_t ring_begin, ring_end;  // its neighbours, in rings_
  };
  class Finder;

  bool keeps_colour(const Collapse& c, std::span<const Rgb> colours, float floor) const;

  std::vector<DrawTriangle> triangles_, selected_;
  std::vector<Collapse> collapses_;  // rounds in order
  std::vector<std::uint32_t> rings_, stands_for_;
  std::vector<char> needed_;
  bool closed_;
};

}  // namespace penumbra::compositor
