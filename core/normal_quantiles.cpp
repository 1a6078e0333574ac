#include "core/normal_quantiles.h"

#include <cmath>
#include <numbers>

namespace penumbra {

std::vector<float> normal_quantiles(std::size_t count) {
  std::vector<double> q(count);
  double square = 0;
  for (std::size_t i = 0; i < count / 2; ++i) {
    const double fraction = (static_cast<double>(i) + .5) / static_cast<double>(count);
    double low = -10, high = 0;
    for (int k = 0; k < 60; ++k) {  // bisection on erfc
      const double middle = (low + high) / 2;
      (.5 * std::erfc(-middle / std::numbers::sqrt2) < fraction ? low : high) = middle;
    }
    q[i] = low;
    q[count - 1 - i] = -low;
    square += 2 * low * low;
  }
  const double scale = std::sqrt(static_cast<double>(count) / square);
  std::vector<float> out;
  out.reserve(count);
  for (const double v : q) out.push_back(static_cast<float>(v * scale));
  return out;
}

}  // namespace penumbra
