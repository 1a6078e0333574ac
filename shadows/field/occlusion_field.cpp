#include "shadows/field/occlusion_field.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>
#include <mutex>

#include "core/conventions.h"
#include "core/half.h"
#include "core/parallel.h"
#include "lighting/sh/basis.h"
#include "prt/geometry/rays.h"

namespace penumbra::shadows {

namespace {

constexpr int kLanes = prt::RayScene::kPacket;
static_assert(kLanes == lighting::kBasisLanes);
constexpr int kMaxValues = kMaxFieldBands * kMaxFieldBands;

bool is_finite(const glm::vec3& v) {
  return std::isfinite(v.x + v.y + v.z);
}

// ------------------------------------------------------------------------------------- bake

// In radii of the object.
constexpr float kClear = 1e-4f;     // points are put this far outside of a surface
constexpr float kConeFrom = 1.02f;  // from here on rays are aimed at the bounding sphere

// Blocked fraction of the sphere from which on a point counts as inside: a hole between two
// triangles or the mouth of a bottle does not make it a place for a receiver.
constexpr float kEnclosed = .98f;

// One set of directions for all points, in packets that lie together.
class ConePattern {
 public:
  explicit ConePattern(int rays) {
    struct FieldSample {
      double height, turn;
    };
    std::vector<FieldSample> samples;  // Fibonacci lattice (Gonzalez 2010)
    for (int i = 0; i < rays; ++i)
      samples.push_back({(i + .5) / rays, std::fmod(i * std::numbers::phi, 1.)});
    const double rows = std::max(1., std::floor(std::sqrt(rays / kLanes)));
    std::ranges::sort(samples, {}, [&](const FieldSample& s) {
      return std::pair(std::floor(s.height * rows), s.turn);
    });
    for (const FieldSample& s : samples) {
      height_.push_back(static_cast<float>(s.height));
      cosine_.push_back(static_cast<float>(std::cos(2 * kPi * s.turn)));
      sine_.push_back(static_cast<float>(std::sin(2 * kPi * s.turn)));
    }
  }

  int rays() const { return static_cast<int>(height_.size()); }
  int packets() const { return rays() / kLanes; }

  // Even in solid angle within a cone about the frame's third column.
  void fill(int packet, const glm::mat3& frame, float cos_half,
            prt::RayScene::RayPacket& out) const {
    for (int i = 0; i < kLanes; ++i) {
      const auto k = static_cast<std::size_t>(packet * kLanes + i);
      const float z = 1 - height_[k] * (1 - cos_half), r = std::sqrt(std::max(0.f, 1 - z * z));
      const glm::vec3 d = frame * glm::vec3(r * cosine_[k], r * sine_[k], z);
      out.x[i] = d.x, out.y[i] = d.y, out.z[i] = d.z;
    }
  }

 private:
  std::vector<float> height_, cosine_, sine_;
};

// Orthonormal with the given third column, and turned about it by an angle of each point's own, so
// that neighbours do not share their errors.
glm::mat3 frame_about(const glm::vec3& axis, std::size_t point) {
  const glm::vec3 aside = std::abs(axis.x) < .6f ? glm::vec3(1, 0, 0) : glm::vec3(0, 1, 0);
  const glm::vec3 u = glm::normalize(glm::cross(axis, aside)), v = glm::cross(axis, u);
  const double angle = 2 * kPi * std::fmod(static_cast<double>(point) * std::numbers::phi, 1.);
  const auto c = static_cast<float>(std::cos(angle)), s = static_cast<float>(std::sin(angle));
  return {c * u + s * v, c * v - s * u, axis};
}

// The k of one axis of which the object fills the fraction e. Steps at its faces are
// (1 + k e)^2/(1 + k) of even ones, least for k = (1 - 2 e)/e. Near that k, one is taken that lays
// grid points just outside the faces: on one of them the object may lie, and the floor then gets
// values of its own side alone.
float best_stretch(float e, int size) {
  constexpr float kOutside = 5e-4f, kMin = -.5f, kMax = 8;
  constexpr float kThinnest = .15f;  // beyond, the outermost cells would grow too large
  e += kOutside;
  const float counted = std::clamp(e, kThinnest, .5f);
  const float k = (1 - 2 * counted) / counted;
  const float steps = .5f * static_cast<float>(size - 1);  // on each side, points at .5, 1.5, ...
  const float wanted = std::floor((1 + k) * e / (1 + k * e) * steps) + .5f;
  const float w = std::min(wanted, steps - 1) / steps;
  const float aligned = (w - e) / (e * (1 - w));
  return aligned > kMin && aligned < kMax ? aligned : k;
}

// Works on a mesh moved to the origin and scaled to radius one, so that neither the size nor the
// place of the model changes a float operation.
class FieldBaker {
 public:
  FieldBaker(const prt::RayScene& scene, const FieldOptions& options, const glm::vec3& stretch)
      : scene_(scene), options_(options), stretch_(stretch), pattern_(options.rays) {}

