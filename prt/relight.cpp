#include <algorithm>
#include <cassert>
#include <cstdint>
#include <span>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/relight.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// One grey transfer under three colours of light: each half is read once for three products. Two
// vectors at a time keep enough sums in flight to hide the latency of the multiply-add.
HWY_ATTR void RelightGrey(const std::uint16_t* values, std::size_t stride, std::size_t first,
                          std::size_t last, int coefficients, const float* light, float* out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t p = first; p < last; p += 2 * lanes) {
    auto r0 = hn::Zero(d), g0 = hn::Zero(d), b0 = hn::Zero(d);
    auto r1 = hn::Zero(d), g1 = hn::Zero(d), b1 = hn::Zero(d);
    const auto* t = reinterpret_cast<const hwy::float16_t*>(values + p);
    for (int n = 0; n < coefficients; ++n, t += stride) {
      const auto t0 = hn::PromoteTo(d, hn::LoadU(dh, t));
      const auto t1 = hn::PromoteTo(d, hn::LoadU(dh, t + lanes));
      const auto lr = hn::Set(d, light[3 * n]), lg = hn::Set(d, light[3 * n + 1]),
                 lb = hn::Set(d, light[3 * n + 2]);
      r0 = hn::MulAdd(t0, lr, r0);
      g0 = hn::MulAdd(t0, lg, g0);
      b0 = hn::MulAdd(t0, lb, b0);
      r1 = hn::MulAdd(t1, lr, r1);
      g1 = hn::MulAdd(t1, lg, g1);
      b1 = hn::MulAdd(t1, lb, b1);
    }
    hn::StoreU(r0, d, out + p);
    hn::StoreU(r1, d, out + p + lanes);
    hn::StoreU(g0, d, out + stride + p);
    hn::StoreU(g1, d, out + stride + p + lanes);
    hn::StoreU(b0, d, out + 2 * stride + p);
    hn::StoreU(b1, d, out + 2 * stride + p + lanes);
  }
}

// One colour with its own transfer.
HWY_ATTR void RelightChannel(const std::uint16_t* values, std::size_t stride, std::size_t first,
                             std::size_t last, int coefficients, const float* light, float* out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t p = first; p < last; p += lanes) {
    auto sum = hn::Zero(d);
    const auto* t = reinterpret_cast<const hwy::float16_t*>(values + p);
    for (int n = 0; n < coefficients; ++n, t += stride)
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, t)), hn::Set(d, light[3 * n]), sum);
    hn::StoreU(sum, d, out + p);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include "core/parallel.h"
#include "prt/prt.h"

namespace penumbra::prt {
HWY_EXPORT(RelightGrey);
HWY_EXPORT(RelightChannel);

void relight(const Transfer& transfer, const RadianceSh& light, std::span<float> out) {
  assert(out.size() >= 3 * transfer.stride);
  // The bands of both: what either lacks is zero.
  const int count = coefficient_count(std::min(light.bands(), transfer.bands));
  const float* const l = &light[0].r;
  constexpr std::size_t kPart = 16384;  // vertices, 30 us; kernels take a power of two at once
  parallel_for(std::size_t{0}, (transfer.stride + kPart - 1) / kPart, 1, [&](const auto& parts) {
    const std::size_t first = parts.begin() * kPart,
                      last = std::min(parts.end() * kPart, transfer.stride);
    if (transfer.channels == 1) {
      HWY_DYNAMIC_DISPATCH(RelightGrey)
      (transfer.values.data(), transfer.stride, first, last, count, l, out.data());
      return;
    }
    for (int c = 0; c < 3; ++c) HWY_DYNAMIC_DISPATCH(RelightChannel)
    (transfer.values.data() + transfer.index(c, 0, 0), transfer.stride, first, last, count, l + c,
     out.data() + static_cast<std::size_t>(c) * transfer.stride);
  });
}

}  // namespace penumbra::prt
#endif
