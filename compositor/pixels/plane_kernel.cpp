#include <algorithm>
#include <cstring>

#include "compositor/pixels/receivers.h"
#include "prt/geometry/receiver.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/pixels/plane_kernel.cpp"
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

// Pixels are looked up some at a time: places first, then their cells, one by one, which takes a
// third of the time of gathers; then what lies between the cells' corners.
constexpr std::size_t kPiece = 64;
static_assert(kPiece % (HWY_MAX_BYTES / sizeof(float)) == 0);

template <class Work>
HWY_INLINE void ForPieces(std::size_t total, const Work& work) {
  for (std::size_t i = 0; i < total; i += kPiece) work(i, total - i < kPiece ? total - i : kPiece);
}

// Where pixels lie between the corners of cells; outside a cell's first corner is 0 and `inside`
// too.
struct Cells {
  HWY_ALIGN std::int32_t at[kPiece];
  HWY_ALIGN float fx[kPiece], fy[kPiece], inside[kPiece];
  HWY_ALIGN std::uint32_t upper[2 * kPiece], lower[2 * kPiece];  // left and right corners in turn
};

// (u, v) in cells; lanes that are not inside may hold anything.
HWY_INLINE void StorePlaces(hn::Vec<D> u, hn::Vec<D> v, hn::Mask<D> inside, int width, int height,
                            std::size_t i, Cells& out) {
  const D d;
  const DI di;
  const auto x = hn::IfThenElseZero(inside, u), z = hn::IfThenElseZero(inside, v);
  const auto iu = hn::Min(hn::ConvertTo(di, x), hn::Set(di, width - 2)),
             iv = hn::Min(hn::ConvertTo(di, z), hn::Set(di, height - 2));
  hn::Store(hn::Add(hn::Mul(iv, hn::Set(di, width)), iu), di, out.at + i);
  hn::Store(hn::Sub(x, hn::ConvertTo(d, iu)), d, out.fx + i);
  hn::Store(hn::Sub(z, hn::ConvertTo(d, iv)), d, out.fy + i);
  hn::Store(hn::IfThenElseZero(inside, hn::Set(d, 1.f)), d, out.inside + i);
}

template <class Word>
HWY_INLINE void LoadCells(const Word* words, int width, std::size_t count, Cells& cells) {
  static_assert(sizeof(Word) == sizeof(std::uint32_t));
  for (std::size_t i = 0; i < count; ++i) {
    const Word* const at = words + cells.at[i];
    std::memcpy(cells.upper + 2 * i, at, 2 * sizeof(Word));
    std::memcpy(cells.lower + 2 * i, at + width, 2 * sizeof(Word));
  }
}

// The lookup of one channel from the packed corners of cells.
template <int kShift, int kBits, int kOne>
HWY_INLINE hn::Vec<D> Ratio(hn::Vec<DU> upper_left, hn::Vec<DU> upper_right, hn::Vec<DU> lower_left,
                            hn::Vec<DU> lower_right, hn::Vec<D> fx, hn::Vec<D> fy,
                            hn::Vec<D> inside) {
  const D d;
  const DI di;
  const auto steps = [&](hn::Vec<DU> packed) HWY_ATTR {
    return hn::ConvertTo(
        d, hn::And(hn::BitCast(di, hn::ShiftRight<kShift>(packed)), hn::Set(di, (1 << kBits) - 1)));
  };
  const auto a = steps(upper_left), c = steps(lower_left);
  const auto top = hn::MulAdd(fx, hn::Sub(steps(upper_right), a), a),
             bottom = hn::MulAdd(fx, hn::Sub(steps(lower_right), c), c);
  const auto blocked = hn::Sub(hn::Set(d, float(kOne)), hn::MulAdd(fy, hn::Sub(bottom, top), top));
  const auto one = hn::Set(d, 1.f);
  return hn::NegMulAdd(hn::Mul(blocked, inside), hn::Set(d, 1.f / float(kOne)), one);
}

