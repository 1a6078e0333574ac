#include "shadows/visibility/internal/soft_shadow_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/visibility/soft_shadow_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::shadows {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::ScalableTag<float> kFloats;
static_assert(kMaxSamples % (HWY_MAX_BYTES / sizeof(float)) == 0);
constexpr float kNone = 1e30f;

// f(first) for vectors over all directions, and over zeros beyond them.
template <class F>
HWY_INLINE void EachVector(const LayerSamples& samples, F f) {
  for (std::size_t k = 0; k < samples.count; k += hn::Lanes(kFloats)) f(k);
}

HWY_ATTR void BeginPlace(const glm::vec3& normal, LayerSamples& samples) {
  const auto d = kFloats;
  const auto nx = hn::Set(d, normal.x), ny = hn::Set(d, normal.y), nz = hn::Set(d, normal.z);
  EachVector(samples, [&](std::size_t k) HWY_ATTR {
    const auto cosine = hn::MulAdd(nx, hn::Load(d, &samples.towards_x[k]),
                                   hn::MulAdd(ny, hn::Load(d, &samples.towards_y[k]),
                                              hn::Mul(nz, hn::Load(d, &samples.towards_z[k]))));
    hn::Store(hn::Max(cosine, hn::Zero(d)), d, &samples.cosine[k]);
    hn::Store(hn::Zero(d), d, &samples.layers[k]);
  });
}

HWY_ATTR void AddLayers(const SilhouetteCrossing& line, LayerSamples& samples) {
  const auto d = kFloats;
  const auto none = hn::Zero(d);
  const glm::vec2 way = line.to - line.from;
  const bool middle_left = line.from.x * way.y - line.from.y * way.x > 0;
  const auto from_x = hn::Set(d, line.from.x), from_y = hn::Set(d, line.from.y),
             to_x = hn::Set(d, line.to.x), to_y = hn::Set(d, line.to.y), way_x = hn::Set(d, way.x),
             way_y = hn::Set(d, way.y), more = hn::Set(d, middle_left ? -line.layers : line.layers);
  EachVector(samples, [&](std::size_t k) HWY_ATTR {
    const auto x = hn::Load(d, &samples.x[k]), z = hn::Load(d, &samples.z[k]);
    // By the same sums for both ends: of two lines that meet a way passes one.
    const auto from_off = hn::MulSub(x, from_y, hn::Mul(z, from_x)),
               to_off = hn::MulSub(x, to_y, hn::Mul(z, to_x)),
               off = hn::MulSub(way_x, hn::Sub(z, from_y), hn::Mul(way_y, hn::Sub(x, from_x)));
    const auto between = hn::Xor(hn::Ge(from_off, none), hn::Ge(to_off, none));
    const auto beyond = middle_left ? hn::Le(off, none) : hn::Gt(off, none);
    const auto layers = hn::Load(d, &samples.layers[k]);
    hn::Store(hn::Add(layers, hn::IfThenElseZero(hn::And(between, beyond), more)), d,
              &samples.layers[k]);
  });
}

HWY_ATTR FewestLayers FindFewest(const LayerSamples& samples) {
  const auto d = kFloats;
  const auto none = hn::Zero(d), far = hn::Set(d, kNone);
  auto fewest = far, open = none;
  EachVector(samples, [&](std::size_t k) HWY_ATTR {
    const auto cosine = hn::Load(d, &samples.cosine[k]);
    open = hn::Add(open, cosine);
    fewest =
        hn::Min(fewest, hn::IfThenElse(hn::Gt(cosine, none), hn::Load(d, &samples.layers[k]), far));
  });
  fewest = hn::MinOfLanes(d, fewest);
  const auto alike = [&](std::size_t k) HWY_ATTR {
    return hn::And(hn::Gt(hn::Load(d, &samples.cosine[k]), none),
                   hn::Eq(hn::Load(d, &samples.layers[k]), fewest));
  };
  auto seen = none, number = none, sum_x = none, sum_z = none;
  EachVector(samples, [&](std::size_t k) HWY_ATTR {
    const auto one = alike(k);
    number = hn::Add(number, hn::IfThenElseZero(one, hn::Set(d, 1)));
    sum_x = hn::Add(sum_x, hn::IfThenElseZero(one, hn::Load(d, &samples.x[k])));
    sum_z = hn::Add(sum_z, hn::IfThenElseZero(one, hn::Load(d, &samples.z[k])));
    const auto counts = hn::Mul(hn::Load(d, &samples.cosine[k]), hn::Load(d, &samples.counted[k]));
    seen = hn::Add(seen, hn::IfThenElseZero(one, counts));
  });
  const auto fraction = hn::Div(hn::Set(d, 1), hn::Max(hn::SumOfLanes(d, number), hn::Set(d, 1)));
  const auto x = hn::Mul(hn::SumOfLanes(d, sum_x), fraction),
             z = hn::Mul(hn::SumOfLanes(d, sum_z), fraction);
  // Amid those that are alike: beside a silhouette rounding could tell rays and layers apart.
  FewestLayers out{hn::GetLane(hn::SumOfLanes(d, open)), hn::GetLane(hn::SumOfLanes(d, seen)), 0};
  float nearest = kNone;
  EachVector(samples, [&](std::size_t k) HWY_ATTR {
    const auto off_x = hn::Sub(hn::Load(d, &samples.x[k]), x),
               off_z = hn::Sub(hn::Load(d, &samples.z[k]), z);
    const auto off = hn::IfThenElse(alike(k), hn::MulAdd(off_x, off_x, hn::Mul(off_z, off_z)), far);
    const auto smallest = hn::MinOfLanes(d, off);
    if (!(hn::GetLane(smallest) < nearest)) return;
    nearest = hn::GetLane(smallest);
    out.ask = static_cast<std::uint32_t>(
        k + static_cast<std::size_t>(hn::FindFirstTrue(d, hn::Eq(off, smallest))));
  });
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::shadows
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::shadows {
HWY_EXPORT(BeginPlace);
HWY_EXPORT(AddLayers);
HWY_EXPORT(FindFewest);

void begin_place(const glm::vec3& normal, LayerSamples& samples) {
  HWY_DYNAMIC_DISPATCH(BeginPlace)(normal, samples);
}
void add_layers(const SilhouetteCrossing& line, LayerSamples& samples) {
  HWY_DYNAMIC_DISPATCH(AddLayers)(line, samples);
}
FewestLayers fewest_layers(const LayerSamples& samples) {
  return HWY_DYNAMIC_DISPATCH(FindFewest)(samples);
}
}  // namespace penumbra::shadows
#endif
