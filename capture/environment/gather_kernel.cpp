#include "capture/environment/internal/gather_kernel.h"

#include <hwy/cache_control.h>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "capture/environment/gather_kernel.cpp"
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
HWY_INLINE Four Load(const std::uint16_t* p) {
  Four out;
  const hn::CappedTag<float, 1> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  for (int c = 0; c < 4; ++c)
    out.v[c] = hn::GetLane(
        hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(p + c))));
  return out;
}
HWY_INLINE Four Mix(Four a, Four b, float t) {
  for (int c = 0; c < 4; ++c) a.v[c] += t * (b.v[c] - a.v[c]);
  return a;
}
HWY_INLINE Four Sum(Four a, Four b) {
  return {{a.v[0] + b.v[0], a.v[1] + b.v[1], a.v[2] + b.v[2], a.v[3] + b.v[3]}};
}
HWY_INLINE Four Black() {
  return {};
}
HWY_INLINE void StorePixel(Four a, float scale, float* out) {
  for (int c = 0; c < 3; ++c) out[c] = scale * a.v[c];
}
HWY_INLINE void StoreLastPixel(Four a, float scale, float* out) {
  StorePixel(a, scale, out);
}
HWY_INLINE float Fourth(Four a) {
  return a.v[3];
}

#else

using Lanes = hn::FixedTag<float, 4>;
using Four = hn::Vec<Lanes>;

HWY_INLINE Four Load(const std::uint16_t* p) {
  const Lanes d;
  const hn::Rebind<hwy::float16_t, Lanes> dh;
  return hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(p)));
}
HWY_INLINE Four Mix(Four a, Four b, float t) {
  return hn::MulAdd(hn::Set(Lanes(), t), hn::Sub(b, a), a);
}
HWY_INLINE Four Sum(Four a, Four b) {
  return hn::Add(a, b);
}
HWY_INLINE Four Black() {
  return hn::Zero(Lanes());
}

// The fourth lane lands in the next pixel, which is written afterwards.
HWY_INLINE void StorePixel(Four a, float scale, float* out) {
  const Lanes d;
  hn::StoreU(hn::Mul(a, hn::Set(d, scale)), d, out);
}
HWY_INLINE void StoreLastPixel(Four a, float scale, float* out) {
  const Lanes d;
  HWY_ALIGN float lanes[4];
  hn::Store(hn::Mul(a, hn::Set(d, scale)), d, lanes);
  for (int c = 0; c < 3; ++c) out[c] = lanes[c];
}
HWY_INLINE float Fourth(Four a) {
  HWY_ALIGN float lanes[4];
  hn::Store(a, Lanes(), lanes);
  return lanes[3];
}

#endif

#if HWY_TARGET != HWY_SCALAR && HWY_MAX_BYTES >= 32
// Both neighbours of a row in one load.
HWY_INLINE Four Bilinear(const std::uint16_t* p, const std::uint16_t* q, float right, float down) {
  const hn::FixedTag<float, 8> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const auto upper = hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(p)));
  const auto lower = hn::PromoteTo(d, hn::LoadU(dh, reinterpret_cast<const hwy::float16_t*>(q)));
  const auto v = hn::MulAdd(hn::Set(d, down), hn::Sub(lower, upper), upper);
  return Mix(hn::LowerHalf(Lanes(), v), hn::UpperHalf(Lanes(), v), right);
}
#else
HWY_INLINE Four Bilinear(const std::uint16_t* p, const std::uint16_t* q, float right, float down) {
  return Mix(Mix(Load(p), Load(p + 4), right), Mix(Load(q), Load(q + 4), right), down);
}
#endif

HWY_INLINE Four Sample(const std::uint16_t* rgba, int source_width, const GatherSample& sample) {
  if (sample.offset < 0) return Black();
  const std::uint16_t* const p = rgba + 4 * static_cast<std::ptrdiff_t>(sample.offset);
  return Bilinear(p, p + 4 * static_cast<std::ptrdiff_t>(source_width), sample.right, sample.down);
}

// A row of the environment is a curve in the source: where it goes is known, so its lines are asked
// for in time.
HWY_INLINE void FetchAhead(const std::uint16_t* rgba, int source_width, const GatherSample* samples,
                           int i, int count) {
  constexpr int kAhead = 40;  // samples
  if (i + kAhead >= count) return;
  const std::uint16_t* const p = rgba + 4 * static_cast<std::ptrdiff_t>(samples[i + kAhead].offset);
  hwy::Prefetch(p);
  hwy::Prefetch(p + 4 * static_cast<std::ptrdiff_t>(source_width));
}

HWY_ATTR float GatherRow(const std::uint16_t* rgba, int source_width, const GatherSample* samples,
                         int count, float scale, float* out) {
  Four sum = Black();
  for (int i = 0; i + 1 < count; ++i) {
    FetchAhead(rgba, source_width, samples, i, count);
    const Four v = Sample(rgba, source_width, samples[i]);
    sum = Sum(sum, v);
    StorePixel(v, scale, out + 3 * i);
  }
  const Four v = Sample(rgba, source_width, samples[count - 1]);
  StoreLastPixel(v, scale, out + 3 * (count - 1));
  return Fourth(Sum(sum, v));
}

HWY_ATTR float ConvertRow(const std::uint16_t* rgba, int count, float scale, float* out) {
  Four sum = Black();
  for (int i = 0; i + 1 < count; ++i) {
    const Four v = Load(rgba + 4 * i);
    sum = Sum(sum, v);
    StorePixel(v, scale, out + 3 * i);
  }
  const Four v = Load(rgba + 4 * (count - 1));
  StoreLastPixel(v, scale, out + 3 * (count - 1));
  return Fourth(Sum(sum, v));
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::capture
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::capture {
HWY_EXPORT(GatherRow);
HWY_EXPORT(ConvertRow);

float gather_row(const std::uint16_t* rgba, int source_width, const GatherSample* samples,
                 int count, float scale, float* out) {
  return HWY_DYNAMIC_DISPATCH(GatherRow)(rgba, source_width, samples, count, scale, out);
}
float convert_row(const std::uint16_t* rgba, int count, float scale, float* out) {
  return HWY_DYNAMIC_DISPATCH(ConvertRow)(rgba, count, scale, out);
}
}  // namespace penumbra::capture
#endif