HWY_INLINE void Multiply(hn::Vec<D> s, std::size_t count, float* out) {
  const D d;
  if (count == hn::Lanes(d)) {
    hn::StoreU(hn::Mul(s, hn::LoadU(d, out)), d, out);
    return;
  }
  HWY_ALIGN float lanes[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(s, d, lanes);
  for (std::size_t i = 0; i < count; ++i) out[i] *= lanes[i];
}

// Homogeneous places of pixels on a plane.
struct Places {
  hn::Vec<D> x, z, w;
};

// Positions at one height of the picture, a pixel apart, through a pinhole.
struct PinholeRow {
  float py, x0;

  HWY_INLINE PinholeRow(const ViewLens*, float height, float first) : py(height), x0(first) {}
  HWY_INLINE Places At(const Homography& h, std::size_t i) const {
    const D d;
    const auto px = hn::Add(hn::Iota(d, 0.f), hn::Set(d, x0 + static_cast<float>(i)));
    const auto along = [&](int k) HWY_ATTR {
      return hn::MulAdd(px, hn::Set(d, h.h[k][0]), hn::Set(d, h.h[k][1] * py + h.h[k][2]));
    };
    return {along(0), along(1), along(2)};
  }
};

// The same through a lens, by rays between the nodes of its grid, for a piece of a row: nodes at
// the row's height first, then each for the pixels of its cell.
class LensRow {
 public:
  HWY_INLINE LensRow(const ViewLens* lens, float height, float first) {
    const D d;
    const DI di;
    const float down = height * kPerPixel;
    const int above = static_cast<int>(down);
    const float across = first * kPerPixel;
    const int left = static_cast<int>(across);
    const std::size_t node =
        static_cast<std::size_t>(above) * lens->columns() + static_cast<std::size_t>(left);
    const float part = down - static_cast<float>(above);
    Blend(lens->ray_x() + node, lens->columns(), part, x_);
    Blend(lens->ray_y() + node, lens->columns(), part, y_);
    Blend(lens->ray_z() + node, lens->columns(), part, z_);
    // A vector's pixels lie in its cells alike all along the row.
    const auto cells = hn::MulAdd(hn::Iota(d, 0.f), hn::Set(d, kPerPixel),
                                  hn::Set(d, across - static_cast<float>(left)));
    const auto whole = hn::ConvertTo(di, cells);
    hn::Store(whole, di, cell_);
    hn::Store(hn::Sub(cells, hn::ConvertTo(d, whole)), d, right_);
  }
  struct LensRays {
    hn::Vec<D> x, y, z;
  };
  // i: a multiple of the lanes
  HWY_INLINE LensRays RaysAt(std::size_t i) const {
    const D d;
    const DI di;
    const auto cell = hn::Load(di, cell_);
    const auto from = hn::IndicesFromVec(d, cell),
               to = hn::IndicesFromVec(d, hn::Add(cell, hn::Set(di, 1)));
    const auto right = hn::Load(d, right_);
    const auto ray = [&](const float* nodes) HWY_ATTR {
      const auto here = hn::LoadU(d, nodes + i / ViewLens::kCell);
      const auto a = hn::TableLookupLanes(here, from), b = hn::TableLookupLanes(here, to);
      return hn::MulAdd(right, hn::Sub(b, a), a);
    };
    return {ray(x_), ray(y_), ray(z_)};
  }
  HWY_INLINE Places At(const Homography& h, std::size_t i) const {
    const D d;
    const LensRays r = RaysAt(i);
    const auto along = [&](int k) HWY_ATTR {
      return hn::MulAdd(
          r.x, hn::Set(d, h.h[k][0]),
          hn::MulAdd(r.y, hn::Set(d, h.h[k][1]), hn::Mul(r.z, hn::Set(d, h.h[k][2]))));
    };
    return {along(0), along(1), along(2)};
  }

 private:
  static constexpr std::size_t kLanes = HWY_MAX_BYTES / sizeof(float);
  static constexpr float kPerPixel = 1.f / ViewLens::kCell;
  static constexpr std::size_t kNodes = kPiece / ViewLens::kCell + 2;
  static_assert(kNodes + 2 * kLanes <= ViewLens::kPadding);
  static_assert(HWY_TARGET == HWY_SCALAR || kLanes >= 4, "a vector holds the ends of its cells");

  HWY_INLINE void Blend(const float* nodes, std::size_t columns, float part, float* out) const {
    const D d;
    for (std::size_t i = 0; i < kNodes; i += hn::Lanes(d)) {
      const auto top = hn::LoadU(d, nodes + i), bottom = hn::LoadU(d, nodes + columns + i);
      hn::Store(hn::MulAdd(hn::Set(d, part), hn::Sub(bottom, top), top), d, out + i);
    }
  }

  HWY_ALIGN float x_[kNodes + 2 * kLanes], y_[kNodes + 2 * kLanes], z_[kNodes + 2 * kLanes];
  HWY_ALIGN float right_[kLanes];
  HWY_ALIGN std::int32_t cell_[kLanes];
};

// False where no pixel of the piece is inside.
template <class Row>
HWY_INLINE bool PlacesOnGrid(const PlaneLookup& t, const Row& row, std::size_t count, Cells& out) {
  const D d;
  const auto size = static_cast<float>(t.size);
  const auto one = hn::Set(d, 1.f);
  bool any = false;
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const Places at = row.At(t.at, i);
    const auto inverse = hn::Div(one, at.w);
    const auto x = hn::Mul(at.x, inverse), z = hn::Mul(at.z, inverse);
    const auto inside = hn::And(hn::Gt(at.w, hn::Zero(d)),
                                hn::And(hn::Lt(hn::Abs(x), one), hn::Lt(hn::Abs(z), one)));
    any = any || !hn::AllFalse(d, inside);
    StorePlaces(Texel(x, size), Texel(z, size), inside, t.size, t.size, i, out);
  }
  return any;
}

