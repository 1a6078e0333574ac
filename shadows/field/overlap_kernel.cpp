#include "shadows/field/internal/overlap_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/field/overlap_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::shadows {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::CappedTag<float, DeficitBatch::kTexels> kTexelFloats;
using TexelFloats = hn::Vec<decltype(kTexelFloats)>;

HWY_INLINE TexelFloats LoadHalves(const std::uint16_t* from) {
  const hn::Rebind<hwy::float16_t, decltype(kTexelFloats)> halves;
  return hn::PromoteTo(kTexelFloats,
                       hn::Load(halves, reinterpret_cast<const hwy::float16_t*>(from)));
}

HWY_INLINE TexelFloats Fraction(TexelFloats common, TexelFloats all) {
  const auto d = kTexelFloats;
  const auto any = hn::Gt(all, hn::Zero(d));
  const auto fraction = hn::Div(common, hn::IfThenElse(any, all, hn::Set(d, 1)));
  return hn::IfThenElseZero(any, hn::Min(hn::Max(fraction, hn::Zero(d)), hn::Set(d, 1)));
}

HWY_ATTR void FindOverlap(const DeficitBatch& deficits, int bands, const float* turn,
                          OverlapBatch& out) {
  const auto d = kTexelFloats;
  for (std::size_t i = 0; i < DeficitBatch::kTexels; i += hn::Lanes(d)) {
    auto common = hn::Zero(d), all_first = common, all_second = common;
    const float* entry = turn;
    for (int l = 0; l < bands; ++l) {
      const int begin = l * l, end = (l + 1) * (l + 1);
      TexelFloats first[2 * kMaxBands - 1];
      for (int n = begin; n < end; ++n) {
        const auto a = first[n - begin] = LoadHalves(&deficits.first[n][i]);
        all_first = hn::MulAdd(a, a, all_first);
      }
      for (int m = begin; m < end; ++m) {
        auto a = first[m - begin];
        if (turn != nullptr) {
          a = hn::Zero(d);
          for (int n = begin; n < end; ++n)
            a = hn::MulAdd(hn::Set(d, *entry++), first[n - begin], a);
        }
        const auto b = LoadHalves(&deficits.second[m][i]);
        common = hn::MulAdd(a, b, common);
        all_second = hn::MulAdd(b, b, all_second);
      }
    }
    hn::Store(Fraction(common, all_first), d, out.of_first + i);
    hn::Store(Fraction(common, all_second), d, out.of_second + i);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::shadows
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::shadows {
HWY_EXPORT(FindOverlap);

void find_overlap(const DeficitBatch& deficits, int bands, std::span<const float> turn,
                  OverlapBatch& out) {
  HWY_DYNAMIC_DISPATCH(FindOverlap)(deficits, bands, turn.empty() ? nullptr : turn.data(), out);
}
}  // namespace penumbra::shadows
#endif
