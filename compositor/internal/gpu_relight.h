// Clips relit by the device that draws.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "compositor/internal/gl.h"
#include "prt/clip/sequence.h"

namespace penumbra::compositor {

/// prt::TransferSequence::relight as a compute shader: the maps stay on the device, each moment's terms go there and the
/// light comes back, since what lights and neighbours add is known on the CPU.
class GpuRelight {
 public:
  /// The sequence must outlive it.
  /// errors: kUnavailable (maps larger than the device's buffers, no compute)
  static Result<GpuRelight> create(const prt::TransferSequence& sequence);

  /// As prt::TransferSequence::relight, but for rounding.
  /// errors: kUnavailable (GL)
  Result<void> relight(double frame, const RadianceSh& light, std::span<const glm::mat3> turns,
                       std::span<float> out);

 private:
  GpuRelight(const prt::TransferSequence& sequence, GlProgram program)
      : sequence_(&sequence), program_(std::move(program)) {}

  const prt::TransferSequence* sequence_;
  GlProgram program_;
  GlBuffer values_, terms_, blocks_, sums_;
  prt::RelightPlan plan_;  // kept for its room
  struct GpuBlock {
    std::uint32_t first_term, end_term, word, unused;
  };
  std::vector<GpuBlock> todo_;
};

}  // namespace penumbra::compositor
