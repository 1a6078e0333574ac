// What GL draws: the objects' radiance and coverage, and what real geometry hides.
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "compositor/edged_light.h"
#include "compositor/layers/canvas.h"
#include "compositor/layers/contour.h"
#include "compositor/layers/drawn_vertices.h"
#include "compositor/layers/edged_vertices.h"
#include "compositor/layers/gl/gl.h"
#include "compositor/layers/glossy.h"
#include "compositor/layers/layer_programs.h"
#include "compositor/projection.h"
#include "compositor/view.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"

namespace penumbra::compositor {

class Layers {
 public:
  static Result<Layers> create(int width, int height, int oversampling);

  /// What is added from then on is drawn with edges that stay straight enough before this lens.
  void use_lens(const ViewLens& lens);
  int add_object(const prt::BakedObject& object, const Appearance& appearance);
  void update_vertices(int object, const prt::Mesh& mesh);
  /// As of Compositor.
  void set_pose(int object, const Pose& world_from_bake, const Pose& world_from_floor);
  void show(int object, bool visible);
  /// As of Compositor.
  void set_light(int object, std::span<const float> relit, const EdgedLight* edged = nullptr);
  /// As of Compositor.
  void set_surroundings(const Surroundings& surroundings);
  void set_light_fractions(int object, std::span<const std::array<float, 4>> fractions);
  /// Whether it has materials, and shows the floor in them.
  bool mirrors(int object) const {
    return objects_[static_cast<std::size_t>(object)].glossy.has_value();
  }
  /// As Glossy::set_floor. in: an object that mirrors, with a receiver
  void set_floor(int object, const Image<Rgb>& ratios);
  /// As of Compositor.
  void set_mirrored(int object, const MirroredPicture& picture);
  int add_occluder(const prt::Mesh& mesh);
  /// Shadow ratios at the vertices of real geometry.
  void set_ratios(int occluder, std::span<const Rgb> ratios);
  /// What these vertices weigh beside an open plane.
  void set_weights(int occluder, std::span<const Rgb> weights);
  void add_plane(const glm::dvec3& point, const glm::dvec3& normal);

  bool has_occluders() const { return !occluders_.empty(); }
  /// The rectangle that draw() gives the layer of objects.
  Rect reach_of_objects(const ViewProjection& from_world) const;
  /// objects: premultiplied signal (radiance times signal_per_radiance) and coverage, averaged over
  /// each pixel: of samples, or where that shows no worse of one sample and the objects' contours.
  /// hidden: real geometry inside `receiver_area` and wherever it is shaded itself: what is taken
  /// of its light times its weight, and coverage, beside the weights; all premultiplied, empty
  /// without any. Both layers are left as they are when nothing changed since the last call; the
  /// caller keeps them.
  Result<void> draw(const View& view, const Rect& receiver_area, CommonLayer& objects,
                    CommonLayer& hidden);

 private:
  struct LightMap {
    GlTexture texture{};
    int width = 0, height = 0;
    std::size_t first = 0;                     // point of its first texel
    std::vector<std::array<int, 2>> places{};  // of the texels
    std::vector<Rgb> pixels{};
  };
  struct DrawnObject {
    DrawnVertices drawn_vertices{};
    GlVertexArray geometry{};
    GlBuffer vertices{}, indices{}, seen{}, light{}, texture_coordinates{}, light_coordinates{};
    std::optional<GlTexture> albedo_map{};  // with a light map white where there is none
    std::optional<LightMap> light_map{};
    std::optional<GlossyObject> glossy{};
    std::vector<std::array<std::uint32_t, 3>> triangles;
    bool closed;
    // Of what one sample a pixel may do for, and the vertices in their present form.
    std::optional<Contour> contour{};
    std::vector<glm::vec3> positions{};
    std::vector<Rgb> albedo;   // by vertex of the object's own
    std::vector<Rgb> colours;  // by vertex that GL draws: radiance as lit now
    EdgedVertices edged{};
    // Of an object with a fine form: by vertex that GL draws, and by its own as lit now
    std::vector<Rgb> fine_albedo{}, lit{};
    GLsizei index_count = 0, seen_count = 0;
    std::size_t stride = 0;  // floats a colour plane
    prt::Bounds bounds;
    double area_m2;  // of all triangles, at rest
    Pose world_from_bake{}, world_from_floor{};
    bool visible = true;
    bool changed = true;               // since it was drawn, in whatever is seen of it
    Rect drawn_at{};                   // what it could reach then
    std::vector<ContourLine> lines{};  // its contour, while that is known
    bool contour_known = false;        // of this form, at this place, from contours_from_
  };
  struct Occluder {
    GlVertexArray geometry;
    GlBuffer vertices, deficits, weights, indices;
    GLsizei index_count = 0;
  };
  struct DrawnPlane {
    glm::dvec3 point, normal;
    Occluder quad;
  };
  struct OccluderMesh {
    DrawnVertices drawn_vertices;
    std::vector<glm::vec3> positions;
    std::vector<std::array<std::uint32_t, 3>> triangles;
    std::optional<prt::Bounds> shaded;  // of the triangles with a ratio other than 1
  };
  struct DrawnLayers {
    View view;
    Rect receiver_area;
    bool by_contours;  // one sample a pixel and smoothed edges

