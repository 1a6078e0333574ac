#include "prt/transfer/internal/visibility_kernel.h"

#include <hwy/cache_control.h>

#include <bit>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/transfer/visibility_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// D: of floats, as many lanes at most as directions are looked into at once.
template <class D>
using Floats = hn::Vec<D>;
template <class D>
using WholeTag = hn::Rebind<std::int32_t, D>;
template <class D>
using Whole = hn::Vec<WholeTag<D>>;
template <class D>
using IsOpen = hn::Mask<D>;

template <class D, class V = Floats<D>>
HWY_INLINE V Along(D d, const glm::vec3& axis, V x, V y, V z) {
  return hn::MulAdd(hn::Set(d, axis.x), x,
                    hn::MulAdd(hn::Set(d, axis.y), y, hn::Mul(hn::Set(d, axis.z), z)));
}

// The cell whose ray is nearest, from a place along the square's side, -1..1.
template <class D>
HWY_INLINE Whole<D> Cell(D d, Floats<D> place, float shift, float cells) {
  const auto at = hn::MulAdd(place, hn::Set(d, .5f * cells), hn::Set(d, .5f * cells + .5f - shift));
  return hn::ConvertTo(WholeTag<D>(), hn::Min(at, hn::Set(d, cells - .5f)));  // just below 0 is 0
}

// The word of each lane, of the vertex's. Where lanes are many a vertex's words fit into registers.
template <class D>
HWY_INLINE Whole<D> Words(D, const std::uint32_t* words, Whole<D> at) {
  constexpr WholeTag<D> d;
  constexpr hn::Rebind<std::uint32_t, D> du;
  constexpr std::int32_t kLanes = hn::MaxLanes(d), kWords = VisibilityMap::kWords;
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
    alignas(64) std::int32_t places[kLanes];
    alignas(64) std::uint32_t found[kLanes];
    hn::Store(at, d, places);
    for (std::size_t k = 0; k < hn::Lanes(d); ++k) found[k] = words[places[k]];
    return hn::BitCast(d, hn::Load(du, found));
  }
}

// By lane the sixteen bits of a block.
template <class D>
HWY_INLINE Whole<D> Blocks(D floats, const std::uint32_t* words, Whole<D> block) {
  const WholeTag<D> d;
  const auto word = Words(floats, words, hn::ShiftRight<1>(block)),
             shift = hn::ShiftLeft<4>(hn::And(block, hn::Set(d, 1)));
  return hn::And(hn::Shr(word, shift), hn::Set(d, 0xffff));
}

struct Coarse {
  static constexpr int kCells = VisibilityMap::kCells;
  static constexpr std::size_t kDirections = VisibilitySamples::kMax;  // at once
  static HWY_INLINE void Prefetch(const VisibilityRows& rows, std::size_t vertex) {
    constexpr std::size_t kLine = 16;  // words
    for (std::size_t at = 0; at < VisibilityMap::kWords; at += kLine)
      hwy::Prefetch(rows.open + vertex * VisibilityMap::kWords + at);
  }
  template <class D>
  static HWY_INLINE IsOpen<D> Look(D floats, const VisibilityRows& rows, std::size_t vertex,
                                   Whole<D> x, Whole<D> y, IsOpen<D>) {
    // Of x four cells in a block and two blocks in a word, of y four cells in a block.
    const WholeTag<D> d;
    const auto three = hn::Set(d, 3);
    const auto word = Words(floats, rows.open + vertex * VisibilityMap::kWords,
                            hn::Or(hn::AndNot(three, y), hn::ShiftRight<3>(x)));
    const auto bit = hn::Or(hn::Or(hn::And(x, three), hn::ShiftLeft<2>(hn::And(y, three))),
                            hn::ShiftLeft<2>(hn::And(x, hn::Set(d, 4))));
    return hn::RebindMask(floats, hn::TestBit(hn::Shr(word, bit), hn::Set(d, 1)));
  }
};

struct Fine {
  static constexpr int kCells = VisibilityMap::kFineCells;
  static constexpr std::size_t kDirections = VisibilitySamples::kFew;
  static HWY_INLINE void Prefetch(const VisibilityRows& rows, std::size_t vertex) {
    Coarse::Prefetch(rows, vertex);
    constexpr std::size_t kLine = 8;  // words
    if (rows.heads[vertex].refined == 0) return;
    for (std::size_t at = 0; at < 3 * kLine; at += kLine)
      hwy::Prefetch(rows.fine + rows.heads[vertex].first_fine + at);
  }
  template <class D>
  static HWY_INLINE IsOpen<D> Look(D floats, const VisibilityRows& rows, std::size_t vertex,
                                   Whole<D> x, Whole<D> y, IsOpen<D> before) {
    // In blocks of eight by eight cells, eight blocks in a row.
    const WholeTag<D> d;
    const auto within = hn::Set(d, 7);
    const auto block = hn::Or(hn::AndNot(within, y), hn::ShiftRight<3>(x)),
               cell = hn::Or(hn::ShiftLeft<3>(hn::And(y, within)), hn::And(x, within));
    const auto bits = Blocks(floats, rows.open + vertex * VisibilityMap::kWords, block);
    const auto open = hn::Ne(bits, hn::Zero(d));
    const auto refined =
        hn::And(IsRefined(floats, rows.heads[vertex].refined, block), hn::RebindMask(d, before));
    if (hn::AllFalse(d, refined)) return hn::RebindMask(floats, open);
    const auto finer = InRefined(floats, rows, vertex, hn::IfThenElseZero(refined, block), cell);
    return hn::RebindMask(floats, hn::Or(hn::AndNot(refined, open), hn::And(refined, finer)));
  }

