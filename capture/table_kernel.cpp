#include "capture/table_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "capture/table_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::capture {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int kSamples = 3 * kMergeBlock;

// From the shortest exposure up, each unclipped longer one takes over the decision. An index is
// step << 16 | next << 8 | code.
HWY_INLINE std::size_t Select(const TableView& t, const std::uint8_t* const* codes,
                              std::uint32_t* index) {
  HWY_ALIGN std::uint8_t low[kSamples], high[kSamples], step[kSamples];
  const hn::ScalableTag<std::uint8_t> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  std::size_t black = 0;
  for (int i = 0; i < kSamples; i += lanes) {
    const auto clip = hn::LoadU(d, t.clip + i);
    auto next = hn::Zero(d), code = hn::LoadU(d, codes[t.steps - 1] + i),
         number = hn::Set(d, static_cast<std::uint8_t>(t.steps));
    auto chosen_next = hn::Zero(d), here = code;
    for (int k = t.steps - 1; k >= 0; --k) {
      here = hn::LoadU(d, codes[k] + i);
      const auto open = hn::Lt(here, clip);
      code = hn::IfThenElse(open, here, code);
      chosen_next = hn::IfThenElse(open, next, chosen_next);
      number = hn::IfThenElse(open, hn::Set(d, static_cast<std::uint8_t>(k)), number);
      next = here;
    }
    black += hn::CountTrue(d, hn::Lt(here, hn::LoadU(d, t.black + i)));
    hn::Store(code, d, low + i);
    hn::Store(chosen_next, d, high + i);
    hn::Store(number, d, step + i);
  }
#if HWY_TARGET == HWY_SCALAR
  for (int i = 0; i < kSamples; ++i)
    index[i] = static_cast<std::uint32_t>(low[i]) | static_cast<std::uint32_t>(high[i]) << 8 |
               static_cast<std::uint32_t>(step[i]) << 16;
#else
  const hn::FixedTag<std::uint8_t, 16> d8;
  const hn::FixedTag<std::uint16_t, 8> d16;
  const hn::FixedTag<std::uint32_t, 4> d32;
  for (int i = 0; i < kSamples; i += 16) {
    const auto l = hn::Load(d8, low + i), h = hn::Load(d8, high + i), s = hn::Load(d8, step + i);
    const auto zero = hn::Zero(d8);
    const auto pair0 = hn::BitCast(d16, hn::InterleaveLower(d8, l, h)),
               pair1 = hn::BitCast(d16, hn::InterleaveUpper(d8, l, h));
    const auto step0 = hn::BitCast(d16, hn::InterleaveLower(d8, s, zero)),
               step1 = hn::BitCast(d16, hn::InterleaveUpper(d8, s, zero));
    hn::Store(hn::BitCast(d32, hn::InterleaveLower(d16, pair0, step0)), d32, index + i);
    hn::Store(hn::BitCast(d32, hn::InterleaveUpper(d16, pair0, step0)), d32, index + i + 4);
    hn::Store(hn::BitCast(d32, hn::InterleaveLower(d16, pair1, step1)), d32, index + i + 8);
    hn::Store(hn::BitCast(d32, hn::InterleaveUpper(d16, pair1, step1)), d32, index + i + 12);
  }
#endif
  return black;
}

HWY_ATTR BlockCounts MergeBlock(const TableView& t, const std::uint8_t* const* codes,
                                HalfRgba* out) {
  HWY_ALIGN std::uint32_t index[kSamples];
  BlockCounts counts;
  counts.black = Select(t, codes, index);
  const std::uint16_t *red = t.channel[0], *green = t.channel[1], *blue = t.channel[2];
  const std::uint32_t lost_from = static_cast<std::uint32_t>(t.steps) << 16;
  for (int i = 0; i < kMergeBlock; ++i) {
    const std::uint32_t r = index[3 * i], g = index[3 * i + 1], b = index[3 * i + 2];
    const bool lost = HWY_MAX(HWY_MAX(r, g), b) >= lost_from;
    out[i] = {red[r], green[g], blue[b], static_cast<std::uint16_t>(lost ? 0 : 0x3c00)};
    counts.clipped += lost;
  }
  return counts;
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::capture
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::capture {
HWY_EXPORT(MergeBlock);

BlockCounts merge_block(const TableView& tables, const std::uint8_t* const* codes, HalfRgba* out) {
  return HWY_DYNAMIC_DISPATCH(MergeBlock)(tables, codes, out);
}
}  // namespace penumbra::capture
#endif
