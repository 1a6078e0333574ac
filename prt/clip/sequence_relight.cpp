#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "prt/clip/sequence_relight.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "lighting/sh/rotation.h"
#include "prt/clip/sequence.h"
#include "prt/transfer/transfer.h"

HWY_BEFORE_NAMESPACE();
namespace penumbra::prt {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// out[p] = sum over terms of colour times map[p], for three colours, two vectors at a time. `count`
// is a multiple of TransferSequence::kLanes.
HWY_ATTR void SumTerms(const std::int16_t* values, const std::int8_t* narrow,
                       const RelightPlan::Term* terms, std::size_t wide_count,
                       std::size_t term_count, std::size_t count, float* r, float* g, float* b) {
  const hn::CappedTag<float, 16> d;
  const hn::Rebind<std::int16_t, decltype(d)> d16;
  const hn::Rebind<std::int8_t, decltype(d)> d8;
  const hn::Rebind<std::int32_t, decltype(d)> d32;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t p = 0; p < count; p += 2 * lanes) {
    auto r0 = hn::Zero(d), g0 = hn::Zero(d), b0 = hn::Zero(d);
    auto r1 = hn::Zero(d), g1 = hn::Zero(d), b1 = hn::Zero(d);
    const auto sum = [&](auto d_map, const auto* maps, std::size_t first,
                         std::size_t last) HWY_ATTR {
      for (std::size_t k = first; k < last; ++k) {
        const RelightPlan::Term& t = terms[k];
        const auto* const map = maps + t.offset + p;
        const auto v0 = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d_map, map)));
        const auto v1 = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d_map, map + lanes)));
        const auto lr = hn::Set(d, t.r), lg = hn::Set(d, t.g), lb = hn::Set(d, t.b);
        r0 = hn::MulAdd(v0, lr, r0);
        r1 = hn::MulAdd(v1, lr, r1);
        g0 = hn::MulAdd(v0, lg, g0);
        g1 = hn::MulAdd(v1, lg, g1);
        b0 = hn::MulAdd(v0, lb, b0);
        b1 = hn::MulAdd(v1, lb, b1);
      }
    };
    sum(d16, values, 0, wide_count);
    sum(d8, narrow, wide_count, term_count);
    hn::StoreU(r0, d, r + p);
    hn::StoreU(r1, d, r + p + lanes);
    hn::StoreU(g0, d, g + p);
    hn::StoreU(g1, d, g + p + lanes);
    hn::StoreU(b0, d, b + p);
    hn::StoreU(b1, d, b + p + lanes);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace penumbra::prt
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include "core/threads/parallel.h"

