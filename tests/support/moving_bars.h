// A picture whose colours are known wherever one looks, and in which something moves.
#pragma once

#include <array>

#include "core/image.h"

namespace penumbra::test {

inline constexpr std::array<Rgb8, 8> kBarColours = {{{235, 235, 235},
                                                     {200, 190, 30},
                                                     {30, 180, 190},
                                                     {40, 170, 50},
                                                     {180, 50, 170},
                                                     {190, 40, 30},
                                                     {30, 50, 190},
                                                     {16, 16, 16}}};

/// Eight bars side by side; in the lowest eighth, on black, a white square that steps by a
/// sixteenth of the width with each number.
inline Image<Rgb8> moving_bars(int width, int height, int number) {
  Image<Rgb8> out(width, height);
  const int floor = height - height / 8, step = width / 16;
  const int left = number % 16 * step;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (y < floor)
        out.at(x, y) = kBarColours[static_cast<std::size_t>(x * 8 / width)];
      else if (x >= left && x < left + step)
        out.at(x, y) = {255, 255, 255};
    }
  return out;
}

}  // namespace penumbra::test
