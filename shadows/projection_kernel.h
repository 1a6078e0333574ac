// Inner loops of shadows drawn by projection.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra::shadows {

inline constexpr std::size_t kMostDirections = 64;
inline constexpr std::size_t kGroup = 16;  // directions that are counted side by side

/// Bits for the first `count` directions.
inline std::uint64_t bits_of(std::size_t count) {
  return count < 64 ? (std::uint64_t{1} << count) - 1 : ~std::uint64_t{0};
}

/// Directions in the frame of the normals, not necessarily unit, and a vector in their middle with the square of the
/// largest distance from it.
struct Directions {
  alignas(64) float x[kMostDirections], y[kMostDirections], z[kMostDirections];
  std::size_t count = 0;
  float middle_x = 0, middle_y = 0, middle_z = 0, square_spread = 0;
};
/// Bit k of out[t]: triangle t faces direction k.
void find_facing(const float* nx, const float* ny, const float* nz, std::size_t triangles,
                 const Directions& directions, std::uint64_t* out);

struct alignas(32) Counts {
  std::int16_t of[kGroup];
};
/// Of a row of steps the running sums: bit k of blocked[i] is set where that of direction k is not zero. The steps are
/// zero afterwards.
void sum_steps(Counts* steps, std::size_t nodes, std::uint16_t* blocked);

}  // namespace penumbra::shadows
