#include <algorithm>
#include <atomic>
#include <numeric>

#include "capture/merge_math.h"
#include "capture/table_kernel.h"
#include "core/half.h"
#include "core/parallel.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kPairs = 65536;

// Information about the radiance grows with the exposure (shot noise): a pair must hold most of it.
bool two_suffice(std::span<const double> products) {
  for (std::size_t k = 0; k < products.size(); ++k) {
    const double all =
        std::accumulate(products.begin() + static_cast<std::ptrdiff_t>(k), products.end(), 0.);
    const double pair = products[k] + (k + 1 < products.size() ? products[k + 1] : 0);
    if (pair < .9 * all) return false;
  }
  return true;
}

unsigned first_clipped(const CodeCurve& curve, int channel, double black_level) {
  unsigned code = 0;
  while (code < 255 && curve.decode(channel, code) + black_level < kClipLevel) ++code;
  return code;
}

}  // namespace

std::optional<TableMerger> TableMerger::make(std::span<const Exposure> exposures,
                                             const calib::Response& response,
                                             const calib::NoiseModel& noise, double black_level) {
  TableMerger out;
  out.order_.resize(exposures.size());
  std::iota(out.order_.begin(), out.order_.end(), 0);
  const auto at = [&](int k) { return exposures[static_cast<std::size_t>(k)]; };
  std::ranges::sort(out.order_, [&](int a, int b) { return at(a).product() > at(b).product(); });
  std::vector<double> products;
  for (int k : out.order_) products.push_back(at(k).product());
  if (exposures.empty() || exposures.size() > 16 || !two_suffice(products)) return std::nullopt;

  const CodeCurve curve = make_code_curve(response, 8, black_level);
  const QuantisationStep step(curve);
  out.channel_sets_ = response.same_for_all_channels() ? 1 : 3;
  out.scale_ =
      static_cast<float>(1 / products.back() / 4096);  // the brightest code fits half floats
  const std::size_t steps = products.size();
  out.tables_.resize(static_cast<std::size_t>(out.channel_sets_) * (steps + 1) * kPairs);
  for (int c = 0; c < 3; ++c) {
    out.clip_code_[static_cast<std::size_t>(c)] =
        static_cast<std::uint8_t>(first_clipped(curve, c, black_level));
    const double floor =
        std::sqrt(noise.variance(0, at(out.order_[0]).gain.value()) + step.variance(c, 0));
    out.black_code_[static_cast<std::size_t>(c)] = static_cast<std::uint8_t>(
        1 + std::min(254u, curve.encode(c, static_cast<float>(2 * floor))));
  }
  for (int c = 0; c < out.channel_sets_; ++c)
    parallel_for(std::size_t{0}, (steps + 1) * 256, [&](std::size_t row) {
      const std::size_t k = row / 256;
      const auto next = static_cast<unsigned>(row % 256);
      std::uint16_t* const table =
          &out.tables_[(static_cast<std::size_t>(c) * (steps + 1) + k) * kPairs + next * 256];
      const Exposure here = at(out.order_[std::min(k, steps - 1)]);
      for (unsigned code = 0; code < 256; ++code) {
        Measurement pair[2] = {{curve.decode(c, code), here.product(), here.gain.value()}, {}};
        std::size_t count = 1;
        if (k + 1 < steps && next < out.clip_code_[static_cast<std::size_t>(c)]) {
          const Exposure shorter = at(out.order_[k + 1]);
          pair[count++] = {curve.decode(c, next), shorter.product(), shorter.gain.value()};
        }
        const double x = estimate_radiance({pair, count}, noise, step, c);
        table[code] = half_from_float(static_cast<float>(x / double(out.scale_)));
      }
    });
  return out;
}

void TableMerger::merge(std::span<const Image<Rgb8>* const> frames, MergedImage& out) const {
  assert(frames.size() == order_.size());
  const int width = frames[0]->width(), height = frames[0]->height();
  if (out.pixels.width() != width || out.pixels.height() != height)
    out.pixels = Image<HalfRgba>(width, height);
  out.scale = scale_;
  const std::size_t set = channel_sets_ == 3 ? (order_.size() + 1) * kPairs : 0;
  std::uint8_t clip[3 * kMergeBlock], black_codes[3 * kMergeBlock];
  for (std::size_t i = 0; i < 3 * kMergeBlock; ++i)
    clip[i] = clip_code_[i % 3], black_codes[i] = black_code_[i % 3];
  const TableView tables{{tables_.data(), tables_.data() + set, tables_.data() + 2 * set},
                         clip,
                         black_codes,
                         static_cast<int>(order_.size())};
  const std::size_t area = out.pixels.area(), whole = area / kMergeBlock;
  std::atomic<std::size_t> clipped = 0, black = 0;
  const auto codes_at = [&](std::size_t k, std::size_t pixel) {
    return &frames[static_cast<std::size_t>(order_[k])]->pixels()[pixel].r;
  };
  parallel_for(std::size_t{0}, whole, 64, [&](const auto& range) {
    BlockCounts sum;
    for (std::size_t block = range.begin(); block < range.end(); ++block) {
      const std::uint8_t* codes[16];
      for (std::size_t k = 0; k < order_.size(); ++k) codes[k] = codes_at(k, block * kMergeBlock);
      const BlockCounts counts =
          merge_block(tables, codes, &out.pixels.pixels()[block * kMergeBlock]);
      sum.clipped += counts.clipped;
      sum.black += counts.black;
    }
    clipped += sum.clipped;
    black += sum.black;
  });
  if (const std::size_t rest = area % kMergeBlock) {
    // The last pixels in a block of their own, repeated so that the counts stay right in
    // proportion.
    std::uint8_t padded[16][3 * kMergeBlock];
    const std::uint8_t* codes[16];
    for (std::size_t k = 0; k < order_.size(); ++k) {
      const std::uint8_t* const source = codes_at(k, whole * kMergeBlock);
      for (std::size_t i = 0; i < 3 * kMergeBlock; ++i) padded[k][i] = source[i % (3 * rest)];
      codes[k] = padded[k];
    }
    HalfRgba pixels[kMergeBlock];
    const BlockCounts counts = merge_block(tables, codes, pixels);
    std::copy_n(pixels, rest, &out.pixels.pixels()[whole * kMergeBlock]);
    clipped += counts.clipped * rest / kMergeBlock;
    black += counts.black * rest / kMergeBlock;
  }
  out.clipped_fraction = static_cast<double>(clipped) / static_cast<double>(area);
  out.black_fraction = static_cast<double>(black) / static_cast<double>(3 * area);
}

}  // namespace penumbra::capture
