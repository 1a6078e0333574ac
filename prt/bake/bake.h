// Precomputed radiance transfer of an object on its receiver.
// Frames: a mesh lives in its bake frame (y up = the receiver's normal, metres); the light is
// rotated into that frame. Back faces are black, in the bake and in the reference alike.
// threads: reentrant and internally parallel (TBB)
#pragma once

#include <cstdint>
#include <functional>
#include <glm/mat3x3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/result.h"
#include "prt/geometry/fine_form.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/transfer.h"
#include "prt/transfer/visibility_map.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

inline constexpr int kMaxBounces = 256;

struct BakeOptions {
  int bands = 5;
  /// Of light between the object's parts, and between object and receiver. From the second on, what
  /// comes after the last is continued as a geometric series.
  int bounces = 4;
  /// Per vertex, a multiple of 64. With `visibility` vertices send as many as their edges need, and
  /// this counts only above 4,096.
  int rays = 1024;
  /// Per receiver texel, a multiple of 64; fewer where it sees little, but with `ray_frames`.
  int ground_rays = 1024;
  bool visibility = false;  // whether to find BakedObject::visibility
  std::optional<Receiver> receiver;
  /// Keeps what the receiver reflects apart (BakedObject::floor), so that it can get any albedo
  /// later; its own counts as 0.
  bool floor_apart = false;
  /// Bands of what comes by reflection (BakedObject::reflected).
  int reflected_bands = kReflectedBands;
  /// One a vertex, or none: axes with the normal as the third, in which its rays keep their places.
  /// Turned with the material they give what only turns the same transfer in all poses, but for
  /// single rays that graze an edge. Not with `visibility`.
  std::span<const glm::mat3> ray_frames{};
  std::function<void(double done)> progress;  // 0..1, called from worker threads, serialised
};

/// How well a vertex is known; not kept in files.
struct PointQuality {
  float standard_error = 0;  // of t_0, fraction of an open point's
  // Fraction of its rays' cosine that met a surface from behind: it lies within something
  float behind = 0;
};

struct BakeReport {
  std::uint64_t rays = 0;
  double seconds = 0;
  /// RMS over vertices of the standard error of t_0 relative to the mean t_0, from the spread of
  /// four quarters of the rays, or two halves of a visibility map's cells. Together they lie
  /// closer, but what hides from all rays of a wide cell is not in it.
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
  /// The part of `transfer`, and of the receiver's irradiance/pi, that came by reflection between
  /// object and receiver: smooth, so at most kReflectedBands, and what a light needs beside its
  /// direct light.
  Transfer reflected, ground_reflected;
  /// What the receiver's reflection adds to the surface, and to the receiver's own irradiance/pi:
  /// at its albedo rho, rho times `floor` of light that it reflects once, and
  /// rho^2 / (1 - rho floor_echo) times `floor_again` of light that it reflects more often. Empty
  /// where it is counted in, or none.
  Transfer floor, ground_floor, floor_again, ground_floor_again;
  Rgb floor_echo{};  // of light that comes to a white floor again, what comes once more
  /// The deficit on all nine bands at up to kShadowProbes of the receiver's texels that a uniform
  /// sky would darken by 5 %: what the governor predicts truncation from. No points without
  /// receiver or bounces.
  static constexpr int kShadowProbes = 64;
  Transfer shadow_probes;
  /// Of the mesh alone: what the receiver hides counts as open.
  VisibilityMap visibility;
  /// Materials of the mesh, for whoever draws it; null where its albedo is all.
  std::shared_ptr<const SurfaceMaterials> surface{};
  /// What is drawn instead of the mesh; null: the mesh. Not in files.
  std::shared_ptr<const FineForm> fine{};
  BakeReport report;
};

/// A bake with its floor apart on a floor of this albedo. One without a floor apart stays as it is.
BakedObject on_floor(const BakedObject& baked, const Rgb& albedo);

/// Precomputes transfer at every vertex, and at the texels of the receiver with the object in
/// place.
/// errors:  kInvalid (options), kNonFinite (the mesh), kUnavailable (Embree)
/// source:  Sloan, Kautz & Snyder 2002;
///          t = A_l Y_n/pi - (1/N) sum_blocked Y_n(d_i), d_i by the cosine, or with `visibility`
///          - sum_blocked of its cells' integrals (convex shapes come out exact);
///          t^{b+1} = t^S + sum_hits w rho t^b(hit), w of the ray's cosine
Result<BakedObject> bake(Mesh mesh, const BakeOptions& options);

}  // namespace penumbra::prt
#pragma GCC visibility pop
