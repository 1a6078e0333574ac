#include "lighting/sh/latlong_kernel.h"

#include "core/conventions.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "lighting/sh/latlong_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::lighting {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Lanes = hn::ScalableTag<float>;

// The four pixels at p, -p, pi - p and p - pi share |cos mp| and |sin mp|. Their sums with the
// signs of even cosine, odd cosine, even sine and odd sine:
//   ce = a + b + c + d    co = a + b - c - d    se = a - b - c + d    so = a - b + c - d
HWY_ATTR void Fold(const RowTables& t, const float* rgb) {
  const Lanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int quarter = t.width / 4, half = t.width / 2;
  float* const buffer = t.scratch;
  const auto plane = [&](int which, int channel)
                         HWY_ATTR { return buffer + (which * 3 + channel) * t.stride; };
  int k = 0;
  for (; k + lanes <= quarter; k += lanes) {
    hn::Vec<Lanes> a[3], b[3], c[3], e[3];
    hn::LoadInterleaved3(d, rgb + 3 * (half + k), a[0], a[1], a[2]);
    hn::LoadInterleaved3(d, rgb + 3 * (half - k - lanes), b[0], b[1], b[2]);
    hn::LoadInterleaved3(d, rgb + 3 * (t.width - k - lanes), c[0], c[1], c[2]);
    hn::LoadInterleaved3(d, rgb + 3 * k, e[0], e[1], e[2]);
    for (int ch = 0; ch < 3; ++ch) {
      const auto rb = hn::Reverse(d, b[ch]), rc = hn::Reverse(d, c[ch]);
      const auto ab = hn::Add(a[ch], rb), amb = hn::Sub(a[ch], rb);
      const auto cd = hn::Add(rc, e[ch]), cmd = hn::Sub(rc, e[ch]);
      hn::StoreU(hn::Add(ab, cd), d, plane(0, ch) + k);
      hn::StoreU(hn::Sub(ab, cd), d, plane(1, ch) + k);
      hn::StoreU(hn::Sub(amb, cmd), d, plane(2, ch) + k);
      hn::StoreU(hn::Add(amb, cmd), d, plane(3, ch) + k);
    }
  }
  for (; k < quarter; ++k)
    for (int ch = 0; ch < 3; ++ch) {
      const float a = rgb[3 * (half + k) + ch], b = rgb[3 * (half - 1 - k) + ch];
      const float c = rgb[3 * (t.width - 1 - k) + ch], e = rgb[3 * k + ch];
      plane(0, ch)[k] = a + b + c + e;
      plane(1, ch)[k] = a + b - c - e;
      plane(2, ch)[k] = a - b - c + e;
      plane(3, ch)[k] = a - b + c - e;
    }
}

// Dot products of one folded plane triple with `Count` tables at once: the tables and the planes
// are zero beyond the quarter row, so whole vectors suffice.
template <int Count>
HWY_ATTR void Dots(int n, const float* const* table, const float* r, const float* g, const float* b,
                   double (*const* out)[3]) {
  const Lanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  hn::Vec<Lanes> sum[Count][3];
  for (auto& s : sum) s[0] = s[1] = s[2] = hn::Zero(d);
  for (int k = 0; k < n; k += lanes) {
    const auto vr = hn::LoadU(d, r + k), vg = hn::LoadU(d, g + k), vb = hn::LoadU(d, b + k);
    for (int i = 0; i < Count; ++i) {
      const auto w = hn::LoadU(d, table[i] + k);
      sum[i][0] = hn::MulAdd(w, vr, sum[i][0]);
      sum[i][1] = hn::MulAdd(w, vg, sum[i][1]);
      sum[i][2] = hn::MulAdd(w, vb, sum[i][2]);
    }
  }
  for (int i = 0; i < Count; ++i)
    for (int ch = 0; ch < 3; ++ch)
      (*out[i])[ch] = static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum[i][ch])));
}

