#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "core/conventions.h"
#include "core/half.h"
#include "core/threads/parallel.h"
#include "prt/transfer/internal/blocked_rows.h"
#include "prt/transfer/transfer.h"
#include "prt/transfer/transfer_pca.h"

namespace penumbra::prt {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::MatrixXf;

// A transfer's coefficients by strips: blocks of points, channel by channel. One channel serves as
// three where there are to be so many.
class Strips {
 public:
  Strips(const Transfer& t, int channels)
      : transfer_(t), channels_(static_cast<std::size_t>(channels)) {}

  int coefficients() const {
    return transfer_.points == 0 ? 0 : coefficient_count(transfer_.bands);
  }
  // A line of the matrix for each point; the padding is zero.
  void read(std::size_t strip, MatrixXf& points) const {
    points.resize(kBlock, coefficients());
    const int channel = transfer_.channels == 1 ? 0 : static_cast<int>(strip % channels_);
    for (int n = 0; n < coefficients(); ++n) {
      const std::uint16_t* const values =
          &transfer_.values[transfer_.index(channel, n, strip / channels_ * kBlock)];
      for (std::size_t i = 0; i < kBlock; ++i)
        points(static_cast<Index>(i), n) = float_from_half(values[i]);
    }
  }
  // Mean products of each two coefficients.
  MatrixXd moments() const {
    constexpr std::size_t kParts = 16;
    std::array<MatrixXd, kParts> sums;
    const std::size_t strips = transfer_.stride / kBlock * channels_;
    parallel_for(std::size_t{0}, kParts, [&](std::size_t part) {
      MatrixXf points, sum;
      sums[part].setZero(coefficients(), coefficients());
      for (std::size_t strip = part; strip < strips; strip += kParts) {
        read(strip, points);
        sum.noalias() = points.transpose() * points;
        sums[part] += sum.cast<double>();
      }
    });
    for (std::size_t part = 1; part < kParts; ++part) sums[0] += sums[part];
    return sums[0] / static_cast<double>(std::max<std::size_t>(transfer_.points, 1) * channels_);
  }

 private:
  const Transfer& transfer_;
  std::size_t channels_;
};

// A light of irradiance 1 from direction w has the coefficients Y_n(w), whose products are in the
// mean over all directions 1/(4 pi) for n = m, else 0; what faces it sends back 1/pi.
double error_without(double moment) {
  return kPi * std::sqrt(std::max(0., moment) / (4 * kPi));
}

// A column for each of the fewest orthogonal mixtures of coefficients that leave less than `error`,
// strongest first.
MatrixXf principal(const MatrixXd& moments, double error) {
  if (moments.size() == 0) return {};
  const Eigen::SelfAdjointEigenSolver<MatrixXd> found(moments);
  assert(found.info() == Eigen::Success && found.eigenvalues().allFinite());
  Index kept = moments.cols();
  for (double left = 0; kept > 0; --kept) {  // eigenvalues grow
    left += found.eigenvalues()(moments.cols() - kept);
    if (error_without(left) > error) break;
  }
  return found.eigenvectors().rightCols(kept).rowwise().reverse().cast<float>();
}

}  // namespace

TransferPca::TransferPca(const Transfer& first, const Transfer& second, double error) {
  assert(second.points == 0 || second.points == first.points);
  assert(first.stride % kBlock == 0);
  channels_ = std::max(first.channels, second.channels);
  const std::array<Strips, 2> strips{Strips(first, channels_), Strips(second, channels_)};
  std::array<MatrixXf, 2> patterns;
  for (std::size_t i = 0; i < 2; ++i) {
    patterns[i] = principal(strips[i].moments(), error);
    parts_[i].coefficients = strips[i].coefficients();
    parts_[i].count = static_cast<int>(patterns[i].cols());
    parts_[i].mix.assign(patterns[i].data(), patterns[i].data() + patterns[i].size());
  }
  const std::size_t count = first.stride / kBlock * static_cast<std::size_t>(channels_);
  values_.resize(count * static_cast<std::size_t>(this->count()) * kBlock);
  parallel_for(std::size_t{0}, count, 16, [&](const auto& some) {
    MatrixXf points, here;
    auto* to = values_.data() + some.begin() * static_cast<std::size_t>(this->count()) * kBlock;
    for (std::size_t strip = some.begin(); strip != some.end(); ++strip)
      for (std::size_t i = 0; i < 2; ++i) {
        strips[i].read(strip, points);
        here.noalias() = points * patterns[i];
        to = std::transform(here.data(), here.data() + here.size(), to, half_from_float);
      }
  });
}

float* TransferPca::PcaPart::weigh(const RadianceSh& light, float* weights) const {
  const float* from = mix.data();
  for (int k = 0; k < count; ++k, from += coefficients, weights += 3)
    for (int n = 0; n < std::min(light.size(), coefficients); ++n)
      for (int c = 0; c < 3; ++c) weights[c] += from[n] * light[n][c];
  return weights;
}

void TransferPca::relight(const RadianceSh& light, const RadianceSh* more,
                          std::span<float> out) const {
  std::array<float, 3 * 2 * kMaxCoefficients> weights{};
  float* const others = parts_[0].weigh(light, weights.data());
  if (more) parts_[1].weigh(*more, others);
  sum_rows({values_, count(), channels_}, 0, more ? count() : first_count(), weights, out);
}

void TransferPca::relight_second(const RadianceSh& light, std::span<float> out) const {
  std::array<float, 3 * kMaxCoefficients> weights{};
  parts_[1].weigh(light, weights.data());
  sum_rows({values_, count(), channels_}, first_count(), parts_[1].count, weights, out);
}

}  // namespace penumbra::prt
