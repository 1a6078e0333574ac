#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/field/field_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "shadows/field/internal/field_kernel.h"

HWY_BEFORE_NAMESPACE();
namespace penumbra::shadows {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Each lobe vector is loaded once for three colours, and two vectors of points go side by side: six
// sums in flight hide the latency of the multiply-add.
HWY_ATTR void SumBilinear(const float* matrix, int rows, int terms, const float* lobe,
                          const float* weight, float* sum) {
  const hn::CappedTag<float, kFieldLanes / 2> d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t p = 0; p < kFieldLanes; p += 2 * lanes) {
    auto r0 = hn::Zero(d), g0 = hn::Zero(d), b0 = hn::Zero(d);
    auto r1 = hn::Zero(d), g1 = hn::Zero(d), b1 = hn::Zero(d);
    const float* m = matrix;
    for (int j = 0; j < rows; ++j) {
      auto row_r0 = hn::Zero(d), row_g0 = hn::Zero(d), row_b0 = hn::Zero(d);
      auto row_r1 = hn::Zero(d), row_g1 = hn::Zero(d), row_b1 = hn::Zero(d);
      const float* y = lobe + p;
      for (int i = 0; i < terms; ++i, m += 3, y += kFieldLanes) {
        const auto y0 = hn::Load(d, y), y1 = hn::Load(d, y + lanes);
        const auto mr = hn::Set(d, m[0]), mg = hn::Set(d, m[1]), mb = hn::Set(d, m[2]);
        row_r0 = hn::MulAdd(mr, y0, row_r0);
        row_g0 = hn::MulAdd(mg, y0, row_g0);
        row_b0 = hn::MulAdd(mb, y0, row_b0);
        row_r1 = hn::MulAdd(mr, y1, row_r1);
        row_g1 = hn::MulAdd(mg, y1, row_g1);
        row_b1 = hn::MulAdd(mb, y1, row_b1);
      }
      const float* const w = weight + j * kFieldLanes + p;
      const auto w0 = hn::Load(d, w), w1 = hn::Load(d, w + lanes);
      r0 = hn::MulAdd(w0, row_r0, r0);
      g0 = hn::MulAdd(w0, row_g0, g0);
      b0 = hn::MulAdd(w0, row_b0, b0);
      r1 = hn::MulAdd(w1, row_r1, r1);
      g1 = hn::MulAdd(w1, row_g1, g1);
      b1 = hn::MulAdd(w1, row_b1, b1);
    }
    hn::Store(r0, d, sum + p);
    hn::Store(r1, d, sum + p + lanes);
    hn::Store(g0, d, sum + kFieldLanes + p);
    hn::Store(g1, d, sum + kFieldLanes + p + lanes);
    hn::Store(b0, d, sum + 2 * kFieldLanes + p);
    hn::Store(b1, d, sum + 2 * kFieldLanes + p + lanes);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::shadows
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::shadows {
HWY_EXPORT(SumBilinear);

void sum_bilinear(const float* matrix, int rows, int terms, const float* lobe, const float* weight,
                  float* sum) {
  HWY_DYNAMIC_DISPATCH(SumBilinear)(matrix, rows, terms, lobe, weight, sum);
}

}  // namespace penumbra::shadows
#endif