template <class Row>
HWY_INLINE void MultiplyPiece(const PlaneLookup& t, const Row& row, std::size_t total, float* red,
                              float* green, float* blue) {
  const D d;
  const DU du;
  Cells cells;
  if (!PlacesOnGrid(t, row, total, cells)) return;
  LoadCells(t.ratio, t.size, total, cells);
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t i = 0; i < total; i += lanes) {
    hn::Vec<DU> a, b, c, e;
    hn::LoadInterleaved2(du, cells.upper + 2 * i, a, b);
    hn::LoadInterleaved2(du, cells.lower + 2 * i, c, e);
    const auto fx = hn::Load(d, cells.fx + i), fy = hn::Load(d, cells.fy + i),
               inside = hn::Load(d, cells.inside + i);
    const std::size_t count = total - i < lanes ? total - i : lanes;
    constexpr int kOne11 = PackedRatio::kOne11, kOne10 = PackedRatio::kOne10;
    Multiply(Ratio<21, 11, kOne11>(a, b, c, e, fx, fy, inside), count, red + i);
    Multiply(Ratio<10, 11, kOne11>(a, b, c, e, fx, fy, inside), count, green + i);
    Multiply(Ratio<0, 10, kOne10>(a, b, c, e, fx, fy, inside), count, blue + i);
  }
}

template <class Row>
HWY_INLINE void MultiplyRow(const PlaneLookup& t, int y, int x0, int x1, float* red, float* green,
                            float* blue) {
  const float py = static_cast<float>(y) + .5f;
  ForPieces(static_cast<std::size_t>(x1 - x0), [&](std::size_t i, std::size_t count) HWY_ATTR {
    const Row row(t.lens, py, static_cast<float>(x0 + static_cast<int>(i)) + .5f);
    MultiplyPiece(t, row, count, red + i, green + i, blue + i);
  });
}

HWY_ATTR void MultiplyPlaneRatios(const PlaneLookup& t, int y, int x0, int x1, float* red,
                                  float* green, float* blue) {
  if (t.lens)
    MultiplyRow<LensRow>(t, y, x0, x1, red, green, blue);
  else
    MultiplyRow<PinholeRow>(t, y, x0, x1, red, green, blue);
}

