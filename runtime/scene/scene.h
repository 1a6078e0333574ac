// Scenes: scene.toml, placing, and baking what is not baked yet into the cache.
// threads: free functions and const members reentrant, the rest thread-bound; prepare() parallel
// inside
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "lighting/lights/sun.h"
#include "lighting/reflections/reflection_map.h"
#include "prt/bake/bake.h"
#include "prt/clip/light_map.h"
#include "prt/clip/live_bake.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/luminous.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/visibility/lamp.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

inline constexpr std::array kBuiltinAssets{"builtin:knot", "builtin:twist", "builtin:ball",
                                           "builtin:box", "builtin:walker"};

/// Where a mesh stands in the world.
struct Placement {
  glm::dvec3 position{0, 0, 0};
  glm::dquat rotation{1, 0, 0, 0};
  double scale = 1;
  bool place_on_floor = false;  // set on the floor at `fit_size_m`, centred on `position`
  double fit_size_m = .5;       // largest extent
};

struct SceneObject : Placement {
  std::string name;
  // A file, or "builtin:knot", "builtin:twist", "builtin:ball", "builtin:box", "builtin:walker"
  std::string asset;
  std::string animation;  // a clip by name or number, which loops; empty: it stands at rest
  std::string transfer;   // of the clip, by `penumbra bake`; empty: baked first, into the cache
  std::string blend;      // a second clip that is mixed in; empty: none
  double blend_weight = .5;
  bool live = false;       // transfer is traced while it plays: no bake, and always so of a blend
  double transfer_ms = 5;  // a frame, for that
  std::array<int, 2> light_map{0, 0};  // width, height of one, texels; 0: transfer at vertices
  Rgb albedo{.7f, .7f, .7f};
  double spin_rpm = 0;           // turntable about the receiver's normal
  int max_vertices = 0;          // lit; 0: as BakeSettings has it
  bool visible = true;           // from the start
  bool emission_lights = false;  // what its materials emit lights floor, real meshes and objects
  // Not of files: baked as BakeSettings::coarse(), and which one of that name it is
  bool coarse = false;
  unsigned instance = 0;
};

struct RealPlane {
  glm::dvec3 point{0, 0, 0}, normal{0, 1, 0};
};
struct RealGeometry : Placement {  // the placement is a mesh's
  std::optional<RealPlane> plane;  // or
  std::string mesh;                // a file or a built-in, or
  std::string depth, camera;       // a depth picture and the camera that saw it
  std::optional<Rgb> albedo;
};

struct Scene {
  std::vector<SceneObject> objects;
  std::vector<RealGeometry> real;
  std::vector<shadows::Lamp> lamps{};
  std::optional<lighting::SunSite> sun{};  // where the sun is known to stand
};

/// errors: kNotFound, kUnreadable, kInvalid (unknown key, bad value: file and line)
Result<Scene> read_scene(const std::filesystem::path& path);
/// The file that read_scene reads as this scene again; the names of files become absolute.
/// errors: kUnwritable
Result<void> write_scene(const std::filesystem::path& path, const Scene& scene);

/// What was baked before is kept in a folder.
enum class BakeCache {
  kUsed,
  kNotUsed,
  kOnly  // nothing is baked: what is not there is kNotFound
};

struct BakeSettings {
  /// Rays of vertices count where `visibility` is not kept: of characters and real things.
  int bands = 5, bounces = 4, rays = 1024, ground_rays = 1024;
  /// Whether still objects keep what their vertices see: lamps are then looked up instead of
  /// traced, and transfer comes from it.
  bool visibility = true;
  BakeCache cache = BakeCache::kUsed;
  /// Longest edge of still objects after subdivision, as a fraction of the bounding radius: one in
  /// 33 holds the edges of a sun's shadow. Characters always have the default.
  float max_edge_fraction = .03f;
  /// A still object with more of them is lit at about so many and drawn in full.
  std::size_t max_vertices = 100'000;

  /// For a first picture in seconds: a quarter of the vertices and of the rays, no visibility.
  static BakeSettings coarse() {
    BakeSettings out;
    out.max_edge_fraction = .06f;
    out.max_vertices = 30'000;
    out.rays = out.ground_rays = 256;
    out.visibility = false;
    return out;
  }
};

/// A character in its bake frame, what it plays, and the clip's transfer unless that is traced
/// live.
struct Animation {
  prt::Character character;
  int clip = 0;
  prt::BakedSequence sequence{};
  prt::SurfaceLayout layout{};
  std::optional<int> blend{};  // a second clip
  float blend_weight = 0;
  bool live = false;
  double live_seconds = 0;  // a frame may take for its transfer
  int bands = 5;            // of live transfer

  prt::CharacterPose pose_at(double seconds) const { return pose_at(seconds, blend_weight); }
  prt::CharacterPose pose_at(double seconds, float weight) const;
  double longest_clip_s() const;
};

/// Transfer that is traced while its character moves.
struct LiveTransfer {
  prt::LiveBake bake;
  bool begun = false;
  // As measured: what a frame costs whatever is traced, and each visit; 0: not yet.
  double fixed_seconds = 0, seconds_a_visit = 0;
};