    // Whether nothing but objects can make them other ones.
    bool shows(const View& now, const Rect& area, bool occluders) const {
      return view.camera == now.camera && view.lens == now.lens &&
             view.signal_per_radiance == now.signal_per_radiance &&
             view.foreground == now.foreground && (!occluders || receiver_area == area);
    }
  };

  Layers(int width, int height, int oversampling, LayerPrograms programs, GlTexture white)
      : width_(width),
        height_(height),
        fine_(oversampling > 2),
        objects_canvas_(oversampling),
        glossy_canvas_(1, Canvas::CanvasKind::kMultisampled),
        plain_canvas_(1),
        hidden_canvas_(oversampling, Canvas::CanvasKind::kWeighted),
        programs_(std::move(programs)),
        white_(std::move(white)) {}
  void draw_occluders(const ViewProjection& from_world);
  void draw_hiding_planes(const glm::dvec3& eye, const ViewProjection& from_world);
  EdgeMiddles refine(prt::Mesh& mesh) const;
  static void set_fine_light(DrawnObject& object, std::span<const float> relit,
                             const EdgedLight* edged);
  static void upload_coordinates(const DrawnObject& object, GLuint buffer, GLuint location,
                                 std::span<const glm::vec2> coordinates);
  std::vector<glm::dvec4> hiding_planes(const DrawnObject& object,
                                        const prt::PinholeView& camera) const;
  GLuint use_program(const View& view, const ViewProjection& from_world, const DrawnObject& object,
                     std::optional<GlossyFeatures> glossy = {}) const;
  Result<void> prepare_programs(const View& view);
  static void add_pictures(DrawnObject& object, const prt::BakedObject& baked,
                           const Appearance& appearance);
  static void fill_light_map(LightMap& map, std::span<const float> relit, std::size_t stride,
                             const std::vector<Rgb>& albedo);
  static Occluder upload(const prt::Mesh& mesh);
  void upload_by_vertex(std::size_t occluder, const GlBuffer& buffer, std::vector<Rgb> values);
  void draw_objects(const View& view, const ViewProjection& from_world, const Rect& region,
                    bool seen_alone);
  void bind_pictures(const DrawnObject& object, GLuint program) const;
  Canvas& canvas_of_samples(const ViewProjection& from_world);
  void draw_glossy(const View& view, const ViewProjection& from_world, const Rect& region,
                   bool seen_alone, bool blended);
  Result<bool> draw_layer_of_objects(const View& view, const ViewProjection& from_world,
                                     Layer& out);
  Result<bool> redraw_changed(const View& view, CommonLayer& objects);
  Rect changed_region(const ViewProjection& from_world) const;
  void keep_as_drawn(const ViewProjection& from_world);
  Result<void> begin(Canvas& canvas, const Rect& rect);
  Result<void> draw_on(Canvas& canvas, const View& view, const ViewProjection& from_world,
                       Layer& out);
  static double distance_to_box(const DrawnObject& object, const glm::dvec3& eye);
  static bool fronts_only(const DrawnObject& object, const glm::dvec3& eye);
  /// How deep an object lies behind the plane, metres; not above 0 where that hides nothing.
  static double hidden_m(const DrawnPlane& plane, const DrawnObject& object, const glm::dvec3& eye);
  static bool in_view(const DrawnObject& object, const ViewProjection& from_world);
  bool one_sample_does(const prt::PinholeView& camera, const ViewProjection& from_world) const;
  bool one_sample_does(const DrawnObject& object, const prt::PinholeView& camera) const;
  bool find_contours(const View& view, const ViewProjection& from_world, const Rect& region);
  bool find_contour(DrawnObject& object, const ViewProjection& from_world);
  static Rect reach_of(const DrawnObject& object, const ViewProjection& from_world);
  static Rect reach_of(const ViewProjection& from_bounds, const prt::Bounds& bounds);

  int width_, height_;
  bool fine_;  // stills: four samples or more everywhere
  Canvas objects_canvas_, glossy_canvas_, plain_canvas_, hidden_canvas_;
  LayerPrograms programs_;
  double max_edge_m_ = std::numeric_limits<double>::infinity();
  GlTexture white_;               // of one texel
  std::optional<Glossy> glossy_;  // once something has materials
  std::optional<Surroundings> surroundings_;
  std::vector<DrawnObject> objects_;
  std::vector<Occluder> occluders_;
  std::vector<DrawnPlane> planes_;
  std::vector<OccluderMesh> occluder_meshes_;  // by occluder
  ContourSmoother smoother_;
  std::vector<ContourLine> lines_;
  std::optional<prt::PinholeView> contours_from_;
  const ViewLens* contours_through_ = nullptr;
  Layer part_;                        // of a layer that is redrawn in part
  std::optional<DrawnLayers> drawn_;  // what the caller's layers show, but for changed objects
};

}  // namespace penumbra::compositor
