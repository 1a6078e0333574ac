#include "capture/ring/internal/table_merger.h"

#include <algorithm>

#include "capture/hdr/merge_math.h"
#include "core/half.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kPairs = 65536;
constexpr double kSameExposure = .002;  // a smaller change of an exposure is not worth new tables

// Information about the radiance grows with the exposure (shot noise): a pair must hold most of it.
bool two_suffice(std::span<const Exposure> exposures) {
  for (std::size_t k = 0; k < exposures.size(); ++k) {
    double all = 0;
    for (const Exposure& e : exposures.subspan(k)) all += e.product();
    const double next = k + 1 < exposures.size() ? exposures[k + 1].product() : 0;
    if (exposures[k].product() + next < .9 * all) return false;
  }
  return true;
}

// What the block after the next needs, into the cache.
void fetch_ahead(const std::uint8_t* codes) {
  for (int i = 0; i < kBlockSamples; i += 64) __builtin_prefetch(codes + 2 * kBlockSamples + i);
}

unsigned first_clipped(const ResponseTable& curve, int channel, double black_level) {
  unsigned code = 0;
  while (code < 255 && static_cast<double>(curve.decode(channel, code)) + black_level < kClipLevel)
    ++code;
  return code;
}

}  // namespace

TableMerger::TableMerger(const CameraInfo& camera)
    : curve_(make_response_table(camera.response, 8, camera.black_level)),
      projection_(camera.projection),
      noise_(camera.noise),
      max_sigmas_(max_sigmas(camera.noise_known)),
      channel_sets_(camera.response.same_for_all_channels() ? 1 : 3) {}

std::optional<TableMerger> TableMerger::make(std::span<const Exposure> exposures,
                                             const CameraInfo& camera) {
  if (exposures.empty() || exposures.size() > kMaxExposures || !two_suffice(exposures))
    return std::nullopt;
  TableMerger out(camera);
  out.nominal_.assign(exposures.begin(), exposures.end());
  out.current_ = out.nominal_;
  out.scale_ =
      static_cast<float>(1 / exposures.back().product() / 4096);  // the brightest code fits
  const QuantisationStep step(out.curve_);
  for (int c = 0; c < 3; ++c) {
    const auto channel = static_cast<std::size_t>(c);
    out.clip_code_[channel] =
        static_cast<std::uint8_t>(first_clipped(out.curve_, c, camera.black_level));
    const double floor =
        std::sqrt(out.noise_.variance(0, exposures[0].gain.value()) + step.variance(c, 0));
    const auto black = static_cast<std::uint8_t>(
        1 + std::min(254u, out.curve_.encode(c, static_cast<float>(2 * floor))));
    for (std::size_t i = channel; i < std::size_t{kBlockSamples}; i += 3)
      out.clip_[i] = out.clip_code_[channel], out.black_[i] = black,
      out.offsets_[i] = static_cast<std::int32_t>(channel % out.channel_sets_ * exposures.size() *
                                                  exposures.size() * 256);
  }
  out.fill_tables();
  out.allowed_.resize(out.channel_sets_ * exposures.size() * exposures.size());
  for (std::size_t k = 0; k < exposures.size(); ++k) out.compare_exposures(k);
  return out;
}

void TableMerger::fill_tables() {
  const std::size_t steps = nominal_.size();
  nominal_tables_.resize(channel_sets_ * (steps + 1) * kPairs);
  const QuantisationStep step(curve_);
  parallel_for(std::size_t{0}, channel_sets_ * (steps + 1) * 256, [&](std::size_t row) {
    const std::size_t set = row / 256 / (steps + 1), k = row / 256 % (steps + 1);
    const auto c = static_cast<int>(set);
    const auto next = static_cast<unsigned>(row % 256);
    std::uint16_t* const table = &nominal_tables_[row * 256];
    const Exposure here = nominal_[std::min(k, steps - 1)];
    for (unsigned code = 0; code < 256; ++code) {
      Measurement pair[2] = {
          {static_cast<double>(curve_.decode(c, code)), here.product(), here.gain.value()}, {}};
      std::size_t count = 1;
      if (k + 1 < steps && next < clip_code_[set]) {
        const Exposure shorter = nominal_[k + 1];
        pair[count++] = {static_cast<double>(curve_.decode(c, next)), shorter.product(),
                         shorter.gain.value()};
      }
      const double x = estimate_radiance({pair, count}, noise_, step, c);
      table[code] = half_from_float(static_cast<float>(x / static_cast<double>(scale_)));
    }
  });
  tables_ = nominal_tables_;
}

