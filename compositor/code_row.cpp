#include "compositor/code_row.h"

#include <algorithm>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compositor/code_row.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace penumbra::compositor {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, 16>;  // rows have room for so many
using DI = hn::RebindToSigned<D>;
using DU = hn::RebindToUnsigned<D>;
using DB = hn::Rebind<std::uint8_t, D>;

HWY_INLINE hn::Vec<DI> Encode(const CodeCurve::Tables8& t, hn::Vec<D> linear) {
  const D d;
  const DI di;
  const auto level = hn::Add(linear, hn::Set(d, t.black)), least = hn::Set(d, CodeCurve::kSmallest);
  const auto x = hn::Min(hn::IfThenElse(hn::Gt(level, least), level, least),  // NaN is the least
                         hn::Set(d, CodeCurve::kLargest));
  const auto bucket = hn::Sub(hn::ShiftRight<CodeCurve::kShift8>(hn::BitCast(di, x)),
                              hn::Set(di, static_cast<std::int32_t>(CodeCurve::kFirst8)));
  const DU du;
  const auto four = hn::GatherIndex(du, t.encode, hn::ShiftRight<2>(bucket));
  const auto shift = hn::ShiftLeft<3>(hn::And(bucket, hn::Set(di, 3)));
  return hn::And(hn::BitCast(di, hn::Shr(four, hn::BitCast(du, shift))), hn::Set(di, 255));
}

HWY_INLINE hn::Vec<DB> Channel(const CodeCurve::Tables8& t, hn::Vec<DB> code, hn::Vec<D> object,
                               hn::Vec<D> behind, hn::Vec<D> ratio, hn::Mask<DI> touched) {
  const D d;
  const DI di;
  const auto before = hn::PromoteTo(di, code);
  const auto real = hn::GatherIndex(d, t.decode, before);
  const auto now = Encode(t, hn::Add(object, hn::Mul(hn::Mul(behind, ratio), real)));
  return hn::DemoteTo(DB(), hn::IfThenElse(touched, now, before));
}

HWY_INLINE std::size_t CompositeLanes(const CodeCurve::Tables8 (&t)[3], const float* object,
                                      const float* r, const float* g, const float* b,
                                      std::uint8_t* codes) {
  const D d;
  const DB db;
  const auto one = hn::Set(d, 1.f), zero = hn::Zero(d);
  const auto sr = hn::LoadU(d, r), sg = hn::LoadU(d, g), sb = hn::LoadU(d, b);
  auto in_r = zero, in_g = zero, in_b = zero, coverage = zero;
  if (object) hn::LoadInterleaved4(d, object, in_r, in_g, in_b, coverage);
  const auto same = hn::And(hn::And(hn::Eq(sr, one), hn::Eq(sg, one)),
                            hn::And(hn::Eq(sb, one), hn::Eq(coverage, zero)));
  if (hn::AllTrue(d, same)) return 0;
  const auto touched = hn::RebindMask(DI(), hn::Not(same));
  const auto behind = hn::Sub(one, coverage);
  hn::Vec<DB> cr, cg, cb;
  hn::LoadInterleaved3(db, codes, cr, cg, cb);
  hn::StoreInterleaved3(Channel(t[0], cr, in_r, behind, sr, touched),
                        Channel(t[1], cg, in_g, behind, sg, touched),
                        Channel(t[2], cb, in_b, behind, sb, touched), db, codes);
  return hn::CountTrue(DI(), touched);
}

HWY_ATTR std::size_t CompositeCodes(const CodeCurve::Tables8 (&t)[3], const float* object,
                                    const float* r, const float* g, const float* b,
                                    std::uint8_t* codes, std::size_t count) {
  const std::size_t lanes = hn::Lanes(D());
  std::size_t touched = 0, i = 0;
  for (; i + lanes <= count; i += lanes)
    touched +=
        CompositeLanes(t, object ? object + 4 * i : nullptr, r + i, g + i, b + i, codes + 3 * i);
  if (i == count) return touched;
  // The rest goes through full vectors of its own; lanes beyond it are not touched.
  constexpr std::size_t kMost = HWY_MAX_BYTES / sizeof(float);
  HWY_ALIGN float ratios[3][kMost], objects[4 * kMost] = {};
  HWY_ALIGN std::uint8_t last[3 * kMost] = {};
  const std::size_t left = count - i;
  const float* const in[3] = {r + i, g + i, b + i};
  for (std::size_t c = 0; c < 3; ++c) {
    std::fill_n(ratios[c], kMost, 1.f);
    std::copy_n(in[c], left, ratios[c]);
  }
  if (object) std::copy_n(object + 4 * i, 4 * left, objects);
  std::copy_n(codes + 3 * i, 3 * left, last);
  touched += CompositeLanes(t, objects, ratios[0], ratios[1], ratios[2], last);
  std::copy_n(last, 3 * left, codes + 3 * i);
  return touched;
}

