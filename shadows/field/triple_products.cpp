#include "shadows/field/internal/triple_products.h"

#include <cmath>

#include "lighting/sh/basis.h"

namespace penumbra::shadows {

TripleProducts::TripleProducts() {
  for (std::size_t s = 0; s < kNodes; ++s) {
    // Fejer's first rule in z = cos theta (Waldvogel 2006); even steps in phi.
    const double theta = kPi * (static_cast<double>(s) + .5) / kNodes;
    const double phi = 2 * kPi * static_cast<double>(s) / kNodes;
    double sum = 1;
    for (int j = 1; j <= kNodes / 2; ++j) sum -= 2 * std::cos(2 * j * theta) / (4. * j * j - 1);
    weight_[s] = 2 * sum / kNodes * (2 * kPi / kNodes);
    double basis[kMaxCoefficients];
    lighting::evaluate_basis(kMaxBands, {std::sin(theta), 0, std::cos(theta)}, basis);
    for (int l = 0; l < kMaxBands; ++l)
      for (int m = -l; m <= l; ++m) {
        const auto n = static_cast<std::size_t>(sh_index(l, m));
        along_[n][s] = basis[sh_index(l, std::abs(m))];
        around_[n][s] = m < 0 ? std::sin(-m * phi) : std::cos(m * phi);
      }
  }
  for (int i = 0; i < kMaxCoefficients; ++i)
    for (int j = 0; j < kMaxValues; ++j)
      for (int k = 0; k < kMaxCoefficients; ++k)
        if (const double v = value(i, j, k); v != 0)
          terms_.push_back({i, j, k, static_cast<float>(v)});
}

double TripleProducts::value(int i, int j, int k) const {
  constexpr double kRounding = 1e-10;
  const auto a = static_cast<std::size_t>(i), b = static_cast<std::size_t>(j),
             c = static_cast<std::size_t>(k);
  double around = 0, along = 0;
  for (std::size_t s = 0; s < kNodes; ++s) around += around_[a][s] * around_[b][s] * around_[c][s];
  if (std::abs(around) < kRounding) return 0;  // most of them
  for (std::size_t s = 0; s < kNodes; ++s)
    along += weight_[s] * along_[a][s] * along_[b][s] * along_[c][s];
  const double product = along * around;
  return std::abs(product) < kRounding ? 0 : product;
}

}  // namespace penumbra::shadows
