#include "prt/sight_kernel.h"

#include <hwy/cache_control.h>

#include <bit>

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
  return hn::ConvertTo(kWhole, hn::Min(at, hn::Set(d, cells - .5f)));  // just below 0 is 0
}

// Of finer cells, in blocks of eight by eight, eight blocks in a row.
struct Place {
  Whole block, cell;  // cell of the block
};
HWY_INLINE Place PlaceOf(Whole x, Whole y) {
  const auto within = hn::Set(kWhole, 7);
  return {hn::Or(hn::AndNot(within, y), hn::ShiftRight<3>(x)),
          hn::Or(hn::ShiftLeft<3>(hn::And(y, within)), hn::And(x, within))};
}

// The word of each lane, of the vertex's. Where lanes are many a vertex's words fit into registers.
HWY_INLINE Whole Words(const std::uint32_t* words, Whole at) {
  constexpr auto d = kWhole;
  constexpr hn::Rebind<std::uint32_t, decltype(kWhole)> du;
  constexpr std::int32_t kLanes = hn::MaxLanes(decltype(kWhole){}), kWords = VertexSight::kWords;
  if constexpr (kLanes >= 8) {
    const auto lane = hn::IndicesFromVec(d, hn::And(at, hn::Set(d, kLanes - 1)));
    const auto of = [&](std::int32_t first) {
      return hn::TableLookupLanes(hn::BitCast(d, hn::LoadU(du, words + first)), lane);
    };
    auto found = of(0);
    for (std::int32_t first = kLanes; first < kWords; first += kLanes)
      found = hn::IfThenElse(hn::Gt(at, hn::Set(d, first - 1)), of(first), found);
    return found;
  } else {
    // One by one: gathering is slower.
    alignas(64) std::int32_t places[SightTaps::kEach];
    alignas(64) std::uint32_t found[SightTaps::kEach];
    hn::Store(at, d, places);
    for (std::size_t k = 0; k < hn::Lanes(d); ++k) found[k] = words[places[k]];
    return hn::BitCast(d, hn::Load(du, found));
  }
}

using IsOpen = hn::Mask<decltype(kFloats)>;
using Lanes = hn::Mask<decltype(kWhole)>;

// By lane the sixteen bits of a block.
HWY_INLINE Whole Blocks(const std::uint32_t* words, Whole block) {
  const auto d = kWhole;
  const auto word = Words(words, hn::ShiftRight<1>(block)),
             shift = hn::ShiftLeft<4>(hn::And(block, hn::Set(d, 1)));
  return hn::And(hn::Shr(word, shift), hn::Set(d, 0xffff));
}

struct Coarse {
  static constexpr int kCells = VertexSight::kCells;
  static HWY_INLINE void Prefetch(const SightRows& rows, std::size_t vertex) {
    constexpr std::size_t kLine = 16;  // words
    for (std::size_t at = 0; at < VertexSight::kWords; at += kLine)
      hwy::Prefetch(rows.open + vertex * VertexSight::kWords + at);
  }
  static HWY_INLINE IsOpen Look(const SightRows& rows, std::size_t vertex, Whole x, Whole y,
                                IsOpen) {
    // Of x four cells in a block and two blocks in a word, of y four cells in a block.
    const auto d = kWhole;
    const auto three = hn::Set(d, 3);
    const auto word = Words(rows.open + vertex * VertexSight::kWords,
                            hn::Or(hn::AndNot(three, y), hn::ShiftRight<3>(x)));
    const auto bit = hn::Or(hn::Or(hn::And(x, three), hn::ShiftLeft<2>(hn::And(y, three))),
                            hn::ShiftLeft<2>(hn::And(x, hn::Set(d, 4))));
    return hn::RebindMask(kFloats, hn::TestBit(hn::Shr(word, bit), hn::Set(d, 1)));
  }
};