namespace penumbra::prt {
HWY_EXPORT(SumTerms);

namespace {

const glm::mat3 kNoTurn(1);

const glm::mat3& turn_of(std::span<const glm::mat3> turns, int bone) {
  return turns.empty() ? kNoTurn : turns[static_cast<std::size_t>(bone)];
}

}  // namespace

std::span<const float> mean_band_energy() {
  static constexpr float kEnergy[kMaxBands] = {1, .31f, .26f, .23f, .18f, .20f, .18f, .17f, .18f};
  return kEnergy;
}

int TransferSequence::max_components() const {
  std::ptrdiff_t largest = 1;
  for (const BoneGroup& g : groups_)
    for (const Component& c : g.components)
      largest = std::max(largest,
                         std::ranges::count(g.components, c.first_frame, &Component::first_frame));
  return static_cast<int>(largest) - 1;
}

float TransferSequence::weight_at(const Component& c, double frame) const {
  const double inside = frame - std::floor(frame / frames_) * frames_;
  const int first = std::min(static_cast<int>(inside), frames_ - 1);
  const int second = first + 1 == frames_ ? 0 : first + 1;
  return std::lerp(c.at(first), c.at(second), static_cast<float>(inside - first));
}

void TransferSequence::finish_maps() {
  narrow_.resize(values_.size());
  for (std::size_t i = 0; i < values_.size(); ++i)
    narrow_[i] = static_cast<std::int8_t>(values_[i]);
  for (BoneGroup& g : groups_)
    for (Component& c : g.components)
      for (Map& map : c.maps) {
        if (map.none()) continue;
        const std::span values = std::span(values_).subspan(map.offset, g.count);
        double square = 0;
        for (const std::int16_t v : values) square += static_cast<double>(v) * v;
        map.mean_square = static_cast<float>(square / static_cast<double>(g.count));
        map.wide = !std::ranges::equal(values, std::span(narrow_).subspan(map.offset, g.count));
      }
}

namespace {

// The energy below which terms can go that together are at most `fraction` of all; in steps of a
// quarter of an octave.
float unseen_energy(std::span<const TermEnergy> terms, float fraction) {
  constexpr int kShift = 21;
  constexpr std::uint32_t kBuckets = 0x7f800000u >> kShift;  // up to infinity
  std::array<float, kBuckets> sums{};
  float all = 0;
  for (const TermEnergy& t : terms) {
    sums[std::min(std::bit_cast<std::uint32_t>(t.energy) >> kShift, kBuckets - 1)] += t.energy;
    all += t.energy;
  }
  float sum = 0;
  std::uint32_t i = 0;
  while (i < kBuckets && (sum += sums[i]) <= fraction * all) ++i;
  return std::bit_cast<float>(i << kShift);
}

// Of the terms that were added last.
void keep_what_is_seen(std::span<const TermEnergy> energies, std::vector<RelightPlan::Term>& terms,
                       RelightPlan::RelightPart& part) {
  constexpr float kUnseen = TransferSequence::kUnseen;
  const float smallest = unseen_energy(energies, kUnseen * kUnseen);
  std::uint32_t kept = part.first_term;
  for (std::size_t i = 0; i < energies.size(); ++i) {
    if (energies[i].energy < smallest) continue;
    terms[kept++] = terms[part.first_term + i];
    part.wide_count += energies[i].wide;
  }
  part.term_count = kept - part.first_term;
  terms.resize(kept);
}

}  // namespace

void TransferSequence::add_terms(const BoneGroup& group, double frame, const RadianceSh& seen,
                                 bool wide, std::vector<RelightPlan::Term>& terms,
                                 std::vector<TermEnergy>& energies) const {
  for (const Component& c : group.components) {
    const float weight = weight_at(c, frame);
    if (weight == 0) continue;
    for (int l = 0, n = 0; l < seen.bands(); ++l)
      for (int m = -l; m <= l; ++m, ++n) {
        const Map& map = c.maps[static_cast<std::size_t>(n)];
        if (map.none() || map.wide != wide) continue;
        const Rgb k = seen[n] * (weight * step_[static_cast<std::size_t>(l)]);
        terms.push_back({map.offset, group.plane == 2 ? 0 : k.r, group.plane == 0 ? k.g : 0,
                         group.plane == 1 ? 0 : k.b});
        const RelightPlan::Term& t = terms.back();
        const float brightest = std::max({std::abs(t.r), std::abs(t.g), std::abs(t.b)});
        energies.push_back({brightest * brightest * map.mean_square, wide});
      }
  }
}

void TransferSequence::plan(double frame, const RadianceSh& light, std::span<const glm::mat3> turns,
                            RelightPlan& out) const {
  const int bands = std::min(bands_, light.bands());
  const auto planes = static_cast<std::size_t>(channels_);
  out.terms.clear();
  out.parts.clear();
  thread_local std::vector<TermEnergy> energies;  // grows once per thread
  for (std::size_t first = 0; first < groups_.size(); first += planes) {
    const BoneGroup& group = groups_[first];
    // The light as the bone sees it.
    const RadianceSh seen =
        lighting::ShRotation(glm::dmat3(glm::transpose(turn_of(turns, group.bone))), bands) *
        light.with_bands(bands);
    RelightPlan::RelightPart part{static_cast<std::uint32_t>(out.terms.size()), 0,
                                  static_cast<std::uint32_t>(group.first),
                                  static_cast<std::uint32_t>(group.count), 0};
    energies.clear();
    for (const bool wide : {true, false})
      for (std::size_t plane = 0; plane < planes; ++plane)
        add_terms(groups_[first + plane], frame, seen, wide, out.terms, energies);
    keep_what_is_seen(energies, out.terms, part);
    out.parts.push_back(part);
  }
}

void TransferSequence::relight(double frame, const RadianceSh& light,
                               std::span<const glm::mat3> turns, std::span<float> out) const {
  assert(out.size() >= 3 * stride());
  thread_local RelightPlan scratch;
  plan(frame, light, turns, scratch);
  const RelightPlan& todo = scratch;  // workers must not look up their own
  parallel_for(std::size_t{0}, todo.parts.size(), 4, [&](const auto& range) {
    thread_local std::vector<float> sums;
    for (std::size_t k = range.begin(); k < range.end(); ++k) {
      const RelightPlan::RelightPart& part = todo.parts[k];
      const std::size_t count = (part.point_count + kLanes - 1) / kLanes * kLanes;
      sums.resize(3 * count);
      HWY_DYNAMIC_DISPATCH(SumTerms)
      (values_.data(), narrow_.data(), todo.terms.data() + part.first_term, part.wide_count,
       part.term_count, count, &sums[0], &sums[count], &sums[2 * count]);
      for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t i = 0; i < part.point_count; ++i)
          out[c * stride() + order_[part.first_point + i]] = sums[c * count + i];
    }
  });
}

