#include <algorithm>
#include <cassert>
#include <cstdint>
#include <span>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/transfer/relight.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sums of points [first, last), kept in `out` between coefficients. Four coefficients at a time:
// memory is then read in few long streams, which a processor fetches ahead, and sums are loaded and
// stored once for twelve products. The first count % 4 coefficients (one, or none: counts are
// squares) begin the sums.

// One grey transfer under three colours of light: each half is read once for three products.
HWY_ATTR void RelightGrey(const std::uint16_t* values, std::size_t stride, std::size_t first,
                          std::size_t last, int coefficients, const float* light, float* out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  const auto at = [&](int n) {
    return reinterpret_cast<const hwy::float16_t*>(values + static_cast<std::size_t>(n) * stride);
  };
  float *const red = out, *const green = out + stride, *const blue = out + 2 * stride;
  int n = coefficients % 4;
  for (std::size_t p = first; p < last; p += lanes) {
    auto r = hn::Zero(d), g = hn::Zero(d), b = hn::Zero(d);
    for (int k = 0; k < n; ++k) {
      const auto t = hn::PromoteTo(d, hn::LoadU(dh, at(k) + p));
      r = hn::MulAdd(t, hn::Set(d, light[3 * k]), r);
      g = hn::MulAdd(t, hn::Set(d, light[3 * k + 1]), g);
      b = hn::MulAdd(t, hn::Set(d, light[3 * k + 2]), b);
    }
    hn::StoreU(r, d, red + p);
    hn::StoreU(g, d, green + p);
    hn::StoreU(b, d, blue + p);
  }
  for (; n < coefficients; n += 4) {
    const float* const l = light + 3 * n;
    const auto *const t0 = at(n), *const t1 = at(n + 1), *const t2 = at(n + 2),
                      *const t3 = at(n + 3);
    const auto r0 = hn::Set(d, l[0]), g0 = hn::Set(d, l[1]), b0 = hn::Set(d, l[2]),
               r1 = hn::Set(d, l[3]), g1 = hn::Set(d, l[4]), b1 = hn::Set(d, l[5]),
               r2 = hn::Set(d, l[6]), g2 = hn::Set(d, l[7]), b2 = hn::Set(d, l[8]),
               r3 = hn::Set(d, l[9]), g3 = hn::Set(d, l[10]), b3 = hn::Set(d, l[11]);
    for (std::size_t p = first; p < last; p += lanes) {
      auto r = hn::LoadU(d, red + p), g = hn::LoadU(d, green + p), b = hn::LoadU(d, blue + p);
      auto t = hn::PromoteTo(d, hn::LoadU(dh, t0 + p));
      r = hn::MulAdd(t, r0, r), g = hn::MulAdd(t, g0, g), b = hn::MulAdd(t, b0, b);
      t = hn::PromoteTo(d, hn::LoadU(dh, t1 + p));
      r = hn::MulAdd(t, r1, r), g = hn::MulAdd(t, g1, g), b = hn::MulAdd(t, b1, b);
      t = hn::PromoteTo(d, hn::LoadU(dh, t2 + p));
      r = hn::MulAdd(t, r2, r), g = hn::MulAdd(t, g2, g), b = hn::MulAdd(t, b2, b);
      t = hn::PromoteTo(d, hn::LoadU(dh, t3 + p));
      r = hn::MulAdd(t, r3, r), g = hn::MulAdd(t, g3, g), b = hn::MulAdd(t, b3, b);
      hn::StoreU(r, d, red + p);
      hn::StoreU(g, d, green + p);
      hn::StoreU(b, d, blue + p);
    }
  }
}

// One colour with its own transfer.
HWY_ATTR void RelightChannel(const std::uint16_t* values, std::size_t stride, std::size_t first,
                             std::size_t last, int coefficients, const float* light, float* out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  const auto at = [&](int n) {
    return reinterpret_cast<const hwy::float16_t*>(values + static_cast<std::size_t>(n) * stride);
  };
  int n = coefficients % 4;
  for (std::size_t p = first; p < last; p += lanes) {
    auto sum = hn::Zero(d);
    for (int k = 0; k < n; ++k)
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, at(k) + p)), hn::Set(d, light[3 * k]), sum);
    hn::StoreU(sum, d, out + p);
  }
  for (; n < coefficients; n += 4) {
    const auto *const t0 = at(n), *const t1 = at(n + 1), *const t2 = at(n + 2),
                      *const t3 = at(n + 3);
    const auto l0 = hn::Set(d, light[3 * n]), l1 = hn::Set(d, light[3 * n + 3]),
               l2 = hn::Set(d, light[3 * n + 6]), l3 = hn::Set(d, light[3 * n + 9]);
    for (std::size_t p = first; p < last; p += lanes) {
      auto sum = hn::LoadU(d, out + p);
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, t0 + p)), l0, sum);
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, t1 + p)), l1, sum);
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, t2 + p)), l2, sum);
      sum = hn::MulAdd(hn::PromoteTo(d, hn::LoadU(dh, t3 + p)), l3, sum);
      hn::StoreU(sum, d, out + p);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include "core/threads/parallel.h"
#include "prt/transfer/relight.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {
HWY_EXPORT(RelightGrey);
HWY_EXPORT(RelightChannel);

void relight(const Transfer& transfer, const RadianceSh& light, std::span<float> out) {
  assert(out.size() >= 3 * transfer.stride);
  // The bands of both: what either lacks is zero.
  const int count = coefficient_count(std::min(light.bands(), transfer.bands));
  const float* const l = &light[0].r;
  constexpr std::size_t kPart = 1024;  // vertices whose sums stay in the first cache
  const std::size_t parts = (transfer.stride + kPart - 1) / kPart;
  parallel_for(std::size_t{0}, parts, 16, [&](const auto& some) {
    for (std::size_t part = some.begin(); part != some.end(); ++part) {
      const std::size_t first = part * kPart, last = std::min(first + kPart, transfer.stride);
      if (transfer.channels == 1) {
        HWY_DYNAMIC_DISPATCH(RelightGrey)
        (transfer.values.data(), transfer.stride, first, last, count, l, out.data());
        continue;
      }
      for (int c = 0; c < 3; ++c) HWY_DYNAMIC_DISPATCH(RelightChannel)
      (transfer.values.data() + transfer.index(c, 0, 0), transfer.stride, first, last, count, l + c,
       out.data() + static_cast<std::size_t>(c) * transfer.stride);
    }
  });
}

}  // namespace penumbra::prt
#endif
