#include "shadows/silhouette/place_kernel.h"

#include <algorithm>
#include <array>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadows/silhouette/place_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::shadows {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::ScalableTag<float> kFloats;
using Floats = hn::Vec<decltype(kFloats)>;
static_assert(HWY_MAX_BYTES <= 64);  // kMaxLanes, below

struct Points {
  Floats x, y, z;
};

HWY_INLINE Points Load(const glm::vec3* points) {
  Points out;
  hn::LoadInterleaved3(kFloats, &points->x, out.x, out.y, out.z);
  return out;
}

HWY_INLINE Floats Along(const Points& p, float x, float y, float z, Floats first) {
  const auto d = kFloats;
  return hn::MulAdd(p.x, hn::Set(d, x),
                    hn::MulAdd(p.y, hn::Set(d, y), hn::MulAdd(p.z, hn::Set(d, z), first)));
}

HWY_INLINE Points Place(const Points& p, const AffineTransform& placing) {
  const auto d = kFloats;
  const glm::mat3& t = placing.turn;
  return {Along(p, t[0].x, t[1].x, t[2].x, hn::Set(d, placing.shift.x)),
          Along(p, t[0].y, t[1].y, t[2].y, hn::Set(d, placing.shift.y)),
          Along(p, t[0].z, t[1].z, t[2].z, hn::Set(d, placing.shift.z))};
}

// f(first) for vectors that cover all of 0..count, in part twice. in: as many as a vector holds, or
// none
template <class F>
HWY_INLINE void EachVector(std::size_t count, F f) {
  const std::size_t lanes = hn::Lanes(kFloats);
  for (std::size_t i = 0; i + lanes <= count; i += lanes) f(i);
  if (count % lanes != 0) f(count - lanes);
}

HWY_ATTR void MeanCosines(std::span<const glm::vec3> normals, const DirectionSet& light,
                          std::span<float> out) {
  const auto d = kFloats;
  const auto none = hn::Zero(d), reach = hn::Set(d, light.reach);
  const auto along = [&](const Points& n, const glm::vec3& w)
                         HWY_ATTR { return Along(n, w.x, w.y, w.z, hn::Zero(d)); };
  const float fraction = 1 / static_cast<float>(light.directions.size());
  EachVector(normals.size(), [&](std::size_t i) HWY_ATTR {
    const Points n = Load(&normals[i]);
    const auto middle = along(n, light.middle);
    auto cosine = hn::IfThenElseZero(hn::Gt(middle, reach), along(n, light.mean));
    const auto grazes = hn::Le(hn::Abs(middle), reach);
    if (!hn::AllFalse(d, grazes)) {
      auto sum = none;
      for (const glm::vec3& w : light.directions) sum = hn::Add(sum, hn::Max(along(n, w), none));
      cosine = hn::IfThenElse(grazes, hn::Mul(sum, hn::Set(d, fraction)), cosine);
    }
    hn::StoreU(cosine, d, &out[i]);
  });
}

HWY_ATTR void FindFootprint(std::span<const glm::vec3> positions,
                            const AffineTransform& plane_from_mesh, const Reach& reach,
                            float near_m, Footprint& out) {
  const auto d = kFloats;
  const auto far = hn::Set(d, 1e30f), none = hn::Set(d, -1e30f);
  auto low_x = far, low_z = far, shadow_low_x = far, shadow_low_z = far, lowest = far;
  auto high_x = none, high_z = none, shadow_high_x = none, shadow_high_z = none;
  EachVector(positions.size(), [&](std::size_t i) HWY_ATTR {
    const Points p = Place(Load(&positions[i]), plane_from_mesh);
    lowest = hn::Min(lowest, p.y);
    const auto counts = hn::Ge(p.y, hn::Set(d, -near_m));
    const auto y = hn::Max(p.y, hn::Zero(d));
    const auto smallest = [&](auto& so_far, auto value) HWY_ATTR {
      so_far = hn::Min(so_far, hn::IfThenElse(counts, value, far));
    };
    const auto largest = [&](auto& so_far, auto value) HWY_ATTR {
      so_far = hn::Max(so_far, hn::IfThenElse(counts, value, none));
    };
    smallest(low_x, p.x), smallest(low_z, p.z), largest(high_x, p.x), largest(high_z, p.z);
    smallest(shadow_low_x, hn::MulAdd(y, hn::Set(d, reach.low.x), p.x));
    smallest(shadow_low_z, hn::MulAdd(y, hn::Set(d, reach.low.y), p.z));
    largest(shadow_high_x, hn::MulAdd(y, hn::Set(d, reach.high.x), p.x));
    largest(shadow_high_z, hn::MulAdd(y, hn::Set(d, reach.high.y), p.z));
  });
  const auto smallest = [&](auto v) HWY_ATTR { return hn::GetLane(hn::MinOfLanes(d, v)); };
  const auto largest = [&](auto v) HWY_ATTR { return hn::GetLane(hn::MaxOfLanes(d, v)); };
  out.low = {smallest(low_x), smallest(low_z)}, out.high = {largest(high_x), largest(high_z)};
  out.shadow_low = {smallest(shadow_low_x), smallest(shadow_low_z)};
  out.shadow_high = {largest(shadow_high_x), largest(shadow_high_z)};
  out.below = smallest(lowest) < -near_m;
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::shadows
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::shadows {
HWY_EXPORT(MeanCosines);
HWY_EXPORT(FindFootprint);

namespace {

constexpr std::size_t kMaxLanes = 16;

// A vector's worth of points at least: the first one again.
class Padded {
 public:
  explicit Padded(std::span<const glm::vec3> points) : points_(points) {
    if (points.empty() || points.size() >= few_.size()) return;
    std::ranges::copy(points, few_.begin());
    std::fill(few_.begin() + static_cast<std::ptrdiff_t>(points.size()), few_.end(), points[0]);
    points_ = few_;
  }
  Padded(const Padded&) = delete;
  Padded& operator=(const Padded&) = delete;
  std::span<const glm::vec3> points() const { return points_; }

 private:
  std::array<glm::vec3, kMaxLanes> few_;
  std::span<const glm::vec3> points_;
};

}  // namespace

void mean_cosines(std::span<const glm::vec3> normals, const DirectionSet& light,
                  std::span<float> out) {
  const Padded all(normals);
  if (all.points().size() == normals.size())
    return HWY_DYNAMIC_DISPATCH(MeanCosines)(normals, light, out);
  std::array<float, kMaxLanes> few;
  HWY_DYNAMIC_DISPATCH(MeanCosines)(all.points(), light, few);
  std::copy_n(few.begin(), normals.size(), out.begin());
}

Footprint footprint_of(std::span<const glm::vec3> positions, const AffineTransform& plane_from_mesh,
                       const Reach& reach, float near_m) {
  Footprint out;
  HWY_DYNAMIC_DISPATCH(FindFootprint)
  (Padded(positions).points(), plane_from_mesh, reach, near_m, out);
  return out;
}
}  // namespace penumbra::shadows
#endif
