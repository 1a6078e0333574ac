// Transfer as sums of few patterns.
// threads: const members reentrant
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/sh.h"
#include "core/threads/parallel.h"
#include "prt/transfer/relight.h"
#include "prt/transfer/transfer.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// A transfer, or two over the same points, as sums of few patterns over these points: their
/// principal components. Light reaches a surface from one side of it, and what stands on a floor
/// from above: half of the coefficients nearly follow from the others.
/// source: Sloan, Hall, Hart & Snyder 2003, "Clustered Principal Components for Precomputed
/// Radiance Transfer", with one cluster and no mean.
/// threads: const members reentrant
class TransferPca {
 public:
  /// As few as keep the error of each below `error`: RMS over points and over directions of a small
  /// light, as a fraction of what a surface that faces the light sends back.
  /// in: finite values; `second` of as many points as `first`, or of none
  TransferPca(const Transfer& first, const Transfer& second, double error);

  /// Patterns of both, and of the first alone.
  int count() const { return parts_[0].count + parts_[1].count; }
  int first_count() const { return parts_[0].count; }
  std::size_t bytes() const { return values_.size() * sizeof(values_[0]); }
  /// As prt::relight of the first under `light` plus, where it is given, of the second under
  /// `more`. Lights of few bands cost as much as others.
  /// out: exactly 3 * stride floats
  void relight(const RadianceSh& light, const RadianceSh* more, std::span<float> out) const;
  /// Of the second alone.
  void relight_second(const RadianceSh& light, std::span<float> out) const;

 private:
  struct PcaPart {
    int count = 0, coefficients = 0;
    std::vector<float> mix{};  // [pattern][coefficient]

    // Three of `weights` for each pattern; returns where the next part's begin.
    float* weigh(const RadianceSh& light, float* weights) const;
  };
  std::array<PcaPart, 2> parts_;
  int channels_ = 1;
  std::vector<std::uint16_t> values_;  // half floats, BlockedRows
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
