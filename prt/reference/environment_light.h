// An environment as a light that can be sampled.
// threads: reentrant
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "core/sh.h"
#include "prt/geometry/animation.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// Radiance arriving from a direction, with a sampler when it is peaky.
class EnvironmentLight {
 public:
  /// A lat-long map, sampled by importance.
  /// errors: kInvalid (empty, wider than 65535 pixels), kNonFinite, kUndetermined (all black)
  static Result<EnvironmentLight> from_map(const Image<Rgb>& map);
  /// Truncated spherical harmonics, negative lobes kept; sampled by their magnitude.
  static EnvironmentLight from_sh(const RadianceSh& light);

  Rgb radiance(const glm::vec3& direction) const;
  bool has_sampler() const { return !cumulative_rows_.empty(); }
  struct LightSample {
    glm::vec3 direction;
    Rgb radiance;
    float density;  // per steradian
  };
  LightSample sample(float u1, float u2) const;
  float density(const glm::vec3& direction) const;

 private:
  Rgb map_value(const glm::vec3& direction) const;
  void add_guides(int row);
  int column_at(int row, float fraction) const;
  Image<Rgb> map_;  // radiance, or with sh_ what it is sampled by
  std::optional<RadianceSh> sh_;
  std::vector<float> cumulative_rows_, cumulative_columns_;
  // Where a row's search for a column begins, for each of an eighth as many equal fractions of the
  // row as it has columns.
  std::vector<std::uint16_t> guides_;
  std::vector<double> row_cosines_;  // of the polar angle, above each row and below the last
  double total_ = 0;                 // of luminance times solid angle
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
