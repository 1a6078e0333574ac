// The light that an object takes from the space around it, whichever way up it lies. It serves
// shadows of tilted objects, shadows on receivers of any shape (mesh or depth), and what virtual
// objects and real meshes take of each other's light. An upright object over a plane is served
// better by compose_planar_shadow, whose visibility is not truncated. All frames are the object's
// bake frame unless a name says otherwise.
// threads: reentrant; bake_occlusion_field and field_ratios are parallel inside (TBB)
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/sh.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

inline constexpr int kMaxFieldBands = 5;
/// Where the field ends, in radii of the object's bounding sphere; it fades over the last of them.
/// As far as the planar shadow's grid goes.
inline constexpr float kFieldReach = 5;

/// b_n(x) = Int (1 - V(x, w)) Y_n(w) dw over the whole sphere, the object alone in the world, at
/// the points of a grid around it. Along each axis, with p in -1..1 the position in half extents,
/// w in -1..1 even steps, and the axis's own k >= -.5 (the map of prt::GroundGrid):
///   w = (1 + k) p / (1 + k |p|),  p = w / (1 + k - k |w|)
/// Points that the object encloses hold the value just outside the nearest surface: a receiver is
/// never inside, and interpolation between the two sides would darken what touches the object.
struct OcclusionField {
  int size = 0;  // points along an edge
  int bands = 0;
  glm::vec3 centre{0, 0, 0};   // metres
  float radius = 0;            // of the object's bounding sphere, metres
  float half_extent = 0;       // from the centre to the outermost points along an axis, metres
  glm::vec3 stretch{0, 0, 0};  // k of each axis
  /// Halves: b_n of the point (i, j, k) along x, y, z stands at
  /// ((k size + j) size + i) bands^2 + n.
  std::vector<std::uint16_t> blocked;
};

struct FieldOptions {
  int size = 32;       // even (so that no point lies in a flat mesh's own plane), 8..128
  int bands = 5;       // 1..kMaxFieldBands
  int rays = 512;      // per point, a multiple of 16
  float extent = 1.5;  // half_extent in radii, 1.2..kFieldReach
  std::function<void(double done)> progress;  // 0..1, called from worker threads, serialised
};

/// Both sides of a triangle block, as in the bake; normals and albedo are not looked at.
/// errors:  kInvalid (options, no triangles, all vertices in one place), kNonFinite (vertex named),
///          kUnavailable (Embree)
/// source:  Zhou et al. 2005; differs: a grid instead of shells
Result<OcclusionField> bake_occlusion_field(const prt::Mesh& mesh, const FieldOptions& options);

/// b_n at a position: trilinear in the grid; beyond it, b falls with the square of the distance
/// along the line from the centre, as a solid angle does, and fades to zero at kFieldReach. It is
/// continuous everywhere, and zero where the position is not finite.
/// out: field.bands^2 values
void blocked_at(const OcclusionField& field, const glm::vec3& position, std::span<float> out);

/// A light in an object's bake frame, made ready for queries of that object's field: 5 us for every
/// change of the light or turn of the object, and 3 ms more for the first in a run (tables). No
/// heap, so it can be made per frame.
class FieldLight {
 public:
  static constexpr int kLobeTerms = 18;  // of the clamped cosine: bands 0, 1, 2 and 4

  /// in: 1 <= field_bands <= kMaxFieldBands; the light may have more bands than the field
  FieldLight(const RadianceSh& light, int field_bands);

  int field_bands() const { return field_bands_; }

  /// E0 - E: what the blocked directions take of the irradiance of a surface with this unit normal.
  /// Cosine and visibility are truncated, so values slightly below zero are possible.
  /// in:     blocked, field_bands^2 values from blocked_at
  /// source: h(n)^T M b, h_i = A_l Y_i(n), M_ij = sum_k l_k Int Y_i Y_j Y_k
  Rgb deficit(std::span<const float> blocked, const glm::vec3& normal) const;

  /// l - M b with the light's bands: what another object, centred where `blocked` was looked up, is
  /// lit by. For several occluders take one after the other, each with a FieldLight of what the
  /// last has left.
  RadianceSh seen_through(std::span<const float> blocked) const;

 private:
  friend class RatioBlock;

  RadianceSh light_;
  int field_bands_;
  /// A_l M as [j of the field][i of the cosine][colour]; then a row of A_l l, which gives E0.
  std::array<float, (kMaxFieldBands * kMaxFieldBands + 1) * kLobeTerms * 3> matrix_{};
};

/// Points of real or virtual surfaces, in the world frame; equally many of each list.
struct FieldReceiver {
  std::span<const glm::vec3> positions;
  std::span<const glm::vec3> normals;  // unit
  /// E of the distant lights, which are not in FieldLight, on the open points; empty: none.
  std::span<const Rgb> distant_irradiance;
};

/// s = 1 - deficit/E0 of every point, of a black object, clamped to 0..1.5, where E0 counts the
/// lights; what the object blocks of them is not in it. It is 1 exactly beyond the object's reach,
/// where E0 has no footing (below kMinIrradiance of the mean; faded in up to twice that, since
/// normals vary), and where a point or normal is not finite. Several objects: smooth_ratios, then
/// multiply. form_factors, where wanted: the irradiance of each point if the object shone with
/// radiance 1 in all directions, 0 where that is not finite; what it sends back is that times its
/// exit radiance.
/// errors: kInvalid (lengths, light made for other bands)
Result<void> field_ratios(const OcclusionField& field, const FieldLight& light,
                          const Pose& bake_from_world, const FieldReceiver& receiver,
                          std::span<Rgb> ratios, std::span<float> form_factors = {});

struct PlacedField {
  const OcclusionField* field;
  Pose world_from_bake;
};

/// As combine_shadows, for ratios at points: changes the second's so that the product with the
/// first's counts once what both block.
/// threads: reentrant, parallel inside; no allocation
void smooth_ratios(const PlacedField& first, const PlacedField& second,
                   std::span<const glm::vec3> positions, std::span<const Rgb> first_ratios,
                   std::span<Rgb> ratios);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
