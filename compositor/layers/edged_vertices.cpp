#include "compositor/layers/edged_vertices.h"

#include <utility>

namespace penumbra::compositor {

namespace {

glm::vec4 with_fourth(const Rgb& c, float fourth) {
  return {c.r, c.g, c.b, fourth};
}

}  // namespace

void EdgedVertices::draw_without() {
  glVertexAttrib4f(kLocation, 0, 0, 0, 1);
}

bool EdgedVertices::set(const EdgedLight* edged, std::span<const Rgb> albedo,
                        std::span<const Rgb> fine_albedo, const DrawnVertices& vertices,
                        const GlVertexArray& into) {
  if (!edged) {
    if (own_.empty()) return false;
    own_.clear();
    glBindVertexArray(into.get());
    glDisableVertexAttribArray(kLocation);
    glBindVertexArray(0);
    return true;
  }
  const bool first = own_.empty();
  bool changed = first;
  own_.resize(albedo.size());
  for (std::size_t i = 0; i < own_.size(); ++i) {
    const Rgb white = edged->radiance * edged->open[i];
    const glm::vec4 now =
        with_fourth(fine_albedo.empty() ? albedo[i] * white : white, edged->lit[i]);
    changed |= now != own_[i];
    own_[i] = now;
  }
  if (!changed) return false;
  glBindVertexArray(into.get());
  if (vertices.are_own()) {
    upload(own_);
  } else {
    drawn_ = own_;
    vertices.spread(drawn_);
    for (std::size_t i = 0; i < fine_albedo.size(); ++i)
      drawn_[i] *= with_fourth(fine_albedo[i], 1);
    upload(drawn_);
  }
  if (first) glEnableVertexAttribArray(kLocation);
  glBindVertexArray(0);
  return true;
}

void EdgedVertices::upload(std::span<const glm::vec4> values) {
  const auto bytes = static_cast<GLsizeiptr>(values.size_bytes());
  glBindBuffer(GL_ARRAY_BUFFER, buffer_.get());
  if (std::exchange(has_room_, true))
    return glBufferSubData(GL_ARRAY_BUFFER, 0, bytes, values.data());
  glBufferData(GL_ARRAY_BUFFER, bytes, values.data(), GL_DYNAMIC_DRAW);
  glVertexAttribPointer(kLocation, 4, GL_FLOAT, GL_FALSE, 0, nullptr);
}

}  // namespace penumbra::compositor
