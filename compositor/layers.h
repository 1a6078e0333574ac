// The two layers that GL draws: object radiance with coverage, and the shadow ratio on receivers.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "compositor/compositor.h"
#include "compositor/gl.h"

namespace penumbra::compositor {

/// Pixels [x0, x1) x [y0, y1).
struct Rect {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  int width() const { return x1 > x0 ? x1 - x0 : 0; }
  int height() const { return y1 > y0 ? y1 - y0 : 0; }
  bool empty() const { return width() == 0 || height() == 0; }
  bool contains(int x, int y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
};
Rect united(const Rect& a, const Rect& b);

/// A drawn layer: half-float RGBA of the rectangle, row by row from the top.
struct Layer {
  Rect rect;
  std::vector<std::uint16_t> halves;  // keeps its capacity between frames
  std::span<const std::uint16_t> row(int y) const {
    const auto stride = static_cast<std::size_t>(rect.width()) * 4;
    return std::span(halves).subspan(static_cast<std::size_t>(y - rect.y0) * stride, stride);
  }
};

class Layers {
 public:
  static Result<Layers> create(int width, int height);

  int add_object(const prt::BakedObject& object);
  void set_pose(int object, const Pose& world_from_bake);
  void set_light(int object, std::span<const float> relit, const shadows::PlanarShadow& shadow);
  void add_occluder(const prt::Mesh& mesh);

  /// Object layer: premultiplied signal (radiance times signal_per_radiance) and coverage, four samples.
  /// Shadow layer: the product of all objects' ratios s; 1 where none reaches. Both are left as they are
  /// when nothing changed since the last call; the caller keeps them.
  Result<void> draw(const View& view, Layer& objects, Layer& shadows);

 private:
  struct Object {
    GlVertexArray geometry;
    GlBuffer vertices, indices, light;
    GLsizei index_count = 0;
    std::size_t stride = 0;  // floats a colour plane
    prt::Bounds bounds;
    Pose world_from_bake;
    bool has_receiver = false;
    prt::GroundGrid grid;
    GlTexture shadow;
    GlVertexArray receiver_geometry;
    GlBuffer receiver_vertices;
    glm::vec2 shadow_low{0, 0}, shadow_high{0, 0};  // visible part, metres in the bake frame
    bool shadow_visible = false;
  };
  struct Occluder {
    GlVertexArray geometry;
    GlBuffer vertices, indices;
    GLsizei index_count = 0;
  };
  struct Targets {
    GlFramebuffer fine, averaged, ratio;
    GlRenderbuffer fine_depth, ratio_depth;
    GlTexture fine_colour, averaged_colour, ratio_colour;
  };

  Layers(int width, int height, GlProgram object, GlProgram receiver, GlProgram depth)
      : width_(width), height_(height), object_program_(std::move(object)),
        receiver_program_(std::move(receiver)), depth_program_(std::move(depth)) {}
  Result<void> make_targets();
  void make_receiver_indices();
  void upload_receiver(Object& o, const shadows::PlanarShadow& shadow);
  void draw_occluders(const glm::dmat4& clip_from_world);
  void draw_objects(const View& view, const glm::dmat4& clip_from_world, Layer& out);
  void draw_receivers(const glm::dmat4& clip_from_world, Layer& out);
  void begin(GLuint framebuffer, const Rect& rect, int scale, bool depth, float clear);
  void read(GLuint framebuffer, Layer& out);

  int width_, height_;
  GlProgram object_program_, receiver_program_, depth_program_;
  Targets targets_;
  GlBuffer receiver_indices_;
  std::vector<Object> objects_;
  std::vector<Occluder> occluders_;
  std::optional<View> drawn_;  // what the caller's layers show
};

}  // namespace penumbra::compositor
