#include "capture/gather_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "capture/gather_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::capture {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

#if HWY_TARGET == HWY_SCALAR

// Machines without four-lane vectors.
struct Four {
  float v[4];
};
HWY_ATTR Four Load(const std::uint16_t* p) {
  Four out;
  const hn::CappedTag<float, 1> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  for (int c = 0; c < 4; ++c)
    out.v[c] = hn::GetLane(hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(p + c))));
  return out;
}
HWY_ATTR Four Mix(Four a, Four b, float t) {
  for (int c = 0; c < 4; ++c) a.v[c] += t * (b.v[c] - a.v[c]);
  return a;
}
HWY_ATTR Four Sum(Four a, Four b) { return {{a.v[0] + b.v[0], a.v[1] + b.v[1], a.v[2] + b.v[2], a.v[3] + b.v[3]}}; }
HWY_ATTR Four Black() { return {}; }
HWY_ATTR void StorePixel(Four a, float scale, float* out, bool) {
  for (int c = 0; c < 3; ++c) out[c] = scale * a.v[c];
}
HWY_ATTR float Fourth(Four a) { return a.v[3]; }

#else

using Lanes = hn::FixedTag<float, 4>;
using Four = hn::Vec<Lanes>;

HWY_ATTR Four Load(const std::uint16_t* p) {
  const Lanes d;
  const hn::Rebind<hwy::float16_t, Lanes> dh;
  return hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(p)));
}
HWY_ATTR Four Mix(Four a, Four b, float t) { return hn::MulAdd(hn::Set(Lanes(), t), hn::Sub(b, a), a); }
HWY_ATTR Four Sum(Four a, Four b) { return hn::Add(a, b); }
HWY_ATTR Four Black() { return hn::Zero(Lanes()); }

// Three floats of four lanes. The fourth lands in the next pixel, which is written afterwards; the last
// pixel of a row has no next and is copied.
HWY_ATTR void StorePixel(Four a, float scale, float* out, bool last) {
  const Lanes d;
  const auto scaled = hn::Mul(a, hn::Set(d, scale));
  if (!last) {
    hn::StoreU(scaled, d, out);
    return;
  }
  HWY_ALIGN float lanes[4];
  hn::Store(scaled, d, lanes);
  for (int c = 0; c < 3; ++c) out[c] = lanes[c];
}
HWY_ATTR float Fourth(Four a) {
  HWY_ALIGN float lanes[4];
  hn::Store(a, Lanes(), lanes);
  return lanes[3];
}

#endif

HWY_ATTR float GatherRow(const std::uint16_t* rgba, int source_width, const GatherTap* taps, int count,
                         float scale, float* out) {
  constexpr float kUnit = 1.f / 32768;
  Four sum = Black();
  for (int i = 0; i < count; ++i) {
    if (taps[i].offset < 0) {
      StorePixel(Black(), 0, out + 3 * i, i + 1 == count);
      continue;
    }
    const std::uint16_t* const p = rgba + 4 * static_cast<std::ptrdiff_t>(taps[i].offset);
    const std::uint16_t* const q = p + 4 * static_cast<std::ptrdiff_t>(source_width);
    const float right = static_cast<float>(taps[i].right) * kUnit;
    const Four v = Mix(Mix(Load(p), Load(p + 4), right), Mix(Load(q), Load(q + 4), right),
                       static_cast<float>(taps[i].down) * kUnit);
    sum = Sum(sum, v);
    StorePixel(v, scale, out + 3 * i, i + 1 == count);
  }
  return Fourth(sum);
}

HWY_ATTR float ConvertRow(const std::uint16_t* rgba, int count, float scale, float* out) {
  Four sum = Black();
  for (int i = 0; i < count; ++i) {
    const Four v = Load(rgba + 4 * i);
    sum = Sum(sum, v);
    StorePixel(v, scale, out + 3 * i, i + 1 == count);
  }
  return Fourth(sum);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::capture
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::capture {
HWY_EXPORT(GatherRow);
HWY_EXPORT(ConvertRow);

float gather_row(const std::uint16_t* rgba, int source_width, const GatherTap* taps, int count, float scale,
                 float* out) {
  return HWY_DYNAMIC_DISPATCH(GatherRow)(rgba, source_width, taps, count, scale, out);
}
float convert_row(const std::uint16_t* rgba, int count, float scale, float* out) {
  return HWY_DYNAMIC_DISPATCH(ConvertRow)(rgba, count, scale, out);
}
}  // namespace penumbra::capture
#endif
