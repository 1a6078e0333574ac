#include "prt/transfer/internal/blocked_rows.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "core/half.h"

namespace penumbra::prt {
namespace {

struct Table {
  int rows, channels;
  std::size_t blocks;
  std::vector<std::uint16_t> values;

  double at(std::size_t point, int channel, int row) const {
    const std::size_t strip = point / kBlock * static_cast<std::size_t>(channels) +
                              static_cast<std::size_t>(channels == 1 ? 0 : channel);
    return double(float_from_half(
        values[(strip * static_cast<std::size_t>(rows) + static_cast<std::size_t>(row)) * kBlock +
               point % kBlock]));
  }
};

Table random_table(int rows, int channels, std::size_t blocks) {
  std::mt19937 rng(3);
  std::normal_distribution<float> gauss;
  Table out{rows, channels, blocks, {}};
  out.values.resize(blocks * static_cast<std::size_t>(channels * rows) * kBlock);
  for (std::uint16_t& v : out.values) v = half_from_float(gauss(rng));
  return out;
}

// More blocks than one thread takes at a time; all rows, some and none of them.
TEST(BlockedRows, AreSummedLikeOneByOne) {
  std::mt19937 rng(4);
  std::normal_distribution<float> gauss;
  for (const int channels : {1, 3})
    for (const auto& [rows, blocks] : {std::pair{1, 1uz}, {7, 3uz}, {64, 2uz}, {5, 130uz}}) {
      const Table table = random_table(rows, channels, blocks);
      std::vector<float> weights(3 * static_cast<std::size_t>(rows));
      for (float& w : weights) w = gauss(rng);
      const std::size_t points = blocks * kBlock;
      for (const auto& [first, used] :
           {std::pair{0, 0}, {0, 1}, {0, rows / 2}, {0, rows}, {rows / 2, rows - rows / 2}}) {
        std::vector<float> out(3 * points, NAN);
        sum_rows({table.values, rows, channels}, first, used, weights, out);
        for (int c = 0; c < 3; ++c)
          for (std::size_t p = 0; p < points; ++p) {
            double sum = 0;
            for (int k = 0; k < used; ++k)
              sum +=
                  double(weights[static_cast<std::size_t>(3 * k + c)]) * table.at(p, c, first + k);
            ASSERT_NEAR(double(out[static_cast<std::size_t>(c) * points + p]), sum, 1e-4)
                << rows << " rows, " << used << " from " << first << " on used, colour " << c
                << ", point " << p;
          }
      }
    }
}

TEST(BlockedRows, NoRowsGiveZero) {
  std::vector<float> out(3 * 2 * kBlock, NAN);
  sum_rows({{}, 0, 3}, 0, 0, {}, out);
  for (const float v : out) ASSERT_EQ(v, 0);
}

}  // namespace
}  // namespace penumbra::prt
