// Private to track: symmetric matrices of a pose's six numbers.
// threads: plain values
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>

namespace penumbra::calib {

using Vector6 = std::array<double, 6>;

struct Matrix6 {
  std::array<double, 36> m{};  // row by row

  double& operator()(std::size_t r, std::size_t c) { return m[6 * r + c]; }
  double operator()(std::size_t r, std::size_t c) const { return m[6 * r + c]; }

  static Matrix6 diagonal(double turn, double place) {
    Matrix6 out;
    for (std::size_t i = 0; i < 6; ++i) out(i, i) = i < 3 ? turn : place;
    return out;
  }
  Matrix6 transposed() const {
    Matrix6 out;
    for (std::size_t r = 0; r < 6; ++r)
      for (std::size_t c = 0; c < 6; ++c) out(c, r) = (*this)(r, c);
    return out;
  }
  friend Matrix6 operator+(Matrix6 a, const Matrix6& b) {
    for (std::size_t i = 0; i < 36; ++i) a.m[i] += b.m[i];
    return a;
  }
  friend Matrix6 operator-(Matrix6 a, const Matrix6& b) {
    for (std::size_t i = 0; i < 36; ++i) a.m[i] -= b.m[i];
    return a;
  }
  friend Matrix6 operator*(double k, Matrix6 a) {
    for (double& v : a.m) v *= k;
    return a;
  }
  friend Matrix6 operator*(const Matrix6& a, const Matrix6& b) {
    Matrix6 out;
    for (std::size_t r = 0; r < 6; ++r)
      for (std::size_t k = 0; k < 6; ++k)
        for (std::size_t c = 0; c < 6; ++c) out(r, c) += a(r, k) * b(k, c);
    return out;
  }
  friend Vector6 operator*(const Matrix6& a, const Vector6& v) {
    Vector6 out{};
    for (std::size_t r = 0; r < 6; ++r)
      for (std::size_t c = 0; c < 6; ++c) out[r] += a(r, c) * v[c];
    return out;
  }
};

inline double dot(const Vector6& a, const Vector6& b) {
  double sum = 0;
  for (std::size_t i = 0; i < 6; ++i) sum += a[i] * b[i];
  return sum;
}

/// Cholesky's factor L of a = L L^T; nothing where a is not positive definite.
inline std::optional<Matrix6> cholesky(const Matrix6& a) {
  Matrix6 l;
  for (std::size_t c = 0; c < 6; ++c) {
    double left = a(c, c);
    for (std::size_t k = 0; k < c; ++k) left -= l(c, k) * l(c, k);
    if (!(left > 1e-14 * std::abs(a(c, c))) || !std::isfinite(left)) return std::nullopt;
    l(c, c) = std::sqrt(left);
    for (std::size_t r = c + 1; r < 6; ++r) {
      double v = a(r, c);
      for (std::size_t k = 0; k < c; ++k) v -= l(r, k) * l(c, k);
      l(r, c) = v / l(c, c);
    }
  }
  return l;
}

/// x of L L^T x = b.
inline Vector6 solve_by(const Matrix6& l, Vector6 b) {
  for (std::size_t r = 0; r < 6; ++r) {
    for (std::size_t k = 0; k < r; ++k) b[r] -= l(r, k) * b[k];
    b[r] /= l(r, r);
  }
  for (std::size_t r = 6; r-- > 0;) {
    for (std::size_t k = r + 1; k < 6; ++k) b[r] -= l(k, r) * b[k];
    b[r] /= l(r, r);
  }
  return b;
}

inline std::optional<Matrix6> inverse_of(const Matrix6& a) {
  const auto l = cholesky(a);
  if (!l) return std::nullopt;
  Matrix6 out;
  for (std::size_t c = 0; c < 6; ++c) {
    Vector6 unit{};
    unit[c] = 1;
    const Vector6 column = solve_by(*l, unit);
    for (std::size_t r = 0; r < 6; ++r) out(r, c) = column[r];
  }
  return out;
}

}  // namespace penumbra::calib
