#include "capture/ring/internal/table_kernel.h"

#include "core/half.h"
#include "core/threads/background_task.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "capture/ring/table_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::capture {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int kSamples = kBlockSamples;

// The longest exposure in which the whole block is open, else the shortest: it and the next decide.
HWY_INLINE int DeepestNeeded(const TableView& t, const std::uint8_t* const* codes) {
  const hn::ScalableTag<std::uint8_t> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto open = [&](int k) {
    for (int i = 0; i < kSamples; i += lanes)
      if (!hn::AllTrue(d, hn::Lt(hn::LoadU(d, codes[k] + i), hn::LoadU(d, t.clip + i))))
        return false;
    return true;
  };
  int k = 0;
  while (k < t.steps - 1 && !open(k)) ++k;
  return HWY_MIN(k + 1, t.steps - 1);
}

// From the shortest exposure up, each unclipped longer one takes over the decision. An index is
// step << 16 | next << 8 | code.
HWY_INLINE std::size_t Select(const TableView& t, int deepest, const std::uint8_t* const* codes,
                              std::uint32_t* index) {
  HWY_ALIGN std::uint8_t low[kSamples], high[kSamples], step[kSamples];
  const hn::ScalableTag<std::uint8_t> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  std::size_t black = 0;
  for (int i = 0; i < kSamples; i += lanes) {
    const auto clip = hn::LoadU(d, t.clip + i);
    auto next = hn::Zero(d), code = hn::LoadU(d, codes[deepest] + i),
         number = hn::Set(d, static_cast<std::uint8_t>(t.steps));
    auto chosen_next = hn::Zero(d), here = code;
    for (int k = deepest; k >= 0; --k) {
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
  const int deepest = DeepestNeeded(t, codes);
  counts.deepest = static_cast<std::uint8_t>(deepest);
  counts.black = static_cast<std::uint16_t>(Select(t, deepest, codes, index));
  const std::uint16_t *red = t.channel[0], *green = t.channel[1], *blue = t.channel[2];
  const std::uint32_t lost_from = static_cast<std::uint32_t>(t.steps) << 16;
  for (int i = 0; i < kMergeBlock; ++i) {
    const std::uint32_t r = index[3 * i], g = index[3 * i + 1], b = index[3 * i + 2];
    const bool lost = HWY_MAX(HWY_MAX(r, g), b) >= lost_from;
    out[i] = {red[r], green[g], blue[b], static_cast<std::uint16_t>(lost ? 0 : 0x3c00)};
    counts.clipped = static_cast<std::uint16_t>(counts.clipped + lost);
  }
  return counts;
}

// Few enough by chance that a block of 768 samples of a still scene hardly ever has more beyond 3.5
// sigma.
constexpr std::size_t kFewByChance = 6;

HWY_ATTR bool BlockChanged(const CodeTolerance& tolerance, const std::uint8_t* now,
                           const std::uint8_t* before) {
  std::size_t often = 0;
#if HWY_TARGET == HWY_SCALAR
  for (int i = 0; i < kSamples; ++i) {
    const int apart = now[i] > before[i] ? now[i] - before[i] : before[i] - now[i];
    if (apart > tolerance.ever[now[i] >> 4]) return true;
    often += apart > tolerance.often[now[i] >> 4];
  }
#else
  const hn::ScalableTag<std::uint8_t> d;
  const hn::Repartition<std::uint16_t, decltype(d)> d16;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto often_of = hn::LoadDup128(d, tolerance.often),
             ever_of = hn::LoadDup128(d, tolerance.ever);
  const auto low_half = hn::Set(d, 15);
  auto ever = hn::Zero(d);
  for (int i = 0; i < kSamples; i += lanes) {
    const auto a = hn::LoadU(d, now + i), b = hn::LoadU(d, before + i);
    const auto apart = hn::Sub(hn::Max(a, b), hn::Min(a, b));
    const auto upper = hn::And(hn::BitCast(d, hn::ShiftRight<4>(hn::BitCast(d16, a))), low_half);
    ever = hn::Or(ever, hn::SaturatedSub(apart, hn::TableLookupBytes(ever_of, upper)));
    often += hn::CountTrue(d, hn::Lt(hn::TableLookupBytes(often_of, upper), apart));
  }
  if (!hn::AllTrue(d, hn::Eq(ever, hn::Zero(d)))) return true;
#endif
  return often > kFewByChance;
}

HWY_ATTR void MarkOutside(const std::uint32_t* allowed, const std::int32_t* offsets,
                          const std::uint8_t* known, const std::uint8_t* asked,
                          std::uint8_t* outside) {
  const hn::ScalableTag<std::int32_t> d;
  const hn::Rebind<std::uint8_t, decltype(d)> d8;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto low_byte = hn::Set(d, 255);
  for (int i = 0; i < kSamples; i += lanes) {
    const auto index =
        hn::Add(hn::LoadU(d, offsets + i), hn::PromoteTo(d, hn::LoadU(d8, known + i)));
    const auto fits = hn::GatherIndex(d, reinterpret_cast<const std::int32_t*>(allowed), index);
    const auto code = hn::PromoteTo(d, hn::LoadU(d8, asked + i));
    const auto bad =
        hn::Or(hn::Lt(code, hn::And(fits, low_byte)), hn::Gt(code, hn::ShiftRight<8>(fits)));
    hn::StoreU(hn::DemoteTo(d8, hn::IfThenElseZero(bad, low_byte)), d8, outside + i);
  }
}

HWY_ATTR void SumDifferences(const HalfRgba* before, const HalfRgba* after,
                             const std::uint8_t* marked, float (*sums)[4]) {
#if HWY_TARGET == HWY_SCALAR
  for (int i = 0; i < kMergeBlock; ++i) {
    const auto value = [](std::uint16_t bits) { return float_from_half(bits); };
    float* const sum = sums[i / kMergeRun];
    if (i % kMergeRun == 0) sum[0] = sum[1] = sum[2] = sum[3] = 0;
    if (!marked[i]) continue;
    sum[0] += value(before[i].r) - value(after[i].r);
    sum[1] += value(before[i].g) - value(after[i].g);
    sum[2] += value(before[i].b) - value(after[i].b);
  }
#else
  const hn::FixedTag<float, 4> d;
  const hn::Rebind<hwy::float16_t, decltype(d)> half;
  const auto load = [&](const HalfRgba& p) {
    return hn::PromoteTo(d, hn::LoadU(half, reinterpret_cast<const hwy::float16_t*>(&p)));
  };
  for (int run = 0; run < kMergeBlock / kMergeRun; ++run) {
    auto sum = hn::Zero(d);
    for (int i = run * kMergeRun; i < (run + 1) * kMergeRun; ++i)
      if (marked[i]) sum = hn::Add(sum, hn::Sub(load(before[i]), load(after[i])));
    hn::StoreU(sum, d, sums[run]);
  }
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::capture
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::capture {
HWY_EXPORT(MergeBlock);
HWY_EXPORT(BlockChanged);
HWY_EXPORT(MarkOutside);
HWY_EXPORT(SumDifferences);

BlockCounts merge_block(const TableView& tables, const std::uint8_t* const* codes, HalfRgba* out) {
  return HWY_DYNAMIC_DISPATCH(MergeBlock)(tables, codes, out);
}

bool block_changed(const CodeTolerance& tolerance, const std::uint8_t* now,
                   const std::uint8_t* before) {
  return HWY_DYNAMIC_DISPATCH(BlockChanged)(tolerance, now, before);
}

void mark_outside(const std::uint32_t* allowed, const std::int32_t* offsets,
                  const std::uint8_t* known, const std::uint8_t* asked, std::uint8_t* outside) {
  HWY_DYNAMIC_DISPATCH(MarkOutside)(allowed, offsets, known, asked, outside);
}

void sum_differences(const HalfRgba* before, const HalfRgba* after, const std::uint8_t* marked,
                     float (*sums)[4]) {
  HWY_DYNAMIC_DISPATCH(SumDifferences)(before, after, marked, sums);
}
}  // namespace penumbra::capture
#endif
