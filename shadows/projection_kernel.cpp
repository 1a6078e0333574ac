#include "shadows/projection_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/projection_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::shadows {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

HWY_INLINE std::uint64_t Bits(const std::uint8_t* bytes, std::size_t lanes) {
  std::uint64_t out = 0;
  for (std::size_t b = 0; b < (lanes + 7) / 8; ++b) out |= std::uint64_t{bytes[b]} << 8 * b;
  return out;
}

// Rows of directions past the last one may hold anything: their bits are cut off.
HWY_INLINE std::uint64_t FacingOf(float x, float y, float z, const Directions& directions) {
  const hn::ScalableTag<float> d;
  const std::size_t lanes = hn::Lanes(d);
  const auto nx = hn::Set(d, x), ny = hn::Set(d, y), nz = hn::Set(d, z);
  std::uint64_t out = 0;
  for (std::size_t k = 0; k < directions.count; k += lanes) {
    const auto along = hn::MulAdd(
        nx, hn::Load(d, directions.x + k),
        hn::MulAdd(ny, hn::Load(d, directions.y + k), hn::Mul(nz, hn::Load(d, directions.z + k))));
    std::uint8_t bytes[HWY_MAX(8, HWY_MAX_BYTES / 8)] = {};
    hn::StoreMaskBits(d, hn::Gt(along, hn::Zero(d)), bytes);
    out |= Bits(bytes, lanes) << k;
  }
  return out & bits_of(directions.count);
}

// Most triangles face all directions or none: |n.d - n.m| <= |n| |d - m|.
HWY_ATTR void FindFacing(const float* nx, const float* ny, const float* nz, std::size_t triangles,
                         const Directions& directions, std::uint64_t* out) {
  const std::uint64_t all = bits_of(directions.count);
  const hn::ScalableTag<float> d;
  const std::size_t lanes = hn::Lanes(d);
  const auto mx = hn::Set(d, directions.middle_x), my = hn::Set(d, directions.middle_y),
             mz = hn::Set(d, directions.middle_z), spread = hn::Set(d, directions.square_spread);
  std::size_t t = 0;
  for (; t + lanes <= triangles; t += lanes) {
    const auto x = hn::LoadU(d, nx + t), y = hn::LoadU(d, ny + t), z = hn::LoadU(d, nz + t);
    const auto along = hn::MulAdd(x, mx, hn::MulAdd(y, my, hn::Mul(z, mz)));
    const auto square = hn::MulAdd(x, x, hn::MulAdd(y, y, hn::Mul(z, z)));
    std::uint8_t bytes[HWY_MAX(8, HWY_MAX_BYTES / 8)] = {};
    hn::StoreMaskBits(d, hn::Gt(along, hn::Zero(d)), bytes);
    const std::uint64_t facing = Bits(bytes, lanes);
    hn::StoreMaskBits(d, hn::Le(hn::Mul(along, along), hn::Mul(square, spread)), bytes);
    const std::uint64_t unsure = Bits(bytes, lanes);
    for (std::size_t i = 0; i < lanes; ++i) out[t + i] = facing >> i & 1 ? all : 0;
    for (std::uint64_t left = unsure; left != 0; left &= left - 1) {
      const std::size_t i = t + hwy::Num0BitsBelowLS1Bit_Nonzero64(left);
      out[i] = FacingOf(nx[i], ny[i], nz[i], directions);
    }
  }
  for (; t < triangles; ++t) out[t] = FacingOf(nx[t], ny[t], nz[t], directions);
}

HWY_ATTR void SumSteps(Counts* steps, std::size_t nodes, std::uint16_t* blocked) {
#if HWY_TARGET == HWY_SCALAR
  Counts sum{};
  for (std::size_t i = 0; i < nodes; ++i) {
    std::uint16_t bits = 0;
    for (std::size_t k = 0; k < kGroup; ++k) {
      sum.of[k] = static_cast<std::int16_t>(sum.of[k] + steps[i].of[k]);
      if (sum.of[k] != 0) bits = static_cast<std::uint16_t>(bits | 1u << k);
    }
    steps[i] = {};
    blocked[i] = bits;
  }
#else
  const hn::CappedTag<std::int16_t, kGroup> d;
  const std::size_t lanes = hn::Lanes(d);
  const auto zero = hn::Zero(d);
  for (std::size_t k = 0; k < kGroup; k += lanes) {
    auto sum = zero;
    std::uint8_t bits[HWY_MAX(8, HWY_MAX_BYTES / 8)] = {};
    for (std::size_t i = 0; i < nodes; ++i) {
      const auto step = hn::Load(d, steps[i].of + k);
      if (!hn::AllTrue(d, hn::Eq(step, zero))) {
        sum = hn::Add(sum, step);
        hn::Store(zero, d, steps[i].of + k);
        hn::StoreMaskBits(d, hn::Ne(sum, zero), bits);
      }
      std::uint16_t some = bits[0];
      if (lanes == kGroup) some = static_cast<std::uint16_t>(some | bits[1] << 8);
      blocked[i] = k == 0 ? some : static_cast<std::uint16_t>(blocked[i] | some << k);
    }
  }
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::shadows
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::shadows {
HWY_EXPORT(FindFacing);
HWY_EXPORT(SumSteps);

void find_facing(const float* nx, const float* ny, const float* nz, std::size_t triangles,
                 const Directions& directions, std::uint64_t* out) {
  HWY_DYNAMIC_DISPATCH(FindFacing)(nx, ny, nz, triangles, directions, out);
}

void sum_steps(Counts* steps, std::size_t nodes, std::uint16_t* blocked) {
  HWY_DYNAMIC_DISPATCH(SumSteps)(steps, nodes, blocked);
}
}  // namespace penumbra::shadows
#endif
