// A smooth map from pixels of one picture to places in another, at a fraction of its price.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "capture/camera_regions.h"
#include "core/threads/parallel.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Calls put(x, y, const PixelHit*) for every pixel of a width x height picture, null where exact()
/// gives nothing. exact(centre) is asked at the corners of cells of up to eight pixels. It is
/// interpolated where the cell's middle agrees within a tenth of a pixel. Cells of which nothing is
/// seen at five points count as not seen. Those that a rim or a seam crosses are asked pixel by
/// pixel.
/// threads: internally parallel, rows of cells apart
template <class Exact, class Put>
void warp_grid(int width, int height, const Exact& exact, const Put& put) {
  const int cell = std::clamp(width / 128, 1, 8);  // of a whole sphere under three degrees
  constexpr double kClose_px = .1;
  using Seen = std::optional<PixelHit>;
  const auto mix = [](const PixelHit& a, const PixelHit& b, double t) {
    return PixelHit{a.px + t * (b.px - a.px), a.from_rim + t * (b.from_rim - a.from_rim),
                    a.light_left + t * (b.light_left - a.light_left)};
  };
  const auto at = [&](double x, double y) -> Seen { return exact(glm::dvec2(x + .5, y + .5)); };
  parallel_for(0, (height + cell - 1) / cell, 8, [&](const auto& rows) {
    std::vector<Seen> upper, lower;
    const auto corners = [&](int y, std::vector<Seen>& out) {
      out.clear();
      for (int x = 0; x < width + cell; x += cell) out.push_back(at(x, y));
    };
    corners(rows.begin() * cell, lower);
    for (int row = rows.begin(); row < rows.end(); ++row) {
      const int y0 = row * cell, y1 = std::min(y0 + cell, height);
      std::swap(upper, lower);
      corners(y0 + cell, lower);
      for (int x0 = 0; x0 < width; x0 += cell) {
        const auto k = static_cast<std::size_t>(x0 / cell);
        const Seen &a = upper[k], &b = upper[k + 1], &c = lower[k], &d = lower[k + 1];
        const Seen middle = at(x0 + cell / 2., y0 + cell / 2.);
        const bool unseen = !a && !b && !c && !d && !middle;
        const bool smooth =
            a && b && c && d && middle &&
            glm::length(middle->px - mix(mix(*a, *b, .5), mix(*c, *d, .5), .5).px) < kClose_px;
        const int x1 = std::min(x0 + cell, width);
        for (int y = y0; y < y1; ++y) {
          if (unseen) {
            for (int x = x0; x < x1; ++x) put(x, y, nullptr);
            continue;
          }
          if (!smooth) {
            for (int x = x0; x < x1; ++x) {
              const Seen seen = at(x, y);
              put(x, y, seen ? &*seen : nullptr);
            }
            continue;
          }
          const double v = double(y - y0) / cell;
          const PixelHit left = mix(*a, *c, v), right = mix(*b, *d, v);
          for (int x = x0; x < x1; ++x) {
            const PixelHit seen = mix(left, right, double(x - x0) / cell);
            put(x, y, &seen);
          }
        }
      }
    }
  });
}

}  // namespace penumbra::capture
#pragma GCC visibility pop
