// The light's noise taken out over time.
// threads: thread-bound
#pragma once

#include <array>
#include <cstddef>
#include <optional>

#include "core/sh.h"
#include "core/units.h"
#include "lighting/sh/projection.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Takes the noise out of the lights of a stream: a Kalman filter with a random walk for every
/// coefficient, its noise measured on the stream itself. A change of 4 sigma of the light as a
/// whole, or of its mean, is another light: everything starts again from the newest map, so that a
/// switched lamp does not fade. Innovations that keep their sign raise the process noise: a light
/// that moves faster than a third of a map's noise per map lags less than one map. A weighted mean
/// of maps, so energy keeps. The first three maps pass unchanged, and so do streams of fewer than
/// one map a second.
/// threads: thread-bound; no heap
class LightFilter {
 public:
  /// Replaces the light by what is known of it now. Time that goes back, or another number of
  /// bands, starts again; a map with NaN is left out: what was known stands in for it.
  void update(TimestampNs time, ShProjection& light);
  /// Mean weight of the newest map in the estimate: 1 = as measured.
  double gain() const { return gain_; }
  /// One standard deviation of the irradiance of the light as it was left, RMS over all normals;
  /// nothing before the noise has been measured.
  std::optional<double> irradiance_noise() const;

 private:
  static constexpr std::size_t kMaps = 4;    // that measure the noise
  static constexpr std::size_t kGroups = 6;  // a channel of the whole light, or of the part above
  struct FilteredValue {
    double estimate = 0, variance = 0, noise = 0, own_noise = 0;
    double innovation = 0;  // over its deviation
    float measured = 0;
    std::array<float, kMaps> before{};  // newest first
  };
  int count() const { return 6 * coefficient_count(bands_); }
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }
  std::size_t group(int i) const { return at(i < count() / 2 ? i % 3 : 3 + i % 3); }
  void repeat(ShProjection& light) const;
  void restart(const ShProjection& light);
  void start(FilteredValue& value) const;
  bool read(const ShProjection& light);  // whether it differs from the last
  void write(ShProjection& light) const;
  bool is_another_light(double step_s);
  void correct();
  void remember(double step_s);

  std::array<FilteredValue, 6 * kMaxCoefficients> values_{};
  std::array<double, kGroups> energy_{};  // mean square of its coefficients
  std::array<double, kMaps> age_s_{};
  std::size_t maps_ = 0;  // in `before`
  int bands_ = 0, noise_maps_ = 0;
  double move_ = 0;      // process noise of a map over the noise variance
  double surprise_ = 1;  // factor on the expected variance
  double gain_ = 1;
  TimestampNs time_;
  bool known_ = false, was_reset_ = false;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
