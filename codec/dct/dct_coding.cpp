#include <algorithm>
#include <numbers>

#include "codec/dct/dct_coding.h"

namespace penumbra::codec {

const QuantiserTable kLuminanceSteps = {
    16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
    14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
    18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99};

const QuantiserTable kColourSteps = {
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99,
    99, 99, 47, 66, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99};

float table_scale(int quality) {
  return quality < 50 ? 50.f / static_cast<float>(quality) : 2 - static_cast<float>(quality) / 50;
}

float quantiser(const QuantiserTable& table, float scale, int index) {
  return std::max(.125f, scale * static_cast<float>(table[static_cast<std::size_t>(index)]));
}

namespace {

const std::array<float, 64>& dct_matrix() {
  static const std::array<float, 64> m = [] {
    std::array<float, 64> out{};
    for (int k = 0; k < kBlock; ++k)
      for (int i = 0; i < kBlock; ++i)
        out[static_cast<std::size_t>(k * kBlock + i)] =
            static_cast<float>(std::sqrt((k == 0 ? 1. : 2.) / kBlock) *
                               std::cos(std::numbers::pi * (2 * i + 1) * k / (2 * kBlock)));
    return out;
  }();
  return m;
}

}  // namespace

DctBlock transformed(const DctBlock& in, bool inverse) {
  const auto& a = dct_matrix();
  const auto at = [&](int k, int i) {
    return inverse ? a[static_cast<std::size_t>(i * kBlock + k)]
                   : a[static_cast<std::size_t>(k * kBlock + i)];
  };
  DctBlock rows{}, out{};
  for (int y = 0; y < kBlock; ++y)
    for (int k = 0; k < kBlock; ++k)
      for (int x = 0; x < kBlock; ++x)
        rows[static_cast<std::size_t>(y * kBlock + k)] +=
            at(k, x) * in[static_cast<std::size_t>(y * kBlock + x)];
  for (int k = 0; k < kBlock; ++k)
    for (int x = 0; x < kBlock; ++x)
      for (int y = 0; y < kBlock; ++y)
        out[static_cast<std::size_t>(k * kBlock + x)] +=
            at(k, y) * rows[static_cast<std::size_t>(y * kBlock + x)];
  return out;
}

const std::array<int, 64>& zigzag() {
  static const std::array<int, 64> order = [] {
    std::array<int, 64> out{};
    std::size_t n = 0;
    for (int d = 0; d < 15; ++d)
      for (int i = 0; i <= d; ++i) {
        const int a = d % 2 == 0 ? d - i : i, b = d - a;
        if (a < kBlock && b < kBlock) out[n++] = a * kBlock + b;
      }
    return out;
  }();
  return order;
}

}  // namespace penumbra::codec