 private:
  template <class D>
  static HWY_INLINE hn::Mask<WholeTag<D>> IsRefined(D, std::uint64_t refined, Whole<D> block) {
    const WholeTag<D> d;
    const auto half = [&](std::uint64_t bits) {
      return hn::Set(d, static_cast<std::int32_t>(static_cast<std::uint32_t>(bits)));
    };
    const auto bits =
        hn::IfThenElse(hn::Gt(block, hn::Set(d, 31)), half(refined >> 32), half(refined));
    return hn::TestBit(bits, hn::Shl(hn::Set(d, 1), hn::And(block, hn::Set(d, 31))));
  }
  // Of blocks that are not refined something that does not count.
  template <class D>
  static HWY_INLINE hn::Mask<WholeTag<D>> InRefined(D, const VisibilityRows& rows,
                                                    std::size_t vertex, Whole<D> block,
                                                    Whole<D> cell) {
    // One by one, all of them: branches that depend on lanes cost more.
    constexpr WholeTag<D> d;
    alignas(64) std::int32_t blocks[hn::MaxLanes(d)], cells[hn::MaxLanes(d)], open[hn::MaxLanes(d)];
    hn::Store(block, d, blocks);
    hn::Store(cell, d, cells);
    const std::uint64_t* const words = rows.fine + rows.heads[vertex].first_fine;
    const std::uint64_t all = rows.heads[vertex].refined;
    for (std::size_t k = 0; k < hn::Lanes(d); ++k) {
      const std::uint64_t before = (std::uint64_t{1} << blocks[k]) - 1;
      open[k] = static_cast<std::int32_t>(words[std::popcount(all & before)] >> cells[k] & 1);
    }
    return hn::Ne(hn::Load(d, open), hn::Zero(d));
  }
};

template <class Visibility>
HWY_INLINE void Look(const VisibilityRows& rows, std::size_t first, std::size_t last,
                     CosineSums* out) {
  const hn::CappedTag<float, Visibility::kDirections> d;
  const auto zero = hn::Zero(d);
  constexpr std::size_t kAhead = 16;  // vertices
  std::size_t turn = first % rows.turns;
  const auto vertex = [&](std::size_t place) { return rows.which ? rows.which[place] : place; };
  for (std::size_t place = first; place < last; ++place) {
    const std::size_t from = turn * rows.each;
    turn = turn + 1 == rows.turns ? 0 : turn + 1;
    if (place + 2 * kAhead < last) hwy::Prefetch(rows.heads + vertex(place + 2 * kAhead));
    if (place + kAhead < last) Visibility::Prefetch(rows, vertex(place + kAhead));
    const std::size_t i = vertex(place);
    const HemiOctFrame& frame = rows.heads[i].frame;
    const glm::vec2 shift = frame.shift(Visibility::kCells);
    auto all = zero, arrives = zero;
    for (std::size_t k = from; k < from + rows.each; k += hn::Lanes(d)) {
      const auto x = hn::LoadU(d, rows.x + k), y = hn::LoadU(d, rows.y + k),
                 z = hn::LoadU(d, rows.z + k);
      const auto cosine = Along(d, frame.normal, x, y, z);
      const auto before = hn::Gt(cosine, zero);
      if (hn::AllFalse(d, before)) continue;
      all = hn::Add(all, hn::IfThenElseZero(before, cosine));
      const auto across = Along(d, frame.first, x, y, z), along = Along(d, frame.second, x, y, z);
      const auto scale = hn::Div(
          hn::Set(d, 1.f),
          hn::Add(hn::Max(cosine, hn::Set(d, 1e-20f)), hn::Add(hn::Abs(across), hn::Abs(along))));
      const auto column =
                     Cell(d, hn::Mul(hn::Add(across, along), scale), shift.x, Visibility::kCells),
                 row = Cell(d, hn::Mul(hn::Sub(across, along), scale), shift.y, Visibility::kCells);
      const auto is_open = hn::And(before, Visibility::Look(d, rows, i, column, row, before));
      arrives =
          hn::MulAdd(hn::IfThenElseZero(is_open, cosine), hn::LoadU(d, rows.counts + k), arrives);
    }
    out[place] = {hn::GetLane(hn::SumOfLanes(d, arrives)), hn::GetLane(hn::SumOfLanes(d, all))};
  }
}

HWY_ATTR void LookCoarse(const VisibilityRows& rows, std::size_t first, std::size_t last,
                         CosineSums* out) {
  Look<Coarse>(rows, first, last, out);
}
HWY_ATTR void LookFine(const VisibilityRows& rows, std::size_t first, std::size_t last,
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

void look_coarse(const VisibilityRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  HWY_DYNAMIC_DISPATCH(LookCoarse)(rows, first, last, out);
}
void look_fine(const VisibilityRows& rows, std::size_t first, std::size_t last, CosineSums* out) {
  HWY_DYNAMIC_DISPATCH(LookFine)(rows, first, last, out);
}

}  // namespace penumbra::prt
#endif
