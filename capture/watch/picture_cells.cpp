#include "capture/watch/picture_cells.h"

#include <algorithm>
#include <limits>

#include "capture/hdr/merge.h"
#include "capture/hdr/merge_math.h"

namespace penumbra::capture {

namespace {

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

// NaN where a sample tells too little.
template <class Pixel>
Rgb cell_mean(const Image<Pixel>& image, const ResponseTable& codes, float clipped,
              const CellGrid& grid, int column, int row) {
  Rgb sum;
  for (int k = 0; k < grid.samples_across * grid.samples_down; ++k) {
    const int across = column * grid.samples_across + k % grid.samples_across,
              down = row * grid.samples_down + k / grid.samples_across;
    const int x = (across * 2 + 1) * image.width() / (2 * grid.samples_across * grid.columns),
              y = (down * 2 + 1) * image.height() / (2 * grid.samples_down * grid.rows);
    const Pixel& p = image.at(x, y);
    const Rgb linear{codes.decode(0, p.r), codes.decode(1, p.g), codes.decode(2, p.b)};
    if (std::max({linear.r, linear.g, linear.b}) >= clipped ||
        linear.r + linear.g + linear.b < 3 * grid.dark)
      return {kUnknown, kUnknown, kUnknown};
    sum += linear;
  }
  return sum * (1 / static_cast<float>(grid.samples_across * grid.samples_down));
}

}  // namespace

void CellMeter::measure(const FramePixels& pixels, const CellGrid& grid, std::vector<Rgb>& out) {
  out.clear();
  const auto clipped = static_cast<float>(kClipLevel - camera_.black_level);
  const auto all = [&](const auto& image, const ResponseTable& codes) {
    out.reserve(static_cast<std::size_t>(grid.cells()));
    for (int row = 0; row < grid.rows; ++row)
      for (int column = 0; column < grid.columns; ++column)
        out.push_back(cell_mean(image, codes, clipped, grid, column, row));
  };
  if (const auto* codes8 = std::get_if<Image<Rgb8>>(&pixels)) all(*codes8, curve(8));
  if (const auto* codes16 = std::get_if<Image<Rgb16>>(&pixels)) all(*codes16, curve(16));
}

const ResponseTable& CellMeter::curve(int bits) {
  if (!curve_ || curve_->largest_code() + 1 != 1u << bits)
    curve_ = make_response_table(camera_.response, bits, camera_.black_level);
  return *curve_;
}

}  // namespace penumbra::capture