struct Fine {
  static constexpr int kCells = VertexSight::kFineCells;
  static HWY_INLINE void Prefetch(const SightRows& rows, std::size_t vertex) {
    Coarse::Prefetch(rows, vertex);
    constexpr std::size_t kLine = 8;  // words
    if (rows.refined[vertex] == 0) return;
    for (std::size_t at = 0; at < 3 * kLine; at += kLine)
      hwy::Prefetch(rows.fine + rows.first_fine[vertex] + at);
  }
  static HWY_INLINE IsOpen Look(const SightRows& rows, std::size_t vertex, Whole x, Whole y,
                                IsOpen before) {
    const auto d = kWhole;
    const Place place = PlaceOf(x, y);
    const auto block = Blocks(rows.open + vertex * VertexSight::kWords, place.block);
    const auto open = hn::Ne(block, hn::Zero(d));
    const auto refined =
        hn::And(IsRefined(rows.refined[vertex], place.block), hn::RebindMask(d, before));
    if (hn::AllFalse(d, refined)) return hn::RebindMask(kFloats, open);
    return hn::RebindMask(
        kFloats, hn::Or(hn::AndNot(refined, open), InRefined(rows, vertex, place, refined)));
  }

 private:
  static HWY_INLINE Lanes IsRefined(std::uint64_t refined, Whole block) {
    const auto d = kWhole;
    const auto half = [&](std::uint64_t bits) {
      return hn::Set(d, static_cast<std::int32_t>(static_cast<std::uint32_t>(bits)));
    };
    const auto bits =
        hn::IfThenElse(hn::Gt(block, hn::Set(d, 31)), half(refined >> 32), half(refined));
    return hn::TestBit(bits, hn::Shl(hn::Set(d, 1), hn::And(block, hn::Set(d, 31))));
  }
  static HWY_INLINE Lanes InRefined(const SightRows& rows, std::size_t vertex, const Place& place,
                                    Lanes refined) {
    // One by one, all of them: branches that depend on lanes cost more.
    alignas(64) std::int32_t blocks[SightTaps::kEach], cells[SightTaps::kEach],
        open[SightTaps::kEach];
    hn::Store(hn::IfThenElseZero(refined, place.block), kWhole, blocks);
    hn::Store(place.cell, kWhole, cells);
    const std::uint64_t* const words = rows.fine + rows.first_fine[vertex];
    const std::uint64_t all = rows.refined[vertex];
    for (std::size_t k = 0; k < hn::Lanes(kWhole); ++k) {
      const std::uint64_t before = (std::uint64_t{1} << blocks[k]) - 1;
      open[k] = static_cast<std::int32_t>(words[std::popcount(all & before)] >> cells[k] & 1);
    }
    return hn::And(refined, hn::Ne(hn::Load(kWhole, open), hn::Zero(kWhole)));
  }
};

template <class Sight>
HWY_INLINE void Look(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  const auto d = kFloats;
  const auto zero = hn::Zero(d);
  constexpr std::size_t kAhead = 8;  // vertices
  std::size_t turn = first % rows.turns;
  const auto vertex = [&](std::size_t place) { return rows.which ? rows.which[place] : place; };
  for (std::size_t place = first; place < last; ++place) {
    const std::size_t from = turn * SightTaps::kEach;
    turn = turn + 1 == rows.turns ? 0 : turn + 1;
    if (place + kAhead < last) Sight::Prefetch(rows, vertex(place + kAhead));
    const std::size_t i = vertex(place);
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
      const auto column =
                     Cell(hn::Mul(hn::Add(across, along), scale), frame.shift.x, Sight::kCells),
                 row = Cell(hn::Mul(hn::Sub(across, along), scale), frame.shift.y, Sight::kCells);
      const auto is_open = hn::And(before, Sight::Look(rows, i, column, row, before));
      arrives =
          hn::MulAdd(hn::IfThenElseZero(is_open, cosine), hn::LoadU(d, rows.counts + k), arrives);
    }
    out[place] = {hn::GetLane(hn::SumOfLanes(d, arrives)), hn::GetLane(hn::SumOfLanes(d, all))};
  }
}

HWY_ATTR void LookCoarse(const SightRows& rows, std::size_t first, std::size_t last,
                         CosineSums* out) {
  Look<Coarse>(rows, first, last, out);
}
HWY_ATTR void LookFine(const SightRows& rows, std::size_t first, std::size_t last,
                       CosineSums* out) {
  Look<Fine>(rows, first, last, out);
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::prt {
HWY_EXPORT(LookCoarse);
HWY_EXPORT(LookFine);

void look_coarse(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  HWY_DYNAMIC_DISPATCH(LookCoarse)(rows, first, last, out);
}
void look_fine(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  HWY_DYNAMIC_DISPATCH(LookFine)(rows, first, last, out);
}

}  // namespace penumbra::prt
#endif
