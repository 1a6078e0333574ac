// Ray directions of the bake: stratified, coherent in blocks of sixteen, in four groups.
// threads: const members reentrant
#pragma once

#include <array>
#include <glm/vec3.hpp>
#include <vector>

#include "prt/rays/rays.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// One of several fixed patterns of N points on the unit square. A point keeps the pattern and the
/// turn that its index gives it, in every frame and on every machine, so errors stay coherent in
/// time.
class RayPatterns {
 public:
  explicit RayPatterns(int rays);

  struct Turn {
    int variant;
    float cosine, sine;  // rotation about the axis
  };
  static Turn turn_of(std::size_t point);

  int rays() const { return rays_; }
  /// Fills directions of block `block` (rays 16*block ..) around `axis`, distributed by the cosine.
  void cosine_block(Turn turn, int block, const glm::mat3& frame,
                    RayScene::RayPacket& packet) const;
  /// The same, uniform in solid angle in a cone of given cosine of its half angle.
  void cone_block(Turn turn, int block, const glm::mat3& frame, float cos_half,
                  RayScene::RayPacket& packet) const;
  /// Which of the four groups each ray of a block belongs to.
  const std::uint8_t* groups(Turn turn, int block) const;

  static constexpr int kVariants = 32;

 private:
  struct Variant {
    std::vector<float> disk_x, disk_y, disk_z;    // cosine-distributed about +z
    std::vector<float> height, cos_phi, sin_phi;  // cylinder coordinates for cones
    std::vector<std::uint8_t> group;
  };
  int rays_;
  std::vector<Variant> variants_;
};

/// Columns x, y, z with z along the axis.
/// source: Duff et al. 2017
glm::mat3 frame_around(const glm::vec3& axis);

}  // namespace penumbra::prt
#pragma GCC visibility pop
