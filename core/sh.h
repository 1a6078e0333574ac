// Spherical-harmonic vectors that do not mix: radiance, irradiance and transfer are different
// types.
// threads: plain values
#pragma once

#include <array>
#include <cassert>
#include <span>

#include "core/conventions.h"
#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra {

/// B*B RGB coefficients in the order of conventions.h; no heap, so it can be passed per frame.
template <class Tag>
class ShRgb {
 public:
  explicit ShRgb(int bands = 1) : bands_(bands) { assert(bands >= 1 && bands <= kMaxBands); }

  int bands() const { return bands_; }
  int size() const { return coefficient_count(bands_); }
  Rgb& operator[](int n) {
    assert(n >= 0 && n < size());
    return terms_[static_cast<std::size_t>(n)];
  }
  const Rgb& operator[](int n) const {
    assert(n >= 0 && n < size());
    return terms_[static_cast<std::size_t>(n)];
  }
  std::span<const Rgb> terms() const { return {terms_.data(), static_cast<std::size_t>(size())}; }
  std::span<Rgb> terms() { return {terms_.data(), static_cast<std::size_t>(size())}; }

  /// The same function with fewer bands, or with zeros in the new ones.
  ShRgb with_bands(int bands) const {
    ShRgb out(bands);
    for (int n = 0; n < out.size() && n < size(); ++n) out[n] = (*this)[n];
    return out;
  }
  friend bool operator==(const ShRgb&, const ShRgb&) = default;

 private:
  int bands_;
  std::array<Rgb, kMaxCoefficients> terms_{};
};

using RadianceSh = ShRgb<struct RadianceShTag>;
using IrradianceSh = ShRgb<struct IrradianceShTag>;
using TransferSh = ShRgb<struct TransferShTag>;

}  // namespace penumbra
#pragma GCC visibility pop
