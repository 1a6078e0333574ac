#include "lighting/reflections/reflection_map.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>
#include <utility>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/reflections/ggx.h"
#include "lighting/reflections/octahedral_map.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/map_average.h"

namespace penumbra::lighting {

namespace {

constexpr int kSmallestSize = 10;
// A smoother surface's lobe is narrower than the largest picture's texels: a mirror. Its width is
// .004.
constexpr float kMirror = .06325f;
// Of the lobes of two levels between which others are mixed: half way a map with a setting sun is
// off by 2 % then, one of a dark studio with small lamps by 40 %.
constexpr float kWidthRatio = 1.7f;
constexpr std::size_t kMaxSingle = 8, kMaxSteps = 7;
// As half precision holds it, with room for a factor.
constexpr float kBrightest = 60'000;

// Texels a side: at least three over the lobe's full width at half its height, 2.6 alpha.
int size_of(float roughness) {
  if (roughness <= kMirror) return ReflectionMap::kLargestSize;
  int size = ReflectionMap::kLargestSize / 2;
  while (size > kSmallestSize && static_cast<float>(size / 2) * roughness * roughness > 4.5f)
    size /= 2;
  return size;
}

// Samples of a lobe: narrow lobes hold few texels of the base, and small pictures afford many.
int samples_of(int size) {
  if (size > 160) return 32;
  return size > 80 ? 96 : std::clamp(1'200'000 / (size * size), 96, 512);
}

struct TangentFrame {
  glm::vec3 x, y, z;
  glm::vec3 operator()(const glm::vec3& v) const { return x * v.x + y * v.y + z * v.z; }
};

TangentFrame frame_around(const glm::vec3& z) {
  const glm::vec3 x =
      glm::normalize(glm::cross(std::abs(z.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0), z));
  return {x, glm::cross(z, x), z};
}

Rgb bounded(const Rgb& c) {
  return {std::min(c.r, kBrightest), std::min(c.g, kBrightest), std::min(c.b, kBrightest)};
}

// The sum of each four texels, times a factor.
void halve(const Image<Rgb>& in, float factor, Image<Rgb>& out) {
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x)
      out.at(x, y) = (in.at(2 * x, 2 * y) + in.at(2 * x + 1, 2 * y) + in.at(2 * x, 2 * y + 1) +
                      in.at(2 * x + 1, 2 * y + 1)) *
                     factor;
}

glm::vec3 texel_direction(int x, int y, int size) {
  return octahedral_direction((glm::vec2(x, y) + .5f) / static_cast<float>(size));
}

// Between the four nearest pixels, around the seam; at the poles those of the last row.
Rgb sample_latlong(const Image<Rgb>& map, const glm::vec3& d) {
  const glm::dvec2 p = latlong_pixel(d, map.width(), map.height());
  const double x = p.x - .5, y = std::clamp(p.y - .5, 0., map.height() - 1.);
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(y);
  const auto fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
  const int a = (x0 + map.width()) % map.width(), b = (a + 1) % map.width(),
            y1 = std::min(y0 + 1, map.height() - 1);
  return (map.at(a, y0) * (1 - fx) + map.at(b, y0) * fx) * (1 - fy) +
         (map.at(a, y1) * (1 - fx) + map.at(b, y1) * fx) * fy;
}

// What a direction counts in the mean over the lobe, by its cosine with the lobe's middle: facets'
// density along the half way vector, times the cosine.
float lobe_weight(float roughness, float along) {
  const float alpha = roughness * roughness;
  return along * ggx_density(alpha, std::sqrt(.5f + .5f * along));
}

// Over the hemisphere, in steps of the cosine that are narrow where the lobe is.
float lobe_sum_of(float roughness) {
  constexpr int kSteps = 4096;
  double sum = 0;
  for (int i = 0; i < kSteps; ++i) {
    const double t = (i + .5) / kSteps, below = t * t * t;  // 1 - cosine
    sum += lobe_weight(roughness, static_cast<float>(1 - below)) * 3 * t * t / kSteps;
  }
  return static_cast<float>(2 * kPi * sum);
}

// Harmonics may fall below zero.
Rgb light_from(const RadianceSh& light, const glm::vec3& d) {
  const Rgb c = evaluate(light, glm::dvec3(d));
  return {std::max(c.r, 0.f), std::max(c.g, 0.f), std::max(c.b, 0.f)};
}

}  // namespace

