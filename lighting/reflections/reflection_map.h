// The surroundings as surfaces of each roughness reflect them: pictures, blurred by the GGX lobe.
// threads: ReflectionFilter thread-bound, parallel inside
#pragma once

#include <algorithm>
#include <glm/vec3.hpp>
#include <vector>

#include "core/image.h"
#include "core/sh.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Density of the lobe's facets along the normal, but for a factor: 1/alpha^2.
inline float lobe_peak(float roughness) {
  const float alpha = std::max(roughness * roughness, .003f);
  return 1 / (alpha * alpha);
}

/// Mean radiance over the lobe around each direction of reflection, seen along the normal, for
/// some roughnesses.
/// source: the split sum of Karis 2013
struct ReflectionMap {
  /// As many texels as six faces of 256 x 256.
  static constexpr int kLargestSize = 640;
  static constexpr std::size_t kMaxLevels = 12;

  struct RoughnessLevel {
    float roughness = 0;
    Image<Rgb> picture{};  // octahedral (octahedral_map.h)
  };
  std::vector<RoughnessLevel> levels{};  // by roughness, rising

  /// Between which levels a roughness lies: 1.25 takes a quarter of the third and the rest of the
  /// second. By lobe_peak(), so that a mean of two lobes is as bright over a small lamp as the one
  /// that is meant. As the shader of surfaces has it.
  float place_of(float roughness) const;
};

/// Rough lobes seen slantwise are longer than wide: narrower ones in a row, of so much of their
/// roughness, stand for them.
inline constexpr float kNarrowLobe = .7746f;  // the root of .6: widths go by its square
inline bool has_long_lobe(float roughness) {
  return roughness > .15f;
}

/// A light that is smaller is mirrored apart from the map: its disc before the lobe. So its
/// highlight has the lobe's own form, also slantwise. Fitted to balls of gold and steel among
/// lamps.
/// roughness: of the map's first level
inline double largest_light_apart_rad(float roughness) {
  constexpr double kSmall = .05, kOfLobe = 1.8, kLarge = .25;
  return std::clamp(kOfLobe * double(roughness) * double(roughness), kSmall, kLarge);
}

/// Roughnesses that a scene's surfaces have, with those of narrower lobes; none at first.
class SurfaceRoughness {
 public:
  /// Of a surface that has one.
  void add(float roughness);
  /// Of a surface whose roughness is a picture's.
  void add_range(float least, float most);
  bool empty() const { return single_.empty() && most_ < least_; }
  /// Those for which levels are made: each that is a surface's own, and steps between which others
  /// are mixed. At most ReflectionMap::kMaxLevels, rising.
  std::vector<float> levels() const;

 private:
  void add_level(float roughness);

  std::vector<float> single_;    // rising
  float least_ = 1, most_ = -1;  // of pictures
};

class ReflectionFilter {
 public:
  /// size_factor: of all pictures' sides, as far as the smallest and the largest allow
  /// in:          asked: not empty
  explicit ReflectionFilter(const SurfaceRoughness& asked, float size_factor = 1);
  /// Of its maps' first level.
  float least_roughness() const { return plans_.front().roughness; }

  /// in:  map: lat-long, finite; lights that are drawn as such are not in it
  ///      confidence: 0 where nothing was seen, which `unseen` then tells; empty: all was seen
  /// out: keeps its memory
  void filter(const Image<Rgb>& map, const Image<float>& confidence, const RadianceSh& unseen,
              ReflectionMap& out);

 private:
  struct LobeSample {
    glm::vec3 towards;  // z along the normal
    float weight;       // of all, 1 in sum
    int halvings;       // of the base, for a sample of its solid angle
  };
  struct LevelPlan {
    float roughness;
    int size;                        // of the picture
    std::vector<LobeSample> lobe{};  // none: the base itself
    float lobe_sum = 0;              // of the lobe's weights over its solid angle
  };
  struct Spot {
    glm::vec3 towards;
    Rgb power;  // radiance times solid angle
  };
  void fill_base(const Image<Rgb>& map, const Image<float>& confidence, const RadianceSh& unseen,
                 Image<Rgb>& base);
  void fill_pyramid(const Image<Rgb>& map, const Image<float>& confidence,
                    const RadianceSh& unseen);
  void take_spots_out(const Image<Rgb>& map);
  std::vector<Spot> spots_for(const LevelPlan& plan) const;
  void sum_lobes(const LevelPlan& plan, Image<Rgb>& out) const;
  static std::vector<LobeSample> lobe_of(float roughness, int size, int base);

  int base_ = 0;  // texels a side of the picture that lobes are taken over
  std::vector<LevelPlan> plans_;
  std::vector<glm::vec3> directions_;  // of the base's texels
  Image<Rgb> whole_;                   // the base, where a mirror shows it
  Image<Rgb> rest_;                    // the map without what is far brighter than the rest
  // The base of that rest with its halvings, and what was taken out: radiance times solid angle
  std::vector<Image<Rgb>> pyramid_, spots_;
  bool any_spot_ = false, any_mirror_ = false, any_lobe_ = false;
  Image<Rgb> blocks_[2];  // scratch
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
