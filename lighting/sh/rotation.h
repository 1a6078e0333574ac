// Rotation of spherical harmonics.
// threads: reentrant
#pragma once

#include <array>
#include <glm/mat3x3.hpp>
#include <span>

#include "core/image.h"
#include "core/sh.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Rotates functions on the sphere: f'(d) = f(R^T d), c' = D(R) c.
/// source: Ivanic & Ruedenberg 1996 with the 1998 correction
class ShRotation {
 public:
  ShRotation(const glm::dmat3& rotation, int bands);

  int bands() const { return bands_; }
  /// Entry D^l_{mn}, -l <= m, n <= l.
  double entry(int l, int m, int n) const;

  template <class Tag>
  ShRgb<Tag> operator*(const ShRgb<Tag>& c) const {
    ShRgb<Tag> out(c.bands());
    apply(c.terms(), out.terms());
    return out;
  }

 private:
  void apply(std::span<const Rgb> in, std::span<Rgb> out) const;
  int bands_;
  static constexpr int kMaxEntries = kMaxBands * (4 * kMaxBands * kMaxBands - 1) / 3;
  std::array<double, kMaxEntries> bands_matrices_;  // D^0, D^1, ... row by row
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
