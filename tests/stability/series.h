// Figures of a long run: whether they drift, and how much they flicker.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <vector>

namespace penumbra::test {

/// One figure, frame by frame, of a scene that stands.
struct Series {
  std::vector<double> values;

  double mean(std::size_t first, std::size_t count) const {
    double sum = 0;
    for (std::size_t i = first; i < first + count; ++i) sum += values[i];
    return sum / static_cast<double>(count);
  }
  double mean() const { return mean(0, values.size()); }
  double deviation() const {
    const double m = mean();
    double sum = 0;
    for (const double v : values) sum += (v - m) * (v - m);
    return std::sqrt(sum / static_cast<double>(values.size()));
  }
  /// RMS change from one to the next over the mean: F of methods 9, for a scene that does not
  /// change.
  double flicker() const {
    double sum = 0;
    for (std::size_t i = 1; i < values.size(); ++i) sum += std::pow(values[i] - values[i - 1], 2);
    return std::sqrt(sum / static_cast<double>(values.size() - 1)) / mean();
  }
};

/// The first hundred against the last.
inline void expect_no_drift(const Series& s, const char* name) {
  constexpr std::size_t kPart = 100;
  const double sigma = s.deviation() * std::sqrt(2. / kPart);
  EXPECT_NEAR(s.mean(0, kPart), s.mean(s.values.size() - kPart, kPart), 3 * sigma + 1e-6 * s.mean())
      << name;
}

}  // namespace penumbra::test
