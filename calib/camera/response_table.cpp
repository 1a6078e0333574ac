#include "calib/camera/response_table.h"

#include <bit>
#include <cmath>
#include <cstdint>

namespace penumbra {

namespace {

// Buckets of equal relative width from 2^-40 to 1: the upper bits of the float are the index.
constexpr int kShift = 23 - 9;  // 512 buckets an octave
constexpr float kFaintest = 0x1p-40f;
const std::uint32_t kFirstBits = std::bit_cast<std::uint32_t>(kFaintest) >> kShift;
const std::uint32_t kLastBits = std::bit_cast<std::uint32_t>(1.f) >> kShift;

// Fractional codes of linear values by inverting the table with linear interpolation; of values
// that rise, so that the table is walked through once.
class RisingCodes {
 public:
  explicit RisingCodes(const std::vector<float>& decode)
      : decode_(decode), above_(decode.begin()) {}
  float operator()(float linear) {
    while (above_ != decode_.end() && *above_ < linear) ++above_;
    if (above_ == decode_.begin()) return 0;
    if (above_ == decode_.end()) return static_cast<float>(decode_.size() - 1);
    const float high = *above_, low = *(above_ - 1);
    const float within = high > low ? (linear - low) / (high - low) : 1;
    return static_cast<float>(above_ - decode_.begin() - 1) + within;
  }

 private:
  const std::vector<float>& decode_;
  // The first value that is not below the last one asked for.
  std::vector<float>::const_iterator above_;
};

}  // namespace

ResponseTable::ResponseTable(const std::array<std::vector<float>, 3>& decode, float black_level)
    : black_(black_level), decode_(decode) {
  for (std::size_t c = 0; c < 3; ++c) {
    RisingCodes edges(decode[c]);
    encode_[c].reserve(kLastBits - kFirstBits + 2);
    for (std::uint32_t bits = kFirstBits; bits <= kLastBits + 1; ++bits)
      encode_[c].push_back(edges(std::bit_cast<float>(bits << kShift)));
    if (decode[c].size() == 256) {
      const std::uint32_t last = std::bit_cast<std::uint32_t>(1.f) >> kShift8;
      RisingCodes middles(decode[c]);
      encode8_[c].resize(last - kFirst8);
      for (std::uint32_t i = 0; i < last - kFirst8; ++i) {
        const float middle =
            std::bit_cast<float>(((kFirst8 + i) << kShift8) | (1u << (kShift8 - 1)));
        encode8_[c][i] = static_cast<std::uint8_t>(middles(middle) + .5f);
      }
    }
    for (float& v : decode_[c]) v -= black_level;
  }
}

unsigned ResponseTable::encode(int channel, float linear) const {
  const std::vector<float>& codes = encode_[static_cast<std::size_t>(channel)];
  const float x = linear + black_;
  if (!(x > 0)) return 0;  // NaN too
  if (x >= 1) return largest_code();
  if (x < kFaintest) return static_cast<unsigned>(codes[0] * (x / kFaintest) + .5f);
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(x);
  const std::size_t bucket = (bits >> kShift) - kFirstBits;
  const float within = static_cast<float>(bits & ((1u << kShift) - 1)) * (1.f / (1u << kShift));
  return static_cast<unsigned>(codes[bucket] + (codes[bucket + 1] - codes[bucket]) * within + .5f);
}

}  // namespace penumbra
