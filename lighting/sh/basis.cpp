#include <algorithm>

#include "lighting/sh/basis.h"
#include "lighting/sh/internal/sh_recursion.h"
#include "lighting/sh/irradiance.h"

namespace penumbra::lighting {

namespace {

// Sixteen floats with element-wise arithmetic that the compiler turns into vector instructions.
struct FloatBlock {
  float v[kBasisLanes];

  friend FloatBlock operator+(const FloatBlock& a, const FloatBlock& b) {
    FloatBlock out;
    for (int i = 0; i < kBasisLanes; ++i) out.v[i] = a.v[i] + b.v[i];
    return out;
  }
  friend FloatBlock operator-(const FloatBlock& a, const FloatBlock& b) {
    FloatBlock out;
    for (int i = 0; i < kBasisLanes; ++i) out.v[i] = a.v[i] - b.v[i];
    return out;
  }
  friend FloatBlock operator*(const FloatBlock& a, const FloatBlock& b) {
    FloatBlock out;
    for (int i = 0; i < kBasisLanes; ++i) out.v[i] = a.v[i] * b.v[i];
    return out;
  }
  friend FloatBlock operator*(const FloatBlock& a, float k) {
    FloatBlock out;
    for (int i = 0; i < kBasisLanes; ++i) out.v[i] = a.v[i] * k;
    return out;
  }
};

}  // namespace

void evaluate_basis(int bands, const glm::dvec3& d, std::span<double> out) {
  evaluate_recursion<double, double>(bands, d.x, d.y, d.z, 1.0, [&](int n, double value) {
    out[static_cast<std::size_t>(n)] = value;
  });
}

void evaluate_basis_block(int bands, const float* x, const float* y, const float* z, float* out) {
  FloatBlock bx, by, bz, one;
  for (int i = 0; i < kBasisLanes; ++i) {
    bx.v[i] = x[i];
    by.v[i] = y[i];
    bz.v[i] = z[i];
    one.v[i] = 1;
  }
  evaluate_recursion<FloatBlock, float>(
      bands, bx, by, bz, one, [&](int n, const FloatBlock& value) {
        std::copy(value.v, value.v + kBasisLanes, out + n * kBasisLanes);
      });
}

Rgb evaluate(const RadianceSh& light, const glm::dvec3& direction) {
  double basis[kMaxCoefficients];
  evaluate_basis(light.bands(), direction, basis);
  double sum[3] = {};
  for (int n = 0; n < light.size(); ++n)
    for (int c = 0; c < 3; ++c) sum[c] += basis[n] * light[n][c];
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

double cosine_coefficient(int l) {
  if (l == 0) return kPi;
  if (l == 1) return 2 * kPi / 3;
  if (l % 2 == 1) return 0;
  // A_l = 2 pi (-1)^(l/2 - 1) / ((l + 2)(l - 1)) * l! / (2^l ((l/2)!)^2)
  double central = 1;  // binomial(l, l/2) / 2^l
  for (int k = 1; k <= l / 2; ++k) central *= (2. * k - 1) / (2. * k);
  return 2 * kPi * (l / 2 % 2 == 1 ? 1 : -1) / ((l + 2.) * (l - 1.)) * central;
}

IrradianceSh irradiance(const RadianceSh& light) {
  IrradianceSh out(light.bands());
  for (int l = 0; l < light.bands(); ++l)
    for (int m = -l; m <= l; ++m)
      out[sh_index(l, m)] = light[sh_index(l, m)] * static_cast<float>(cosine_coefficient(l));
  return out;
}

Rgb evaluate(const IrradianceSh& irradiance, const glm::dvec3& normal) {
  RadianceSh same(irradiance.bands());
  std::ranges::copy(irradiance.terms(), same.terms().begin());
  return evaluate(same, normal);
}

}  // namespace penumbra::lighting