void TransferSequence::decode(double frame, std::span<const glm::mat3> turns, Transfer& out) const {
  if (out.bands != bands_ || out.channels != channels_ || out.points != points_)
    out = Transfer(bands_, channels_, points_);
  out.values.make_own();  // before threads write into it
  const auto planes = static_cast<std::size_t>(channels_);
  parallel_for(std::size_t{0}, groups_.size() / planes, [&](std::size_t part) {
    constexpr std::size_t kBlock = 64;
    const BoneGroup& first = groups_[part * planes];
    const bool turned = !turns.empty();
    const lighting::ShRotation turn(glm::dmat3(turn_of(turns, first.bone)), bands_);
    const auto count = static_cast<std::size_t>(coefficient_count(bands_));
    std::vector<float> values(planes * count * kBlock);
    for (std::size_t begin = 0; begin < first.count; begin += kBlock) {
      const std::size_t block = std::min(kBlock, first.count - begin);
      std::ranges::fill(values, 0.f);
      for (std::size_t plane = 0; plane < planes; ++plane)
        for (const Component& c : groups_[part * planes + plane].components) {
          const float weight = weight_at(c, frame);
          if (weight == 0) continue;
          for (int l = 0, n = 0; l < bands_; ++l)
            for (int m = -l; m <= l; ++m, ++n) {
              const Map& kept = c.maps[static_cast<std::size_t>(n)];
              if (kept.none()) continue;
              const std::int16_t* map = &values_[kept.offset + begin];
              const float k = weight * step_[static_cast<std::size_t>(l)];
              float* const sum = &values[(plane * count + static_cast<std::size_t>(n)) * kBlock];
              for (std::size_t i = 0; i < block; ++i) sum[i] += k * static_cast<float>(map[i]);
            }
        }
      for (std::size_t i = 0; i < block; ++i) {
        TransferSh t(bands_);
        for (int n = 0; n < t.size(); ++n) {
          const auto at = [&](std::size_t plane) {
            return values[(plane * count + static_cast<std::size_t>(n)) * kBlock + i];
          };
          const float green = at(0);
          t[n] = planes == 1 ? Rgb{green, green, green} : Rgb{green + at(1), green, green + at(2)};
        }
        if (turned) t = turn * t;
        const std::uint32_t point = order_[first.first + begin + i];
        for (int c = 0; c < channels_; ++c)
          for (int n = 0; n < t.size(); ++n) out.set(c, n, point, t[n][c]);
      }
    }
  });
}

}  // namespace penumbra::prt
#endif
