#include <cassert>

#include "lighting/sh/rotation.h"

namespace penumbra::lighting {

namespace {

constexpr int matrices_before(int l) {
  return l * (2 * l - 1) * (2 * l + 1) / 3;
}

// Index of D^l_{mn} in the packed storage: the matrices of all lower bands stand before it.
constexpr int entry_index(int l, int m, int n) {
  return matrices_before(l) + (m + l) * (2 * l + 1) + (n + l);
}

struct Builder {
  std::span<double> d;
  double at(int l, int m, int n) const { return d[static_cast<std::size_t>(entry_index(l, m, n))]; }

  // P of Ivanic & Ruedenberg 1996, table 2.
  double p(int i, int l, int a, int b) const {
    if (b == l) return at(1, i, 1) * at(l - 1, a, l - 1) - at(1, i, -1) * at(l - 1, a, -l + 1);
    if (b == -l) return at(1, i, 1) * at(l - 1, a, -l + 1) + at(1, i, -1) * at(l - 1, a, l - 1);
    return at(1, i, 0) * at(l - 1, a, b);
  }
  double v(int l, int m, int n) const {
    if (m == 0) return p(1, l, 1, n) + p(-1, l, -1, n);
    if (m > 0)
      return p(1, l, m - 1, n) * std::sqrt(m == 1 ? 2. : 1.) - (m == 1 ? 0. : p(-1, l, -m + 1, n));
    return (m == -1 ? 0. : p(1, l, m + 1, n)) + p(-1, l, -m - 1, n) * std::sqrt(m == -1 ? 2. : 1.);
  }
  double w(int l, int m, int n) const {
    if (m > 0) return p(1, l, m + 1, n) + p(-1, l, -m - 1, n);
    return p(1, l, m - 1, n) - p(-1, l, -m + 1, n);
  }
  double entry(int l, int m, int n) const {
    const int am = std::abs(m);
    const double denominator = std::abs(n) < l ? (l + n) * (l - n) : 2. * l * (2 * l - 1);
    const double cu = std::sqrt((l + m) * (l - m) / denominator);
    const double cv = .5 * std::sqrt((m == 0 ? 2. : 1.) * (l + am - 1) * (l + am) / denominator) *
                      (m == 0 ? -1 : 1);
    const double cw = m == 0 ? 0 : -.5 * std::sqrt((l - am - 1.) * (l - am) / denominator);
    // A coefficient of zero also marks a term whose indices leave the lower band.
    return (cu != 0 ? cu * p(0, l, m, n) : 0) + (cv != 0 ? cv * v(l, m, n) : 0) +
           (cw != 0 ? cw * w(l, m, n) : 0);
  }
};

}  // namespace

ShRotation::ShRotation(const glm::dmat3& rotation, int bands) : bands_(bands) {
  assert(bands >= 1 && bands <= kMaxBands);
  bands_matrices_[0] = 1;
  if (bands == 1) return;
  constexpr int axis[3] = {1, 2, 0};  // m = -1, 0, 1 are y, z, x
  for (int m = -1; m <= 1; ++m)
    for (int n = -1; n <= 1; ++n)
      bands_matrices_[static_cast<std::size_t>(entry_index(1, m, n))] =
          rotation[axis[n + 1]][axis[m + 1]];  // GLM is column-major: [column][row]
  const Builder build{bands_matrices_};
  for (int l = 2; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      for (int n = -l; n <= l; ++n)
        bands_matrices_[static_cast<std::size_t>(entry_index(l, m, n))] = build.entry(l, m, n);
}

double ShRotation::entry(int l, int m, int n) const {
  return bands_matrices_[static_cast<std::size_t>(entry_index(l, m, n))];
}

void ShRotation::apply(std::span<const Rgb> in, std::span<Rgb> out) const {
  assert(in.size() <= static_cast<std::size_t>(coefficient_count(bands_)));
  for (int l = 0; static_cast<std::size_t>(coefficient_count(l)) < in.size(); ++l)
    for (int m = -l; m <= l; ++m) {
      double sum[3] = {};
      for (int n = -l; n <= l; ++n) {
        const Rgb& c = in[static_cast<std::size_t>(sh_index(l, n))];
        const double d = entry(l, m, n);
        for (int k = 0; k < 3; ++k) sum[k] += d * c[k];
      }
      out[static_cast<std::size_t>(sh_index(l, m))] = {
          static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
    }
}

}  // namespace penumbra::lighting
