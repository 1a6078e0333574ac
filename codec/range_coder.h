// An adaptive binary range coder and a code of whole numbers on top of it.
// source: Martin 1979; the carry and the adaptation by a shift as in Pavlov's LZMA
// threads: thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <utility>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// Probability that the next bit is 0, in 1/4096.
struct BitModel {
  std::uint16_t zero = 2048;
  void saw(bool bit) {
    constexpr int kShift = 5;
    if (bit) {
      zero = static_cast<std::uint16_t>(zero - (zero >> kShift));
    } else {
      zero = static_cast<std::uint16_t>(zero + ((4096 - zero) >> kShift));
    }
  }
};

class RangeEncoder {
 public:
  void bit(BitModel& model, bool value) {
    const std::uint32_t bound = (range_ >> 12) * model.zero;
    if (value) {
      low_ += bound;
      range_ -= bound;
    } else {
      range_ = bound;
    }
    model.saw(value);
    normalise();
  }
  void raw_bit(bool value) {
    range_ >>= 1;
    if (value) low_ += range_;
    normalise();
  }
  std::vector<unsigned char> finish() && {
    for (int i = 0; i < 5; ++i) shift();
    return std::move(out_);
  }

 private:
  void normalise() {
    while (range_ < (1u << 24)) {
      range_ <<= 8;
      shift();
    }
  }
  void shift() {
    if (low_ < 0xff000000ull || low_ > 0xffffffffull) {
      const auto carry = static_cast<unsigned char>(low_ >> 32);
      out_.push_back(static_cast<unsigned char>(cache_ + carry));
      while (--pending_ > 0) out_.push_back(static_cast<unsigned char>(0xff + carry));
      cache_ = static_cast<unsigned char>(low_ >> 24);
    }
    ++pending_;
    low_ = (low_ & 0x00ffffffull) << 8;
  }
  std::uint64_t low_ = 0;
  std::uint32_t range_ = 0xffffffffu;
  unsigned char cache_ = 0;
  std::uint64_t pending_ = 1;  // the first byte is always 0
  std::vector<unsigned char> out_;
};

/// Reads zeros beyond the end: any bytes decode to something.
class RangeDecoder {
 public:
  explicit RangeDecoder(std::span<const unsigned char> bytes) : bytes_(bytes) {
    for (int i = 0; i < 5; ++i) code_ = code_ << 8 | next();
  }
  bool bit(BitModel& model) {
    const std::uint32_t bound = (range_ >> 12) * model.zero;
    const bool value = code_ >= bound;
    if (value) {
      code_ -= bound;
      range_ -= bound;
    } else {
      range_ = bound;
    }
    model.saw(value);
    normalise();
    return value;
  }
  bool raw_bit() {
    range_ >>= 1;
    const bool value = code_ >= range_;
    if (value) code_ -= range_;
    normalise();
    return value;
  }

 private:
  unsigned char next() { return at_ < bytes_.size() ? bytes_[at_++] : 0; }
  void normalise() {
    while (range_ < (1u << 24)) {
      range_ <<= 8;
      code_ = code_ << 8 | next();
    }
  }
  std::span<const unsigned char> bytes_;
  std::size_t at_ = 0;
  std::uint32_t code_ = 0, range_ = 0xffffffffu;
};

/// Whole numbers that are mostly near 0: is it 0, its sign, how far (unary, then Elias gamma), each
/// bit with a model of its own.
struct NumberModel {
  static constexpr int kUnary = 14, kMaxBits = 28;  // beyond what any coder here writes
  BitModel zero, sign;
  std::array<BitModel, kUnary> further;

  void encode(RangeEncoder& out, int value) {
    out.bit(zero, value != 0);
    if (value == 0) return;
    out.bit(sign, value < 0);
    const int rest = std::abs(value) - 1;
    for (int i = 0; i < kUnary; ++i) {
      out.bit(further[static_cast<std::size_t>(i)], rest > i);
      if (rest <= i) return;
    }
    const auto beyond = static_cast<std::uint32_t>(rest - kUnary + 1);
    int bits = 0;
    while (beyond >> (bits + 1)) ++bits;
    for (int i = 0; i < bits; ++i) out.raw_bit(true);
    out.raw_bit(false);
    for (int i = bits; i-- > 0;) out.raw_bit(beyond >> i & 1);
  }
  int decode(RangeDecoder& in) {
    if (!in.bit(zero)) return 0;
    const bool negative = in.bit(sign);
    int rest = 0;
    while (rest < kUnary && in.bit(further[static_cast<std::size_t>(rest)])) ++rest;
    if (rest == kUnary) {
      int bits = 0;
      while (bits < kMaxBits && in.raw_bit()) ++bits;
      int beyond = 1;
      for (int i = 0; i < bits; ++i) beyond = beyond << 1 | int{in.raw_bit()};
      rest = kUnary + beyond - 1;
    }
    return negative ? -(rest + 1) : rest + 1;
  }
};

}  // namespace penumbra::codec
#pragma GCC visibility pop
