#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "compositor/pixels/sensor_effects.h"
#include "core/normal_quantiles.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/pixels/sensor_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::compositor {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kSensorLanes>;
using DU = hn::RebindToUnsigned<D>;
using DI = hn::RebindToSigned<D>;

HWY_ATTR void WeightedSum(const float* const* rows, const float* weights, std::size_t samples,
                          std::size_t count, float* out) {
  const D d;
  const std::size_t n = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + 4 * n <= count; i += 4 * n) {  // a weight serves four vectors
    auto s0 = hn::Zero(d), s1 = s0, s2 = s0, s3 = s0;
    for (std::size_t k = 0; k < samples; ++k) {
      const auto w = hn::Set(d, weights[k]);
      const float* const in = rows[k] + i;
      s0 = hn::MulAdd(w, hn::LoadU(d, in), s0);
      s1 = hn::MulAdd(w, hn::LoadU(d, in + n), s1);
      s2 = hn::MulAdd(w, hn::LoadU(d, in + 2 * n), s2);
      s3 = hn::MulAdd(w, hn::LoadU(d, in + 3 * n), s3);
    }
    hn::StoreU(s0, d, out + i);
    hn::StoreU(s1, d, out + i + n);
    hn::StoreU(s2, d, out + i + 2 * n);
    hn::StoreU(s3, d, out + i + 3 * n);
  }
  for (; i < count; i += n) {
    auto sum = hn::Zero(d);
    for (std::size_t k = 0; k < samples; ++k)
      sum = hn::MulAdd(hn::Set(d, weights[k]), hn::LoadU(d, rows[k] + i), sum);
    hn::StoreU(sum, d, out + i);
  }
}

// 32 bits of a column and a key.
// source: C. Wellons, hash-prospector (triple32's multipliers)
HWY_INLINE hn::Vec<DU> Hash(hn::Vec<DU> column, std::uint32_t key0, std::uint32_t key1) {
  const DU du;
  auto h = hn::Add(column, hn::Set(du, key0));
  h = hn::Mul(hn::Xor(h, hn::ShiftRight<17>(h)), hn::Set(du, 0xed5ad4bbu));
  h = hn::Xor(hn::Xor(h, hn::ShiftRight<11>(h)), hn::Set(du, key1));
  h = hn::Mul(h, hn::Set(du, 0xac4c1b51u));
  h = hn::Mul(hn::Xor(h, hn::ShiftRight<15>(h)), hn::Set(du, 0x31848babu));
  return hn::Xor(h, hn::ShiftRight<14>(h));
}

HWY_ATTR void AddWithNoise(const NoisyRow& row, const float* normal, float shot_gain,
                           float read_variance, std::size_t count, float* out) {
  const D d;
  const DU du;
  const DI di;
  const auto one = hn::Set(d, 1.f), g = hn::Set(d, shot_gain), r2 = hn::Set(d, read_variance);
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto t = hn::Sub(one, hn::LoadU(d, row.deficit + i)), y = hn::LoadU(d, row.real + i);
    const auto signal = hn::MulAdd(t, y, hn::LoadU(d, row.added + i));
    const auto wanted = hn::MulAdd(g, signal, r2);
    const auto present = hn::MulAdd(g, y, hn::Add(r2, hn::LoadU(d, row.rounding + i)));
    const auto lacking = hn::NegMulAdd(hn::Mul(t, t), present, wanted);
    if (hn::AllTrue(d, hn::Le(lacking, hn::Zero(d)))) {
      hn::StoreU(signal, d, out + i);
      continue;
    }
    const auto bits =
        Hash(hn::Iota(du, row.first + static_cast<std::uint32_t>(i)), row.key[0], row.key[1]);
    const auto sample = hn::GatherIndex(d, normal, hn::BitCast(di, hn::ShiftRight<20>(bits)));
    const auto deviation = hn::Sqrt(hn::Max(lacking, hn::Zero(d)));
    hn::StoreU(hn::MulAdd(deviation, sample, signal), d, out + i);
  }
}

HWY_ATTR void MarkTouched(const float* planes, std::size_t stride, std::size_t width,
                          std::uint32_t* touched, std::size_t* first, std::size_t* last) {
  const D d;
  const DU du;
  *first = width, *last = 0;
  for (std::size_t i = 0; i < width; i += hn::Lanes(d)) {
    auto any = hn::Zero(du);
    for (std::size_t p = 0; p < 6; ++p)
      any = hn::Or(any, hn::BitCast(du, hn::LoadU(d, planes + p * stride + i)));
    any = hn::ShiftLeft<1>(any);  // a zero's sign is no light
    hn::StoreU(any, du, touched + i);
    const auto marked = hn::Ne(any, hn::Zero(du));
    if (hn::AllFalse(du, marked)) continue;
    std::uint8_t bits[8] = {};
    hn::StoreMaskBits(du, marked, bits);
    std::uint32_t lanes = bits[0] | static_cast<std::uint32_t>(bits[1]) << 8;
    if (width - i < kSensorLanes) lanes &= (1u << (width - i)) - 1;
    if (lanes == 0) continue;
    if (*first == width) *first = i + static_cast<std::size_t>(std::countr_zero(lanes));
    *last = i + static_cast<std::size_t>(std::bit_width(lanes));
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(WeightedSum);
HWY_EXPORT(AddWithNoise);
HWY_EXPORT(MarkTouched);

namespace {

constexpr std::size_t kQuantiles = 4096;  // the kernel takes the hash's upper 12 bits

const float* quantiles() {
  static const std::vector<float> table = normal_quantiles(kQuantiles);
  return table.data();
}

}  // namespace

void weighted_sum(const float* const* rows, const float* weights, std::size_t samples,
                  std::size_t count, float* out) {
  HWY_DYNAMIC_DISPATCH(WeightedSum)(rows, weights, samples, count, out);
}

void add_with_noise(const NoisyRow& row, float shot_gain, float read_variance, std::size_t count,
                    float* out) {
  HWY_DYNAMIC_DISPATCH(AddWithNoise)
  (row, quantiles(), shot_gain, read_variance, count, out);
}

std::pair<std::size_t, std::size_t> mark_touched(const float* planes, std::size_t stride,
                                                 std::size_t width, std::uint32_t* touched) {
  std::size_t first = 0, last = 0;
  HWY_DYNAMIC_DISPATCH(MarkTouched)(planes, stride, width, touched, &first, &last);
  return {std::min(first, last), last};
}
}  // namespace penumbra::compositor
#endif
