#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "codec/tone/internal/checks.h"
#include "codec/tone/internal/row_kernel.h"
#include "codec/tone/layers.h"
#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

constexpr double kWorkingRange = 10;  // the text of section 3.1.2 stretches luminance to it

// Several steps in one way down a strip of rows, so that between two of them a row never leaves the
// cache: memory is read and written once for all of them. Of each step four rows are kept.
class StripOfSteps {
 public:
  StripOfSteps(int width, int steps)
      : width_(static_cast<std::size_t>(width)),
        stride_(width_ + 2 * kRowPadding),
        steps_(steps),
        rows_(stride_ * kKept * static_cast<std::size_t>(steps + 1)) {}

  /// Rows [first, last) of `out` are those of `in` after all steps.
  void run(const Image<float>& in, const LevelSetRow& how, int first, int last, Image<float>& out) {
    const int height = in.height();
    for (int y = std::max(0, first - steps_); y < last + steps_; ++y) {
      if (y < height) load(in, y);
      for (int s = 1; s <= steps_; ++s) {
        // A step needs of the one before it a row more at both sides.
        const int row = y - s, beyond = steps_ - s;
        if (row < std::max(0, first - beyond) || row >= std::min(height, last + beyond)) continue;
        float* const target = at(s, row);
        level_set_row(at(s - 1, std::max(row - 1, 0)), at(s - 1, row),
                      at(s - 1, std::min(row + 1, height - 1)), how, width_, target);
        close_ends(target);
        if (s == steps_) std::copy_n(target, width_, out.row(row).data());
      }
    }
  }

  static std::size_t bytes_per_step(int width) {
    return (static_cast<std::size_t>(width) + 2 * kRowPadding) * kKept * sizeof(float);
  }

 private:
  static constexpr std::size_t kKept = 4;

  float* at(int step, int row) {
    const std::size_t slot =
        static_cast<std::size_t>(step) * kKept + static_cast<std::size_t>(row) % kKept;
    return rows_.data() + slot * stride_ + kRowPadding;
  }
  void close_ends(float* row) const {
    row[-1] = row[0];
    row[width_] = row[width_ - 1];
  }
  void load(const Image<float>& in, int y) {
    float* const row = at(0, y);
    std::ranges::copy(in.row(y), row);
    close_ends(row);
  }

  std::size_t width_, stride_;
  int steps_;
  std::vector<float> rows_;
};

void run_steps(const Image<float>& in, const LevelSetRow& how, int steps, Image<float>& out) {
  // A strip begins some rows early for each of its steps: tall strips waste little on that, and
  // some of them are wanted for each core.
  constexpr int kStripRows = 128;
  const int strips = (in.height() + kStripRows - 1) / kStripRows;
  parallel_for(0, strips, [&](int strip) {
    const int first = strip * kStripRows;
    StripOfSteps(in.width(), steps)
        .run(in, how, first, std::min(first + kStripRows, in.height()), out);
  });
}

Result<void> check_level_set(double range, const LevelSetOptions& options) {
  PENUMBRA_TRY(check_option("level set range", range, 1e-6, 1e6));
  PENUMBRA_TRY(check_option("level set steps", options.steps, 0, 1000));
  PENUMBRA_TRY(check_option("level set time step", options.time_step, 1e-6, 100));
  return check_option("level set sensitivity", options.sensitivity, 0, 1000);
}

}  // namespace

Result<Image<float>> level_set_profile(const Image<float>& log_luminance, double range,
                                       const LevelSetOptions& options) {
  PENUMBRA_TRY(check_level_set(range, options));
  PENUMBRA_TRY(check_finite_values(log_luminance, "luminance"));
  if (options.steps == 0 || log_luminance.empty()) return log_luminance;
  const int parts = static_cast<int>(std::ceil(options.time_step / kLargestStep));
  const double scale = kWorkingRange / range;
  const LevelSetRow how{static_cast<float>(1 / (scale * scale)),
                        static_cast<float>(options.sensitivity * scale * std::numbers::log2e),
                        static_cast<float>(std::log2(options.time_step / parts))};
  constexpr std::size_t kCacheBytes = 512 << 10;  // of a core, with room for other things
  const int together = static_cast<int>(std::clamp<std::size_t>(
      kCacheBytes / StripOfSteps::bytes_per_step(log_luminance.width()), 1, 16));
  int left = options.steps * parts;
  Image<float> out(log_luminance.width(), log_luminance.height()), before;
  run_steps(log_luminance, how, std::min(left, together), out);
  while ((left -= together) > 0) {
    if (before.empty()) before.reset(out.width(), out.height());
    std::swap(before, out);
    run_steps(before, how, std::min(left, together), out);
  }
  return out;
}

double level_set_bound(double range, const LevelSetOptions& options) {
  if (!(options.sensitivity > 0)) return std::numeric_limits<double>::infinity();
  return std::numbers::sqrt2 * options.steps * options.time_step /
         (std::numbers::e * options.sensitivity) * range / kWorkingRange;
}

}  // namespace penumbra::tone
