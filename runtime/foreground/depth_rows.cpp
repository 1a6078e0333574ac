#include "runtime/foreground/internal/depth_rows.h"

#include "compositor/foreground.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "runtime/foreground/depth_rows.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::runtime {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Lanes of D from pixel x on; `left` and `right`: of the neighbours, which at the rim is the pixel
// itself.
template <class D>
HWY_INLINE void KeepLanes(D d, const DepthRow& row, std::span<const SeenPlane> planes,
                          std::size_t x, std::size_t left, std::size_t right, float* out) {
  using Margin = compositor::Foreground;
  constexpr float kJump = .05f;
  const auto here = hn::LoadU(d, row.here.data() + x), above = hn::LoadU(d, row.above.data() + x),
             below = hn::LoadU(d, row.below.data() + x),
             before = hn::LoadU(d, row.here.data() + left),
             after = hn::LoadU(d, row.here.data() + right);
  const auto nearest = hn::Min(hn::Min(hn::Min(above, below), hn::Min(before, after)), here);
  const auto farthest = hn::Max(hn::Max(hn::Max(above, below), hn::Max(before, after)), here);
  const auto side =
      hn::IfThenElse(hn::Lt(hn::Sub(here, nearest), hn::Sub(farthest, here)), nearest, farthest);
  const auto zero = hn::Zero(d);
  const auto mixed = hn::And(hn::Gt(nearest, zero), hn::Gt(hn::Sub(farthest, nearest),
                                                           hn::Mul(hn::Set(d, kJump), nearest)));
  const auto depth = hn::IfThenElse(mixed, side, here);
  const auto margin =
      hn::Max(hn::Set(d, Margin::kMinMargin_m), hn::Mul(hn::Set(d, Margin::kMargin), depth));
  const auto ray_x = hn::LoadU(d, row.ray_x.data() + x), ray_y = hn::LoadU(d, row.ray_y.data() + x);
  // A ray that is not a number compares as neither.
  auto in_front = hn::And(hn::Gt(depth, zero), hn::Eq(ray_x, ray_x));
  for (const SeenPlane& p : planes) {
    const auto slope =
        hn::MulAdd(hn::Set(d, p.normal.x), ray_x,
                   hn::MulAdd(hn::Set(d, p.normal.y), ray_y, hn::Set(d, -p.normal.z)));
    in_front = hn::And(in_front, hn::Gt(hn::MulAdd(depth, slope, hn::Set(d, p.eye_m)), margin));
  }
  hn::StoreU(hn::IfThenElseZero(in_front, depth), d, out + x);
}

HWY_ATTR void KeepInFront(const DepthRow& row, std::span<const SeenPlane> planes, std::size_t count,
                          float* out) {
  const hn::ScalableTag<float> d;
  const hn::CappedTag<float, 1> one;
  const std::size_t lanes = hn::Lanes(d), last = count - 1;
  const auto single = [&](std::size_t x) HWY_ATTR {
    KeepLanes(one, row, planes, x, x > 0 ? x - 1 : 0, x < last ? x + 1 : last, out);
  };
  single(0);
  std::size_t x = 1;
  for (; x + lanes < count; x += lanes) KeepLanes(d, row, planes, x, x - 1, x + 1, out);
  for (; x < count; ++x) single(x);
}

template <class D>
HWY_INLINE void ProjectLanes(D d, const PinholePicture& v, const DepthRow& row, std::size_t i,
                             const ProjectedRow& out) {
  constexpr float kNear = static_cast<float>(compositor::kNearPlane);
  const auto depth = hn::LoadU(d, row.here.data() + i), rx = hn::LoadU(d, row.ray_x.data() + i),
             ry = hn::LoadU(d, row.ray_y.data() + i);
  const auto coordinate = [&](int c) HWY_ATTR {
    const auto turned =
        hn::MulAdd(hn::Set(d, v.turn[0][c]), rx,
                   hn::MulAdd(hn::Set(d, v.turn[1][c]), ry, hn::Set(d, -v.turn[2][c])));
    return hn::MulAdd(depth, turned, hn::Set(d, v.move[c]));
  };
  const auto w = hn::Neg(coordinate(2));
  const auto seen = hn::And(hn::Gt(depth, hn::Zero(d)), hn::Gt(w, hn::Set(d, kNear)));
  const auto per = hn::Div(hn::Set(d, 1.f), hn::IfThenElse(seen, w, hn::Set(d, 1.f)));
  const auto x = hn::MulAdd(hn::Mul(hn::Set(d, v.focal_px.x), coordinate(0)), per,
                            hn::Set(d, v.principal_px.x)),
             y = hn::NegMulAdd(hn::Mul(hn::Set(d, v.focal_px.y), coordinate(1)), per,
                               hn::Set(d, v.principal_px.y));
  hn::StoreU(x, d, out.x_px.data() + i);
  hn::StoreU(y, d, out.y_px.data() + i);
  hn::StoreU(hn::IfThenElseZero(seen, w), d, out.distance_m.data() + i);
}

HWY_ATTR void ProjectRow(const PinholePicture& view, const DepthRow& row, std::size_t count,
                         const ProjectedRow& out) {
  const hn::ScalableTag<float> d;
  const hn::CappedTag<float, 1> one;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) ProjectLanes(d, view, row, i, out);
  for (; i < count; ++i) ProjectLanes(one, view, row, i, out);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::runtime
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::runtime {
HWY_EXPORT(KeepInFront);
HWY_EXPORT(ProjectRow);

void keep_in_front(const DepthRow& row, std::span<const SeenPlane> planes, std::span<float> out) {
  HWY_DYNAMIC_DISPATCH(KeepInFront)(row, planes, out.size(), out.data());
}

void project_row(const PinholePicture& view, const DepthRow& row, const ProjectedRow& out) {
  HWY_DYNAMIC_DISPATCH(ProjectRow)(view, row, row.here.size(), out);
}
}  // namespace penumbra::runtime
#endif