// Flicker moves exposures by a few per cent, each frame by another amount. To first order a pair's
// radiance moves by its members' changes, weighted by their fraction of the light.
void TableMerger::scale_step(std::size_t step) {
  const std::size_t last = nominal_.size() - 1, k = std::min(step, last);
  const auto change = [&](std::size_t i) { return nominal_[i].product() / current_[i].product(); };
  const double alone = change(k);
  double pair = alone;
  if (step < last) {
    const double fraction =
        current_[k].product() / (current_[k].product() + current_[k + 1].product());
    pair = fraction * alone + (1 - fraction) * change(k + 1);
  }
  for (std::size_t set = 0; set < channel_sets_; ++set)
    parallel_for(std::size_t{0}, std::size_t{256}, 32, [&](const auto& rows) {
      for (std::size_t next = rows.begin(); next < rows.end(); ++next) {
        const auto factor = static_cast<float>(next < clip_code_[set] ? pair : alone);
        const std::size_t row = ((set * (last + 2) + step) * 256 + next) * 256;
        for (std::size_t i = row; i < row + 256; ++i)
          tables_[i] = half_from_float(factor * float_from_half(nominal_tables_[i]));
      }
    });
}

void TableMerger::follow(std::span<const MergeSlot> slots) {
  for (std::size_t k = 0; k < slots.size(); ++k) {
    if (std::abs(slots[k].exposure.product() / current_[k].product() - 1) < kSameExposure) continue;
    current_[k] = slots[k].exposure;
    compare_exposures(k);
    if (k > 0) scale_step(k - 1);
    scale_step(k);
    if (k + 1 == slots.size()) scale_step(k + 1);  // the bound of what is clipped everywhere
  }
}

CodeSamples TableMerger::samples(std::size_t channel) const {
  return {curve_, noise_, QuantisationStep(curve_), clip_code_[channel], static_cast<int>(channel)};
}

AllowedCodes& TableMerger::allowed(std::size_t channel, std::size_t known, std::size_t asked) {
  return allowed_[(channel % channel_sets_ * nominal_.size() + known) * nominal_.size() + asked];
}
const AllowedCodes& TableMerger::allowed(std::size_t channel, std::size_t known,
                                         std::size_t asked) const {
  return const_cast<TableMerger*>(this)->allowed(channel, known, asked);
}

void TableMerger::compare_exposures(std::size_t one) {
  for (std::size_t set = 0; set < channel_sets_; ++set)
    for (std::size_t k = 0; k < current_.size(); ++k) {
      if (k == one) continue;
      allowed(set, one, k) = allowed_codes(samples(set), current_[one], current_[k], max_sigmas_);
      allowed(set, k, one) = allowed_codes(samples(set), current_[k], current_[one], max_sigmas_);
    }
}

CodeTolerance TableMerger::tolerance(const Exposure& now, const Exposure& before) const {
  constexpr double kEver = 1.7;  // 6 standard deviations, where `often` means 3.5
  CodeTolerance out{};
  for (std::size_t set = 0; set < channel_sets_; ++set) {
    const AllowedCodes often = allowed_codes(samples(set), now, before, max_sigmas_),
                       ever = allowed_codes(samples(set), now, before, kEver * max_sigmas_);
    const auto widen = [](std::uint8_t& tolerance, int code, std::uint32_t interval) {
      const int low = interval & 255, high = static_cast<int>(interval >> 8);
      tolerance = static_cast<std::uint8_t>(std::max<int>({tolerance, code - low, high - code}));
    };
    for (std::size_t code = 0; code < clip_code_[set]; ++code) {
      widen(out.often[code / 16], static_cast<int>(code), often[code]);
      widen(out.ever[code / 16], static_cast<int>(code), ever[code]);
    }
    // Clipped codes say the same, however far they lie apart.
    for (std::size_t code = (clip_code_[set] + 15u) / 16 * 16; code < 256; ++code)
      out.often[code / 16] = out.ever[code / 16] = static_cast<std::uint8_t>(255 - clip_code_[set]);
  }
  return out;
}

TableView TableMerger::view() const {
  const std::size_t set = channel_sets_ == 3 ? (nominal_.size() + 1) * kPairs : 0;
  return {{tables_.data(), tables_.data() + set, tables_.data() + 2 * set},
          clip_.data(),
          black_.data(),
          static_cast<int>(nominal_.size())};
}

TableMerger::MergeJob TableMerger::describe(std::span<const MergeSlot> slots,
                                            const MergeSlot* replaced) const {
  MergeJob job;
  for (std::size_t k = 0; k < slots.size(); ++k) {
    job.codes[k] = &slots[k].pixels->pixels()[0].r;
    job.by_age[k] = static_cast<std::uint8_t>(k);
  }
  std::sort(job.by_age.begin(), job.by_age.begin() + static_cast<std::ptrdiff_t>(slots.size()),
            [&](std::size_t a, std::size_t b) { return slots[a].placed > slots[b].placed; });
  job.now = slots[job.newest()].placed;
  job.oldest = slots[job.by_age[slots.size() - 1]].placed;
  if (replaced) {
    job.replaced = &replaced->pixels->pixels()[0].r;
    job.tolerance = tolerance(slots[job.newest()].exposure, replaced->exposure);
  }
  return job;
}

