#include "compositor/receivers.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/plane_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::compositor {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using DI = hn::RebindToSigned<D>;

// Texture coordinate in texels along one axis: GroundGrid::uv without its centre.
HWY_INLINE hn::Vec<D> Texel(hn::Vec<D> p, float size) {
  const D d;
  constexpr float k = prt::GroundGrid::kStretch;
  const auto w = hn::Div(hn::Mul(p, hn::Set(d, 1 + k)),
                         hn::MulAdd(hn::Abs(p), hn::Set(d, k), hn::Set(d, 1.f)));
  const auto texel = hn::MulAdd(w, hn::Set(d, .5f * size), hn::Set(d, .5f * size - .5f));
  return hn::Min(hn::Max(texel, hn::Zero(d)), hn::Set(d, size - 1));
}

using DU = hn::RebindToUnsigned<D>;

// The lookup of one channel from the packed corners of a cell, fx and fy of the way into it.
template <int kShift, int kBits, int kOne>
HWY_INLINE void MultiplyChannel(hn::Vec<DU> upper_left, hn::Vec<DU> upper_right,
                                hn::Vec<DU> lower_left, hn::Vec<DU> lower_right, hn::Vec<D> fx,
                                hn::Vec<D> fy, hn::Mask<D> inside, std::size_t count, float* out) {
  const D d;
  const DI di;
  const auto missing = [&](hn::Vec<DU> packed) HWY_ATTR {
    const auto steps =
        hn::And(hn::BitCast(di, hn::ShiftRight<kShift>(packed)), hn::Set(di, (1 << kBits) - 1));
    return hn::ConvertTo(d, hn::Sub(hn::Set(di, kOne), steps));
  };
  const auto a = missing(upper_left), b = missing(upper_right);
  const auto c = missing(lower_left), e = missing(lower_right);
  const auto top = hn::MulAdd(fx, hn::Sub(b, a), a), bottom = hn::MulAdd(fx, hn::Sub(e, c), c);
  const auto taken = hn::IfThenElseZero(inside, hn::MulAdd(fy, hn::Sub(bottom, top), top));
  const auto s = hn::NegMulAdd(taken, hn::Set(d, 1.f / static_cast<float>(kOne)), hn::Set(d, 1.f));
  if (count == hn::Lanes(d)) {
    hn::StoreU(hn::Mul(s, hn::LoadU(d, out)), d, out);
    return;
  }
  HWY_ALIGN float lanes[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(s, d, lanes);
  for (std::size_t i = 0; i < count; ++i) out[i] *= lanes[i];
}

HWY_ATTR void MultiplyPlaneRatios(const PlaneLookup& t, int y, int x0, int x1, float* red,
                                  float* green, float* blue) {
  const D d;
  const DI di;
  const std::size_t lanes = hn::Lanes(d), total = static_cast<std::size_t>(x1 - x0);
  const float py = static_cast<float>(y) + .5f;
  const auto size = static_cast<float>(t.size);
  float start[3];
  for (int k = 0; k < 3; ++k) start[k] = t.at.h[k][1] * py + t.at.h[k][2];
  for (std::size_t i = 0; i < total; i += lanes) {
    const auto px =
        hn::Add(hn::Iota(d, 0.f), hn::Set(d, static_cast<float>(x0 + static_cast<int>(i)) + .5f));
    const auto w = hn::MulAdd(px, hn::Set(d, t.at.h[2][0]), hn::Set(d, start[2]));
    const auto inverse = hn::Div(hn::Set(d, 1.f), w);
    const auto x = hn::Mul(hn::MulAdd(px, hn::Set(d, t.at.h[0][0]), hn::Set(d, start[0])), inverse);
    const auto z = hn::Mul(hn::MulAdd(px, hn::Set(d, t.at.h[1][0]), hn::Set(d, start[1])), inverse);
    const auto one = hn::Set(d, 1.f);
    const auto inside =
        hn::And(hn::Gt(w, hn::Zero(d)), hn::And(hn::Lt(hn::Abs(x), one), hn::Lt(hn::Abs(z), one)));
    if (hn::AllFalse(d, inside)) continue;
    // Lanes outside may hold anything, NaN too: they read texel 0 and are not used.
    const auto u = hn::IfThenElseZero(inside, Texel(x, size)),
               v = hn::IfThenElseZero(inside, Texel(z, size));
    const auto last = hn::Set(di, t.size - 2);
    const auto iu = hn::Min(hn::ConvertTo(di, u), last), iv = hn::Min(hn::ConvertTo(di, v), last);
    const auto at = hn::Add(hn::Mul(iv, hn::Set(di, t.size)), iu);
    const DU du;
    const std::uint32_t* const lower = t.ratio + t.size;
    const auto a = hn::GatherIndex(du, t.ratio, at), b = hn::GatherIndex(du, t.ratio + 1, at),
               c = hn::GatherIndex(du, lower, at), e = hn::GatherIndex(du, lower + 1, at);
    const auto fx = hn::Sub(u, hn::ConvertTo(d, iu)), fy = hn::Sub(v, hn::ConvertTo(d, iv));
    const std::size_t count = total - i < lanes ? total - i : lanes;
    constexpr int kOne11 = PackedRatio::kOne11, kOne10 = PackedRatio::kOne10;
    MultiplyChannel<21, 11, kOne11>(a, b, c, e, fx, fy, inside, count, red + i);
    MultiplyChannel<10, 11, kOne11>(a, b, c, e, fx, fy, inside, count, green + i);
    MultiplyChannel<0, 10, kOne10>(a, b, c, e, fx, fy, inside, count, blue + i);
  }
}

HWY_INLINE void SubtractShare(hn::Vec<D> value, float share, std::size_t count, float* out) {
  const D d;
  const auto product = hn::Mul(value, hn::Set(d, share));
  if (count == hn::Lanes(d)) {
    hn::StoreU(hn::Sub(hn::LoadU(d, out), product), d, out);
    return;
  }
  HWY_ALIGN float lanes[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(product, d, lanes);
  for (std::size_t i = 0; i < count; ++i) out[i] -= lanes[i];
}

// Positions (px, py) that the map holds.
HWY_INLINE hn::Mask<D> Holds(const DiscLookup& t, hn::Vec<D> px, float py) {
  const D d;
  const auto at = [&](int k) HWY_ATTR {
    return hn::MulAdd(px, hn::Set(d, t.at.h[k][0]), hn::Set(d, t.at.h[k][1] * py + t.at.h[k][2]));
  };
  const auto zero = hn::Zero(d), w = at(2), x = at(0), z = at(1);
  const auto last_x = hn::Mul(w, hn::Set(d, static_cast<float>(t.width - 1))),
             last_z = hn::Mul(w, hn::Set(d, static_cast<float>(t.height - 1)));
  return hn::And(hn::Gt(w, zero), hn::And(hn::And(hn::Ge(x, zero), hn::Lt(x, last_x)),
                                          hn::And(hn::Ge(z, zero), hn::Lt(z, last_z))));
}

// The map's value at picture positions (px, py): 0 outside.
HWY_INLINE hn::Vec<D> DiscValue(const DiscLookup& t, hn::Vec<D> px, float py) {
  const D d;
  const DI di;
  const auto at = [&](int k) HWY_ATTR {
    return hn::MulAdd(px, hn::Set(d, t.at.h[k][0]), hn::Set(d, t.at.h[k][1] * py + t.at.h[k][2]));
  };
  const auto inside = Holds(t, px, py);
  if (hn::AllFalse(d, inside)) return hn::Zero(d);
  const auto inverse = hn::Div(hn::Set(d, 1.f), at(2));
  const auto x = hn::Mul(at(0), inverse), z = hn::Mul(at(1), inverse);
  const auto u = hn::IfThenElseZero(inside, x), v = hn::IfThenElseZero(inside, z);
  const auto iu = hn::Min(hn::ConvertTo(di, u), hn::Set(di, t.width - 2)),
             iv = hn::Min(hn::ConvertTo(di, v), hn::Set(di, t.height - 2));
  const auto fx = hn::Sub(u, hn::ConvertTo(d, iu)), fy = hn::Sub(v, hn::ConvertTo(d, iv));
  const auto first = hn::Add(hn::Mul(iv, hn::Set(di, t.width)), iu);
  const auto a = hn::GatherIndex(d, t.nodes, first), c = hn::GatherIndex(d, t.nodes + 1, first);
  const auto e = hn::GatherIndex(d, t.nodes + t.width, first),
             f = hn::GatherIndex(d, t.nodes + t.width + 1, first);
  const auto top = hn::MulAdd(fx, hn::Sub(c, a), a), bottom = hn::MulAdd(fx, hn::Sub(f, e), e);
  return hn::IfThenElseZero(inside, hn::MulAdd(fy, hn::Sub(bottom, top), top));
}

HWY_INLINE hn::Vec<D> MeanValue(const DiscLookup& t, hn::Vec<D> left, int y) {
  const D d;
  const int n = t.samples;
  const float step = 1 / static_cast<float>(n);
  auto sum = hn::Zero(d);
  for (int k = 0; k < n * n; ++k)
    sum = hn::Add(sum, DiscValue(t, hn::Add(left, hn::Set(d, step * (float(k % n) + .5f))),
                                 float(y) + step * (float(k / n) + .5f)));
  return hn::Mul(sum, hn::Set(d, step * step));
}

HWY_ATTR void LoadDiscValues(const DiscLookup& t, int y, int x0, int x1, float* out) {
  const D d;
  const std::size_t lanes = hn::Lanes(d), total = static_cast<std::size_t>(x1 - x0);
  const auto top = static_cast<float>(y);
  for (std::size_t i = 0; i < total; i += lanes) {
    const auto left =
        hn::Add(hn::Iota(d, 0.f), hn::Set(d, static_cast<float>(x0 + static_cast<int>(i))));
    const auto right = hn::Add(left, hn::Set(d, 1.f));
    const auto inside = hn::And(hn::And(Holds(t, left, top), Holds(t, right, top)),
                                hn::And(Holds(t, left, top + 1), Holds(t, right, top + 1)));
    if (hn::AllFalse(d, inside)) continue;
    const auto value = MeanValue(t, left, y);
    const std::size_t count = total - i < lanes ? total - i : lanes;
    if (count == lanes) {
      hn::StoreU(hn::IfThenElse(inside, value, hn::LoadU(d, out + i)), d, out + i);
      continue;
    }
    HWY_ALIGN float values[HWY_MAX_BYTES / sizeof(float)];
    hn::Store(hn::IfThenElse(inside, value, hn::Set(d, -1.f)), d, values);
    for (std::size_t k = 0; k < count; ++k)
      if (values[k] >= 0) out[i + k] = values[k];
  }
}

HWY_ATTR void SubtractDiscShares(const DiscLookup& t, int y, int x0, int x1, float* r, float* g,
                                 float* b) {
  const D d;
  const std::size_t lanes = hn::Lanes(d), total = static_cast<std::size_t>(x1 - x0);
  for (std::size_t i = 0; i < total; i += lanes) {
    const auto left =
        hn::Add(hn::Iota(d, 0.f), hn::Set(d, static_cast<float>(x0 + static_cast<int>(i))));
    const auto value = MeanValue(t, left, y);
    if (hn::AllTrue(d, hn::Eq(value, hn::Zero(d)))) continue;
    const std::size_t count = total - i < lanes ? total - i : lanes;
    SubtractShare(value, t.share.r, count, r + i);
    SubtractShare(value, t.share.g, count, g + i);
    SubtractShare(value, t.share.b, count, b + i);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(MultiplyPlaneRatios);
HWY_EXPORT(SubtractDiscShares);
HWY_EXPORT(LoadDiscValues);

void multiply_plane_ratios(const PlaneLookup& plane, int y, int x0, int x1, float* r, float* g,
                           float* b) {
  HWY_DYNAMIC_DISPATCH(MultiplyPlaneRatios)(plane, y, x0, x1, r, g, b);
}

void load_disc_values(const DiscLookup& disc, int y, int x0, int x1, float* out) {
  HWY_DYNAMIC_DISPATCH(LoadDiscValues)(disc, y, x0, x1, out);
}

void subtract_disc_shares(const DiscLookup& disc, int y, int x0, int x1, float* r, float* g,
                          float* b) {
  HWY_DYNAMIC_DISPATCH(SubtractDiscShares)(disc, y, x0, x1, r, g, b);
}
}  // namespace penumbra::compositor
#endif
