#include "compositor/pixels/code_row.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/pixels/code_row.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::compositor {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, 16>;  // rows have room for so many
using DI = hn::RebindToSigned<D>;

// Pixels some at a time. Tables are read one by one: a third less than gathers take.
constexpr std::size_t kPiece = 64;
static_assert(kPiece % (HWY_MAX_BYTES / sizeof(float)) == 0);

// Where a signal lies in the table of codes.
HWY_INLINE hn::Vec<DI> Bucket(const ResponseTable::Tables8& t, hn::Vec<D> linear) {
  const D d;
  const DI di;
  const auto level = hn::Add(linear, hn::Set(d, t.black)),
             smallest = hn::Set(d, ResponseTable::kSmallest);
  const auto x =
      hn::Min(hn::IfThenElse(hn::Gt(level, smallest), level, smallest),  // NaN is the least
              hn::Set(d, ResponseTable::kLargest));
  return hn::Sub(hn::ShiftRight<ResponseTable::kShift8>(hn::BitCast(di, x)),
                 hn::Set(di, static_cast<std::int32_t>(ResponseTable::kFirst8)));
}

struct Piece {
  HWY_ALIGN float real[3][kPiece];
  HWY_ALIGN std::int32_t bucket[3][kPiece], touched[kPiece];
};

HWY_INLINE hn::Vec<D> Load4(const float* object, std::size_t i, hn::Vec<D> (&signal)[3]) {
  const D d;
  auto coverage = hn::Zero(d);
  for (auto& v : signal) v = coverage;
  if (object) hn::LoadInterleaved4(d, object + 4 * i, signal[0], signal[1], signal[2], coverage);
  return coverage;
}

// Up to kPiece pixels; rows have room for whole vectors.
HWY_INLINE std::size_t CompositePiece(const ResponseTable::Tables8 (&t)[3], const float* object,
                                      const float* const (&ratios)[3], std::uint8_t* codes,
                                      std::size_t count) {
  const D d;
  const DI di;
  const std::size_t lanes = hn::Lanes(d);
  const auto one = hn::Set(d, 1.f);
  Piece p;
  std::size_t touched = 0;
  for (std::size_t i = 0; i < count; i += lanes) {
    hn::Vec<D> signal[3];
    const auto coverage = Load4(object, i, signal);
    auto same = hn::Eq(coverage, hn::Zero(d));
    for (const float* s : ratios) same = hn::And(same, hn::Eq(hn::LoadU(d, s + i), one));
    const auto mask = hn::RebindMask(di, hn::Not(same));
    hn::Store(hn::VecFromMask(di, mask), di, p.touched + i);
    touched += hn::CountTrue(di, mask);
  }
  if (touched == 0) return 0;
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t c = 0; c < 3; ++c) p.real[c][i] = t[c].decode[codes[3 * i + c]];
  for (std::size_t i = 0; i < count; i += lanes) {
    hn::Vec<D> signal[3];
    const auto behind = hn::Sub(one, Load4(object, i, signal));
    for (std::size_t c = 0; c < 3; ++c) {
      const auto left = hn::Mul(behind, hn::LoadU(d, ratios[c] + i));
      const auto now = hn::Add(signal[c], hn::Mul(left, hn::Load(d, p.real[c] + i)));
      hn::Store(Bucket(t[c], now), di, p.bucket[c] + i);
    }
  }
  for (std::size_t i = 0; i < count; ++i)
    if (p.touched[i])
      for (std::size_t c = 0; c < 3; ++c) codes[3 * i + c] = t[c].encode[p.bucket[c][i]];
  return touched;
}

