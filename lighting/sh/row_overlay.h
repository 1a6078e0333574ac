// A map of which some rows are changed, without a copy of the others.
#pragma once

#include <algorithm>
#include <cassert>
#include <span>
#include <vector>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Refers to the map, which must outlive it. A row that was asked for before its first change is
/// the map's own. Memory grows once.
/// threads: const members reentrant
class RowOverlay {
 public:
  RowOverlay() = default;
  explicit RowOverlay(const Image<Rgb>& map) { reset(map); }

  /// The map as it is.
  void reset(const Image<Rgb>& map) {
    map_ = &map;
    place_.assign(static_cast<std::size_t>(map.height()), -1);
    used_ = 0;
  }
  int width() const { return map_ ? map_->width() : 0; }
  int height() const { return map_ ? map_->height() : 0; }
  bool is_changed(int y) const { return place_[index(y)] >= 0; }
  std::span<const Rgb> row(int y) const {
    const int place = place_[index(y)];
    if (place < 0) return map_->row(y);
    return changed_[static_cast<std::size_t>(place)];
  }
  const Rgb& at(int x, int y) const {
    assert(x >= 0 && x < width());
    return row(y)[static_cast<std::size_t>(x)];
  }
  std::span<Rgb> row_to_change(int y) {
    int& place = place_[index(y)];
    if (place < 0) {
      place = used_++;
      if (changed_.size() < static_cast<std::size_t>(used_)) changed_.emplace_back();
      changed_[static_cast<std::size_t>(place)].assign(map_->row(y).begin(), map_->row(y).end());
    }
    return changed_[static_cast<std::size_t>(place)];
  }
  Image<Rgb> whole() const {
    Image<Rgb> out(width(), height());
    for (int y = 0; y < height(); ++y) std::ranges::copy(row(y), out.row(y).begin());
    return out;
  }

 private:
  std::size_t index(int y) const {
    assert(y >= 0 && y < height());
    return static_cast<std::size_t>(y);
  }

  const Image<Rgb>* map_ = nullptr;
  std::vector<int> place_;  // by row: in changed_, or -1
  std::vector<std::vector<Rgb>> changed_;
  int used_ = 0;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
