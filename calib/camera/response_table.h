// Sensor codes and linear signal, tabulated: what the merge decodes and the compositor encodes
// with.
// threads: const members reentrant
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// Sensor code <-> linear signal in fractions of full scale, tabulated for one bit depth.
/// source: the camera's inverse response, sampled at every code
class ResponseTable {
 public:
  /// decode[c][code] = linear signal of that code, 2^bits values each, non-decreasing;
  /// `black_level` in fractions of full scale is taken off after decoding and put back before
  /// encoding.
  ResponseTable(const std::array<std::vector<float>, 3>& decode, float black_level);

  float decode(int channel, unsigned code) const {
    return decode_[static_cast<std::size_t>(channel)][code];
  }
  /// Nearest code, within a hundredth of a code of the exact rounding point; clamps, and NaN is 0.
  unsigned encode(int channel, float linear) const;
  /// Nearest 8-bit code within a tenth of a code by one lookup; for curves of 8 bits alone.
  std::uint8_t encode8(int channel, float linear) const {
    // NaN becomes the smallest
    const float x = std::min(std::max(kSmallest, linear + black_), kLargest);
    const std::uint32_t bucket = (std::bit_cast<std::uint32_t>(x) >> kShift8) - kFirst8;
    return encode8_[static_cast<std::size_t>(channel)][bucket];
  }
  /// The tables behind `decode` and `encode8` of one channel, for vector code.
  struct Tables8 {
    const float* decode;         // by code, black level taken off
    const std::uint8_t* encode;  // by bucket
    float black;
  };
  Tables8 tables8(int channel) const {
    const auto c = static_cast<std::size_t>(channel);
    return {decode_[c].data(), encode8_[c].data(), black_};
  }
  static constexpr float kSmallest = 0x1p-24f, kLargest = 1 - 0x1p-11f;
  static constexpr int kShift8 = 23 - 10;  // 1024 buckets an octave
  static constexpr std::uint32_t kFirst8 = std::bit_cast<std::uint32_t>(kSmallest) >> kShift8;

  unsigned largest_code() const { return static_cast<unsigned>(decode_[0].size()) - 1; }

 private:
  float black_;
  std::array<std::vector<float>, 3> decode_;
  std::array<std::vector<float>, 3> encode_;          // code at the edges of logarithmic buckets
  std::array<std::vector<std::uint8_t>, 3> encode8_;  // in the middle of finer buckets
};

}  // namespace penumbra
#pragma GCC visibility pop
