// What the dissertation's coders of stills and of video share: blocks of 8x8 by cosines, steps that
// follow the exponents, and bits to or from a stream by one code path, so that both sides agree.
// source: ITU-T T.81; Xu 2005, chapter 4
// threads: thread-bound
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "codec/range_coder.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

inline constexpr int kBlock = 8;

/// Rows one after another.
using DctBlock = std::array<float, 64>;
using QuantiserTable = std::array<int, 64>;

/// ITU-T T.81, tables K.1 and K.2 (Xu 2005, equation 4.5).
extern const QuantiserTable kLuminanceSteps, kColourSteps;

/// How many times the table's steps a quality of 1..100 takes, as JPEG's.
float table_scale(int quality);

/// The step of coefficient `index`.
float quantiser(const QuantiserTable& table, float scale, int index);

/// By how much steps are divided in a block of these exponents, smallest and largest: an error of
/// the base is one of a larger value where exponents differ.
/// source: Xu 2005, equation 4.7
inline float finer_where_exponents_differ(int low, int high) {
  return high == low ? 1.f : static_cast<float>((high - low + 3) / 2);
}

/// out = A in A^T with the cosines A, or with the transpose of A.
DctBlock transformed(const DctBlock& in, bool inverse);

/// The order of diagonals.
const std::array<int, 64>& zigzag();

struct BlockModels {
  std::array<NumberModel, 64> coefficient;
  // Is the coefficient at this place the last that is not zero?
  std::array<BitModel, 64> last;
  BitModel empty;
};

class BitWriter {
 public:
  bool bit(BitModel& m, bool v) {
    range_.bit(m, v);
    return v;
  }
  int number(NumberModel& m, int v) {
    m.encode(range_, v);
    return v;
  }
  std::vector<unsigned char> finish() { return std::move(range_).finish(); }
  static constexpr bool kWrites = true;

 private:
  RangeEncoder range_;
};

class BitReader {
 public:
  explicit BitReader(std::span<const unsigned char> bytes) : range_(bytes) {}
  bool bit(BitModel& m, bool) { return range_.bit(m); }
  int number(NumberModel& m, int) { return m.decode(range_); }
  static constexpr bool kWrites = false;

 private:
  RangeDecoder range_;
};

/// In: coefficients (writing), any (reading); afterwards what a reader gets. `step_of` gives the
/// step of a coefficient.
template <class Stream>
void code_block(Stream& stream, BlockModels& models, DctBlock& block, const auto& step_of) {
  std::array<int, 64> values{};
  int last = -1;
  if constexpr (Stream::kWrites)
    for (int k = 0; k < 64; ++k) {
      const int i = zigzag()[static_cast<std::size_t>(k)];
      const int v = static_cast<int>(std::lround(block[static_cast<std::size_t>(i)] / step_of(i)));
      values[static_cast<std::size_t>(k)] = v;
      if (v != 0) last = k;
    }
  block.fill(0);
  if (stream.bit(models.empty, last < 0)) return;
  for (std::size_t k = 0; k < 64; ++k) {
    const int v = stream.number(models.coefficient[k], values[k]);
    const int i = zigzag()[k];
    block[static_cast<std::size_t>(i)] = static_cast<float>(v) * step_of(i);
    if (v != 0 && stream.bit(models.last[k], static_cast<int>(k) == last)) return;
  }
}

}  // namespace penumbra::codec
#pragma GCC visibility pop
