// Borders of a light map's charts: places of one surface that stand in it twice.
// threads: free of shared state; const members reentrant
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "prt/clip/light_map.h"
#include "prt/geometry/animation.h"

namespace penumbra::prt {

/// What bilinear lookups on the two sides of an edge show differs by noise and by where the texels
/// lie. Texels along it are changed by as little as makes the two meet.
/// source: least squares over the lookups' weights as in Iwanicki 2013, Lighting Technology of "The
/// Last of Us"
class Seams {
 public:
  /// Creases of the surface, where light really differs, are none.
  Seams(const Character& character, const SurfaceLayout& layout);

  bool empty() const { return lookups_.empty(); }
  /// Values of all of the layout's points, one map after another `stride` apart. Points for which
  /// `hidden` is not 0 neither change nor pull.
  void equalise(std::span<const char> hidden, std::size_t stride, std::span<float> maps) const;

 private:
  // Of one place, seen from both sides: 0 = sum of weights times values.
  struct Lookup {
    std::array<std::uint32_t, 8> point;
    std::array<float, 8> weight;
  };
  std::vector<Lookup> lookups_;
  std::vector<std::uint32_t> points_;  // that lookups touch
  // By point: where it stands in points_, or SurfaceLayout::kNone
  std::vector<std::uint32_t> variable_;
};

}  // namespace penumbra::prt
