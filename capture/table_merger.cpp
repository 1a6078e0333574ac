#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <numeric>

#include "capture/merge_math.h"
#include "core/half.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kPairs = 65536;
constexpr int kBlock = 256;  // pixels whose codes are sorted out together; everything stays in cache

// Information about the radiance grows with the exposure (shot noise): a pair must hold most of it.
bool two_suffice(std::span<const double> products) {
  for (std::size_t k = 0; k < products.size(); ++k) {
    const double all = std::accumulate(products.begin() + static_cast<std::ptrdiff_t>(k), products.end(), 0.);
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

std::optional<TableMerger> TableMerger::make(std::span<const Exposure> exposures, const calib::Response& response,
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
  out.scale_ = static_cast<float>(1 / products.back() / 4096);  // the brightest code fits half floats
  const std::size_t steps = products.size();
  out.tables_.resize(static_cast<std::size_t>(out.channel_sets_) * (steps + 1) * kPairs);
  for (int c = 0; c < 3; ++c) {
    out.clip_code_[static_cast<std::size_t>(c)] = static_cast<std::uint8_t>(first_clipped(curve, c, black_level));
    const double floor = std::sqrt(noise.variance(0, at(out.order_[0]).gain.value()) + step.variance(c, 0));
    out.black_code_[static_cast<std::size_t>(c)] =
        static_cast<std::uint8_t>(curve.encode(c, static_cast<float>(2 * floor)));
  }
  for (int c = 0; c < out.channel_sets_; ++c)
    tbb::parallel_for(std::size_t{0}, (steps + 1) * 256, [&](std::size_t row) {
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

namespace {

// Which exposure decides each code, and the table entry that holds the answer.
struct Selector {
  alignas(64) std::uint8_t low[3 * kBlock], high[3 * kBlock], step[3 * kBlock];
  alignas(64) std::uint8_t clip[3 * kBlock];
  alignas(64) std::uint32_t index[3 * kBlock];

  explicit Selector(const std::array<std::uint8_t, 3>& clip_code) {
    for (int i = 0; i < 3 * kBlock; ++i) clip[i] = clip_code[static_cast<std::size_t>(i % 3)];
  }

  // From the shortest exposure up, each unclipped longer one takes over; plain byte loops vectorise.
  void select(std::span<const std::uint8_t* const> codes, std::size_t first, int count) {
    const auto steps = static_cast<int>(codes.size());
    for (int i = 0; i < count; ++i) {
      low[i] = codes[static_cast<std::size_t>(steps - 1)][first + static_cast<std::size_t>(i)];
      high[i] = 0;
      step[i] = static_cast<std::uint8_t>(steps);
    }
    for (int k = steps - 1; k >= 0; --k) {
      const std::uint8_t* const here = codes[static_cast<std::size_t>(k)] + first;
      const std::uint8_t* const next = k + 1 < steps ? codes[static_cast<std::size_t>(k + 1)] + first : nullptr;
      const auto number = static_cast<std::uint8_t>(k);
      for (int i = 0; i < count; ++i) {
        const bool open = here[i] < clip[i];
        low[i] = open ? here[i] : low[i];
        step[i] = open ? number : step[i];
      }
      if (next) {
        for (int i = 0; i < count; ++i) high[i] = here[i] < clip[i] ? next[i] : high[i];
      } else {
        for (int i = 0; i < count; ++i) high[i] = here[i] < clip[i] ? 0 : high[i];
      }
    }
    for (int i = 0; i < count; ++i)
      index[i] = static_cast<std::uint32_t>(low[i]) | static_cast<std::uint32_t>(high[i]) << 8 |
                 static_cast<std::uint32_t>(step[i]) << 16;
  }
};

}  // namespace

void TableMerger::merge(std::span<const Image<Rgb8>* const> frames, MergedImage& out) const {
  assert(frames.size() == order_.size());
  const int width = frames[0]->width(), height = frames[0]->height();
  if (out.pixels.width() != width || out.pixels.height() != height) out.pixels = Image<HalfRgba>(width, height);
  out.scale = scale_;
  const std::uint8_t* codes[16];
  for (std::size_t k = 0; k < order_.size(); ++k)
    codes[k] = &frames[static_cast<std::size_t>(order_[k])]->pixels()[0].r;
  const std::span<const std::uint8_t* const> ordered(codes, order_.size());
  const std::size_t set = channel_sets_ == 3 ? (order_.size() + 1) * kPairs : 0;
  const std::uint16_t *red = tables_.data(), *green = red + set, *blue = green + set;
  const auto all_clipped = static_cast<std::uint8_t>(order_.size());
  const std::size_t area = out.pixels.area();
  std::atomic<std::size_t> clipped = 0, black = 0;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, (area + kBlock - 1) / kBlock, 64), [&](const auto& range) {
    Selector selector(clip_code_);
    std::size_t clipped_here = 0, black_here = 0;
    for (std::size_t block = range.begin(); block < range.end(); ++block) {
      const std::size_t first = block * kBlock;
      const int count = static_cast<int>(std::min<std::size_t>(kBlock, area - first));
      selector.select(ordered, 3 * first, 3 * count);
      HalfRgba* const target = &out.pixels.pixels()[first];
      for (int i = 0; i < count; ++i) {
        const std::uint8_t* const step = &selector.step[3 * i];
        const bool lost = step[0] == all_clipped || step[1] == all_clipped || step[2] == all_clipped;
        target[i] = {red[selector.index[3 * i]], green[selector.index[3 * i + 1]],
                     blue[selector.index[3 * i + 2]], lost ? std::uint16_t{0} : kHalfOne};
        clipped_here += lost;
      }
      const std::uint8_t* const longest = codes[0] + 3 * first;
      for (int i = 0; i < count; ++i)
        black_here += longest[3 * i] <= black_code_[0] && longest[3 * i + 1] <= black_code_[1] &&
                      longest[3 * i + 2] <= black_code_[2];
    }
    clipped += clipped_here;
    black += black_here;
  });
  out.clipped_fraction = static_cast<double>(clipped) / static_cast<double>(area);
  out.black_fraction = static_cast<double>(black) / static_cast<double>(area);
}

}  // namespace penumbra::capture