float ReflectionMap::place_of(float roughness) const {
  float place = 0;
  for (std::size_t i = 0; i + 1 < levels.size(); ++i) {
    const float from = lobe_peak(levels[i].roughness), to = lobe_peak(levels[i + 1].roughness);
    place += std::clamp((from - lobe_peak(roughness)) / (from - to), 0.f, 1.f);
  }
  return place;
}

void SurfaceRoughness::add(float roughness) {
  const float r = std::clamp(roughness, kMirror, 1.f);
  add_level(r);
  if (has_long_lobe(r)) add_level(kNarrowLobe * r);
}

void SurfaceRoughness::add_level(float roughness) {
  const auto at = std::ranges::lower_bound(single_, roughness);
  if (at == single_.end() || *at != roughness) single_.insert(at, roughness);
}

void SurfaceRoughness::add_range(float least, float most) {
  if (!(least < most)) return add(least);
  if (has_long_lobe(least)) least *= kNarrowLobe;
  least_ = std::min(least_, std::clamp(least, kMirror, 1.f));
  most_ = std::max(most_, std::clamp(most, kMirror, 1.f));
}

std::vector<float> SurfaceRoughness::levels() const {
  std::vector<float> out = single_;
  float least = least_, most = most_;
  if (out.size() > kMaxSingle) {
    least = std::min(least, out.front()), most = std::max(most, out.back());
    out.clear();
  }
  if (least <= most) {
    // Lobes' widths rise by one factor.
    const float ratio = most / least;
    const auto steps =
        std::min(static_cast<std::size_t>(std::ceil(2 * std::log(ratio) / std::log(kWidthRatio))),
                 std::min(kMaxSteps, ReflectionMap::kMaxLevels - 1 - out.size()));
    for (std::size_t i = 0; i <= steps; ++i) {
      const float part = steps > 0 ? static_cast<float>(i) / static_cast<float>(steps) : 0;
      out.push_back(least * std::pow(ratio, part));
    }
  }
  std::ranges::sort(out);
  constexpr float kSame = 1e-3f;
  const auto repeated =
      std::ranges::unique(out, [](float a, float b) { return std::abs(a - b) < kSame; });
  out.erase(repeated.begin(), repeated.end());
  return out;
}

ReflectionFilter::ReflectionFilter(const SurfaceRoughness& asked, float size_factor) {
  for (const float r : asked.levels())
    plans_.push_back({r, std::clamp(static_cast<int>(static_cast<float>(size_of(r)) * size_factor),
                                    kSmallestSize, ReflectionMap::kLargestSize)});
  // A coarser one would read single places of the map.
  constexpr int kSmallestBase = 160;
  base_ = std::clamp(2 * plans_.front().size, kSmallestBase, ReflectionMap::kLargestSize);
  for (LevelPlan& plan : plans_) {
    any_mirror_ |= plan.roughness <= kMirror;
    if (plan.roughness <= kMirror) continue;
    any_lobe_ = true;
    plan.lobe = lobe_of(plan.roughness, plan.size, base_);
    plan.lobe_sum = lobe_sum_of(plan.roughness);
  }
  directions_.reserve(static_cast<std::size_t>(base_ * base_));
  for (int y = 0; y < base_; ++y)
    for (int x = 0; x < base_; ++x) directions_.push_back(texel_direction(x, y, base_));
  if (any_mirror_) whole_ = Image<Rgb>(base_, base_);
  for (int size = base_; size >= kSmallestSize; size /= 2) pyramid_.emplace_back(size, size);
  spots_ = pyramid_;
}