/// An object ready to be drawn. The bake frame stands on the receiver, y along its normal.
struct PreparedObject {
  std::string name;
  /// Of an animation as it is at `frame`: mesh, receiver and transfer; the latter is kept up to
  /// date by move_to on demand.
  prt::BakedObject baked;
  Pose world_from_bake;  // at time 0
  double spin_rpm = 0;
  std::shared_ptr<const Animation> animation{};  // null: it does not move by itself
  double frame = 0;                      // of the animation; seconds where its transfer is live
  float weight = 0;                      // of its second clip then
  int held = 0;                          // frames of live transfer at that pose
  std::shared_ptr<LiveTransfer> live{};  // of one that plays; null: made by begin_live
  std::vector<glm::mat3> turns{};        // of its bones then
  bool visible = true;                   // from the start
  std::vector<prt::LuminousPart> luminous{};  // what of it lights its surroundings
  unsigned instance = 0;                      // which one of that name, see SceneObject

  /// Placement at a time: the turntable turns about the bake frame's y.
  Pose pose_at(double seconds) const;
  /// In the bake frame, as it is drawn.
  prt::Mesh mesh_at(double seconds) const;
  struct MoveOptions {
    bool all_transfer = true;  // all of `baked`; else what relight() needs alone
    /// Rays of live transfer keep to the time that the animation allows them a frame; else their
    /// number is always the same.
    bool keep_time = false;
    std::optional<float> blend_weight{};  // of the second clip; nothing: as the animation has it
    /// It stands still: live transfer goes on for kSettling frames at the pose that it holds.
    bool holds = false;
  };
  static constexpr int kSettling = 32;
  /// Brings an animation to a time: its mesh and its transfer. Returns false where nothing moved.
  bool move_to(double seconds, const MoveOptions& options);
  /// A copy's own live transfer: two copies never share one.
  /// errors: kUnavailable (Embree)
  Result<void> begin_live();
  /// As prt::relight of the baked transfer, of its reflected part, of the receiver's deficit and
  /// its reflected part.
  enum class TransferPart { kSurface, kReflected, kGround, kGroundReflected };
  static constexpr std::size_t kParts = 4;
  /// Of a baked animation.
  const prt::TransferSequence& clip_of(TransferPart part) const;
  std::span<const glm::mat3> turns_of(TransferPart part) const;
  void relight(TransferPart part, const RadianceSh& light, std::span<float> out) const;
};

/// The real meshes as one, baked like an object on the plane that they stand on: vertex i is that
/// of real_mesh.
struct PreparedReal {
  prt::BakedObject baked;
  Pose world_from_bake;
};

struct PreparedScene {
  std::vector<PreparedObject> objects;
  std::vector<prt::Plane> planes;
  prt::Mesh real_mesh;  // world frame; empty without real meshes
  // Null without real meshes, or nothing virtual beside them
  std::shared_ptr<const PreparedReal> real{};
  std::vector<shadows::Lamp> lamps{};
  std::optional<lighting::SunSite> sun{};
};

/// Loads, places and bakes. What is baked and which triangles are left out goes to the log
/// (core/io/log.h).
/// errors: what the assets say
Result<PreparedScene> prepare(
    const Scene& scene, const BakeSettings& settings,
    const std::function<std::function<void(double)>(const std::string&)>& progress);

/// Roughnesses of all surfaces with materials; empty without any.
lighting::SurfaceRoughness mirrored_roughness(const PreparedScene& scene);

/// From the mesh's frame to the world. With fit_size_m the mesh, turned as it is, touches the floor
/// of normal `up` through the position.
glm::dmat4 world_from_mesh(const Placement& placement, const prt::Mesh& mesh,
                           const glm::dvec3& up = {0, 1, 0});

/// Of the plane under a position; without one, the vertical.
glm::dvec3 floor_normal(const std::vector<prt::Plane>& planes, const glm::dvec3& position);

/// An asset in its own frame, or a built-in one. `edge_fraction`: longest edge after subdivision,
/// as a fraction of the bounding radius (vertex transfer needs short edges); 0 leaves the mesh.
/// Above .05 the built-in knot and twist have a quarter of their vertices. A file's mesh of more
/// than `max_vertices` is simplified. With an `edge_fraction` above 0 a closed mesh of a format
/// other than glTF that is inside out is turned round, and the log says so.
struct LoadedAsset {
  prt::Mesh mesh;
  std::shared_ptr<const prt::SurfaceMaterials> surface{};  // null: its albedo is all
  std::shared_ptr<const prt::FineForm> fine{};             // of a mesh that is simplified
};
Result<LoadedAsset> load_asset(const std::string& asset, Rgb albedo, float edge_fraction,
                               std::size_t max_vertices = BakeSettings{}.max_vertices);

/// All meshes of a scene that are visible from the start, in the world frame at a time, for the
/// reference.
prt::Mesh world_mesh(const PreparedScene& scene, bool with_objects, double seconds = 0);
/// Of the same vertices: those without materials are Lambertian with their albedo. Null where there
/// are no materials at all.
/// errors: kInvalid (more than 65,536 materials)
Result<std::shared_ptr<const prt::SurfaceMaterials>> world_surface(const PreparedScene& scene,
                                                                   bool with_objects,
                                                                   double seconds = 0);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
