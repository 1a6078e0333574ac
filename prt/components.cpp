#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "core/conventions.h"
#include "core/half.h"
#include "prt/prt.h"
#include "prt/relight.h"

namespace penumbra::prt {

namespace {

constexpr std::size_t kPart = 1024;  // points

// f(channel, first point, values: a row for each point) for all points, few at a time.
template <class F>
void each_part(const Transfer& t, F f) {
  const int coefficients = coefficient_count(t.bands);
  Eigen::MatrixXf part;
  for (int c = 0; c < t.channels; ++c)
    for (std::size_t first = 0; first < t.points; first += kPart) {
      const std::size_t count = std::min(kPart, t.points - first);
      part.resize(static_cast<Eigen::Index>(count), coefficients);
      for (int n = 0; n < coefficients; ++n)
        for (std::size_t i = 0; i < count; ++i)
          part(static_cast<Eigen::Index>(i), n) = t.value(c, n, first + i);
      f(c, first, part);
    }
}

// Mean products of each two coefficients.
Eigen::MatrixXd moments_of(const Transfer& t) {
  const int coefficients = coefficient_count(t.bands);
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(coefficients, coefficients);
  each_part(t, [&](int, std::size_t, const Eigen::MatrixXf& part) {
    sum += (part.transpose() * part).cast<double>();
  });
  return sum / static_cast<double>(std::max<std::size_t>(t.points, 1) *
                                   static_cast<std::size_t>(t.channels));
}

// A light of irradiance 1 from direction w has the coefficients Y_n(w), whose products are in the mean over all
// directions 1/(4 pi) for n = m, else 0; what faces it sends back 1/pi.
double error_without(double moment) {
  return kPi * std::sqrt(std::max(0., moment) / (4 * kPi));
}

}  // namespace

TransferComponents::TransferComponents(const Transfer& transfer, double error)
    : coefficients_(coefficient_count(transfer.bands)),
      channels_(transfer.channels),
      stride_(transfer.stride) {
  if (coefficients_ == 0 || transfer.points == 0) return;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> found(moments_of(transfer));
  assert(found.info() == Eigen::Success && found.eigenvalues().allFinite());
  double left = 0;
  for (count_ = coefficients_; count_ > 1; --count_) {  // eigenvalues grow
    left += found.eigenvalues()(coefficients_ - count_);
    if (error_without(left) > error) break;
  }
  const Eigen::MatrixXf mix =
      found.eigenvectors().rightCols(count_).rowwise().reverse().cast<float>();
  mix_.assign(mix.data(), mix.data() + mix.size());
  const auto count = static_cast<std::size_t>(count_);
  values_.assign(static_cast<std::size_t>(channels_) * count * stride_, 0);
  each_part(transfer, [&](int c, std::size_t first, const Eigen::MatrixXf& part) {
    const Eigen::MatrixXf here = part * mix;
    for (std::size_t k = 0; k < count; ++k)
      for (Eigen::Index i = 0; i < here.rows(); ++i)
        values_[(static_cast<std::size_t>(c) * count + k) * stride_ + first +
                static_cast<std::size_t>(i)] =
            half_from_float(here(i, static_cast<Eigen::Index>(k)));
  });
}

void TransferComponents::relight(const RadianceSh& light, std::span<float> out) const {
  const int known = std::min(light.size(), coefficients_);
  std::array<float, 3 * kMaxCoefficients> weights{};
  for (int k = 0; k < count_; ++k)
    for (int n = 0; n < known; ++n)
      for (int c = 0; c < 3; ++c)
        weights[static_cast<std::size_t>(3 * k + c)] +=
            mix_[static_cast<std::size_t>(k * coefficients_ + n)] * light[n][c];
  prt::relight(Rows{values_, stride_, channels_}, count_, weights, out);
}

}  // namespace penumbra::prt
