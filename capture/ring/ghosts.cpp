// The part of the table merge that sees to what moved: samples that contradict newer ones are left
// out.
#include <algorithm>

#include "capture/hdr/merge.h"
#include "capture/ring/internal/table_kernel.h"
#include "capture/ring/internal/table_merger.h"
#include "core/half.h"

namespace penumbra::capture {

namespace {

// Alpha of a pixel until keep_energy(): minus zero and, in its last bits, which channels are
// undecided.
constexpr std::uint16_t kUndecided = 0x8000;
constexpr std::uint16_t kChannelBits = 7;
bool is_undecided(std::uint16_t alpha) {
  return (alpha & ~kChannelBits) == kUndecided;
}
constexpr float kLargestHalf = 65504;

}  // namespace

// Samples from the newest back; each must agree with all newer ones that stayed. What is left out
// counts as clipped: the merge passes over it.
bool TableMerger::leave_out_contradicted(const BlockJob& job, LeftOut& left) const {
  const std::size_t steps = nominal_.size();
  bool any = false;
  for (std::size_t a = 1; a < steps; ++a) {
    const std::size_t asked = job.all.by_age[a];
    Flags& out = left.of[asked];
    for (std::size_t b = 0; b < a; ++b) {
      const std::size_t known = job.all.by_age[b];
      std::array<std::uint8_t, kBlockSamples> outside;
      mark_outside(allowed(0, known, asked).data(), offsets_.data(), job.codes[known],
                   job.codes[asked], outside.data());
      const Flags& not_known = left.of[known];
      for (std::size_t i = 0; i < out.size(); ++i)
        out[i] |= static_cast<std::uint8_t>(
            (outside[3 * i] | outside[3 * i + 1] | outside[3 * i + 2]) & ~not_known[i]);
    }
    for (std::size_t i = 0; i < out.size(); ++i) left.any[i] |= out[i];
  }
  for (const std::uint8_t flag : left.any) any |= flag != 0;
  return any;
}

// What is clipped in every sample that stayed is at least as bright as the brightest of them says.
void TableMerger::bound_undecided(const BlockJob& job, const LeftOut& left, std::size_t i) const {
  HalfRgba& p = job.out[i];
  p.a = kUndecided;
  std::uint16_t* const channels[] = {&p.r, &p.g, &p.b};
  for (std::size_t c = 0; c < 3; ++c) {
    double bound = 0;
    bool clipped = true;
    for (std::size_t k = 0; k < nominal_.size(); ++k) {
      const std::uint8_t code = job.codes[k][3 * i + c];
      if (left.of[k][i]) continue;
      clipped &= code >= clip_code_[c];
      bound = std::max(bound, static_cast<double>(curve_.decode(static_cast<int>(c), code)) /
                                  current_[k].product());
    }
    if (!clipped) continue;
    p.a = static_cast<std::uint16_t>(p.a | 1u << c);
    *channels[c] = half_from_float(static_cast<float>(bound) / scale_);
  }
}

void TableMerger::merge_mixed(const BlockJob& job, MergeBlock& block) const {
  LeftOut left;
  BlockJob kept = job;
  std::array<std::array<std::uint8_t, kBlockSamples>, kMaxExposures> codes;
  std::array<HalfRgba, kMergeBlock> before;
  const bool any = leave_out_contradicted(job, left);
  if (any) {
    std::copy_n(job.out, kMergeBlock, before.begin());
    for (std::size_t k = 0; k < nominal_.size(); ++k) {
      for (std::size_t i = 0; i < kMergeBlock; ++i)
        for (std::size_t c = 0; c < 3; ++c)
          codes[k][3 * i + c] = left.of[k][i] | job.codes[k][3 * i + c];
      kept.codes[k] = codes[k].data();
    }
  }
  block.counts = merge_real(kept);
  block.undecided = false;
  if (!any) return;
  std::fill(left.any.begin() + static_cast<std::ptrdiff_t>(job.count), left.any.end(), 0);
  for (std::size_t i = 0; i < job.count; ++i)
    if (left.any[i] && job.out[i].a == 0) bound_undecided(job, left, i), block.undecided = true;
  if (!job.all.replaced) return;
  for (std::size_t i = 0; i < job.count; ++i)
    block.vanished_clipped |= left.any[i] && before[i].a == 0 && job.out[i].a == kHalfOne;
  float sums[kMergeBlock / kMergeRun][4];
  sum_differences(before.data(), job.out, left.any.data(), sums);
  for (std::size_t run = 0; run * kMergeRun < job.count; ++run)
    for (std::size_t c = 0; c < 3; ++c)
      block.vanished[c] += static_cast<double>(weights_->of(job.first + run * kMergeRun)) *
                           static_cast<double>(sums[run][c]);
}

// Light that went out of visibility while something became too bright to tell is taken to be the
// same light, evenly spread.
void TableMerger::keep_energy(MergedImage& out) {
  std::array<double, 3> vanished{};
  bool clipped = false;  // what vanished was a lower bound
  for (const MergeBlock& block : blocks_) {
    clipped |= block.vanished_clipped;
    for (std::size_t c = 0; c < 3; ++c) vanished[c] += block.vanished[c];
  }
  const auto each_undecided = [&](const auto& visit) {
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      if (!blocks_[b].undecided) continue;
      const std::size_t end = std::min(out.pixels.area(), (b + 1) * kMergeBlock);
      for (std::size_t i = b * kMergeBlock; i < end; ++i)
        if (is_undecided(out.pixels.pixels()[i].a))
          visit(blocks_[b], out.pixels.pixels()[i], static_cast<double>(weights_->of(i)));
    }
  };
  const auto undecided = [](const HalfRgba& p, std::size_t c) { return (p.a >> c & 1) != 0; };
  std::array<double, 3> weights{};
  each_undecided([&](MergeBlock&, const HalfRgba& p, double weight) {
    for (std::size_t c = 0; c < 3; ++c) weights[c] += undecided(p, c) ? weight : 0;
  });
  std::array<float, 3> more{};
  for (std::size_t c = 0; c < 3; ++c)
    if (weights[c] > 0) more[c] = static_cast<float>(std::max(0., vanished[c]) / weights[c]);
  const bool moved = std::ranges::any_of(more, [](float m) { return m > 0; }),
             known = moved && !clipped;
  each_undecided([&](MergeBlock& block, HalfRgba& p, double) {
    std::uint16_t* const channels[] = {&p.r, &p.g, &p.b};
    for (std::size_t c = 0; c < 3; ++c)
      if (undecided(p, c))
        *channels[c] =
            half_from_float(std::min(kLargestHalf, float_from_half(*channels[c]) + more[c]));
    p.a = known ? kHalfOne : std::uint16_t{0};
    if (known && block.counts.clipped > 0) --block.counts.clipped;
  });
  for (MergeBlock& block : blocks_) block.undecided = false;
}

}  // namespace penumbra::capture