HWY_ATTR void RowFourierSums(const RowTables& t, const float* rgb, double (*out_cos)[3],
                             double (*out_sin)[3]) {
  Fold(t, rgb);
  const int n = (t.width / 4 + 15) / 16 * 16;
  for (int which = 0; which < 4; ++which) {
    const float* const plane = t.scratch + which * 3 * t.stride;
    const float* const base = which < 2 ? t.cosine : t.sine;
    double(*const target)[3] = which < 2 ? out_cos : out_sin;
    const float* table[5];
    double(*out[5])[3];
    int count = 0;
    const int first = which % 2 == 1 ? 1 : (which == 0 ? 0 : 2);
    for (int m = first; m < t.bands; m += 2) {
      table[count] = base + m * t.stride;
      out[count++] = &target[m];
    }
    const float *r = plane, *g = plane + t.stride, *b = plane + 2 * t.stride;
    switch (count) {
      case 1:
        Dots<1>(n, table, r, g, b, out);
        break;
      case 2:
        Dots<2>(n, table, r, g, b, out);
        break;
      case 3:
        Dots<3>(n, table, r, g, b, out);
        break;
      case 4:
        Dots<4>(n, table, r, g, b, out);
        break;
      case 5:
        Dots<5>(n, table, r, g, b, out);
        break;
      default:
        break;
    }
  }
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V LuminanceOf(D d, V r, V g, V b) {
  return hn::MulAdd(
      hn::Set(d, kLuminance[0]), r,
      hn::MulAdd(hn::Set(d, kLuminance[1]), g, hn::Mul(hn::Set(d, kLuminance[2]), b)));
}

template <class D>
HWY_INLINE hn::Vec<D> LuminanceAt(D d, const float* rgb) {
  hn::Vec<D> r, g, b;
  hn::LoadInterleaved3(d, rgb, r, g, b);
  return LuminanceOf(d, r, g, b);
}

HWY_ATTR double Luminance(const float* rgb, int width, float* peaks) {
  const Lanes d;
  const hn::CappedTag<float, 1> one;
  const int lanes = static_cast<int>(hn::Lanes(d));
  auto sum = hn::Zero(d);
  double residual = 0;
  for (int k = 0; k < width; ++peaks) {
    const int end = k + kPeakBlock < width ? k + kPeakBlock : width;
    auto peak = hn::Zero(d);
    for (; k + lanes <= end; k += lanes) {
      const auto l = LuminanceAt(d, rgb + 3 * k);
      sum = hn::Add(sum, l);
      peak = hn::Max(peak, l);
    }
    *peaks = hn::GetLane(hn::MaxOfLanes(d, peak));
    for (; k < end; ++k) {
      const float l = hn::GetLane(LuminanceAt(one, rgb + 3 * k));
      residual += static_cast<double>(l);
      *peaks = l > *peaks ? l : *peaks;
    }
  }
  return static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum))) + residual;
}

HWY_ATTR double LuminanceAbove(const float* rgb, int width, float level) {
  const Lanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto limit = hn::Set(d, level);
  auto sum = hn::Zero(d);
  int k = 0;
  for (; k + lanes <= width; k += lanes)
    sum = hn::Add(sum, hn::Max(hn::Sub(LuminanceAt(d, rgb + 3 * k), limit), hn::Zero(d)));
  double out = static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum)));
  const hn::CappedTag<float, 1> one;
  for (; k < width; ++k) {
    const float l = hn::GetLane(LuminanceAt(one, rgb + 3 * k)) - level;
    out += l > 0 ? static_cast<double>(l) : 0;
  }
  return out;
}

HWY_ATTR void PixelLuminance(const float* rgb, int width, float* out) {
  const Lanes d;
  const hn::CappedTag<float, 1> one;
  const int lanes = static_cast<int>(hn::Lanes(d));
  int k = 0;
  for (; k + lanes <= width; k += lanes) hn::StoreU(LuminanceAt(d, rgb + 3 * k), d, out + k);
  for (; k < width; ++k) hn::StoreU(LuminanceAt(one, rgb + 3 * k), one, out + k);
}

struct Cut {
  float* rgb;
  float level, per_unit;
  const float *column_x, *column_z;
  float *excess_rgb, *excess_luminance;
};

