#include "prt/sight_kernel.h"

#include <hwy/cache_control.h>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/sight_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::CappedTag<float, SightTaps::kEach> kFloats;
constexpr hn::Rebind<std::int32_t, hn::CappedTag<float, SightTaps::kEach>> kWhole;
using Floats = hn::Vec<decltype(kFloats)>;
using Whole = hn::Vec<decltype(kWhole)>;

HWY_INLINE Floats Along(const glm::vec3& axis, Floats x, Floats y, Floats z) {
  const auto d = kFloats;
  return hn::MulAdd(hn::Set(d, axis.x), x,
                    hn::MulAdd(hn::Set(d, axis.y), y, hn::Mul(hn::Set(d, axis.z), z)));
}

// The cell whose ray is nearest, from a place along the square's side, -1..1.
HWY_INLINE Whole Cell(Floats place, float shift, float cells) {
  const auto d = kFloats;
  const auto at = hn::MulAdd(place, hn::Set(d, .5f * cells), hn::Set(d, .5f * cells + .5f - shift));
  return hn::ConvertTo(kWhole, hn::Min(hn::Max(at, hn::Zero(d)), hn::Set(d, cells - .5f)));
}

// Its bit among all of the vertex.
HWY_INLINE Whole Place(Whole x, Whole y, int cells) {
  const auto three = hn::Set(kWhole, 3);
  const auto block =
      hn::Add(hn::Mul(hn::ShiftRight<2>(y), hn::Set(kWhole, cells / 4)), hn::ShiftRight<2>(x));
  return hn::Or(hn::ShiftLeft<4>(block),
                hn::Or(hn::ShiftLeft<2>(hn::And(y, three)), hn::And(x, three)));
}

using IsOpenBits = hn::Mask<decltype(kFloats)>;

// A vertex's words in registers: the fastest where they are few and lanes are many.
constexpr std::int32_t kInRegisters = 32;  // words
HWY_INLINE IsOpenBits IsOpenOfFew(const std::uint32_t* words, Whole place) {
  constexpr auto d = kWhole;
  constexpr std::int32_t kLanes = hn::MaxLanes(decltype(kWhole){});
  const auto table = [&](std::int32_t first) {
    return hn::BitCast(d, hn::LoadU(hn::Rebind<std::uint32_t, decltype(kWhole)>(), words + first));
  };
  const auto word = hn::ShiftRight<5>(place);
  const auto lane = hn::IndicesFromVec(d, hn::And(word, hn::Set(d, kLanes - 1)));
  auto found = hn::TableLookupLanes(table(0), lane);
  for (std::int32_t first = kLanes; first < kInRegisters; first += kLanes)
    found = hn::IfThenElse(hn::Gt(word, hn::Set(d, first - 1)),
                           hn::TableLookupLanes(table(first), lane), found);
  const auto bit = hn::Shl(hn::Set(d, 1), hn::And(place, hn::Set(d, 31)));
  return hn::RebindMask(kFloats, hn::TestBit(found, bit));
}

// One by one: gathering words is slower.
HWY_INLINE IsOpenBits IsOpenOfMany(const std::uint32_t* words, Whole place) {
  alignas(64) std::int32_t places[SightTaps::kEach];
  hn::Store(place, kWhole, places);
  std::uint32_t bits = 0;
  for (std::size_t k = 0; k < hn::Lanes(kWhole); ++k) {
    const auto at = static_cast<std::uint32_t>(places[k]);
    bits |= (words[at / 32] >> at % 32 & 1) << k;
  }
  const std::uint8_t bytes[8] = {static_cast<std::uint8_t>(bits),
                                 static_cast<std::uint8_t>(bits >> 8)};
  return hn::LoadMaskBits(kFloats, bytes);
}

HWY_INLINE IsOpenBits IsOpen(const SightRows& rows, const std::uint32_t* words, Whole place) {
  if constexpr (hn::MaxLanes(decltype(kWhole){}) >= 8)
    if (rows.words_each == kInRegisters) return IsOpenOfFew(words, place);
  return IsOpenOfMany(words, place);
}

HWY_ATTR void Look(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  const auto d = kFloats;
  const auto zero = hn::Zero(d);
  constexpr std::size_t kAhead = 8, kLine = 16;  // vertices; words
  const auto cells = static_cast<float>(rows.cells);
  std::size_t turn = first % rows.turns;
  for (std::size_t i = first; i < last; ++i) {
    const std::size_t from = turn * SightTaps::kEach;
    turn = turn + 1 == rows.turns ? 0 : turn + 1;
    const std::uint32_t* const words = rows.words + i * rows.words_each;
    if (i + kAhead < last)
      for (std::size_t line = 0; line < rows.words_each; line += kLine)
        hwy::Prefetch(words + kAhead * rows.words_each + line);
    const SightFrame& frame = rows.frames[i];
    auto all = zero, arrives = zero;
    for (std::size_t k = from; k < from + SightTaps::kEach; k += hn::Lanes(d)) {
      const auto x = hn::LoadU(d, rows.x + k), y = hn::LoadU(d, rows.y + k),
                 z = hn::LoadU(d, rows.z + k);
      const auto cosine = Along(frame.normal, x, y, z);
      const auto before = hn::Gt(cosine, zero);
      if (hn::AllFalse(d, before)) continue;
      all = hn::Add(all, hn::IfThenElseZero(before, cosine));
      const auto across = Along(frame.first, x, y, z), along = Along(frame.second, x, y, z);
      const auto scale = hn::Div(
          hn::Set(d, 1.f),
          hn::Add(hn::Max(cosine, hn::Set(d, 1e-20f)), hn::Add(hn::Abs(across), hn::Abs(along))));
      const auto column = Cell(hn::Mul(hn::Add(across, along), scale), frame.shift.x, cells),
                 row = Cell(hn::Mul(hn::Sub(across, along), scale), frame.shift.y, cells);
      const auto is_open = hn::And(before, IsOpen(rows, words, Place(column, row, rows.cells)));
      arrives =
          hn::MulAdd(hn::IfThenElseZero(is_open, cosine), hn::LoadU(d, rows.counts + k), arrives);
    }
    out[i] = {hn::GetLane(hn::SumOfLanes(d, arrives)), hn::GetLane(hn::SumOfLanes(d, all))};
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::prt {
HWY_EXPORT(Look);

void look(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  HWY_DYNAMIC_DISPATCH(Look)(rows, first, last, out);
}
}  // namespace penumbra::prt
#endif
