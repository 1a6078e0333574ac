// What an edged light adds at the vertices that GL draws of an object.
// threads: thread-bound, to the one of the GL context
#pragma once

#include <glm/vec4.hpp>
#include <span>
#include <vector>

#include "compositor/edged_light.h"
#include "compositor/layers/drawn_vertices.h"
#include "compositor/layers/gl/gl.h"
#include "core/image.h"

namespace penumbra::compositor {

class EdgedVertices {
 public:
  /// The attribute of shaders, as of light_beside_edge(): radiance, and EdgedLight::lit.
  static constexpr GLuint kLocation = 10;
  /// For objects drawn next that have none.
  static void draw_without();

  /// in:  edged: null for none
  ///      albedo: of the object's own vertices; fine_albedo: of those of its fine form instead, or
  ///      empty
  ///      into: the object's vertex array
  /// out: whether it differs from before
  bool set(const EdgedLight* edged, std::span<const Rgb> albedo, std::span<const Rgb> fine_albedo,
           const DrawnVertices& vertices, const GlVertexArray& into);

 private:
  void upload(std::span<const glm::vec4> values);

  GlBuffer buffer_{};
  std::vector<glm::vec4> own_;    // by vertex of the object's own; none: none is set
  std::vector<glm::vec4> drawn_;  // where others are drawn
  bool has_room_ = false;
};

}  // namespace penumbra::compositor