// Each sample stands for a solid angle of the lobe, and reads where texels are as large. Small
// pictures afford more of them.
// source: Krivanek & Colbert 2008
std::vector<ReflectionFilter::LobeSample> ReflectionFilter::lobe_of(float roughness, int size,
                                                                    int base) {
  const float alpha = roughness * roughness;
  const int count = samples_of(size);
  const float texel = static_cast<float>(4 * kPi) / static_cast<float>(base * base);
  int halvings = 0;
  while ((base >> (halvings + 1)) >= kSmallestSize) ++halvings;
  std::vector<LobeSample> out;
  float sum = 0;
  for (const glm::vec3& m : ggx_half_vectors(alpha, count)) {
    const glm::vec3 towards(2 * m.z * m.x, 2 * m.z * m.y, 2 * m.z * m.z - 1);
    if (towards.z <= 0) continue;
    const float solid_angle = 4 / (static_cast<float>(count) * ggx_density(alpha, m.z));
    const float level = .5f * std::log2(solid_angle / texel);
    out.push_back(
        {towards, towards.z, std::clamp(static_cast<int>(std::lround(level)), 0, halvings)});
    sum += towards.z;
  }
  for (LobeSample& s : out) s.weight /= sum;
  return out;
}

void ReflectionFilter::fill_base(const Image<Rgb>& map, const Image<float>& confidence,
                                 const RadianceSh& unseen, Image<Rgb>& base) {
  // A texel of the base is about as large as a pixel of a map of as many rows.
  const Image<Rgb>* from = &map;
  for (int i = 0; 2 * from->height() >= 3 * base_ && divides_into_blocks(*from, 2); i = 1 - i) {
    average_blocks(*from, 2, blocks_[i]);
    from = &blocks_[i];
  }
  const auto row_length = static_cast<std::size_t>(base_);
  parallel_for(0, base_, 16, [&](const auto& rows) {
    for (int row = rows.begin(); row < rows.end(); ++row) {
      const auto out = base.row(row);
      for (std::size_t x = 0; x < row_length; ++x) {
        const glm::vec3& d = directions_[static_cast<std::size_t>(row) * row_length + x];
        bool seen = true;
        if (!confidence.empty()) {
          const glm::dvec2 p = latlong_pixel(d, confidence.width(), confidence.height());
          seen = confidence.at(std::min(static_cast<int>(p.x), confidence.width() - 1),
                               std::min(static_cast<int>(p.y), confidence.height() - 1)) > 0;
        }
        out[x] = bounded(seen ? sample_latlong(*from, d) : light_from(unseen, d));
      }
    }
  });
}

// A lamp that is much brighter than the rest would be found by one sample of a lobe or by none. Of
// such places there are few: together they have less light than the map.
void ReflectionFilter::take_spots_out(const Image<Rgb>& map) {
  constexpr float kBright = 50;  // times the mean
  double sum = 0, areas = 0;
  float brightest = 0;
  for (int y = 0; y < map.height(); ++y) {
    const double area = latlong_solid_angle(y, map.width(), map.height());
    for (const Rgb& c : map.row(y)) {
      sum += area * luminance(c), areas += area;
      brightest = std::max(brightest, luminance(c));
    }
  }
  const float limit = kBright * static_cast<float>(sum / areas);
  any_spot_ = brightest > limit;
  if (!any_spot_) return;
  if (!rest_.same_size(map)) rest_ = Image<Rgb>(map.width(), map.height());
  std::ranges::fill(spots_[0].pixels(), Rgb{});
  for (int y = 0; y < map.height(); ++y) {
    const auto area = static_cast<float>(latlong_solid_angle(y, map.width(), map.height()));
    for (int x = 0; x < map.width(); ++x) {
      const Rgb& c = map.at(x, y);
      const float bright = luminance(c);
      rest_.at(x, y) = bright > limit ? c * (limit / bright) : c;
      if (!(bright > limit)) continue;
      const glm::vec2 at =
          octahedral_place(latlong_direction(x + .5, y + .5, map.width(), map.height())) *
          static_cast<float>(base_);
      spots_[0].at(std::min(static_cast<int>(at.x), base_ - 1),
                   std::min(static_cast<int>(at.y), base_ - 1)) += (c - rest_.at(x, y)) * area;
    }
  }
}

