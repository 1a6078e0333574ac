#include "bench/eigen_relight.h"

#include <Eigen/Core>

#include "core/threads/parallel.h"

namespace penumbra::bench {

namespace {
constexpr Eigen::Index kCoefficients = 25;
}

struct EigenRelight::Matrices {
  Eigen::Matrix<float, Eigen::Dynamic, kCoefficients> transfer;
  Eigen::Matrix<float, kCoefficients, 3> light;
  Eigen::Matrix<float, Eigen::Dynamic, 3> radiance;
};

EigenRelight::EigenRelight(std::span<const float> transfer, std::span<const float> light)
    : matrices_(std::make_unique<Matrices>()) {
  const auto points = static_cast<Eigen::Index>(transfer.size()) / kCoefficients;
  matrices_->transfer = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, kCoefficients>>(
      transfer.data(), points, kCoefficients);
  matrices_->light =
      Eigen::Map<const Eigen::Matrix<float, kCoefficients, 3, Eigen::RowMajor>>(light.data());
  matrices_->radiance.resize(points, 3);
}
EigenRelight::~EigenRelight() = default;

bool EigenRelight::missing() {
#ifdef __x86_64__
  return !(__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"));
#else
  return false;
#endif
}

void EigenRelight::run() {
  constexpr Eigen::Index kRows = 2048;
  Matrices& m = *matrices_;
  parallel_for(Eigen::Index{0}, m.transfer.rows(), kRows, [&](const auto& rows) {
    const auto size = static_cast<Eigen::Index>(rows.size());
    m.radiance.middleRows(rows.begin(), size).noalias() =
        m.transfer.middleRows(rows.begin(), size) * m.light;
  });
}

std::span<const float> EigenRelight::radiance() const {
  return {matrices_->radiance.data(), static_cast<std::size_t>(matrices_->radiance.size())};
}

}  // namespace penumbra::bench
