// IEEE 754 binary16 by Imath, under one name.
// threads: reentrant
#pragma once

#include <Imath/half.h>

#include <cstdint>

#pragma GCC visibility push(default)
namespace penumbra {

inline float float_from_half(std::uint16_t bits) {
  return imath_half_to_float(bits);
}
inline std::uint16_t half_from_float(float value) {
  return imath_float_to_half(value);
}
inline constexpr std::uint16_t kHalfOne = 0x3c00;

}  // namespace penumbra
#pragma GCC visibility pop