// As many whole vectors as fit into [k, width); returns where they end.
template <class D>
HWY_ATTR int CutVectors(D d, const Cut& cut, int k, int width, CutSums& sums) {
  using V = hn::Vec<D>;
  const int lanes = static_cast<int>(hn::Lanes(d));
  if (k + lanes > width) return k;
  const V level = hn::Set(d, cut.level), one = hn::Set(d, 1.f), per_unit = hn::Set(d, cut.per_unit);
  V sum[3] = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  V square = hn::Zero(d), x = hn::Zero(d), z = hn::Zero(d);
  for (; k + lanes <= width; k += lanes) {
    V r, g, b;
    hn::LoadInterleaved3(d, cut.rgb + 3 * k, r, g, b);
    const V before = LuminanceOf(d, r, g, b);
    const V kept = hn::IfThenElse(hn::Gt(before, level), hn::Div(level, before), one);
    const V gone = hn::Sub(one, kept);
    const V er = hn::Mul(r, gone), eg = hn::Mul(g, gone), eb = hn::Mul(b, gone);
    hn::StoreInterleaved3(hn::Mul(r, kept), hn::Mul(g, kept), hn::Mul(b, kept), d, cut.rgb + 3 * k);
    hn::StoreInterleaved3(er, eg, eb, d, cut.excess_rgb + 3 * k);
    const V l = LuminanceOf(d, er, eg, eb);
    hn::StoreU(l, d, cut.excess_luminance + k);
    sum[0] = hn::Add(sum[0], er), sum[1] = hn::Add(sum[1], eg), sum[2] = hn::Add(sum[2], eb);
    const V units = hn::Mul(l, per_unit);
    square = hn::MulAdd(units, units, square);
    x = hn::MulAdd(l, hn::LoadU(d, cut.column_x + k), x);
    z = hn::MulAdd(l, hn::LoadU(d, cut.column_z + k), z);
  }
  const auto total = [&](V v) HWY_ATTR { return double(hn::GetLane(hn::SumOfLanes(d, v))); };
  for (int c = 0; c < 3; ++c) sums.rgb[c] += total(sum[c]);
  sums.square += total(square), sums.x += total(x), sums.z += total(z);
  return k;
}

HWY_ATTR void CutRow(float* rgb, int width, float level, float unit, const float* column_x,
                     const float* column_z, float* excess_rgb, float* excess_luminance,
                     CutSums& sums) {
  const Cut cut{rgb, level, 1 / unit, column_x, column_z, excess_rgb, excess_luminance};
  const int k = CutVectors(Lanes(), cut, 0, width, sums);
  CutVectors(hn::CappedTag<float, 1>(), cut, k, width, sums);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::lighting
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::lighting {
HWY_EXPORT(RowFourierSums);
HWY_EXPORT(Luminance);
HWY_EXPORT(LuminanceAbove);
HWY_EXPORT(PixelLuminance);
HWY_EXPORT(CutRow);

void row_fourier_sums(const RowTables& tables, const float* rgb, double (*out_cos)[3],
                      double (*out_sin)[3]) {
  HWY_DYNAMIC_DISPATCH(RowFourierSums)(tables, rgb, out_cos, out_sin);
}

double row_luminance(const float* rgb, int width, float* peaks) {
  return HWY_DYNAMIC_DISPATCH(Luminance)(rgb, width, peaks);
}

void MapLuminance::read_row(const Image<Rgb>& map, int y) {
  const auto row = static_cast<std::size_t>(y);
  row_sum[row] =
      row_luminance(&map.row(y)[0].r, map.width(),
                    &block_peak[row * static_cast<std::size_t>(peak_blocks(map.width()))]);
}

double row_luminance_above(const float* rgb, int width, float level) {
  return HWY_DYNAMIC_DISPATCH(LuminanceAbove)(rgb, width, level);
}

void pixel_luminance(const float* rgb, int width, float* out) {
  HWY_DYNAMIC_DISPATCH(PixelLuminance)(rgb, width, out);
}

void cut_row(float* rgb, int width, float level, float unit, const float* column_x,
             const float* column_z, float* excess_rgb, float* excess_luminance, CutSums& sums) {
  HWY_DYNAMIC_DISPATCH(CutRow)
  (rgb, width, level, unit, column_x, column_z, excess_rgb, excess_luminance, sums);
}
}  // namespace penumbra::lighting
#endif
