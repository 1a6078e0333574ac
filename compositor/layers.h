// What GL draws: the objects' radiance and coverage, and what real geometry hides.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "compositor/compositor.h"
#include "compositor/gl.h"
#include "compositor/projection.h"

namespace penumbra::compositor {

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
  static Result<Layers> create(int width, int height, int oversampling);

  int add_object(const prt::BakedObject& object);
  void set_pose(int object, const Pose& world_from_bake);
  void set_light(int object, std::span<const float> relit);
  int add_occluder(const prt::Mesh& mesh);
  /// Shadow ratios at the vertices of real geometry.
  void set_ratios(int occluder, std::span<const Rgb> ratios);
  void add_plane(const glm::dvec3& point, const glm::dvec3& normal);

  /// objects: premultiplied signal (radiance times signal_per_radiance) and coverage, four samples
  /// a pixel. hidden: real geometry inside `receiver_area` and wherever it is shaded itself: what is taken
  /// of its light, premultiplied, and coverage; empty without any. Both are left as they are when nothing changed since the last call; the caller
  /// keeps them.
  Result<void> draw(const View& view, const Rect& receiver_area, Layer& objects, Layer& hidden);

 private:
  struct Object {
    GlVertexArray geometry;
    GlBuffer vertices, indices, light;
    GLsizei index_count = 0;
    std::size_t stride = 0;  // floats a colour plane
    prt::Bounds bounds;
    Pose world_from_bake;
  };
  struct Occluder {
    GlVertexArray geometry;
    GlBuffer vertices, deficits, indices;
    GLsizei index_count = 0;
  };
  struct OccluderMesh {
    std::vector<glm::vec3> positions;
    std::vector<std::array<std::uint32_t, 3>> triangles;
    std::optional<prt::Bounds> shaded;  // of the triangles with a ratio other than 1
  };
  // The fine picture first, each following one half as large, the last at one sample a pixel.
  struct Target {
    GlFramebuffer framebuffer;
    GlTexture colour;
    int scale;
  };
  struct Drawn {
    View view;
    Rect receiver_area;
  };

  Layers(int width, int height, int oversampling, GlProgram object, GlProgram occluder)
      : width_(width),
        height_(height),
        oversampling_(oversampling),
        object_program_(std::move(object)),
        occluder_program_(std::move(occluder)) {}
  Result<void> make_targets();
  void begin(const Rect& rect);
  void draw_occluders(const std::vector<Occluder>& occluders, const glm::dmat4& clip_from_world);
  static Occluder upload(const prt::Mesh& mesh);
  void draw_objects(const View& view, const glm::dmat4& clip_from_world);
  void finish(Layer& out);
  Rect reach_of(const glm::dmat4& clip_from_bounds, const prt::Bounds& bounds) const;

  int width_, height_, oversampling_;
  GlProgram object_program_, occluder_program_;
  std::vector<Target> targets_;
  GlRenderbuffer fine_depth_;
  std::vector<Object> objects_;
  std::vector<Occluder> occluders_, planes_;
  std::vector<OccluderMesh> occluder_meshes_;  // by occluder
  std::optional<Drawn> drawn_;                 // what the caller's layers show
};

}  // namespace penumbra::compositor
