#include "lighting/reflections/reflection_map.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/reflections/ggx.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/map_average.h"

namespace penumbra::lighting {

namespace {

constexpr int kSmallestFace = 8;
constexpr int kMinSamples = 48, kMaxSamples = 96;

int face_of(int level) {
  return ReflectionMap::kLargestFace >> level;
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

// what(face, x, y, direction of the texel's middle), on several threads.
template <class What>
void for_texels(int size, const What& what) {
  const auto place = [size](int i) {
    return (static_cast<float>(i) + .5f) / static_cast<float>(size);
  };
  parallel_for(0, 6 * size, 4, [&](const auto& rows) {
    for (int row = rows.begin(); row < rows.end(); ++row)
      for (int x = 0; x < size; ++x)
        what(row / size, x, row % size, cube_direction(row / size, place(x), place(row % size)));
  });
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

// Harmonics may fall below zero.
Rgb light_from(const RadianceSh& light, const glm::vec3& d) {
  const Rgb c = evaluate(light, glm::dvec3(d));
  return {std::max(c.r, 0.f), std::max(c.g, 0.f), std::max(c.b, 0.f)};
}

}  // namespace

bool ReflectionMap::empty() const {
  return std::ranges::all_of(levels, &CubeMap::empty);
}

void RoughnessRange::add(float roughness) {
  const float r = std::clamp(roughness, 0.f, 1.f);
  least = std::min(least, r), most = std::max(most, r);
}

ReflectionFilter::ReflectionFilter(const RoughnessRange& asked) {
  constexpr int kSteps = ReflectionMap::kLevels - 1;
  first_ = static_cast<int>(std::floor(asked.least * kSteps));
  last_ = static_cast<int>(std::ceil(asked.most * kSteps));
  base_ = std::min(ReflectionMap::kLargestFace, 2 * face_of(first_));
  for (int level = std::max(first_, 1); level <= last_; ++level)
    lobes_[static_cast<std::size_t>(level)] = lobe(ReflectionMap::roughness_of(level), base_);
  directions_.reserve(static_cast<std::size_t>(6 * base_ * base_));
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < base_; ++y)
      for (int x = 0; x < base_; ++x)
        directions_.push_back(
            cube_direction(face, (static_cast<float>(x) + .5f) / static_cast<float>(base_),
                           (static_cast<float>(y) + .5f) / static_cast<float>(base_)));
  for (int size = base_; size >= kSmallestFace; size /= 2) pyramid_.emplace_back(size);
}

// Each sample stands for its share of the lobe, and reads where texels are as large.
// source: Krivanek & Colbert 2008
std::vector<ReflectionFilter::LobeSample> ReflectionFilter::lobe(float roughness, int base) {
  const float alpha = roughness * roughness;
  const int count =
      std::clamp(static_cast<int>(2 * kMaxSamples * roughness), kMinSamples, kMaxSamples);
  const float texel = static_cast<float>(4 * kPi) / static_cast<float>(6 * base * base);
  int halvings = 0;
  while ((base >> (halvings + 1)) >= kSmallestFace) ++halvings;
  std::vector<LobeSample> out;
  float sum = 0;
  for (const glm::vec3& m : ggx_half_vectors(alpha, count)) {
    const glm::vec3 towards(2 * m.z * m.x, 2 * m.z * m.y, 2 * m.z * m.z - 1);
    if (towards.z <= 0) continue;
    const float share = 4 / (static_cast<float>(count) * ggx_density(alpha, m.z));
    const float level = .5f * std::log2(share / texel) + 0.f;
    out.push_back(
        {towards, towards.z, std::clamp(static_cast<int>(std::lround(level)), 0, halvings)});
    sum += towards.z;
  }
  for (LobeSample& s : out) s.weight /= sum;
  return out;
}

void ReflectionFilter::fill_base(const Image<Rgb>& map, const Image<float>& confidence,
                                 const RadianceSh& unseen) {
  // A texel of the base is as large as a pixel of a map of twice as many rows.
  const Image<Rgb>* from = &map;
  for (int i = 0; from->height() >= 4 * base_ && divides_into_blocks(*from, 2); i = 1 - i) {
    average_blocks(*from, 2, blocks_[i]);
    from = &blocks_[i];
  }
  const auto row_length = static_cast<std::size_t>(base_);
  parallel_for(0, 6 * base_, 16, [&](const auto& rows) {
    for (int row = rows.begin(); row < rows.end(); ++row) {
      const auto out = pyramid_[0].faces[static_cast<std::size_t>(row / base_)].row(row % base_);
      for (std::size_t x = 0; x < row_length; ++x) {
        const glm::vec3& d = directions_[static_cast<std::size_t>(row) * row_length + x];
        bool seen = true;
        if (!confidence.empty()) {
          const glm::dvec2 p = latlong_pixel(d, confidence.width(), confidence.height());
          seen = confidence.at(std::min(static_cast<int>(p.x), confidence.width() - 1),
                               std::min(static_cast<int>(p.y), confidence.height() - 1)) > 0;
        }
        out[x] = seen ? sample_latlong(*from, d) : light_from(unseen, d);
      }
    }
  });
  for (std::size_t i = 1; i < pyramid_.size(); ++i) pyramid_[i] = halved(pyramid_[i - 1]);
}

// Narrow lobes are still some texels wide at half the size, for a quarter of the time.
void ReflectionFilter::filter_level(int level, CubeMap& out) const {
  constexpr int kFine = 32;
  if (out.size() > kFine) {
    CubeMap half(out.size() / 2);
    sum_lobes(level, half);
    for_texels(out.size(), [&](int face, int x, int y, const glm::vec3& direction) {
      out.faces[static_cast<std::size_t>(face)].at(x, y) = sample(half, direction);
    });
  } else {
    sum_lobes(level, out);
  }
}

void ReflectionFilter::sum_lobes(int level, CubeMap& out) const {
  const auto& samples = lobes_[static_cast<std::size_t>(level)];
  for_texels(out.size(), [&](int face, int x, int y, const glm::vec3& direction) {
    const TangentFrame frame = frame_around(direction);
    Rgb sum;
    for (const LobeSample& s : samples)
      sum += sample(pyramid_[static_cast<std::size_t>(s.halvings)], frame(s.towards)) * s.weight;
    out.faces[static_cast<std::size_t>(face)].at(x, y) = sum;
  });
}

void ReflectionFilter::filter(const Image<Rgb>& map, const Image<float>& confidence,
                              const RadianceSh& unseen, ReflectionMap& out) {
  fill_base(map, confidence, unseen);
  for (int level = 0; level < ReflectionMap::kLevels; ++level) {
    CubeMap& cube = out.levels[static_cast<std::size_t>(level)];
    if (level < first_ || level > last_) {
      cube = {};
      continue;
    }
    if (cube.size() != face_of(level)) cube = CubeMap(face_of(level));
    if (level == 0)
      cube = pyramid_[0];
    else
      filter_level(level, cube);
  }
}

}  // namespace penumbra::lighting
