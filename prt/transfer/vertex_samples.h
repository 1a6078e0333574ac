// Some of a mesh's vertices that look around for all of them.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Mesh;

/// Of each vertex and those beside it at least three are samples, or all; so are those with sharp
/// or long edges. About half of a smooth mesh's vertices.
/// threads: const members reentrant
class VertexSamples {
 public:
  static constexpr std::size_t kMax = 4;

  explicit VertexSamples(const Mesh& mesh);

  /// Rising.
  std::span<const std::uint32_t> vertices() const { return vertices_; }
  bool is_sample(std::size_t vertex) const {
    const std::uint32_t first = around_[vertex][0];
    return first < vertices_.size() && vertices_[first] == vertex;
  }
  /// Places in vertices() of samples at and beside the vertex, its own first, kMax of many; of
  /// none: vertices().size().
  const std::array<std::uint32_t, kMax>& around(std::size_t vertex) const {
    return around_[vertex];
  }

 private:
  std::vector<std::uint32_t> vertices_;
  std::vector<std::array<std::uint32_t, kMax>> around_;  // by vertex
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
