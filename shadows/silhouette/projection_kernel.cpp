#include "shadows/silhouette/projection_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/silhouette/projection_kernel.cpp"
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
HWY_ATTR std::uint64_t FindFacing(float x, float y, float z, const Directions& directions) {
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

// A normal faces all of the cone, or none, where it is off the rim's plane by more than the cone's
// angle.
HWY_ATTR void FindFacingAll(const NormalSpans& normals, const Cone& cone,
                            std::span<std::uint8_t> out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<std::int32_t, decltype(d)> di;
  const hn::Rebind<std::uint8_t, decltype(d)> d8;
  const std::size_t lanes = hn::Lanes(d);
  const auto ax = hn::Set(d, cone.x), ay = hn::Set(d, cone.y), az = hn::Set(d, cone.z),
             square_sine = hn::Set(d, cone.sine * cone.sine);
  const auto part = [&](std::size_t t) {
    const auto x = hn::LoadU(d, &normals.x[t]), y = hn::LoadU(d, &normals.y[t]),
               z = hn::LoadU(d, &normals.z[t]);
    const auto along = hn::MulAdd(x, ax, hn::MulAdd(y, ay, hn::Mul(z, az)));
    const auto square = hn::MulAdd(x, x, hn::MulAdd(y, y, hn::Mul(z, z)));
    const auto sure = hn::Gt(hn::Mul(along, along), hn::Mul(square, square_sine));
    const auto facing =
        hn::IfThenElse(hn::Gt(along, hn::Zero(d)), hn::Set(d, kFacesAll), hn::Set(d, kFacesNone));
    const auto found = hn::ConvertTo(di, hn::IfThenElse(sure, facing, hn::Set(d, kUnsure)));
    hn::StoreU(hn::DemoteTo(d8, found), d8, &out[t]);
  };
  if (out.size() < lanes) {
    for (std::size_t t = 0; t < out.size(); ++t) {
      const float x = normals.x[t], y = normals.y[t], z = normals.z[t],
                  along = x * cone.x + y * cone.y + z * cone.z;
      const bool sure = along * along > (x * x + y * y + z * z) * cone.sine * cone.sine;
      out[t] = !sure ? kUnsure : along > 0 ? kFacesAll : kFacesNone;
    }
    return;
  }
  for (std::size_t t = 0; t + lanes <= out.size(); t += lanes) part(t);
  part(out.size() - lanes);
}

// First integer that is not less, of 0..limit.
template <class D>
HWY_INLINE hn::Vec<hn::Rebind<std::int32_t, D>> CeilWithin(D d, hn::Vec<D> x, float limit) {
  return hn::ConvertTo(hn::Rebind<std::int32_t, D>(),
                       hn::Ceil(hn::Min(hn::Max(hn::Zero(d), x), hn::Set(d, limit))));
}

HWY_ATTR std::uint16_t Fall(const SegmentSpan& s, const Shifts& shifts, int height,
                            ProjectedEdge& out) {
  const hn::CappedTag<float, kGroup> d;
  const hn::Rebind<std::int32_t, decltype(d)> di;
  const std::size_t lanes = hn::Lanes(d);
  const auto end = static_cast<float>(height);
  std::uint64_t crosses = 0;
  for (std::size_t k = 0; k < kGroup; k += lanes) {
    const auto along_x = hn::Load(d, shifts.x + k), along_z = hn::Load(d, shifts.z + k);
    const auto z0 = hn::MulAdd(hn::Set(d, s.from_y), along_z, hn::Set(d, s.from_z)),
               z1 = hn::MulAdd(hn::Set(d, s.to_y), along_z, hn::Set(d, s.to_z));
    const auto row = CeilWithin(d, z0, end), last = CeilWithin(d, z1, end);
    std::uint8_t bits[HWY_MAX(8, HWY_MAX_BYTES / 8)] = {};
    hn::StoreMaskBits(di, hn::Ne(row, last), bits);
    const std::uint64_t here = Bits(bits, lanes);
    if (here == 0) continue;
    crosses |= here << k;
    const auto x0 = hn::MulAdd(hn::Set(d, s.from_y), along_x, hn::Set(d, s.from_x)),
               x1 = hn::MulAdd(hn::Set(d, s.to_y), along_x, hn::Set(d, s.to_x));
    const auto rises = hn::Lt(z0, z1);
    hn::Store(hn::IfThenElse(rises, x0, x1), d, out.x + k);
    hn::Store(hn::Min(z0, z1), d, out.z + k);
    hn::Store(hn::Div(hn::Sub(x1, x0), hn::Sub(z1, z0)), d, out.slope + k);
    hn::Store(row, di, out.row + k);
    hn::Store(last, di, out.last + k);
  }
  return static_cast<std::uint16_t>(crosses);
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
HWY_EXPORT(FindFacingAll);
HWY_EXPORT(Fall);
HWY_EXPORT(SumSteps);

std::uint64_t find_facing(float x, float y, float z, const Directions& directions) {
  return HWY_DYNAMIC_DISPATCH(FindFacing)(x, y, z, directions);
}

void find_facing_all(const NormalSpans& normals, const Cone& cone, std::span<std::uint8_t> out) {
  HWY_DYNAMIC_DISPATCH(FindFacingAll)(normals, cone, out);
}

std::uint16_t fall(const SegmentSpan& span_along, const Shifts& shifts, int height,
                   ProjectedEdge& out) {
  return HWY_DYNAMIC_DISPATCH(Fall)(span_along, shifts, height, out);
}

void sum_steps(Counts* steps, std::size_t nodes, std::uint16_t* blocked) {
  HWY_DYNAMIC_DISPATCH(SumSteps)(steps, nodes, blocked);
}
}  // namespace penumbra::shadows
#endif
