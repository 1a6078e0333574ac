// Transfer at points, as half floats.
// threads: plain values
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/sh.h"
#include "prt/transfer/cow_vector.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

inline constexpr int kReflectedBands = 9;

/// Transfer t_n of conventions.h at points, as half floats in structure-of-arrays order:
/// value(channel, n, point) stands at ((channel * bands^2) + n) * stride + point. One channel
/// serves all three colours when every albedo is grey.
struct Transfer {
  int bands = 0;
  int channels = 1;
  std::size_t points = 0;
  std::size_t stride = 0;           // points rounded up to a multiple of 64; the padding is zero
  CowVector<std::uint16_t> values;  // copies share it

  Transfer() = default;
  Transfer(int bands_, int channels_, std::size_t points_);
  std::size_t index(int channel, int n, std::size_t point) const {
    return (static_cast<std::size_t>(channel) * static_cast<std::size_t>(coefficient_count(bands)) +
            static_cast<std::size_t>(n)) *
               stride +
           point;
  }
  float value(int channel, int n, std::size_t point) const;
  /// threads: one, or several for different points after values.make_own()
  void set(int channel, int n, std::size_t point, float v);
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
