#include "runtime/direct/open_planes.h"

#include <algorithm>

#include "core/conventions.h"
#include "lighting/sh/irradiance.h"
#include "prt/geometry/receiver.h"
#include "runtime/direct/scene_light.h"
#include "runtime/surroundings/real_point.h"

namespace penumbra::runtime {

namespace {

glm::dvec3 middle_of(const PreparedScene& scene) {
  glm::dvec3 sum(0);
  for (const PreparedObject& o : scene.objects) sum += o.world_from_bake.translation;
  return sum / std::max(1., static_cast<double>(scene.objects.size()));
}

}  // namespace

OpenPlanes::OpenPlanes(const PreparedScene& scene)
    : scene_(&scene), exchange_(scene.planes, middle_of(scene)) {
  changes_.resize(scene.planes.size());
}

void OpenPlanes::update(const lighting::LightEstimate& light) {
  irradiance_.clear();
  for (const prt::Plane& plane : scene_->planes)
    irradiance_.push_back(open_irradiance(light, plane.normal));
  if (!exchange_.any()) return;
  residuals_.clear();
  for (const prt::Plane& plane : scene_->planes)
    residuals_.push_back(&residual_for(light, plane.normal.y > kLevel));
  exchange_.changes(residuals_, light.lights, changes_);
  constexpr float kMinFraction = .02f;
  for (std::size_t p = 0; p < irradiance_.size(); ++p)
    for (int c = 0; c < 3; ++c) {
      const float alone = irradiance_[p][c];
      irradiance_[p][c] = std::max(alone + changes_[p][c], kMinFraction * alone);
      changes_[p][c] = irradiance_[p][c] - alone;
    }
}

Rgb OpenPlanes::change_under(const prt::BakedObject& baked, const Pose& world_from_bake) const {
  if (!exchange_.any() || !baked.receiver) return {};
  const int plane =
      plane_at(scene_->planes, world_from_bake * glm::dvec3(0, baked.receiver->grid.height, 0),
               world_from_bake.rotation * glm::dvec3(0, 1, 0));
  return plane == RealPoint::kMesh ? Rgb{} : changes_[static_cast<std::size_t>(plane)];
}

}  // namespace penumbra::runtime
