#include "shadows/silhouette/internal/projected_shadow.h"

#include <algorithm>
#include <array>
#include <bit>

#include "core/threads/scratch.h"
#include "shadows/silhouette/internal/silhouette_segments.h"
#include "shadows/silhouette/projection_kernel.h"

namespace penumbra::shadows {

namespace {

// First integer that is not less, of 0..limit.
int ceil_within(float x, float limit) {
  const float clamped = std::min(std::max(0.f, x), limit);
  const int whole = static_cast<int>(clamped);
  return whole + (static_cast<float>(whole) < clamped ? 1 : 0);
}

// Sixteen directions' layers over a grid: first as steps between neighbours in a row.
class DirectionLayers {
 public:
  /// `steps`: zeros, which it grows where it must and leaves as zeros where each row was asked for.
  DirectionLayers(int width, int height, std::vector<Counts>& steps)
      : width_(width), height_(height), steps_(steps) {
    const auto size = static_cast<std::size_t>(width * height);
    if (steps.size() < size) steps.resize(size);
  }

  /// The directions of group `group` alone.
  void draw(std::span<const SilhouetteSegment> sides, std::span<const PlaneSample> samples,
            std::size_t group, float cell_m) {
    const std::size_t first = kGroup * group;
    for (std::size_t k = first; k < std::min(first + kGroup, samples.size()); ++k) {
      shifts_.x[k - first] = static_cast<float>(samples[k].shift.x / double(cell_m));
      shifts_.z[k - first] = static_cast<float>(samples[k].shift.y / double(cell_m));
    }
    ProjectedEdge fallen;
    for (const SilhouetteSegment& s : sides) {
      const auto more = static_cast<std::uint16_t>(s.more >> first),
                 fewer = static_cast<std::uint16_t>(s.fewer >> first);
      if ((more | fewer) == 0) continue;
      const std::uint16_t crosses =
          fall({s.from.x, s.from.y, s.from.z, s.to.x, s.to.y, s.to.z}, shifts_, height_, fallen);
      draw(fallen, more & crosses, s.layers);
      draw(fallen, fewer & crosses, static_cast<std::int16_t>(-s.layers));
    }
  }
  /// Row y, once.
  void blocked(int y, std::span<std::uint16_t> out) {
    sum_steps(&steps_[index(0, y)], out.size(), out.data());
  }

 private:
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y * width_ + x); }

  // in: directions that cross a row
  void draw(const ProjectedEdge& side, int directions, std::int16_t layers) {
    const auto right = static_cast<float>(width_);
    for (auto left = static_cast<unsigned>(directions); left != 0; left &= left - 1) {
      const auto k = static_cast<std::size_t>(std::countr_zero(left));
      int row = side.row[k], last = side.last[k];
      std::int16_t step = layers;
      if (row > last) std::swap(row, last), step = static_cast<std::int16_t>(-step);
      for (; row < last; ++row) {
        const int x =
            ceil_within(side.x[k] + (static_cast<float>(row) - side.z[k]) * side.slope[k], right);
        if (x == width_) continue;
        std::int16_t& at = steps_[index(x, row)].of[k];
        at = static_cast<std::int16_t>(at + step);
      }
    }
  }

  int width_, height_;
  std::vector<Counts>& steps_;
  Shifts shifts_{};
};

// The sum of weights for each set of sixteen directions.
class WeightSums {
 public:
  WeightSums(std::span<const PlaneSample> samples, std::size_t group) {
    for (std::size_t half = 0; half < 2; ++half)
      for (std::size_t bits = 1; bits < 256; ++bits) {
        const std::size_t sample =
            kGroup * group + 8 * half + static_cast<std::size_t>(std::countr_zero(bits));
        sums_[half][bits] =
            sums_[half][bits & (bits - 1)] + (sample < samples.size() ? samples[sample].weight : 0);
      }
  }
  float operator()(unsigned directions) const {
    return sums_[0][directions & 255] + sums_[1][directions >> 8];
  }

 private:
  std::array<std::array<float, 256>, 2> sums_{};
};

}  // namespace

void add_projected_shadows(const ShadowCasters& casters, const NodeGrid& grid,
                           const SampleCone& light, SilhouetteCache& cache,
                           Image<float>& virtual_occlusion, Image<float>& real_occlusion) {
  const int width = virtual_occlusion.width(), height = virtual_occlusion.height();
  const std::span<const PlaneSample> samples = light.samples;
  const Scratch::Scope scope;
  const auto sides_of = [&](std::span<const Caster> things) {
    return find_sides(things, grid, casters.near_m, light, cache, scope.memory());
  };
  const std::pmr::vector<SilhouetteSegment> of_virtual = sides_of(casters.virtual_things),
                                            of_real = sides_of(casters.real_things);
  thread_local std::vector<Counts> virtual_steps, real_steps;  // grow once per thread
  DirectionLayers virtual_layers(width, height, virtual_steps),
      real_layers(width, of_real.empty() ? 0 : height, real_steps);
  std::pmr::vector<std::uint16_t> blocked(static_cast<std::size_t>(width), scope.memory()),
      by_real(static_cast<std::size_t>(width), scope.memory());
  for (std::size_t group = 0; kGroup * group < samples.size(); ++group) {
    const WeightSums weight(samples, group);
    virtual_layers.draw(of_virtual, samples, group, grid.cell_m);
    if (!of_real.empty()) real_layers.draw(of_real, samples, group, grid.cell_m);
    for (int y = 0; y < height; ++y) {
      virtual_layers.blocked(y, blocked);
      if (!of_real.empty()) real_layers.blocked(y, by_real);
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(x);
        if ((blocked[i] | by_real[i]) == 0) continue;
        virtual_occlusion.at(x, y) += weight(blocked[i] & ~unsigned{by_real[i]});
        if (!real_occlusion.empty()) real_occlusion.at(x, y) += weight(by_real[i]);
      }
    }
  }
}

}  // namespace penumbra::shadows