HWY_INLINE void SubtractFraction(hn::Vec<D> value, float fraction, std::size_t count, float* out) {
  const D d;
  const auto product = hn::Mul(value, hn::Set(d, fraction));
  if (count == hn::Lanes(d)) {
    hn::StoreU(hn::Sub(hn::LoadU(d, out), product), d, out);
    return;
  }
  HWY_ALIGN float lanes[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(product, d, lanes);
  for (std::size_t i = 0; i < count; ++i) out[i] -= lanes[i];
}

// Positions that the map holds.
HWY_INLINE hn::Mask<D> Holds(const ShadowMapLookup& t, const Places& at) {
  const D d;
  const auto zero = hn::Zero(d);
  const auto last_x = hn::Mul(at.w, hn::Set(d, static_cast<float>(t.width - 1))),
             last_z = hn::Mul(at.w, hn::Set(d, static_cast<float>(t.height - 1)));
  return hn::And(hn::Gt(at.w, zero), hn::And(hn::And(hn::Ge(at.x, zero), hn::Lt(at.x, last_x)),
                                             hn::And(hn::Ge(at.z, zero), hn::Lt(at.z, last_z))));
}

// Adds `fraction` times the map's value at the positions of a piece, 0 outside.
template <class Row>
HWY_INLINE void AddSamples(const ShadowMapLookup& t, const Row& row, float fraction,
                           std::size_t total, float* sum) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  Cells cells;
  bool any = false;
  for (std::size_t i = 0; i < total; i += lanes) {
    const Places at = row.At(t.at, i);
    const auto inside = Holds(t, at);
    any = any || !hn::AllFalse(d, inside);
    const auto inverse = hn::Div(hn::Set(d, 1.f), at.w);
    StorePlaces(hn::Mul(at.x, inverse), hn::Mul(at.z, inverse), inside, t.width, t.height, i,
                cells);
  }
  if (!any) return;
  LoadCells(t.nodes, t.width, total, cells);
  for (std::size_t i = 0; i < total; i += lanes) {
    hn::Vec<DU> corners[4];
    const DU du;
    hn::LoadInterleaved2(du, cells.upper + 2 * i, corners[0], corners[1]);
    hn::LoadInterleaved2(du, cells.lower + 2 * i, corners[2], corners[3]);
    const auto a = hn::BitCast(d, corners[0]), c = hn::BitCast(d, corners[2]);
    const auto fx = hn::Load(d, cells.fx + i);
    const auto top = hn::MulAdd(fx, hn::Sub(hn::BitCast(d, corners[1]), a), a),
               bottom = hn::MulAdd(fx, hn::Sub(hn::BitCast(d, corners[3]), c), c);
    const auto value = hn::MulAdd(hn::Load(d, cells.fy + i), hn::Sub(bottom, top), top);
    const auto weight = hn::Mul(hn::Load(d, cells.inside + i), hn::Set(d, fraction));
    hn::Store(hn::MulAdd(weight, value, hn::Load(d, sum + i)), d, sum + i);
  }
}

// Of pixels [x0, x0 + total) of row y; sum: room for kPiece.
template <class Row>
HWY_INLINE void MeanValues(const ShadowMapLookup& t, int y, int x0, std::size_t total, float* sum) {
  std::fill_n(sum, kPiece, 0.f);
  const int n = t.samples;
  const float step = 1 / static_cast<float>(n);
  for (int k = 0; k < n * n; ++k)
    AddSamples(t,
               Row(t.lens, float(y) + step * (float(k / n) + .5f),
                   float(x0) + step * (float(k % n) + .5f)),
               step * step, total, sum);
}

template <class Row>
HWY_INLINE void LoadShadowRow(const ShadowMapLookup& t, int y, int x0, int x1, float* out) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  ForPieces(static_cast<std::size_t>(x1 - x0), [&](std::size_t first, std::size_t total) HWY_ATTR {
    HWY_ALIGN float values[kPiece];
    const int x = x0 + static_cast<int>(first);
    MeanValues<Row>(t, y, x, total, values);
    const auto held = [&](int dx, int dy, std::size_t i) HWY_ATTR {
      return Holds(t, Row(t.lens, float(y + dy), float(x + dx)).At(t.at, i));
    };
    for (std::size_t i = 0; i < total; i += lanes) {
      const auto inside =
          hn::And(hn::And(held(0, 0, i), held(1, 0, i)), hn::And(held(0, 1, i), held(1, 1, i)));
      hn::Store(hn::IfThenElse(inside, hn::Load(d, values + i), hn::Set(d, -1.f)), d, values + i);
    }
    for (std::size_t i = 0; i < total; ++i)
      if (values[i] >= 0) out[first + i] = values[i];
  });
}

