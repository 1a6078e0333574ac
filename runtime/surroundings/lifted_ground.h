// The floor under an object that is lifted off it or leans, by rays: what the object takes of the
// floor's light, and the floor as the object sees it. Its bake knows neither.
// threads: thread-bound, parallel inside
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "core/sh.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

/// Points are even steps of the object's ground grid, which lie closer where the object is near.
/// Light is in the floor's frame: y up, as the bake frame of an object that stands.
class LiftedGround {
 public:
  static constexpr int kSize = 32, kPoints = kSize * kSize, kBands = 5;
  static constexpr int kRays = 32, kStillRays = 128;  // of a point, into the cone of the object
  /// Corners of a box half as large as the object's: the floor looks otherwise from each.
  static constexpr std::size_t kPlaces = 8;

  /// Casts rays where the object is placed otherwise over its floor than at the last call, and once
  /// more of them when it is not. True where it did.
  /// in: things[object] is the mesh of `baked`, which has a receiver, as it lies in the world
  bool look(const prt::RayWorld& things, int object, const prt::BakedObject& baked,
            const Pose& world_from_bake, const Pose& world_from_floor);

  /// Of the light, what comes from above the horizon, and what the floor sends to each place, on
  /// kBands.
  static RadianceSh from_above(const RadianceSh& light);
  std::array<RadianceSh, kPlaces> from_floor(const RadianceSh& light, const Rgb& albedo) const;
  /// How near a vertex is to each place; they sum to 1.
  static std::array<float, kPlaces> weights(const prt::Bounds& object, const glm::vec3& vertex);

  /// What the object takes of the floor's irradiance/pi at the texels of its grid, less what it
  /// reflects there; a plane for each colour.
  /// relit: irradiance/pi of the object's vertices; of its mesh, which shines by its albedo
  /// out: 3 strides, size^2 texels of each used
  void taken(const RadianceSh& light, std::span<const float> relit, const prt::Mesh& mesh, int size,
             std::span<float> out) const;

 private:
  struct LiftedHit {  // of the object's front
    std::uint32_t vertex;
    float weight;  // of radiance, in irradiance/pi
  };
  // What a point sees of the object.
  struct FloorPoint {
    std::array<float, static_cast<std::size_t>(kBands* kBands)> blocked{};
    std::vector<LiftedHit> hits;
    // Solid angle of its cell from each place, times the basis towards it
    std::array<std::array<float, static_cast<std::size_t>(kBands* kBands)>, kPlaces> seen{};
  };
  struct Look;
  void look_from(const Look& in, std::size_t point);
  void see(const Look& in, std::size_t point);

  std::optional<Pose> floor_from_bake_{};
  bool still_ = false;  // looked with all rays
  std::vector<FloorPoint> points_;
};

}  // namespace penumbra::runtime
