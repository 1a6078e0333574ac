// The surroundings as surfaces of each roughness reflect them: cube maps, blurred by the GGX lobe.
// threads: ReflectionFilter thread-bound, parallel inside
#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <memory>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "lighting/reflections/cube_map.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// levels[k]: mean radiance over the lobe around each direction of reflection, seen along the
/// normal, at roughness k/6; faces of 256 >> k. Those that nobody asked for are empty.
/// source: the split sum of Karis 2013
struct ReflectionMap {
  static constexpr int kLevels = 7;
  static constexpr int kLargestFace = 256;
  static constexpr float roughness_of(int level) {
    return static_cast<float>(level) / (kLevels - 1);
  }

  std::array<CubeMap, kLevels> levels;

  bool empty() const;
};

/// Roughnesses that a scene's surfaces have; none at first.
struct RoughnessRange {
  float least = 1, most = -1;  // 0..1

  bool empty() const { return most < least; }
  void add(float roughness);
};

class ReflectionFilter {
 public:
  /// in: not empty
  explicit ReflectionFilter(const RoughnessRange& asked);

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
  void fill_base(const Image<Rgb>& map, const Image<float>& confidence, const RadianceSh& unseen);
  void filter_level(int level, CubeMap& out) const;
  void sum_lobes(int level, CubeMap& out) const;
  static std::vector<LobeSample> lobe(float roughness, int base);

  int first_ = 0, last_ = 0;  // levels
  int base_ = 0;              // texels a side of the picture that lobes are taken over
  std::array<std::vector<LobeSample>, ReflectionMap::kLevels> lobes_;
  std::vector<glm::vec3> directions_;  // of the base's texels
  std::vector<CubeMap> pyramid_;       // the base, and its halvings
  Image<Rgb> blocks_[2];               // scratch
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