HWY_ATTR std::size_t CompositeCodes(const ResponseTable::Tables8 (&t)[3], const float* object,
                                    const float* r, const float* g, const float* b,
                                    std::uint8_t* codes, std::size_t count) {
  const std::size_t whole = count / kPiece * kPiece, left = count - whole;
  std::size_t touched = 0;
  for (std::size_t i = 0; i < whole; i += kPiece)
    touched += CompositePiece(t, object ? object + 4 * i : nullptr, {r + i, g + i, b + i},
                              codes + 3 * i, kPiece);
  if (left == 0) return touched;
  // The rest goes through whole vectors of its own; lanes beyond it are not touched.
  HWY_ALIGN float ratios[3][kPiece], objects[4 * kPiece] = {};
  const float* const in[3] = {r + whole, g + whole, b + whole};
  for (std::size_t c = 0; c < 3; ++c) {
    std::fill_n(ratios[c], kPiece, 1.f);
    std::copy_n(in[c], left, ratios[c]);
  }
  if (object) std::copy_n(object + 4 * whole, 4 * left, objects);
  return touched + CompositePiece(t, object ? objects : nullptr, {ratios[0], ratios[1], ratios[2]},
                                  codes + 3 * whole, left);
}

HWY_ATTR void DecodeCodes(const ResponseTable::Tables8 (&t)[3], const float* const* roundings,
                          const std::uint8_t* codes, std::size_t count, const SignalRows& out) {
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t code = codes[3 * i + c];
      out.signal[c * out.stride + i] = t[c].decode[code];
      out.rounding[c * out.stride + i] = roundings[c][code];
    }
}

HWY_ATTR void EncodeCodes(const ResponseTable::Tables8 (&t)[3], const SignalRows& in,
                          const std::uint32_t* touched, std::size_t count, std::uint8_t* codes) {
  const DI di;
  const std::size_t lanes = hn::Lanes(di);
  for (std::size_t first = 0; first < count; first += kPiece) {
    const std::size_t total = std::min(kPiece, count - first);
    HWY_ALIGN std::int32_t bucket[3][kPiece];
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t i = 0; i < total; i += lanes) {
        const float* const signal = in.signal + c * in.stride + first + i;
        hn::Store(Bucket(t[c], hn::LoadU(D(), signal)), di, bucket[c] + i);
      }
    for (std::size_t i = 0; i < total; ++i)
      if (touched[first + i])
        for (std::size_t c = 0; c < 3; ++c) codes[3 * (first + i) + c] = t[c].encode[bucket[c][i]];
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(CompositeCodes);
HWY_EXPORT(DecodeCodes);
HWY_EXPORT(EncodeCodes);

namespace {

// Tables where the largest code stands for more: a copy where it does, small beside a row.
class ClippedTables {
 public:
  ClippedTables(const ResponseTable& curve, const Rgb& clipped)
      : tables{curve.tables8(0), curve.tables8(1), curve.tables8(2)} {
    for (int c = 0; c < 3; ++c) {
      ResponseTable::Tables8& t = tables[c];
      if (!(clipped[c] > t.decode[255])) continue;
      std::copy_n(t.decode, 256, decode_[c]);
      for (unsigned code = 255; t.decode[code] > kClipping * t.decode[255]; --code)
        decode_[c][code] = decode_clipped(curve, c, code, clipped[c]);
      t.decode = decode_[c];
    }
  }
  ClippedTables(const ClippedTables&) = delete;

  ResponseTable::Tables8 tables[3];

 private:
  float decode_[3][256];
};

}  // namespace

void decode_codes(const ResponseTable& curve, const Rgb& clipped, const float* const* roundings,
                  const Rgb8* pixels, std::size_t count, const SignalRows& out) {
  const ClippedTables with(curve, clipped);
  HWY_DYNAMIC_DISPATCH(DecodeCodes)(with.tables, roundings, &pixels->r, count, out);
}

void encode_codes(const ResponseTable& curve, const SignalRows& in, const std::uint32_t* touched,
                  std::size_t count, Rgb8* pixels) {
  const ResponseTable::Tables8 tables[3] = {curve.tables8(0), curve.tables8(1), curve.tables8(2)};
  HWY_DYNAMIC_DISPATCH(EncodeCodes)(tables, in, touched, count, &pixels->r);
}

std::size_t composite_codes(const ResponseTable& curve, const Rgb& clipped, const float* object,
                            const float* r, const float* g, const float* b, Rgb8* pixels,
                            std::size_t count) {
  static_assert(sizeof(Rgb8) == 3);
  const ClippedTables with(curve, clipped);
  return HWY_DYNAMIC_DISPATCH(CompositeCodes)(with.tables, object, r, g, b, &pixels->r, count);
}
}  // namespace penumbra::compositor
#endif
