// Filling what a camera does not see, with everything that depends on the hole alone done once.
// threads: const members reentrant
#pragma once

#include <Eigen/Cholesky>

#include "core/image.h"
#include "lighting/sh/projection.h"

namespace penumbra::lighting {

/// Weighted least squares on nine bands with the smoothness penalty, for one confidence map.
class ShInpainting {
 public:
  explicit ShInpainting(const Image<float>& confidence);

  const Image<float>& confidence() const { return confidence_; }
  double coverage() const { return coverage_; }
  /// Unseen part of a level floor's view of the sky, by the cosine.
  double unseen_above() const { return unseen_above_; }
  /// From the moments of the map with its holes black.
  /// errors: kUndetermined (coverage below 2 %)
  Result<ShProjection> fill(const RadianceSh& moments) const;

 private:
  Image<float> confidence_;
  double coverage_ = 0, unseen_above_ = 0;
  Eigen::LDLT<Eigen::MatrixXd> system_;
};

}  // namespace penumbra::lighting
