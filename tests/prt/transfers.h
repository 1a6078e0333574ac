// Transfers of no scene.
#pragma once

#include <random>

#include "prt/prt.h"

namespace penumbra::test {

inline prt::Transfer random_transfer(int bands, int channels, std::size_t points, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<float> gauss(0, .3f);
  prt::Transfer out(bands, channels, points);
  for (int c = 0; c < channels; ++c)
    for (int n = 0; n < coefficient_count(bands); ++n)
      for (std::size_t p = 0; p < points; ++p) out.set(c, n, p, gauss(rng));
  return out;
}

}  // namespace penumbra::test
