#include "codec/tone/internal/row_kernel.h"

#include <algorithm>
#include <cstddef>
#include <span>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "codec/tone/row_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// Behind the two above, which say for what it is compiled.
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::tone {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;

// 2^t for t in -126..0 by a cubic of the fraction, to 1e-4: the library's exponential is as dear as
// all the rest of a step.
HWY_INLINE V PowerOfTwo(V t) {
  const D d;
  const DI di;
  const auto whole = hn::NearestInt(t);
  const auto f = hn::Sub(t, hn::ConvertTo(d, whole));
  auto p = hn::MulAdd(f, hn::Set(d, 5.508868e-2f), hn::Set(d, .24260405f));
  p = hn::MulAdd(f, p, hn::Set(d, .69327624f));
  p = hn::MulAdd(f, p, hn::Set(d, .99992894f));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<23>(whole)));
}

struct Surrounding {
  V left, middle, right, top, bottom, cross;  // cross: four times the mixed difference
};

HWY_INLINE Surrounding LoadNeighbours(const float* above, const float* row, const float* below) {
  const D d;
  const auto falling = hn::Sub(hn::LoadU(d, below + 1), hn::LoadU(d, above + 1)),
             rising = hn::Sub(hn::LoadU(d, below - 1), hn::LoadU(d, above - 1));
  return {hn::LoadU(d, row - 1), hn::LoadU(d, row),   hn::LoadU(d, row + 1),
          hn::LoadU(d, above),   hn::LoadU(d, below), hn::Sub(falling, rising)};
}

// The change of one step, dt e N / (1 + |grad I|^2), with both parts of the fraction times 4.
// Root and quotient to 12 bits: the change is small beside what it changes. docs/methods/
// tone-mapping.md derives it.
HWY_INLINE V Change(const Surrounding& n, V ones, V decay, V step) {
  const D d;
  const auto twice = hn::Add(n.middle, n.middle);
  const auto xx = hn::Sub(hn::Add(n.left, n.right), twice),
             yy = hn::Sub(hn::Add(n.top, n.bottom), twice);
  const auto x = hn::Sub(n.right, n.left), y = hn::Sub(n.bottom, n.top);
  const auto x2 = hn::MulAdd(x, x, ones), y2 = hn::MulAdd(y, y, ones);
  const auto mixed = hn::Mul(hn::Mul(x, y), n.cross);
  const auto bend = hn::NegMulAdd(hn::Set(d, .5f), mixed, hn::MulAdd(y2, xx, hn::Mul(x2, yy)));
  const auto slope = hn::MulAdd(x, x, y2);
  const auto eighth = hn::Mul(n.cross, hn::Set(d, .125f));
  const auto edge2 =
      hn::MulAdd(xx, xx, hn::MulAdd(yy, yy, hn::MulAdd(eighth, n.cross, hn::Set(d, 1e-30f))));
  const auto edge = hn::Mul(edge2, hn::ApproximateReciprocalSqrt(edge2));
  const auto weight = PowerOfTwo(hn::Max(hn::NegMulAdd(edge, decay, step), hn::Set(d, -60.f)));
  return hn::Mul(hn::Mul(weight, bend), hn::ApproximateReciprocal(slope));
}

HWY_ATTR void StepRow(const float* above, const float* row, const float* below,
                      const LevelSetRow& how, std::size_t count, float* out) {
  const D d;
  const auto ones = hn::Set(d, 4 * how.inverse_scale_squared), decay = hn::Set(d, how.decay),
             step = hn::Set(d, how.log2_step);
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const Surrounding n = LoadNeighbours(above + i, row + i, below + i);
    const auto next = hn::Add(n.middle, Change(n, ones, decay, step));
    const auto low = hn::Min(hn::Min(hn::Min(n.left, n.right), hn::Min(n.top, n.bottom)), n.middle),
               high =
                   hn::Max(hn::Max(hn::Max(n.left, n.right), hn::Max(n.top, n.bottom)), n.middle);
    hn::StoreU(hn::Min(hn::Max(next, low), high), d, out + i);
  }
}

template <class Function>
HWY_INLINE void ForAll(float* values, std::size_t count, const Function& function) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  HWY_ALIGN float rest[HWY_MAX_BYTES / sizeof(float)] = {};
  for (std::size_t i = 0; i < count; i += lanes) {
    const std::size_t part = count - i < lanes ? count - i : lanes;
    if (part == lanes) {
      hn::StoreU(function(hn::LoadU(d, values + i)), d, values + i);
      continue;
    }
    for (std::size_t k = 0; k < lanes; ++k) rest[k] = values[i + (k < part ? k : 0)];
    hn::Store(function(hn::Load(d, rest)), d, rest);
    for (std::size_t k = 0; k < part; ++k) values[i + k] = rest[k];
  }
}

HWY_ATTR void LogAll(float* values, std::size_t count) {
  ForAll(values, count, [](V v) HWY_ATTR { return hn::Log(D(), v); });
}

HWY_ATTR void ExpAll(float* values, std::size_t count) {
  ForAll(values, count, [](V v) HWY_ATTR { return hn::Exp(D(), v); });
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::tone
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::tone {
HWY_EXPORT(StepRow);
HWY_EXPORT(LogAll);
HWY_EXPORT(ExpAll);

void level_set_row(const float* above, const float* row, const float* below, const LevelSetRow& how,
                   std::size_t count, float* out) {
  HWY_DYNAMIC_DISPATCH(StepRow)(above, row, below, how, count, out);
}

void log_in_place(std::span<float> values) {
  HWY_DYNAMIC_DISPATCH(LogAll)(values.data(), values.size());
}

void exp_in_place(std::span<float> values) {
  HWY_DYNAMIC_DISPATCH(ExpAll)(values.data(), values.size());
}
}  // namespace penumbra::tone
#endif
