// Sensor codes and linear signal, tabulated: what the merge decodes and the compositor encodes with.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace penumbra {

/// Sensor code <-> linear signal in fractions of full scale, tabulated for one bit depth.
/// source: the camera's inverse response, sampled at every code
class CodeCurve {
 public:
  /// decode[c][code] = linear signal of that code, 2^bits values each, non-decreasing; `black_level` in
  /// fractions of full scale is taken off after decoding and put back before encoding.
  CodeCurve(const std::array<std::vector<float>, 3>& decode, float black_level);

  float decode(int channel, unsigned code) const {
    return decode_[static_cast<std::size_t>(channel)][code];
  }
  unsigned encode(int channel, float linear) const;
  unsigned largest_code() const { return static_cast<unsigned>(decode_[0].size()) - 1; }

 private:
  float black_;
  std::array<std::vector<float>, 3> decode_;
  std::array<std::vector<float>, 3> encode_;  // code at the edges of logarithmic buckets
};

}  // namespace penumbra