void TableMerger::update(std::span<const MergeSlot> slots, const MergeSlot* replaced,
                         MergedImage& out) {
  assert(slots.size() == nominal_.size());
  const Image<Rgb8>& any = *slots[0].pixels;
  follow(slots);
  if (!out.pixels.same_size(any)) out.pixels = Image<HalfRgba>(any.width(), any.height());
  if (!weights_) weights_.emplace(projection_);
  const std::size_t area = out.pixels.area(), whole = area / kMergeBlock;
  if (blocks_.size() != (area + kMergeBlock - 1) / kMergeBlock) {
    blocks_.assign((area + kMergeBlock - 1) / kMergeBlock, {});
    replaced = nullptr;
  }
  out.scale = scale_;
  const MergeJob job = describe(slots, replaced);
  // Nothing is known of what stood there before: older frames may show anything.
  if (!replaced)
    for (MergeBlock& block : blocks_) block.changed = job.now;
  parallel_for(std::size_t{0}, whole, 64, [&](const auto& range) {
    for (std::size_t b = range.begin(); b < range.end(); ++b) {
      const std::size_t first = b * kMergeBlock;
      BlockJob block{job,
                     {},
                     job.replaced ? job.replaced + 3 * first : nullptr,
                     &out.pixels.pixels()[first],
                     first,
                     kMergeBlock};
      if (job.replaced && b + 3 < whole) fetch_ahead(block.replaced);
      for (std::size_t k = 0; k < slots.size(); ++k) {
        block.codes[k] = job.codes[k] + 3 * first;
        const bool needed = k <= blocks_[b].counts.deepest || k == job.newest();
        if (needed && b + 3 < whole) fetch_ahead(block.codes[k]);
      }
      update_block(block, blocks_[b]);
    }
  });
  if (area % kMergeBlock) update_rest(job, out);
  keep_energy(out);
  std::size_t clipped = 0, black = 0;
  for (const MergeBlock& b : blocks_) clipped += b.counts.clipped, black += b.counts.black;
  out.clipped_fraction = static_cast<double>(clipped) / static_cast<double>(area);
  out.black_fraction = static_cast<double>(black) / static_cast<double>(3 * area);
}

// The last pixels in a block of their own, repeated so that the counts stay right in proportion.
void TableMerger::update_rest(const MergeJob& job, MergedImage& out) {
  using Codes = std::array<std::uint8_t, kBlockSamples>;
  const std::size_t first = (blocks_.size() - 1) * kMergeBlock, rest = out.pixels.area() - first;
  const auto repeat = [&](const std::uint8_t* source, Codes& codes) {
    for (std::size_t i = 0; i < codes.size(); ++i) codes[i] = source[3 * first + i % (3 * rest)];
    return codes.data();
  };
  std::array<Codes, kMaxExposures + 1> padded;
  std::array<HalfRgba, kMergeBlock> pixels{};
  std::copy_n(&out.pixels.pixels()[first], rest, pixels.begin());
  BlockJob block{job, {}, nullptr, pixels.data(), first, rest};
  for (std::size_t k = 0; k < nominal_.size(); ++k)
    block.codes[k] = repeat(job.codes[k], padded[k]);
  if (job.replaced) block.replaced = repeat(job.replaced, padded[kMaxExposures]);
  update_block(block, blocks_.back());
  std::copy_n(pixels.begin(), rest, &out.pixels.pixels()[first]);
}

// Counts in proportion where the block repeats pixels.
BlockCounts TableMerger::merge_real(const BlockJob& job) const {
  BlockCounts counts = merge_block(view(), job.codes.data(), job.out);
  counts.clipped = static_cast<std::uint16_t>(counts.clipped * job.count / kMergeBlock);
  counts.black = static_cast<std::uint16_t>(counts.black * job.count / kMergeBlock);
  return counts;
}

void TableMerger::update_block(const BlockJob& job, MergeBlock& block) const {
  block.vanished = {};
  block.vanished_clipped = false;
  const MergeJob& all = job.all;
  const bool anew = all.replaced == nullptr;
  if (!anew && block_changed(all.tolerance, job.codes[all.newest()], job.replaced))
    block.changed = all.now;
  const bool was_mixed = block.mixed;
  block.mixed = all.oldest < block.changed;
  if (block.mixed) return merge_mixed(job, block);
  if (!anew && !was_mixed && all.newest() > block.counts.deepest) return;
  block.counts = merge_real(job);
}

}  // namespace penumbra::capture
