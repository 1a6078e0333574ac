// Draws virtual objects and their shadows into camera frames by differential rendering, and writes
// the result: video files, a window. GL draws the objects (radiance and coverage) into the
// rectangle that they can reach. The shadow ratio and the fused pass over the touched pixels run on
// the CPU, where the frame is anyway. Pixels outside are not read, converted or written.
// threads: Compositor thread-bound, to the one that made it; VideoWriter thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "compositor/composite_stats.h"
#include "compositor/edged_light.h"
#include "compositor/surroundings.h"
#include "compositor/view.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "shadows/field/planar_shadow.h"

#pragma GCC visibility push(default)
namespace penumbra::compositor {

/// A view that has been drawn, with all that compositing it takes.
/// threads: thread-bound, to whichever has it
class Drawn {
 public:
  Drawn();
  ~Drawn();
  Drawn(Drawn&&) noexcept;
  Drawn& operator=(Drawn&&) noexcept;

  /// The second step of Compositor::composite.
  /// in: frame of the size and kind that draw() was told
  CompositeStats composite_into(FramePixels& frame);

 private:
  friend class Compositor;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

class Compositor {
 public:
  enum class Surface { kOffscreen, kWindow };

  /// oversampling: samples a pixel along each axis, 4 for stills or 2 for video. Video draws only
  /// the triangles that form and light need, and takes one sample a pixel where contours make edges
  /// as good.
  /// errors: kUnavailable (no EGL, no OpenGL ES 3.1, no display)
  static Result<std::unique_ptr<Compositor>> create(int width, int height, Surface surface,
                                                    int oversampling = 2,
                                                    const std::string& title = "Penumbra");
  ~Compositor();

  /// What is added from then on is drawn with edges that stay straight enough before this lens.
  void use_lens(const ViewLens& lens);
  /// Uploads geometry once; the number names the object from then on.
  int add_object(const prt::BakedObject& object, const Appearance& appearance = {});
  /// Another form of an object's mesh: as many vertices, the same triangles. From then on all of
  /// them are drawn.
  void update_vertices(int object, const prt::Mesh& mesh);
  /// Rigid placement of the bake frame in the world, and where that frame would be if the object
  /// stood on its plane as it was baked: there lies its shadow.
  void set_pose(int object, const Pose& world_from_bake, const Pose& world_from_floor);
  void set_pose(int object, const Pose& world_from_bake) {
    set_pose(object, world_from_bake, world_from_bake);
  }
  /// Whether it and its shadow are drawn; they are at first.
  void show(int object, bool visible);
  /// Relit transfer (prt::relight's layout) and shadow. An object without receiver gets an empty
  /// shadow. of_open: the light that the shadow's ratio is of, over that of the open plane; below 1
  /// where real things keep some of it from the object. edged: of the object's vertices; null: no
  /// light is apart.
  void set_light(int object, std::span<const float> relit, const shadows::PlanarShadow& shadow,
                 const Rgb& of_open = {1, 1, 1}, const EdgedLight* edged = nullptr);
  /// What objects with materials (prt::BakedObject::surface) mirror from now on.
  void set_surroundings(const Surroundings& surroundings);
  /// What of each of Surroundings::lights comes to an object's vertices, 0..1; 1 at first, and for
  /// those that are not told.
  void set_light_fractions(int object, std::span<const std::array<float, 4>> fractions);

  /// What an object with materials mirrors of virtual ones in the view that is drawn next, and
  /// until another one is told; at first its transfer stands for it.
  /// in: not empty
  void set_mirrored(int object, const MirroredPicture& picture);
  /// Shadow ratios on the floor around such an object, as it mirrors them, on the grid of its
  /// receiver; null without one.
  const Image<Rgb>* mirrored_floor(int object);

  /// Ways in for real things:
  ///   add_plane          a plane: hides objects; a shadow is seen where its plane is the nearest
  ///   add_occluder       a mesh, or a depth picture made one: hides objects and shadows
  ///   set_ratios         shadows of virtual things on such a mesh
  ///   set_weights        how bright it is beside other real things
  ///   add_real_receiver  with set_real_shadow: shadows of real things on a plane, in the residual
  ///   set_shadow_maps    shadows of virtual and of real things on planes, in each distant light

  /// A plane that real things shade: its grid and place, once, and what they take of the light
  /// beside the lights. The picture shows that already; what virtual things take is taken from what
  /// is left.
  void add_real_receiver(const prt::GroundGrid& grid, const Pose& world_from_grid);
  void set_real_shadow(const shadows::PlanarShadow& shadow);
  /// The lights' shadows on real planes, all at once; none after creation. Copies the maps.
  void set_shadow_maps(std::span<const ShadowMapOnPlane> lights);
  /// Real geometry (world frame): hides objects and shadows behind it.
  /// The number names it for set_ratios.
  int add_occluder(const prt::Mesh& world_mesh);
  /// What virtual things leave of the light at the vertices of real geometry; 1 after add_occluder.
  void set_ratios(int occluder, std::span<const Rgb> ratios);
  /// The radiance that leaves these vertices without virtual things, over that of an open plane,
  /// 1e-3..1e3; 1 after add_occluder. What a pixel shows of several surfaces counts by its light.
  void set_weights(int occluder, std::span<const Rgb> weights);
  /// A real plane: hides objects behind it. Shadows fall on it, so it hides none.
  void add_plane(const glm::dvec3& point, const glm::dvec3& normal);

  /// out = the camera's frame with all that is virtual, in linear camera radiance:
  ///   B = f^-1(z), z' = f(a e L_v + (1 - a) B s)
  /// and with sensor effects
  ///   z' = f(V + T B + n), V = PSF * a e L_v, T = PSF * (1 - a) s,
  ///   var n = g (V + T B) + r^2 - T^2 var B, 0 at least.
  /// in:     camera: a frame of the size given at creation; `out` may be the same object, which
  ///         copies nothing
  /// errors: kInvalid (size, missing curve, depth, effects; `out` is left alone), kUnavailable (GL
  ///         lost; `out` may have its shadows already)
  /// source: Debevec 1998 in the ratio form
  Result<CompositeStats> composite(const View& view, const FramePixels& camera, FramePixels& out);
  Result<CompositeStats> composite(const View& view, FramePixels& frame) {
    return composite(view, frame, frame);
  }
  /// composite() in two steps, the second on any thread while this one goes on. What view.curve
  /// points to must stay until then. `out` keeps its room.
  /// in, errors: as composite
  Result<void> draw(const View& view, const FramePixels& frame, Drawn& out);

  /// From then on another thread may use it, the only one then.
  void release();
  bool has_window() const;
  /// Shows an 8-bit picture; nothing without a window. False when the user has closed the window.
  bool present(const Image<Rgb8>& picture);
  /// All zero without a window.
  Pointer pointer() const;

  std::string renderer() const;  // what GL calls itself

 private:
  struct Impl;
  explicit Compositor(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// H.264 in MP4, written under a temporary name until finish(). Odd sizes lose their last row or
/// column.
/// errors: kUnwritable, kUnavailable (no encoder)
class VideoWriter {
 public:
  /// `live`: half the time for half as many bytes again
  static Result<VideoWriter> create(const std::filesystem::path& path, int width, int height,
                                    double frames_per_second, bool live = false);
  ~VideoWriter();
  VideoWriter(VideoWriter&&) noexcept;
  VideoWriter& operator=(VideoWriter&&) noexcept;

  Result<void> write(const Image<Rgb8>& frame);
  Result<void> finish();

 private:
  struct Impl;
  explicit VideoWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
