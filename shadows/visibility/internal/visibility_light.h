// Direct light on an object from its visibility map.
#pragma once

#include <algorithm>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <memory_resource>
#include <span>
#include <vector>

#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::shadows {

/// What an object's visibility map does under a light.
enum class LookupUse { kNone, kScout, kCoarse, kFine };
/// kCoarse, kFine: the light is wide against the map's coarse or fine cells, so the map answers in
/// place of rays. kScout: the light is smaller, and the map tells which vertices need rays. kNone:
/// there is no map, the shadow is hard, or more than eight rays a vertex are asked for.
LookupUse lookup_use(const Caster& object, const lighting::DistantLight& source, int samples);

/// The other casters that may stand between an object and some of a light. An object's map knows
/// nothing of them: where they reach it tells only what is dark.
class CastersBetween {
 public:
  CastersBetween(const ShadowCasters& casters, const Caster& object,
                 const lighting::DistantLight& source,
                 std::pmr::memory_resource* memory = std::pmr::get_default_resource());

  bool any() const { return !boxes_.empty(); }
  /// Whether one of them may take some of the light of a point in the object's frame. False is
  /// sure; true by their spheres and boxes.
  bool may_shade(const glm::vec3& point) const {
    return std::ranges::any_of(boxes_, [&](const Box& b) { return may_shade(b, point, 0, {}); });
  }

 private:
  // In the object's frame: a sphere around a caster, and a box whose sides are the caster's axes.
  struct Box {
    glm::vec3 centre, half;
    glm::mat3 axes;
    float radius;
  };
  void add(const Caster& caster, const Caster& object);
  bool may_shade(const Box& box, const glm::vec3& point, float radius, const glm::vec3& half) const;

  std::pmr::vector<Box> boxes_;
  glm::vec3 towards_;    // the light's middle
  float sine_, cosine_;  // of the angle to its farthest direction
  float near_m_;
};

/// By vertex, over directions of the light that are not behind the plane.
/// in: cells as VisibilitySamples::clear
/// threads: as trace_direct_light
void look_up(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
             int cells, std::span<prt::CosineSums> out);

enum class VisibilityVerdict : std::uint8_t {
  kTurnedAway,
  kDark,
  kLit,
  kMaybeDark,
  kMaybeLit,
  kMixed
};
/// What the samples (prt::VertexSamples) at and beside each vertex say of a light, as finely as a
/// look-up can tell. kLit, kDark: all of them say that the whole light is open, or nothing of it.
/// kMaybeLit, kMaybeDark: the vertex is a sample and says so, but others say otherwise.
/// threads: as trace_direct_light
void scout(const Caster& object, const lighting::DistantLight& source,
           std::vector<VisibilityVerdict>& out);

}  // namespace penumbra::shadows
