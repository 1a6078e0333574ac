// Units that do not mix: a time passed where a radiance is wanted does not compile
// (tests/compile_fail proves it). Construction is explicit; arithmetic exists only where units
// allow.
// threads: plain values
#pragma once

#include <chrono>
#include <compare>
#include <cstdint>

#pragma GCC visibility push(default)
namespace penumbra {

template <class Tag, class Rep>
class Quantity {
 public:
  constexpr Quantity() = default;
  explicit constexpr Quantity(Rep value) : value_(value) {}
  constexpr Rep value() const { return value_; }

  friend constexpr auto operator<=>(Quantity, Quantity) = default;
  friend constexpr Quantity operator+(Quantity a, Quantity b) {
    return Quantity(a.value_ + b.value_);
  }
  friend constexpr Quantity operator-(Quantity a, Quantity b) {
    return Quantity(a.value_ - b.value_);
  }
  friend constexpr Quantity operator*(Quantity a, Rep k) { return Quantity(a.value_ * k); }
  friend constexpr Quantity operator*(Rep k, Quantity a) { return Quantity(a.value_ * k); }
  friend constexpr Rep operator/(Quantity a, Quantity b) { return a.value_ / b.value_; }

 private:
  Rep value_{};
};

using Radians = Quantity<struct RadiansTag, double>;
/// Linear amplification of the sensor signal; 1 is the base gain.
using Gain = Quantity<struct GainTag, double>;

/// Durations in seconds (exposure times, ages). For instants see TimestampNs.
using Seconds = std::chrono::duration<double>;

/// An instant on the one monotonic clock of a run, in nanoseconds. Replay supplies its own clock.
struct TimestampNs {
  std::int64_t value = 0;
  friend constexpr auto operator<=>(TimestampNs, TimestampNs) = default;
};

constexpr Seconds operator-(TimestampNs later, TimestampNs earlier) {
  return Seconds(static_cast<double>(later.value - earlier.value) * 1e-9);
}
constexpr TimestampNs operator+(TimestampNs start, Seconds step) {
  return {start.value +
          static_cast<std::int64_t>(step.count() * 1e9 + (step.count() < 0 ? -.5 : .5))};
}

/// The exposure APPLIED to a frame, never the one requested.
struct Exposure {
  Seconds time{};
  Gain gain{1.0};
  /// time x gain in seconds: the sensor signal per unit of radiance.
  constexpr double product() const { return time.count() * gain.value(); }
};

}  // namespace penumbra
#pragma GCC visibility pop