HWY_ATTR void LoadShadowValues(const ShadowMapLookup& t, int y, int x0, int x1, float* out) {
  if (t.lens)
    LoadShadowRow<LensRow>(t, y, x0, x1, out);
  else
    LoadShadowRow<PinholeRow>(t, y, x0, x1, out);
}

template <class Row>
HWY_INLINE void SubtractRow(const ShadowMapLookup& t, int y, int x0, int x1, float* r, float* g,
                            float* b) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  ForPieces(static_cast<std::size_t>(x1 - x0), [&](std::size_t first, std::size_t total) HWY_ATTR {
    HWY_ALIGN float values[kPiece];
    MeanValues<Row>(t, y, x0 + static_cast<int>(first), total, values);
    for (std::size_t i = 0; i < total; i += lanes) {
      const auto value = hn::Load(d, values + i);
      const std::size_t count = total - i < lanes ? total - i : lanes, at = first + i;
      SubtractFraction(value, t.fraction.r, count, r + at);
      SubtractFraction(value, t.fraction.g, count, g + at);
      SubtractFraction(value, t.fraction.b, count, b + at);
    }
  });
}

HWY_ATTR void SubtractShadowFractions(const ShadowMapLookup& t, int y, int x0, int x1, float* r,
                                      float* g, float* b) {
  if (t.lens)
    SubtractRow<LensRow>(t, y, x0, x1, r, g, b);
  else
    SubtractRow<PinholeRow>(t, y, x0, x1, r, g, b);
}

HWY_INLINE hn::Vec<D> LeastSide(const LensRow::LensRays& r, const HalfImage* sides,
                                std::size_t count) {
  const D d;
  const auto term = [&](double v) HWY_ATTR { return hn::Set(d, static_cast<float>(v)); };
  auto least = hn::Set(d, 1e30f);
  for (std::size_t k = 0; k < count; ++k) {
    const HalfImage& h = sides[k];
    least = hn::Min(
        least, hn::MulAdd(r.x, term(h.a),
                          hn::MulAdd(r.y, term(h.b), hn::MulAdd(r.z, term(h.c), term(h.margin)))));
  }
  return least;
}

HWY_ATTR void LoadLeastSide(const ViewLens& lens, const HalfImage* sides, std::size_t count, int y,
                            int x0, int x1, float* out) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  ForPieces(static_cast<std::size_t>(x1 - x0), [&](std::size_t first, std::size_t total) HWY_ATTR {
    const LensRow row(&lens, static_cast<float>(y) + .5f,
                      static_cast<float>(x0 + static_cast<int>(first)) + .5f);
    HWY_ALIGN float values[HWY_MAX_BYTES / sizeof(float)];
    for (std::size_t i = 0; i < total; i += lanes) {
      hn::Store(LeastSide(row.RaysAt(i), sides, count), d, values);
      std::copy_n(values, std::min(lanes, total - i), out + first + i);
    }
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(MultiplyPlaneRatios);
HWY_EXPORT(SubtractShadowFractions);
HWY_EXPORT(LoadShadowValues);
HWY_EXPORT(LoadLeastSide);

void multiply_plane_ratios(const PlaneLookup& plane, int y, int x0, int x1, float* r, float* g,
                           float* b) {
  HWY_DYNAMIC_DISPATCH(MultiplyPlaneRatios)(plane, y, x0, x1, r, g, b);
}

void load_least_side(const ViewLens& lens, std::span<const HalfImage> sides, int y, int x0, int x1,
                     float* out) {
  HWY_DYNAMIC_DISPATCH(LoadLeastSide)(lens, sides.data(), sides.size(), y, x0, x1, out);
}

void load_shadow_values(const ShadowMapLookup& source, int y, int x0, int x1, float* out) {
  HWY_DYNAMIC_DISPATCH(LoadShadowValues)(source, y, x0, x1, out);
}

void subtract_shadow_fractions(const ShadowMapLookup& source, int y, int x0, int x1, float* r,
                               float* g, float* b) {
  HWY_DYNAMIC_DISPATCH(SubtractShadowFractions)(source, y, x0, x1, r, g, b);
}
}  // namespace penumbra::compositor
#endif
