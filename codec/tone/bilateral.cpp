#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "codec/tone/internal/checks.h"
#include "codec/tone/layers.h"
#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

constexpr int kBorder = 2;  // cells around the picture, as far as the weights reach
constexpr std::array<float, 5> kBinomial{1.f / 16, 4.f / 16, 6.f / 16, 4.f / 16, 1.f / 16};

struct GridCell {
  float sum = 0, weight = 0;
};

// Sums and counts of values over cells of place and value: in it the bilateral filter is a blur.
class BilateralGrid {
 public:
  BilateralGrid(const Image<float>& values, const BilateralOptions& options)
      : cell_px_(options.sigma_px) {
    const auto [low, high] = std::ranges::minmax(values.pixels());
    constexpr double kMaxCells = 128;
    const double range = static_cast<double>(high) - low;
    low_ = low;
    cell_range_ = static_cast<float>(std::max(options.sigma_range, range / kMaxCells));
    width_ = cells((values.width() - 1) / cell_px_);
    height_ = cells((values.height() - 1) / cell_px_);
    depth_ = cells(range / cell_range_);
  }

  [[nodiscard]] std::size_t size() const {
    return static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) *
           static_cast<std::size_t>(depth_);
  }

  // Each row of cells gathers its own rows of pixels, so that no two threads meet.
  void gather(const Image<float>& values) {
    grid_.assign(size(), {});
    std::vector<int> first(static_cast<std::size_t>(height_) + 1, values.height());
    for (int y = values.height() - 1; y >= 0; --y) first[static_cast<std::size_t>(nearest(y))] = y;
    for (std::size_t k = first.size() - 1; k-- > 0;) first[k] = std::min(first[k], first[k + 1]);
    parallel_for(0, height_, [&](int row) {
      const auto k = static_cast<std::size_t>(row);
      for (int y = first[k]; y < first[k + 1]; ++y)
        for (int x = 0; x < values.width(); ++x) {
          const float above = values.at(x, y) - low_, z = above / cell_range_ + kBorder;
          const float part = z - std::floor(z);
          GridCell* const cell = at(nearest(x), row, static_cast<int>(z));
          cell[0].sum += (1 - part) * above, cell[0].weight += 1 - part;
          cell[1].sum += part * above, cell[1].weight += part;
        }
    });
  }

  void blur() {
    const auto depth = static_cast<std::size_t>(depth_);
    blur_along(width_ * height_, depth_, 1,
               [&](int line) { return static_cast<std::size_t>(line) * depth; });
    blur_along(height_ * depth_, width_, depth, [&](int line) {
      return static_cast<std::size_t>(line / depth_) * depth * static_cast<std::size_t>(width_) +
             static_cast<std::size_t>(line % depth_);
    });
    blur_along(width_ * depth_, height_, depth * static_cast<std::size_t>(width_),
               [&](int line) { return static_cast<std::size_t>(line); });
  }

  [[nodiscard]] float read(int x, int y, float value) const {
    const float u = place(x), v = place(y), z = (value - low_) / cell_range_ + kBorder;
    const int iu = static_cast<int>(u), iv = static_cast<int>(v), iz = static_cast<int>(z);
    const float fu = u - static_cast<float>(iu), fv = v - static_cast<float>(iv),
                fz = z - static_cast<float>(iz);
    float sum = 0, weight = 0;
    for (int k = 0; k < 4; ++k) {
      const GridCell* const cell = at(iu + k % 2, iv + k / 2, iz);
      const float w = (k % 2 ? fu : 1 - fu) * (k / 2 ? fv : 1 - fv);
      sum += w * ((1 - fz) * cell[0].sum + fz * cell[1].sum);
      weight += w * ((1 - fz) * cell[0].weight + fz * cell[1].weight);
    }
    return low_ + sum / weight;
  }

 private:
  static int cells(double last) { return static_cast<int>(last) + 2 + 2 * kBorder; }
  [[nodiscard]] float place(int pixel) const {
    return static_cast<float>(pixel / cell_px_) + kBorder;
  }
  [[nodiscard]] int nearest(int pixel) const { return static_cast<int>(place(pixel) + .5f); }
  [[nodiscard]] std::size_t index(int u, int v, int z) const {
    return (static_cast<std::size_t>(v) * static_cast<std::size_t>(width_) +
            static_cast<std::size_t>(u)) *
               static_cast<std::size_t>(depth_) +
           static_cast<std::size_t>(z);
  }
  GridCell* at(int u, int v, int z) { return &grid_[index(u, v, z)]; }
  [[nodiscard]] const GridCell* at(int u, int v, int z) const { return &grid_[index(u, v, z)]; }

  // Lines of `count` cells that lie `stride` apart; nothing lies beyond their ends.
  template <class Start>
  void blur_along(int lines, int count, std::size_t stride, const Start& start) {
    parallel_for(0, lines, 64, [&](const auto& part) {
      std::vector<GridCell> line(static_cast<std::size_t>(count) + 2 * kBorder);
      for (int l = part.begin(); l < part.end(); ++l) {
        GridCell* const cells = &grid_[start(l)];
        const auto cell = [&](int i) -> GridCell& {
          return cells[static_cast<std::size_t>(i) * stride];
        };
        for (int i = 0; i < count; ++i) line[static_cast<std::size_t>(i + kBorder)] = cell(i);
        for (int i = 0; i < count; ++i) {
          GridCell mean;
          for (std::size_t k = 0; k < kBinomial.size(); ++k) {
            const GridCell& c = line[static_cast<std::size_t>(i) + k];
            mean.sum += kBinomial[k] * c.sum, mean.weight += kBinomial[k] * c.weight;
          }
          cell(i) = mean;
        }
      }
    });
  }

  double cell_px_;
  float low_ = 0, cell_range_ = 1;
  int width_ = 0, height_ = 0, depth_ = 0;
  std::vector<GridCell> grid_;
};

}  // namespace

Result<Image<float>> bilateral_base(const Image<float>& values, const BilateralOptions& options) {
  PENUMBRA_TRY(check_option("bilateral sigma in pixels", options.sigma_px, 4, 1e6));
  PENUMBRA_TRY(check_option("bilateral sigma of the range", options.sigma_range, 1e-3, 1e3));
  PENUMBRA_TRY(check_finite_values(values, "values"));
  if (values.empty()) return values;
  BilateralGrid grid(values, options);
  constexpr std::size_t kMaxCells = std::size_t{1} << 25;
  if (grid.size() > kMaxCells)
    return fail(ErrorCode::kInvalid, "bilateral sigma in pixels",
                fmt::format("{} needs {} cells for this picture, more than {}", options.sigma_px,
                            grid.size(), kMaxCells));
  grid.gather(values);
  grid.blur();
  Image<float> out(values.width(), values.height());
  parallel_for(0, values.height(), 8, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < values.width(); ++x) out.at(x, y) = grid.read(x, y, values.at(x, y));
  });
  return out;
}

}  // namespace penumbra::tone
