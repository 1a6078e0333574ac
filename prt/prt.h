// Geometry, ray queries, precomputed radiance transfer, relighting, and the path-traced reference.
// Frames: a mesh lives in its bake frame (y up = the receiver's normal, metres); the light is
// rotated into that frame. Back faces are black, in the bake and in the reference alike. threads:
// free functions reentrant and internally parallel (TBB); RayScene queries reentrant
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/sh.h"
#include "prt/animation.h"     // IWYU pragma: export
#include "prt/live_bake.h"     // IWYU pragma: export
#include "prt/receiver.h"      // IWYU pragma: export
#include "prt/sequence.h"      // IWYU pragma: export
#include "prt/vertex_sight.h"  // IWYU pragma: export

namespace penumbra::prt {

// ---------------------------------------------------------------------------------- geometry

struct Mesh {
  std::vector<glm::vec3>
      positions;  // those that no triangle uses are points to be baked and lit, e.g. texels
  std::vector<glm::vec3> normals;                       // unit, one per position
  std::vector<Rgb> albedo;                              // 0..1, one per position
  std::vector<std::array<std::uint32_t, 3>> triangles;  // counter-clockwise seen from outside
};

struct Bounds {
  glm::vec3 low, high;
  glm::vec3 centre() const { return .5f * (low + high); }
};
Bounds bounds_of(const Mesh& mesh);
/// By vertex, the first one in the same place, to the bit (0 and -0 are one): normals and the like split vertices where the
/// surface goes on.
std::vector<std::uint32_t> places_of(std::span<const glm::vec3> positions);
/// Largest distance of a vertex from `centre`.
float radius_around(const Mesh& mesh, const glm::vec3& centre);
/// Affine map of positions; normals follow by the inverse transpose.
void transform(Mesh& mesh, const glm::dmat4& matrix);
void append(Mesh& mesh, const Mesh& other);
/// Splits every edge longer than `longest_edge` (shared edges alike, so no cracks); at most
/// `triangle_limit` triangles. Vertex transfer needs edges shorter than the shading features.
/// Returns of what edge each new vertex is the middle, in their order.
std::vector<std::array<std::uint32_t, 2>> subdivide(Mesh& mesh, float longest_edge,
                                                    std::size_t triangle_limit = 400'000);

/// Sphere from a subdivided icosahedron, unit outward normals.
Mesh make_sphere(const glm::vec3& centre, float radius, int subdivisions, Rgb albedo);
/// Axis-aligned box with flat faces of n x n quads.
Mesh make_box(const glm::vec3& low, const glm::vec3& high, int n, Rgb albedo);
/// (2, 3) torus knot resting on y = 0: the shape of the built-in demo.
Mesh make_knot(float height, int segments, int sides, Rgb albedo);

struct Import {
  Mesh mesh;
  std::size_t degenerate_triangles = 0;  // removed
};
/// glTF (.gltf, .glb), OBJ, PLY, STL, FBX or COLLADA, at rest pose; normals are made where absent.
/// Materials give the albedo, `default_albedo` where there is none.
/// errors:  kNotFound, kUnreadable, kInvalid (no triangles, all degenerate), kNonFinite (vertex
/// named)
Result<Import> import_mesh(const std::filesystem::path& path, Rgb default_albedo);

// ---------------------------------------------------------------------------------- rays

struct Hit {
  std::uint32_t triangle;
  float distance, u, v;  // position = (1-u-v) a + u b + v c
  bool front;            // seen against the geometric normal
};

/// Triangle rays over Embree.
class RayScene {
 public:
  /// errors: kInvalid (no triangles), kUnavailable (Embree says why)
  static Result<RayScene> build(const Mesh& mesh);
  ~RayScene();
  RayScene(RayScene&&) noexcept;
  RayScene& operator=(RayScene&&) noexcept;

  /// Another form of the same mesh: as many vertices, the same triangles. Only while no ray is under way.
  void set_form(const Mesh& form);

  std::optional<Hit> intersect(const glm::vec3& origin, const glm::vec3& direction, float near,
                               float far = 1e30f) const;
  bool occluded(const glm::vec3& origin, const glm::vec3& direction, float near,
                float far = 1e30f) const;

  static constexpr int kPacket = 16;
  struct Packet {
    alignas(64) float x[kPacket], y[kPacket], z[kPacket];  // unit directions
    alignas(64) float distance[kPacket], u[kPacket], v[kPacket];
    alignas(64) std::uint32_t triangle[kPacket];  // kMiss or the triangle
    alignas(64) bool front[kPacket];
  };
  static constexpr std::uint32_t kMiss = 0xffffffffu;
  /// Sixteen rays from one origin: nearest hits.
  void intersect(const glm::vec3& origin, float near, Packet& packet) const;
  /// Sixteen rays from one origin: bit i is set when ray i is blocked.
  std::uint32_t occluded(const glm::vec3& origin, float near, const Packet& packet) const;

 private:
  struct Impl;
  explicit RayScene(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Meshes at rigid poses in one world, for shadow rays through all of them.
/// threads: occluded() reentrant; everything else only while no ray is under way
class RayWorld {
 public:
  /// errors: kUnavailable (Embree says why)
  static Result<RayWorld> create();
  ~RayWorld();
  RayWorld(RayWorld&&) noexcept;
  RayWorld& operator=(RayWorld&&) noexcept;

  /// The number names the mesh from then on.
  /// errors: kInvalid (no triangles), kUnavailable
  Result<int> add(const Mesh& mesh);
  void set_pose(int mesh, const Pose& world_from_mesh);
  /// Another form of the same mesh: as many vertices, the same triangles.
  void set_form(int mesh, const Mesh& form);
  bool empty() const;

  static constexpr int kPacket = 16;
  struct Rays {
    alignas(64) float ox[kPacket], oy[kPacket], oz[kPacket];  // origins, metres
    alignas(64) float dx[kPacket], dy[kPacket], dz[kPacket];  // unit directions
    alignas(64) float far[kPacket];  // metres: blockers beyond do not count
    Rays() { std::fill_n(far, kPacket, 1e30f); }
  };
  /// Bit i is set when one of the first `count` rays, i, is blocked by any mesh but `except`.
  std::uint32_t occluded(const Rays& rays, int count = kPacket, int except = -1) const;
  std::uint32_t occluded_by(int mesh, const Rays& rays, int count = kPacket) const;

 private:
  struct Impl;
  explicit RayWorld(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// ---------------------------------------------------------------------------------- bake

/// The grid that an object needs: out to five radii of its bounding sphere, where an upright object
/// takes less than 1 % of the light (deficit R^2 h/d^3).
GroundGrid fit_ground_grid(const Mesh& mesh, float plane_height, int size = 128);

inline constexpr int kIndirectBands = 9;
inline constexpr int kMostBounces = 256;

struct BakeOptions {
  int bands = 5;
  /// Of light between the object's parts, and between object and receiver. From the second on, what comes after the
  /// last is continued as a geometric series.
  int bounces = 4;
  int rays = 1024;         // per vertex, a multiple of 64
  int ground_rays = 1024;  // per receiver texel, a multiple of 64
  bool sight = false;      // whether to find BakedObject::sight
  std::optional<Receiver> receiver;
  /// Bands of what comes by reflection (BakedObject::indirect).
  int indirect_bands = kIndirectBands;
  /// One a vertex, or none: axes with the normal as the third, in which its rays keep their places. Turned with the
  /// material they give what only turns the same transfer in all poses, but for single rays that graze an edge.
  std::span<const glm::mat3> ray_frames{};
  std::function<void(double done)> progress;  // 0..1, called from worker threads, serialised
};

/// Transfer t_n of conventions.h at points, as half floats in structure-of-arrays order:
/// value(channel, n, point) stands at ((channel * bands^2) + n) * stride + point. One channel
/// serves all three colours when every albedo is grey.
struct Transfer {
  int bands = 0;
  int channels = 1;
  std::size_t points = 0;
  std::size_t stride = 0;  // points rounded up to a multiple of 64; the padding is zero
  std::vector<std::uint16_t> values;

  Transfer() = default;
  Transfer(int bands_, int channels_, std::size_t points_);
  std::size_t index(int channel, int n, std::size_t point) const {
    return (static_cast<std::size_t>(channel) * static_cast<std::size_t>(coefficient_count(bands)) +
            static_cast<std::size_t>(n)) *
               stride +
           point;
  }
  float value(int channel, int n, std::size_t point) const;
  void set(int channel, int n, std::size_t point, float v);
};

/// How well a vertex is known; not kept in files.
struct PointQuality {
  float standard_error = 0;  // of t_0, share of an open point's
  float behind = 0;  // share of its rays that met a surface from behind: it lies within something
};

struct BakeReport {
  std::uint64_t rays = 0;
  double seconds = 0;
  /// RMS over vertices of the standard error of t_0 relative to the mean t_0, from the spread of
  /// four quarters of the rays; an upper bound, since together they are stratified finer.
  double standard_error = 0;
  std::vector<PointQuality> quality;  // by vertex
};

struct BakedObject {
  Mesh mesh;
  Transfer transfer;
  std::optional<Receiver> receiver;
  /// (E0_n - E_n)/pi at the receiver's texels, row by row: what the object takes of an unshadowed
  /// receiver's irradiance E0 (its own reflected light counted in); empty without a receiver.
  Transfer ground_deficit;
  /// The share of `transfer`, and of the receiver's irradiance/pi, that came by reflection between object and
  /// receiver: smooth, so at most kIndirectBands, and what a disc needs beside its direct light.
  Transfer indirect, ground_indirect;
  /// The deficit on all nine bands at up to kShadowProbes of the receiver's texels that a uniform sky would darken by
  /// 5 %: what the governor predicts truncation from. No points without receiver or bounces.
  static constexpr int kShadowProbes = 64;
  Transfer shadow_probes;
  /// Of the mesh alone: what the receiver hides counts as open.
  VertexSight sight;
  BakeReport report;
};

/// Precomputes transfer at every vertex, and at the texels of the receiver with the object in
/// place.
/// errors:  kInvalid (options), kUnavailable (Embree)
/// source:  Sloan, Kautz & Snyder 2002; t
/// = A_l Y_n/pi - (1/N) sum_blocked Y_n(d_i), d_i by the cosine
///          (convex shapes come out exact); t^{b+1} = t^S + (1/N) sum_blocked rho t^b(hit)
Result<BakedObject> bake(Mesh mesh, const BakeOptions& options);

/// The baked file: binary glTF that any viewer opens, transfer in underscore attributes.
/// errors: kUnwritable / kNotFound, kUnreadable, kInvalid (not baked by us, another version)
Result<void> write_baked(const std::filesystem::path& path, const BakedObject& object);
Result<BakedObject> read_baked(const std::filesystem::path& path);
/// True when the file is a glTF that carries our transfer.
bool is_baked_file(const std::filesystem::path& path);

// ---------------------------------------------------------------------------------- relight

/// out[channel * stride + point] = sum_n l_n t_n(point): exit radiance for a unit albedo (times pi:
/// irradiance). `light` must be in the bake frame; further bands than baked are ignored.
/// out: 3 * transfer.stride floats. threads: reentrant, no allocation
void relight(const Transfer& transfer, const RadianceSh& light, std::span<float> out);

/// A transfer, or two over the same points, as sums of few patterns over these points: their principal components. Light reaches a
/// surface from one side of it, and what stands on a floor from above: half of the coefficients nearly follow from the others.
/// source: Sloan, Hall, Hart & Snyder 2003, "Clustered Principal Components for Precomputed Radiance Transfer", with one cluster
/// and no mean. threads: const members reentrant
class TransferComponents {
 public:
  /// As few as keep the error of each below `error`: RMS over points and over directions of a small light, as a share of what a
  /// surface that faces the light sends back.
  /// in: finite values; `second` of as many points as `first`, or of none
  TransferComponents(const Transfer& first, const Transfer& second, double error);

  /// Patterns of both, and of the first alone.
  int count() const { return parts_[0].count + parts_[1].count; }
  int first_count() const { return parts_[0].count; }
  /// As prt::relight of the first under `light` plus, where it is given, of the second under `more`. Lights of few bands cost as
  /// much as others.
  /// out: exactly 3 * stride floats
  void relight(const RadianceSh& light, const RadianceSh* more, std::span<float> out) const;

 private:
  struct Part {
    int count = 0, coefficients = 0;
    std::vector<float> mix{};  // [pattern][coefficient]
  };
  std::array<Part, 2> parts_;
  int channels_ = 1;
  std::vector<std::uint16_t> values_;  // half floats, BlockedRows
};

// ---------------------------------------------------------------------------------- reference

/// Radiance arriving from a direction, with a sampler when it is peaky.
class EnvironmentLight {
 public:
  /// A lat-long map, sampled by importance.
  /// errors: kInvalid, kNonFinite, kUndetermined (all black)
  static Result<EnvironmentLight> from_map(const Image<Rgb>& map);
  /// Truncated spherical harmonics, negative lobes kept; sampled by their magnitude.
  static EnvironmentLight from_sh(const RadianceSh& light);

  Rgb radiance(const glm::vec3& direction) const;
  bool has_sampler() const { return !cumulative_rows_.empty(); }
  struct Sample {
    glm::vec3 direction;
    Rgb radiance;
    float density;  // per steradian
  };
  Sample sample(float u1, float u2) const;
  float density(const glm::vec3& direction) const;

 private:
  Rgb map_value(const glm::vec3& direction) const;
  Image<Rgb> map_;  // radiance, or with sh_ what it is sampled by
  std::optional<RadianceSh> sh_;
  std::vector<float> cumulative_rows_, cumulative_columns_;
  double total_ = 0;  // of luminance times solid angle
};

/// An infinite real plane. `texture` scales the albedo by position where given.
struct Plane {
  glm::dvec3 point{0, 0, 0}, normal{0, 1, 0};
  Rgb albedo{.5f, .5f, .5f};
  std::function<Rgb(const glm::dvec3&)> texture;
};

/// A sphere of even radiance that nothing sees but by its light.
struct SphereLight {
  glm::dvec3 position{0, 1, 0};
  double radius_m = .03;
  Rgb irradiance_at_1m;  // of a surface that faces it: pi r^2 times its radiance
};

struct World {
  Mesh mesh;  // world frame, virtual and real together
  std::vector<Plane> planes;
  const EnvironmentLight* light = nullptr;
  /// What a ray that leaves the camera and meets nothing shows; `light` when empty.
  std::function<Rgb(const glm::vec3&)> background;
  std::vector<SphereLight> lamps{};
};

struct PinholeView {
  int width = 0, height = 0;
  glm::dvec2 focal_px{0, 0}, principal_px{0, 0};
  Pose world_from_camera;
  friend bool operator==(const PinholeView&, const PinholeView&) = default;
};

struct ReferenceOptions {
  double error = .01;       // stop when the estimated relative RMS error is below
  int longest_path = 12;    // diffuse bounces; Russian roulette from the fourth on
  int most_samples = 4096;  // per pixel
  std::uint64_t seed = 1;
  std::function<void(double done)> progress;
};

struct Reference {
  Image<Rgb> radiance;  // mean of the two halves
  Image<Rgb> half_a, half_b;
  double error = 0;  // RMS(a - b)/2 over the mean, by luminance
  int samples = 0;   // per pixel, both halves
};

/// Path tracer with next-event estimation and balance-heuristic weights (Veach & Guibas 1995).
/// errors: kInvalid (size), kUnavailable
Result<Reference> render_reference(const World& world, const PinholeView& view,
                                   const ReferenceOptions& options);

/// Irradiance at surface points by the same estimator: for shadow errors in s and for closed forms.
struct IrradiancePoint {
  glm::dvec3 position, normal;
};
Result<std::vector<Rgb>> reference_irradiance(const World& world,
                                              std::span<const IrradiancePoint> points, int samples,
                                              std::uint64_t seed);

}  // namespace penumbra::prt