void ReflectionFilter::fill_pyramid(const Image<Rgb>& map, const Image<float>& confidence,
                                    const RadianceSh& unseen) {
  take_spots_out(map);
  if (any_mirror_ && !any_spot_)
    pyramid_[0] = whole_;
  else
    fill_base(any_spot_ ? rest_ : map, confidence, unseen, pyramid_[0]);
  for (std::size_t i = 1; i < pyramid_.size(); ++i) {
    halve(pyramid_[i - 1], .25f, pyramid_[i]);
    if (any_spot_) halve(spots_[i - 1], 1, spots_[i]);
  }
}

// In texels of which several lie within the lobe, and so many that they are few.
std::vector<ReflectionFilter::Spot> ReflectionFilter::spots_for(const LevelPlan& plan) const {
  constexpr std::ptrdiff_t kMaxSpots = 200;
  std::vector<Spot> out;
  if (!any_spot_) return out;
  const auto is_spot = [](const Rgb& c) { return luminance(c) > 0; };
  std::size_t level = 0;
  while (level + 1 < spots_.size() &&
         (spots_[level].width() > 2 * plan.size ||
          std::ranges::count_if(spots_[level].pixels(), is_spot) > kMaxSpots))
    ++level;
  const Image<Rgb>& picture = spots_[level];
  for (int y = 0; y < picture.height(); ++y)
    for (int x = 0; x < picture.width(); ++x)
      if (const Rgb& c = picture.at(x, y); is_spot(c))
        out.push_back({texel_direction(x, y, picture.width()), c});
  return out;
}

void ReflectionFilter::sum_lobes(const LevelPlan& plan, Image<Rgb>& out) const {
  const std::vector<Spot> spots = spots_for(plan);
  parallel_for(0, plan.size, 2, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < plan.size; ++x) {
        const TangentFrame frame = frame_around(texel_direction(x, y, plan.size));
        Rgb sum;
        for (const LobeSample& s : plan.lobe)
          sum +=
              sample_octahedral(pyramid_[static_cast<std::size_t>(s.halvings)], frame(s.towards)) *
              s.weight;
        for (const Spot& s : spots) {
          const float along = glm::dot(frame.z, s.towards);
          if (along > 0) sum += s.power * (lobe_weight(plan.roughness, along) / plan.lobe_sum);
        }
        out.at(x, y) = bounded(sum);
      }
  });
}

void ReflectionFilter::filter(const Image<Rgb>& map, const Image<float>& confidence,
                              const RadianceSh& unseen, ReflectionMap& out) {
  if (any_mirror_) fill_base(map, confidence, unseen, whole_);
  if (any_lobe_) fill_pyramid(map, confidence, unseen);
  out.levels.resize(plans_.size());
  for (std::size_t i = 0; i < plans_.size(); ++i) {
    ReflectionMap::RoughnessLevel& level = out.levels[i];
    level.roughness = plans_[i].roughness;
    if (plans_[i].lobe.empty()) {
      level.picture = whole_;
      continue;
    }
    if (level.picture.width() != plans_[i].size)
      level.picture = Image<Rgb>(plans_[i].size, plans_[i].size);
    sum_lobes(plans_[i], level.picture);
  }
}

}  // namespace penumbra::lighting
