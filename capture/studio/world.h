// What a synthetic studio's cameras look at.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <memory>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// What the studio's cameras look at.
/// threads: reentrant
class RadianceWorld {
 public:
  virtual ~RadianceWorld() = default;
  /// Linear radiance arriving at `origin` from `direction`.
  virtual Rgb radiance(const glm::dvec3& origin, const glm::dvec3& direction) const = 0;
  /// The far light alone, without the floor: what an environment camera brackets.
  virtual Rgb far_radiance(const glm::dvec3& direction) const = 0;
};

/// A far environment over a textured diffuse floor y = 0. The floor takes its colour from the
/// environment's own ground, seen from kCaptureHeight above the origin, and fine detail from a
/// procedural texture; it is lit by the environment. Radiance is scaled so that the mean luminance
/// over the sphere is kMeanLuminance: full scales a second at gain 1, the light of a room for usual
/// exposure times.
class FloorWorld : public RadianceWorld {
 public:
  static constexpr double kCaptureHeight = .8, kMeanLuminance = 60;
  /// A map of the sky alone has sky below its horizon too. No ground is as blue: with
  /// kGreyUnderSky the floor near the origin is then grey stone.
  enum class Ground { kOfTheMap, kGreyUnderSky };
  static constexpr float kSkyBlue = 2;  // blue over red of such a ground
  /// errors: kInvalid (no pixels), kNonFinite, kUndetermined (black)
  static Result<std::shared_ptr<FloorWorld>> make(Image<Rgb> latlong,
                                                  Ground ground = Ground::kOfTheMap);
  Rgb radiance(const glm::dvec3& origin, const glm::dvec3& direction) const override;
  Rgb far_radiance(const glm::dvec3& direction) const override;

  Rgb floor_albedo(const glm::dvec3& position) const;
  Rgb mean_floor_albedo() const { return mean_albedo_; }  // around the origin
  Rgb floor_irradiance() const { return irradiance_; }    // exact, from every pixel of the map
  const Image<Rgb>& environment() const { return map_; }

 private:
  FloorWorld() = default;
  Image<Rgb> map_;
  Rgb irradiance_, mean_albedo_;
  float albedo_scale_ = 1;
  bool grey_ = false;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