  void run(std::span<std::uint16_t> out) const;

 private:
  glm::vec3 grid_point(std::size_t index) const;
  float trace(const glm::vec3& origin, std::size_t index, std::span<float> out) const;
  glm::vec3 nearest_outside(const glm::vec3& origin, std::size_t index) const;
  void bake_point(std::size_t index, std::span<float> out) const;

  const prt::RayScene& scene_;
  const FieldOptions& options_;
  glm::vec3 stretch_;
  ConePattern pattern_;
};

glm::vec3 FieldBaker::grid_point(std::size_t index) const {
  const auto size = static_cast<std::size_t>(options_.size);
  const glm::vec3 ijk(index % size, index / size % size, index / (size * size));
  const glm::vec3 w = ijk * (2 / static_cast<float>(size - 1)) - 1.f;
  return options_.extent * w / (1.f + stretch_ * (1.f - glm::abs(w)));
}

// Fills b_n and returns the blocked fraction of the sphere.
float FieldBaker::trace(const glm::vec3& origin, std::size_t index, std::span<float> out) const {
  const float distance = glm::length(origin);
  const bool cone = distance > kConeFrom;
  const float cos_half = cone ? std::sqrt(1 - 1 / (distance * distance)) : -1;
  const glm::mat3 frame = frame_about(cone ? -origin / distance : glm::vec3(0, 0, 1), index);
  const float fraction = .5f * (1 - cos_half) / static_cast<float>(pattern_.rays());
  const auto solid_angle = static_cast<float>(4 * kPi) * fraction;

  alignas(64) float sum[kMaxValues * kLanes] = {}, basis[kMaxValues * kLanes], weight[kLanes];
  int hits = 0;
  prt::RayScene::RayPacket packet;
  for (int p = 0; p < pattern_.packets(); ++p) {
    pattern_.fill(p, frame, cos_half, packet);
    const std::uint32_t blocked = scene_.occluded(origin, 0, packet);
    if (blocked == 0) continue;
    hits += std::popcount(blocked);
    lighting::evaluate_basis_block(options_.bands, packet.x, packet.y, packet.z, basis);
    for (int i = 0; i < kLanes; ++i) weight[i] = blocked >> i & 1 ? solid_angle : 0;
    for (std::size_t n = 0; n < out.size(); ++n)
      for (int i = 0; i < kLanes; ++i) sum[n * kLanes + i] += weight[i] * basis[n * kLanes + i];
  }
  for (std::size_t n = 0; n < out.size(); ++n) {
    out[n] = 0;
    for (int i = 0; i < kLanes; ++i) out[n] += sum[n * kLanes + i];
  }
  return static_cast<float>(hits) * fraction;
}

glm::vec3 FieldBaker::nearest_outside(const glm::vec3& origin, std::size_t index) const {
  constexpr float kNowhere = std::numeric_limits<float>::max();
  float nearest = kNowhere;
  glm::vec3 way{};
  prt::RayScene::RayPacket packet;
  for (int p = 0; p < pattern_.packets(); ++p) {
    pattern_.fill(p, frame_about({0, 0, 1}, index), -1, packet);
    scene_.intersect(origin, 0, packet);
    for (int i = 0; i < kLanes; ++i)
      if (packet.triangle[i] != prt::RayScene::kMiss && packet.distance[i] < nearest)
        nearest = packet.distance[i], way = {packet.x[i], packet.y[i], packet.z[i]};
  }
  return nearest < kNowhere ? origin + (nearest + kClear) * way : origin;
}

void FieldBaker::bake_point(std::size_t index, std::span<float> out) const {
  constexpr int kMaxMoves = 4;  // of two bodies that overlap, the way out of one ends in the other
  glm::vec3 at = grid_point(index);
  for (int move = 0; trace(at, index, out) > kEnclosed && move < kMaxMoves; ++move)
    at = nearest_outside(at, index);
}

void FieldBaker::run(std::span<std::uint16_t> out) const {
  const auto count = static_cast<std::size_t>(coefficient_count(options_.bands));
  const std::size_t points = out.size() / count;
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(std::size_t{0}, points, 256, [&](const auto& range) {
    std::array<float, kMaxValues> values;
    for (std::size_t p = range.begin(); p < range.end(); ++p) {
      bake_point(p, std::span(values).first(count));
      for (std::size_t n = 0; n < count; ++n) out[p * count + n] = half_from_float(values[n]);
    }
    if (!options_.progress) return;
    const std::scoped_lock lock(mutex);
    done += range.size();
    options_.progress(static_cast<double>(done) / static_cast<double>(points));
  });
}

Result<void> check(const prt::Mesh& mesh, const FieldOptions& o) {
  if (mesh.triangles.empty()) return fail(ErrorCode::kInvalid, "mesh", "has no triangles");
  for (std::size_t i = 0; i < mesh.positions.size(); ++i)
    if (!is_finite(mesh.positions[i]))
      return fail(ErrorCode::kNonFinite, "mesh", fmt::format("vertex {} is not finite", i));
  if (o.size < 8 || o.size > 128 || o.size % 2 != 0)
    return fail(ErrorCode::kInvalid, "size",
                fmt::format("{} is not even and within 8..128", o.size));
  if (o.bands < 1 || o.bands > kMaxFieldBands)
    return fail(ErrorCode::kInvalid, "bands",
                fmt::format("{} is not within 1..{}", o.bands, kMaxFieldBands));
  if (o.rays < kLanes || o.rays % kLanes != 0)
    return fail(ErrorCode::kInvalid, "rays",
                fmt::format("are not a positive multiple of {}", kLanes));
  if (!(o.extent >= 1.2f && o.extent <= kFieldReach))
    return fail(ErrorCode::kInvalid, "extent",
                fmt::format("{} is not within 1.2..{}", o.extent, kFieldReach));
  return {};
}

}  // namespace

Result<OcclusionField> bake_occlusion_field(const prt::Mesh& mesh, const FieldOptions& options) {
  PENUMBRA_TRY(check(mesh, options));
  const prt::Bounds bounds = prt::bounds_of(mesh);
  OcclusionField field;
  field.size = options.size;
  field.bands = options.bands;
  field.centre = bounds.centre();
  field.radius = prt::radius_around(mesh, field.centre);
  field.half_extent = options.extent * field.radius;
  if (!(field.radius > 0 && std::isfinite(field.half_extent)))
    return fail(ErrorCode::kInvalid, "mesh", "has an extent of zero, or too large a one");
  for (int axis = 0; axis < 3; ++axis)
    field.stretch[axis] =
        best_stretch((bounds.high[axis] - field.centre[axis]) / field.half_extent, options.size);

  prt::Mesh unit;
  unit.triangles = mesh.triangles;
  for (const glm::vec3& p : mesh.positions)
    unit.positions.push_back((p - field.centre) / field.radius);
  PENUMBRA_ASSIGN(scene, prt::RayScene::build(unit));
  const auto size = static_cast<std::size_t>(options.size);
  field.blocked.resize(size * size * size *
                       static_cast<std::size_t>(coefficient_count(options.bands)));
  FieldBaker(scene, options, field.stretch).run(field.blocked);
  return field;
}

// ------------------------------------------------------------------------------------- look-up

void blocked_at(const OcclusionField& field, const glm::vec3& position, std::span<float> out) {
  assert(out.size() == static_cast<std::size_t>(coefficient_count(field.bands)));
  std::ranges::fill(out, 0.f);
  glm::vec3 p = position - field.centre;
  const float left = std::min(kFieldReach - glm::length(p) / field.radius, 1.f);
  if (!(left > 0)) return;  // also where it is not a number
  p *= 1 / field.half_extent;
  const float beyond = std::max({1.f, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  p *= 1 / beyond;
  const float scale = left * left * (3 - 2 * left) / (beyond * beyond);

  const glm::vec3 w = (1.f + field.stretch) * p / (1.f + field.stretch * glm::abs(p));
  const glm::vec3 at = (w + 1.f) * (.5f * static_cast<float>(field.size - 1));
  const glm::ivec3 cell = glm::clamp(glm::ivec3(at), 0, field.size - 2);
  const glm::vec3 t = at - glm::vec3(cell);
  const auto size = static_cast<std::size_t>(field.size);
  const std::size_t first =
      (static_cast<std::size_t>(cell.z) * size + static_cast<std::size_t>(cell.y)) * size +
      static_cast<std::size_t>(cell.x);
  for (std::size_t corner = 0; corner < 8; ++corner) {
    const std::size_t i = corner & 1, j = corner >> 1 & 1, k = corner >> 2;
    const float weight = scale * (i ? t.x : 1 - t.x) * (j ? t.y : 1 - t.y) * (k ? t.z : 1 - t.z);
    const std::uint16_t* const b = &field.blocked[(first + (k * size + j) * size + i) * out.size()];
    for (std::size_t n = 0; n < out.size(); ++n) out[n] += weight * float_from_half(b[n]);
  }
}

}  // namespace penumbra::shadows
