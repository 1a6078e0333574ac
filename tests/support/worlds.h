// The scenes that the tests of whole worlds are made of.
#pragma once

#include <cstdlib>
#include <string>

#include "runtime/scene/scene.h"

namespace penumbra::test {

inline runtime::SceneObject twist(const glm::dvec3& position) {
  runtime::SceneObject o;
  o.asset = "builtin:twist";
  o.name = "twist";
  o.albedo = {.6f, .6f, .6f};
  o.position = position;
  o.place_on_floor = true;
  return o;
}

inline runtime::RealGeometry grey_plane(const glm::dvec3& point = {0, 0, 0},
                                        const glm::dvec3& normal = {0, 1, 0}) {
  runtime::RealGeometry g;
  g.plane = runtime::RealPlane{point, glm::normalize(normal)};
  g.albedo = Rgb{.4f, .4f, .4f};
  return g;
}

/// What the same run of ctest has baked already is recalled (tests/CMakeLists.txt).
inline runtime::BakeCache shared_bakes() {
  const char* const bakes = std::getenv("PENUMBRA_TEST_BAKES");
  if (bakes) ::setenv("XDG_CACHE_HOME", bakes, 1);
  return bakes ? runtime::BakeCache::kUsed : runtime::BakeCache::kNotUsed;
}

/// Baked silently.
inline Result<runtime::PreparedScene> prepared(const runtime::Scene& scene, int rays = 512) {
  runtime::BakeSettings settings;
  settings.rays = settings.ground_rays = rays;
  settings.cache = shared_bakes();
  return runtime::prepare(scene, settings,
                          [](const std::string&) { return std::function<void(double)>(); });
}

}  // namespace penumbra::test
