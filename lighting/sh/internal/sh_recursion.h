// The one evaluation of the basis, for a double or for a block of floats.
#pragma once

#include <cmath>

#include "core/conventions.h"

namespace penumbra::lighting {

/// Constants of the fully normalised recursion Q_l^m = a (z Q_{l-1}^m - b Q_{l-2}^m), where
/// Y_lm = sqrt2 Q_l^|m| * {Re, Im}(x + iy)^|m| and Q_m^m is a constant.
struct RecursionTable {
  double sectoral[kMaxBands]{};
  double a[kMaxBands][kMaxBands]{}, b[kMaxBands][kMaxBands]{};

  RecursionTable() {
    sectoral[0] = std::sqrt(1 / (4 * kPi));
    for (int m = 1; m < kMaxBands; ++m)
      sectoral[m] = sectoral[m - 1] * std::sqrt((2. * m + 1) / (2. * m));
    for (int m = 0; m < kMaxBands; ++m)
      for (int l = m + 1; l < kMaxBands; ++l) {
        const double l2 = double(l) * l, k2 = double(l - 1) * (l - 1), m2 = double(m) * m;
        a[l][m] = std::sqrt((4 * l2 - 1) / (l2 - m2));
        b[l][m] = l == m + 1 ? 0 : std::sqrt((k2 - m2) / (4 * k2 - 1));
      }
  }
};

inline const RecursionTable& recursion_table() {
  static const RecursionTable table;
  return table;
}

/// emit(n, value) is called once for every n < bands^2. V needs V + V, V - V, V * V and V * Scalar.
template <class V, class Scalar, class Emit>
inline void evaluate_recursion(int bands, const V& x, const V& y, const V& z, const V& one,
                               Emit emit) {
  const RecursionTable& t = recursion_table();
  const auto sqrt2 = static_cast<Scalar>(std::numbers::sqrt2);
  V re = one, im = one - one;  // (x + iy)^m
  for (int m = 0; m < bands; ++m) {
    V previous = one - one;
    V current = one * static_cast<Scalar>(t.sectoral[m]);
    for (int l = m; l < bands; ++l) {
      if (m == 0) {
        emit(sh_index(l, 0), current);
      } else {
        emit(sh_index(l, m), current * re * sqrt2);
        emit(sh_index(l, -m), current * im * sqrt2);
      }
      if (l + 1 < bands) {
        const V next = (z * current - previous * static_cast<Scalar>(t.b[l + 1][m])) *
                       static_cast<Scalar>(t.a[l + 1][m]);
        previous = current;
        current = next;
      }
    }
    const V turned = re * x - im * y;
    im = re * y + im * x;
    re = turned;
  }
}

}  // namespace penumbra::lighting
