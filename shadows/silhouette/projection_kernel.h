// Inner loops of shadows drawn by projection.
// threads: reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#pragma GCC visibility push(default)
namespace penumbra::shadows {

inline constexpr std::size_t kMaxDirections = 64;
inline constexpr std::size_t kGroup = 16;  // directions that are counted side by side

/// Bits for the first `count` directions.
inline std::uint64_t bits_of(std::size_t count) {
  return count < 64 ? (std::uint64_t{1} << count) - 1 : ~std::uint64_t{0};
}

/// Directions in the frame of the normals, not necessarily unit.
struct Directions {
  alignas(64) float x[kMaxDirections], y[kMaxDirections], z[kMaxDirections];
  std::size_t count = 0;
};
/// Bit k: a triangle with this normal faces direction k.
std::uint64_t find_facing(float x, float y, float z, const Directions& directions);

struct NormalSpans {
  std::span<const float> x, y, z;
};
struct Cone {
  float x, y, z;  // axis, unit
  float sine;     // of the angle around it
};
inline constexpr std::uint8_t kFacesNone = 0, kFacesAll = 1, kUnsure = 2;
/// Whether triangles face all directions of a cone, or none: one of the three for each.
void find_facing_all(const NormalSpans& normals, const Cone& cone, std::span<std::uint8_t> out);

/// A stretch of a silhouette: x and z in cells, y in metres.
struct SegmentSpan {
  float from_x, from_y, from_z, to_x, to_y, to_z;
};
/// So many directions' shifts of a shadow: cells for each metre of height.
struct Shifts {
  alignas(64) float x[kGroup], z[kGroup];
};
/// A stretch on the plane, by direction: its lower end, and the rows before which its two ends lie,
/// 0..height.
struct ProjectedEdge {
  alignas(64) float x[kGroup], z[kGroup], slope[kGroup];
  alignas(64) int row[kGroup], last[kGroup];
};
/// Bit by direction: whether the stretch crosses a row. Those alone are set in `out`, or more.
std::uint16_t fall(const SegmentSpan& span_along, const Shifts& shifts, int height,
                   ProjectedEdge& out);

struct alignas(32) Counts {
  std::int16_t of[kGroup];
};
/// Of a row of steps the running sums: bit k of blocked[i] is set where that of direction k is not
/// zero. The steps are zero afterwards.
void sum_steps(Counts* steps, std::size_t nodes, std::uint16_t* blocked);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