// Rows of any length: full vectors where there are as many pixels, the rest through room of its own.
template <class Pixels, class Work>
HWY_INLINE void ForLanes(Pixels* codes, std::size_t count, const Work& work) {
  const std::size_t lanes = hn::Lanes(D());
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) work(i, codes + 3 * i);
  if (i == count) return;
  HWY_ALIGN std::uint8_t last[3 * HWY_MAX_BYTES / sizeof(float)] = {};
  std::copy_n(codes + 3 * i, 3 * (count - i), last);
  work(i, last);
  if constexpr (!std::is_const_v<Pixels>) std::copy_n(last, 3 * (count - i), codes + 3 * i);
}

HWY_ATTR void DecodeCodes(const CodeCurve::Tables8 (&t)[3], const float* const* roundings,
                          const std::uint8_t* codes, std::size_t count, const SignalRows& out) {
  const D d;
  const DI di;
  ForLanes(codes, count, [&](std::size_t i, const std::uint8_t* from) HWY_ATTR {
    hn::Vec<DB> code[3];
    hn::LoadInterleaved3(DB(), from, code[0], code[1], code[2]);
    for (std::size_t c = 0; c < 3; ++c) {
      const auto index = hn::PromoteTo(di, code[c]);
      hn::StoreU(hn::GatherIndex(d, t[c].decode, index), d, out.signal + c * out.stride + i);
      hn::StoreU(hn::GatherIndex(d, roundings[c], index), d, out.rounding + c * out.stride + i);
    }
  });
}

HWY_ATTR void EncodeCodes(const CodeCurve::Tables8 (&t)[3], const SignalRows& in,
                          const std::uint32_t* touched, std::size_t count, std::uint8_t* codes) {
  const D d;
  const DU du;
  const DI di;
  ForLanes(codes, count, [&](std::size_t i, std::uint8_t* to) HWY_ATTR {
    const auto changes = hn::Ne(hn::LoadU(du, touched + i), hn::Zero(du));
    if (hn::AllFalse(du, changes)) return;
    hn::Vec<DB> code[3];
    hn::LoadInterleaved3(DB(), to, code[0], code[1], code[2]);
    for (std::size_t c = 0; c < 3; ++c) {
      const auto now = Encode(t[c], hn::LoadU(d, in.signal + c * in.stride + i));
      code[c] = hn::DemoteTo(
          DB(), hn::IfThenElse(hn::RebindMask(di, changes), now, hn::PromoteTo(di, code[c])));
    }
    hn::StoreInterleaved3(code[0], code[1], code[2], DB(), to);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::compositor
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace penumbra::compositor {
HWY_EXPORT(CompositeCodes);
HWY_EXPORT(DecodeCodes);
HWY_EXPORT(EncodeCodes);

void decode_codes(const CodeCurve& curve, const float* const* roundings, const Rgb8* pixels,
                  std::size_t count, const SignalRows& out) {
  const CodeCurve::Tables8 tables[3] = {curve.tables8(0), curve.tables8(1), curve.tables8(2)};
  HWY_DYNAMIC_DISPATCH(DecodeCodes)(tables, roundings, &pixels->r, count, out);
}

void encode_codes(const CodeCurve& curve, const SignalRows& in, const std::uint32_t* touched,
                  std::size_t count, Rgb8* pixels) {
  const CodeCurve::Tables8 tables[3] = {curve.tables8(0), curve.tables8(1), curve.tables8(2)};
  HWY_DYNAMIC_DISPATCH(EncodeCodes)(tables, in, touched, count, &pixels->r);
}

std::size_t composite_codes(const CodeCurve& curve, const float* object, const float* r,
                            const float* g, const float* b, Rgb8* pixels, std::size_t count) {
  static_assert(sizeof(Rgb8) == 3);
  const CodeCurve::Tables8 tables[3] = {curve.tables8(0), curve.tables8(1), curve.tables8(2)};
  return HWY_DYNAMIC_DISPATCH(CompositeCodes)(tables, object, r, g, b, &pixels->r, count);
}
}  // namespace penumbra::compositor
#endif
