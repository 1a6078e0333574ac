// Integrals over the sphere of the products of three spherical harmonics.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/conventions.h"
#include "shadows/field/occlusion_field.h"

namespace penumbra::shadows {

/// Values that a point of an occlusion field holds at most.
inline constexpr int kMaxValues = kMaxFieldBands * kMaxFieldBands;

/// One of the integrals below.
struct TripleTerm {
  int i, j, k;
  float value;
};

/// Int Y_i Y_j Y_k dw over the sphere, with j < kMaxFieldBands^2, i and k < kMaxCoefficients. Y_lm
/// is a function of z times cos m phi or sin m phi, so that it is an integral over z times one over
/// phi; the rules for both are exact for the degrees that occur. Made at the first use, 3 ms.
/// source: Waldvogel 2006 (Fejer's first rule);
/// threads: any
class TripleProducts {
 public:
  static const TripleProducts& get() {
    static const TripleProducts products;
    return products;
  }
  double value(int i, int j, int k) const;
  /// All that are not zero, in ascending i.
  std::span<const TripleTerm> terms() const { return terms_; }

 private:
  static constexpr int kDegree = 2 * (kMaxBands - 1) + kMaxFieldBands - 1;
  static constexpr int kNodes = kDegree + 1;
  using Samples = std::array<double, kNodes>;

  TripleProducts();

  std::array<Samples, kMaxCoefficients> along_, around_;  // the factors of Y_n
  Samples weight_;                                        // of the product of both rules
  std::vector<TripleTerm> terms_;
};

}  // namespace penumbra::shadows
