#include "prt/transfer/internal/blocked_rows.h"

#include <hwy/cache_control.h>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/transfer/blocked_rows.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;
static_assert(2 * HWY_MAX_BYTES <= kBlock * sizeof(float));
static_assert(kBlock * sizeof(hwy::float16_t) == 64, "a row of a block fills a cache line");

// One block under three colours of light, or under one: two vectors of points at a time. What is
// `ahead` is asked for, since memory is what it waits for.
template <int kColours>
HWY_ATTR void SumBlock(const std::uint16_t* rows, std::size_t ahead, int used, const float* weights,
                       float* out, std::size_t stride) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> dh;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t p = 0; p < kBlock; p += 2 * lanes) {
    auto r0 = hn::Zero(d), r1 = r0, g0 = r0, g1 = r0, b0 = r0, b1 = r0;
    const auto* row = reinterpret_cast<const hwy::float16_t*>(rows + p);
    const float* w = weights;
    for (int k = 0; k < used; ++k, row += kBlock, w += 3) {
      if (p == 0) hwy::Prefetch(row + ahead);
      const auto t0 = hn::PromoteTo(d, hn::LoadU(dh, row)),
                 t1 = hn::PromoteTo(d, hn::LoadU(dh, row + lanes));
      const auto red = hn::Set(d, w[0]);
      r0 = hn::MulAdd(t0, red, r0), r1 = hn::MulAdd(t1, red, r1);
      if constexpr (kColours == 3) {
        const auto green = hn::Set(d, w[1]), blue = hn::Set(d, w[2]);
        g0 = hn::MulAdd(t0, green, g0), g1 = hn::MulAdd(t1, green, g1);
        b0 = hn::MulAdd(t0, blue, b0), b1 = hn::MulAdd(t1, blue, b1);
      }
    }
    const auto store = [&](std::size_t colour, auto first, auto second) HWY_ATTR {
      hn::StoreU(first, d, out + colour * stride + p);
      hn::StoreU(second, d, out + colour * stride + p + lanes);
    };
    store(0, r0, r1);
    if constexpr (kColours == 3) store(1, g0, g1), store(2, b0, b1);
  }
}

HWY_ATTR void SumGrey(const std::uint16_t* rows, std::size_t ahead, int used, const float* weights,
                      float* out, std::size_t stride) {
  SumBlock<3>(rows, ahead, used, weights, out, stride);
}
HWY_ATTR void SumChannel(const std::uint16_t* rows, std::size_t ahead, int used,
                         const float* weights, float* out, std::size_t stride) {
  SumBlock<1>(rows, ahead, used, weights, out, stride);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <algorithm>
#include <cassert>

#include "core/threads/parallel.h"

namespace penumbra::prt {
HWY_EXPORT(SumGrey);
HWY_EXPORT(SumChannel);

void sum_rows(const BlockedRows& from, int first, int used, std::span<const float> weights,
              std::span<float> out) {
  assert(first >= 0 && first + used <= from.rows &&
         weights.size() >= 3 * static_cast<std::size_t>(used));
  if (used == 0) {  // no row, of which there may be none to point at
    std::ranges::fill(out, 0.0F);
    return;
  }
  constexpr std::size_t kTogether = 64,  // blocks
      kAhead = 4096;                     // values: twice a page
  const std::size_t stride = out.size() / 3, blocks = stride / kBlock,
                    rows = static_cast<std::size_t>(from.rows) * kBlock,
                    of_block = rows * static_cast<std::size_t>(from.channels),
                    ahead = (kAhead / std::max<std::size_t>(of_block, 1) + 1) * of_block;
  assert(from.values.size() == blocks * of_block);
  parallel_for(std::size_t{0}, blocks, kTogether, [&](const auto& some) {
    for (std::size_t b = some.begin(); b != some.end(); ++b) {
      const std::uint16_t* const values =
          from.values.data() + b * of_block + static_cast<std::size_t>(first) * kBlock;
      float* const to = out.data() + b * kBlock;
      if (from.channels == 1) {
        HWY_DYNAMIC_DISPATCH(SumGrey)(values, ahead, used, weights.data(), to, stride);
        continue;
      }
      for (std::size_t c = 0; c < 3; ++c) HWY_DYNAMIC_DISPATCH(SumChannel)
      (values + c * rows, ahead, used, weights.data() + c, to + c * stride, stride);
    }
  });
}

}  // namespace penumbra::prt
#endif
