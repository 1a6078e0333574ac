// Compression of transfer over time, and its bytes.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/clip/light_map.h"
#include "prt/clip/sequence.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

/// How the points of a stream lie: which share a bone, and which earlier ones a point is like.
struct StreamLayout {
  std::vector<std::uint16_t> bone;                       // by point
  std::vector<std::array<std::uint32_t, 3>> neighbours;  // earlier ones; SurfaceLayout::kNone
  // From here on neighbours are the left one, that above, that between
  std::size_t first_texel = 0;
};
StreamLayout layout_of_surface(const SurfaceLayout& layout);
StreamLayout layout_of_ground(int size);

class SequenceCodec {
 public:
  struct Outcome {
    TransferSequence sequence;
    double error = 0;  // rendered, RMS over points, frames and colours, as rendered_rms
  };
  /// The coarsest step, and the fewest components at it, that keep the rendered error.
  /// in: frames of one shape; error in units of rendered_rms
  static Outcome encode(std::span<const Transfer> frames, const StreamLayout& layout, double error);
  /// Exit radiance of a unit albedo under a light of unit l_0 and mean_band_energy, RMS over
  /// points, frames and colours.
  static double rendered_rms(std::span<const Transfer> frames);

  static std::vector<unsigned char> write(const TransferSequence& sequence,
                                          const StreamLayout& layout);
  /// errors: kUnreadable (damaged: where and what)
  static Result<TransferSequence> read(std::span<const unsigned char> bytes,
                                       const StreamLayout& layout, const std::string& name);

 private:
  class Encoder;
};

}  // namespace penumbra::prt
