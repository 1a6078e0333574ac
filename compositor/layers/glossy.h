// Draws surfaces with materials: their pictures, the maps of the surroundings, and one part of an
// object for each material.
// threads: thread-bound, to the one of the GL context
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "compositor/layers/drawn_vertices.h"
#include "compositor/layers/gl/gl.h"
#include "compositor/layers/glossy_program.h"
#include "compositor/projection.h"
#include "compositor/surroundings.h"
#include "core/pose.h"
#include "prt/bake/bake.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"

namespace penumbra::compositor {

/// What an object with materials has beyond its vertices and its light.
struct GlossyObject {
  using Triangle = std::array<std::uint32_t, 3>;
  struct Part {  // of one material
    std::size_t material;
    GLsizei first, count;  // indices
  };
  std::shared_ptr<const prt::SurfaceMaterials> surface;
  GlBuffer attributes{}, directions{}, fractions{}, sorted{};
  std::vector<Part> parts{};
  bool shows_backs = false;  // of some part
  std::size_t own_vertices = 0;
  glm::dvec3 edged_towards{0};  // EdgedLight::direction
  // The floor that it mirrors.
  std::optional<prt::GroundGrid> floor_grid{};
  GlTexture floor{};
  std::vector<std::uint8_t> floor_codes{};  // of shadow ratios over 1.5; none: not told
  // What it mirrors of objects, as last told.
  GlTexture mirrored{}, past_objects{};
  glm::ivec3 mirrored_place{0, 0, 1};  // corner and step of MirroredPicture
  glm::ivec2 mirrored_size{0, 0};      // texels; 0: not told

  bool is_blended(const Part& part) const;
  bool any(bool blended) const;
  /// The parts of some of its triangles, in their order.
  std::vector<Part> parts_of(std::span<const Triangle> triangles) const;
};

class Glossy {
 public:
  Glossy();

  /// in:  triangles: of the mesh that GL draws; out: by material
  /// Adds its attributes to the vertex array that is bound.
  GlossyObject add(const prt::BakedObject& baked, const prt::Mesh& drawn,
                   const DrawnVertices& vertices, std::vector<GlossyObject::Triangle>& triangles);
  /// Of another form, whose vertices count as open.
  static void update_normals(GlossyObject& object, std::span<const glm::vec3> normals);
  /// Visible fractions of Surroundings::lights, by vertex of the object's own; none: all open.
  static void set_fractions(GlossyObject& object, std::span<const std::array<float, 4>> fractions,
                            const DrawnVertices& vertices);
  void set_surroundings(const Surroundings& surroundings);
  /// Shadow ratios on the floor that it stands on.
  /// in:  of kMirroredFloor texels a side, on the grid of the object's receiver
  /// out: whether it looks different now
  static bool set_floor(GlossyObject& object, const Image<Rgb>& ratios);

  /// As of Compositor.
  static void set_mirrored(GlossyObject& object, const MirroredPicture& picture);
  /// The part of the picture that is drawn next, and samples a pixel along each axis.
  void place(const Rect& canvas, int oversampling) { canvas_ = canvas, scale_ = oversampling; }

  GlossyFeatures features_of(const GlossyObject& object, const GlossyObject::Part& part) const;

  /// Draws the parts that are blended, or those that are not, from the bound vertex array.
  /// use: makes the program of features current
  using UseProgram = std::function<GLuint(GlossyFeatures)>;
  struct Placed {
    Pose world_from_object, world_from_floor;
    glm::dvec3 eye;
    bool cull_backs;
    GLuint indices;  // of the triangles
    std::span<const GlossyObject::Triangle> triangles;
    std::span<const GlossyObject::Part> parts;  // of them
    std::span<const glm::vec3> positions;
  };
  void draw(const GlossyObject& object, const UseProgram& use, const Placed& placed, bool blended);

 private:
  struct PictureKey {
    const prt::TexturePicture* picture;
    bool srgb;
    auto operator<=>(const PictureKey&) const = default;
  };
  struct HeldPicture {
    std::shared_ptr<const prt::TexturePicture> picture;
    GlTexture texture{};
  };
  void lay_out_levels(std::span<const lighting::ReflectionMap::RoughnessLevel> levels);
  void set_levels(GLuint program) const;
  void set_mirrored_objects(GLuint program, const GlossyObject& object) const;
  static void set_mirrored_floor(GLuint program, const GlossyObject& object,
                                 const Pose& world_from_floor);
  void upload(const prt::Texture& texture, bool srgb);
  void bind(int unit, const prt::Texture& texture, bool srgb, GLuint program, const char* name);
  GLuint sampler_of(const prt::Texture& texture);
  void set_material(const prt::Material& material, GLuint program);
  void set_scene(GLuint program, const GlossyObject& object, const Placed& placed) const;
  void set_mirrored_lights(GLuint program, const prt::Material& material) const;
  void begin_part(const GlossyObject& object, const GlossyObject::Part& part, const UseProgram& use,
                  const Placed& placed);
  void draw_sorted(const GlossyObject& object, const UseProgram& use, const Placed& placed);

  std::map<PictureKey, HeldPicture> pictures_;
  std::map<std::uint32_t, GlSampler> samplers_;
  bool in_software_ = false;  // llvmpipe, softpipe
  GlTexture level_pictures_{}, reflected_{}, white_{};
  std::shared_ptr<const lighting::ReflectionMap> shown_{};
  // Of the levels' pictures within level_pictures_.
  std::vector<int> level_sizes_;  // texels a side
  std::vector<glm::ivec2> level_corners_;
  std::array<glm::vec4, lighting::ReflectionMap::kMaxLevels> tiles_{};
  Surroundings surroundings_;
  Rect canvas_{};
  int scale_ = 1;
  struct SortedTriangle {
    float distance2;
    const GlossyObject::Part* part;
    GlossyObject::Triangle corners;
  };
  std::vector<SortedTriangle> farthest_;       // scratch
  std::vector<GlossyObject::Triangle> order_;  // likewise
};

}  // namespace penumbra::compositor
