#include "compositor/pixels/half_rows.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/pixels/half_rows.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::compositor {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

HWY_ATTR void FloatsFromHalves(const std::uint16_t* in, float* out, std::size_t count) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  const auto* halves = reinterpret_cast<const hwy::float16_t*>(in);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes)
    hn::StoreU(hn::PromoteTo(d, hn::LoadU(dh, halves + i)), d, out + i);
  const hn::CappedTag<float, 1> d1;
  const hn::Rebind<hwy::float16_t, decltype(d1)> d1h;
  for (; i < count; ++i) hn::StoreU(hn::PromoteTo(d1, hn::LoadU(d1h, halves + i)), d1, out + i);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(FloatsFromHalves);

void floats_from_halves(std::span<const std::uint16_t> in, std::span<float> out) {
  HWY_DYNAMIC_DISPATCH(FloatsFromHalves)(in.data(), out.data(), in.size());
}
}  // namespace penumbra::compositor
#endif
