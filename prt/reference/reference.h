// The path-traced reference.
// threads: reentrant and internally parallel (TBB)
#pragma once

#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <memory>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/geometry/plane.h"
#include "prt/reference/environment_light.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// A sphere of even radiance that nothing sees but by its light.
struct SphereLight {
  glm::dvec3 position{0, 1, 0};
  double radius_m = .03;
  Rgb irradiance_at_1m;  // of a surface that faces it: pi r^2 times its radiance
};

struct ReferenceWorld {
  Mesh mesh;  // world frame, virtual and real together
  std::vector<Plane> planes;
  const EnvironmentLight* light = nullptr;
  /// What a ray that leaves the camera and meets nothing shows; `light` when empty.
  std::function<Rgb(const glm::vec3&)> background;
  std::vector<SphereLight> lamps{};
  /// Of the vertices of `mesh`; null: they are Lambertian with its albedo. What glows lights the
  /// rest, found by chance alone.
  std::shared_ptr<const SurfaceMaterials> surface{};
  float emission_unit = 1;  // radiance of an emission of 1
};

struct ReferenceOptions {
  double error = .01;      // stop when the estimated relative RMS error is below
  int longest_path = 12;   // diffuse bounces; Russian roulette from the fourth on
  int max_samples = 4096;  // per pixel
  std::uint64_t seed = 1;
  std::function<void(double done)> progress;
  /// Where a continuous pixel looks in the camera's frame, unit; 0 where it shows nothing, which
  /// stays black. Empty: the view's own pinhole.
  std::function<glm::dvec3(glm::dvec2 pixel)> ray;
};

struct Reference {
  Image<Rgb> radiance;  // mean of the two halves
  Image<Rgb> half_a, half_b;
  double error = 0;  // RMS(a - b)/2 over the mean, by luminance
  int samples = 0;   // per pixel, both halves
};

/// Path tracer with next-event estimation and balance-heuristic weights (Veach & Guibas 1995).
/// errors: kInvalid (size, world), kUnavailable
Result<Reference> render_reference(const ReferenceWorld& world, const PinholeView& view,
                                   const ReferenceOptions& options);

/// Irradiance at surface points by the same estimator: for shadow errors in s and for closed forms.
struct IrradiancePoint {
  glm::dvec3 position, normal;
};
Result<std::vector<Rgb>> reference_irradiance(const ReferenceWorld& world,
                                              std::span<const IrradiancePoint> points, int samples,
                                              std::uint64_t seed);

}  // namespace penumbra::prt
#pragma GCC visibility pop
