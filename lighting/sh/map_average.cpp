#include "lighting/sh/map_average.h"

#include <algorithm>
#include <vector>

#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::lighting {

namespace {

constexpr int kMinRows = 64;

// Rows y.. as one, by their parts of the rows' solid angle.
void weighted_sum(const Image<Rgb>& map, int y, int side, std::span<Rgb> out) {
  double all = 0;
  for (int j = 0; j < side; ++j) all += latlong_solid_angle(y + j, map.width(), map.height());
  for (int j = 0; j < side; ++j) {
    const auto w =
        static_cast<float>(latlong_solid_angle(y + j, map.width(), map.height()) / (all * side));
    const Rgb* const row = map.row(y + j).data();
    if (j == 0)
      for (std::size_t x = 0; x < out.size(); ++x) out[x] = row[x] * w;
    else
      for (std::size_t x = 0; x < out.size(); ++x) out[x] += row[x] * w;
  }
}

}  // namespace

bool divides_into_blocks(const Image<Rgb>& map, int side) {
  return map.height() % side == 0 && map.height() / side >= kMinRows &&
         map.width() % (4 * side) == 0;
}

void average_blocks(const Image<Rgb>& map, int side, Image<Rgb>& out) {
  const int width = map.width() / side, height = map.height() / side;
  if (out.width() != width || out.height() != height) out = Image<Rgb>(width, height);
  parallel_for(0, height, 16, [&](const auto& rows) {
    thread_local std::vector<Rgb> sums;  // grows once per thread
    sums.resize(static_cast<std::size_t>(map.width()));
    for (int y = rows.begin(); y < rows.end(); ++y) {
      weighted_sum(map, y * side, side, sums);
      const Rgb* block = sums.data();
      for (Rgb& pixel : out.row(y)) {
        pixel = block[0];
        for (int i = 1; i < side; ++i) pixel += block[i];
        block += side;
      }
    }
  });
}

}  // namespace penumbra::lighting
