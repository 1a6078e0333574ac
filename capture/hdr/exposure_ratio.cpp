// Exposure ratios by what two pictures both show.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "capture/hdr/stacks.h"
#include "core/median.h"

namespace penumbra::capture {

namespace {

constexpr int kBlockSide = 4;   // pixels
constexpr int kTilesAlong = 8;  // of a picture, which are drawn whole: neighbours are alike
constexpr int kTiles = kTilesAlong * kTilesAlong;
constexpr std::size_t kFewestBlocks = 50, kMaxBlocks = 4000;
constexpr unsigned kDarkCode = 8;      // below, codes and noise reduction bend the curve
constexpr unsigned kBrightCode = 236;  // above, glow does, and a shoulder
constexpr double kStep = .004;         // about a code: the noise that no signal is without
constexpr int kBins = 24;              // of signal, evenly in its logarithm
constexpr std::size_t kFewestOfBin = 8;
constexpr int kDraws = 200, kSteps = 30;
constexpr double kLowestSignal = 1e-4;

struct Block {
  int channel, tile, bin;
  double a, b;  // mean signals
};

// y_b = slope y_a + offset: the base of a film, or glare inside a camera, adds the same to both.
struct Line {
  double slope = 1;
  std::array<double, 3> offset{};
};

double off(const Block& k, const Line& line) {
  return k.b - line.slope * k.a - line.offset[static_cast<std::size_t>(k.channel)];
}
// Noise grows with the signal: in units that all blocks share.
double sigma(const Block& k, const Line& line) {
  return std::hypot(k.b + kStep, line.slope * (k.a + kStep));
}

int bin_of(double signal) {
  const double at = std::log(std::max(signal, kLowestSignal) / kLowestSignal) /
                    std::log(1 / kLowestSignal) * kBins;
  return std::clamp(static_cast<int>(at), 0, kBins - 1);
}

unsigned code_of(const Rgb8& p, int channel) {
  return channel == 0 ? p.r : channel == 1 ? p.g : p.b;
}

// A shoulder may have any height: what is bright is to be the same for all curves.
double unit_of(const ResponseTable& curve, int channel) {
  return .9 / double(curve.decode(channel, kBrightCode));
}

// Of a block's signals in one channel, if no pixel of either picture clips or is dark.
std::optional<Block> read_block(const Image<Rgb8>& a, const Image<Rgb8>& b,
                                const ResponseTable& curve, int channel, int left, int top) {
  Block out{channel, 0, 0, 0, 0};
  const double unit = unit_of(curve, channel);
  for (int y = top; y < top + kBlockSide; ++y)
    for (int x = left; x < left + kBlockSide; ++x) {
      const unsigned code_a = code_of(a.at(x, y), channel), code_b = code_of(b.at(x, y), channel);
      if (std::min(code_a, code_b) < kDarkCode || std::max(code_a, code_b) > kBrightCode)
        return std::nullopt;
      const double ya = unit * double(curve.decode(channel, code_a)),
                   yb = unit * double(curve.decode(channel, code_b));
      out.a += ya, out.b += yb;
    }
  constexpr double kPixels = kBlockSide * kBlockSide;
  out.a /= kPixels, out.b /= kPixels;
  out.tile = top * kTilesAlong / a.height() * kTilesAlong + left * kTilesAlong / a.width();
  out.bin = bin_of(std::sqrt(std::max(0., out.a * out.b)));
  return out;
}

// Blocks from one that is read to the next, along each axis: a quarter of a million tell enough.
int apart_in(const Image<Rgb8>& a) {
  constexpr double kMax_px = 4e6;
  return std::max(1, static_cast<int>(std::sqrt(static_cast<double>(a.area()) / kMax_px) + .5));
}

std::vector<Block> read_blocks(const Image<Rgb8>& a, const Image<Rgb8>& b,
                               const ResponseTable& curve) {
  std::vector<Block> out;
  const int step = kBlockSide * apart_in(a);
  for (int y = 0; y + kBlockSide <= a.height(); y += step)
    for (int x = 0; x + kBlockSide <= a.width(); x += step)
      for (int c = 0; c < 3; ++c)
        if (const auto block = read_block(a, b, curve, c, x, y)) out.push_back(*block);
  return out;
}

// Every bin has the same say, however many blocks are in it: most of a picture may be dark.
std::vector<Block> chosen(const std::vector<Block>& all) {
  std::array<std::size_t, kBins> count{}, seen{};
  for (const Block& k : all) ++count[static_cast<std::size_t>(k.bin)];
  const auto filled =
      static_cast<std::size_t>(std::ranges::count_if(count, [](std::size_t n) { return n > 0; }));
  const std::size_t room = kMaxBlocks / std::max<std::size_t>(filled, 1);
  std::vector<Block> out;
  for (const Block& k : all) {
    const auto bin = static_cast<std::size_t>(k.bin);
    const std::size_t apart = (count[bin] + room - 1) / room;
    if (seen[bin]++ % apart == 0) out.push_back(k);
  }
  return out;
}

// By the bright half of the bins, since what is added brings the dark ones near 1. Of a bin half of
// the blocks may be wrong.
Line first_line(const std::vector<Block>& blocks) {
  std::vector<double> ratios;
  for (int bin = 0; bin < kBins; ++bin) {
    std::vector<double> logs;
    for (const Block& k : blocks)
      if (k.bin == bin && k.a > 0 && k.b > 0) logs.push_back(std::log(k.b / k.a));
    if (logs.size() >= kFewestOfBin) ratios.push_back(median(logs));
  }
  if (ratios.empty()) return {};
  std::vector<double> bright(ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2),
                             ratios.end());
  return {std::exp(median(bright)), {}};
}

// What is added to a channel is no more than its darkest blocks have, in either picture.
using Darkest = std::array<double, 3>;

Darkest darkest(const std::vector<Block>& blocks) {
  Darkest out{};
  for (int c = 0; c < 3; ++c) {
    std::vector<double> signals;
    for (const Block& k : blocks)
      if (k.channel == c) signals.push_back(std::min(k.a, k.b));
    if (signals.empty()) continue;
    const auto at = signals.begin() + static_cast<std::ptrdiff_t>(signals.size() / 100);
    std::ranges::nth_element(signals, at);
    out[static_cast<std::size_t>(c)] = *at;
  }
  return out;
}

// One step of a robust line with errors in both pictures. `counts`: how often each block counts.
// source: Deming 1943; biweight, Beaton & Tukey 1974
bool refine(const std::vector<Block>& blocks, const Darkest& max_offset,
            const std::vector<int>& counts, double scale, Line& line) {
  struct Moments {
    double w = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
  };
  std::array<Moments, 3> of_channel;
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    const Block& k = blocks[i];
    const double s = sigma(k, line), u = off(k, line) / (s * 4.685 * scale);
    if (std::abs(u) >= 1) continue;
    const double w = counts[i] * std::pow(1 - u * u, 2) / (s * s);
    Moments& m = of_channel[static_cast<std::size_t>(k.channel)];
    m.w += w, m.a += w * k.a, m.b += w * k.b;
    m.aa += w * k.a * k.a, m.bb += w * k.b * k.b, m.ab += w * k.a * k.b;
  }
  double aa = 0, bb = 0, ab = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    const Moments& m = of_channel[c];
    if (m.w <= 0) continue;
    // Added to both: (1 - slope) times as much to the line.
    const double bound = (1 - line.slope) * max_offset[c], free = (m.b - line.slope * m.a) / m.w;
    const double offset = std::clamp(free, std::min(bound, 0.), std::max(bound, 0.));
    line.offset[c] = offset;
    const double mean_a = offset == free ? m.a / m.w : 0;
    const double mean_b = offset == free ? m.b / m.w : offset;
    aa += m.aa - 2 * mean_a * m.a + m.w * mean_a * mean_a;
    bb += m.bb - 2 * mean_b * m.b + m.w * mean_b * mean_b;
    ab += m.ab - mean_a * m.b - mean_b * m.a + m.w * mean_a * mean_b;
  }
  if (!(ab > 0)) return false;
  const double lambda = line.slope * line.slope, d = bb - lambda * aa;
  line.slope = (d + std::sqrt(d * d + 4 * lambda * ab * ab)) / (2 * ab);
  return true;
}

double scale_of(const std::vector<Block>& blocks, const Line& line) {
  std::vector<double> u;
  for (const Block& k : blocks) u.push_back(std::abs(off(k, line)) / sigma(k, line));
  return std::max(1.4826 * median(u), 1e-4);
}

struct Fit {
  Line line;
  Darkest max_offset{};
  double scale = 1;
};

std::optional<Fit> fit(const std::vector<Block>& blocks) {
  const std::vector<int> once(blocks.size(), 1);
  Fit out{first_line(blocks), darkest(blocks)};
  for (int i = 0; i < kSteps; ++i) {
    // Wide at first, so that nothing is thrown out by a line that is not there yet.
    out.scale = std::max(scale_of(blocks, out.line), i < kSteps / 2 ? .1 : 0.);
    if (!refine(blocks, out.max_offset, once, out.scale, out.line)) return std::nullopt;
  }
  return out;
}

double variance(const std::vector<double>& values) {
  double sum = 0, square = 0;
  for (const double v : values) sum += v, square += v * v;
  const auto n = static_cast<double>(values.size());
  return n > 1 ? std::max(0., (square - sum * sum / n) / (n - 1)) : 0;
}

// The logarithm of the ratio where blocks count so often.
std::optional<double> log_ratio(const std::vector<Block>& blocks, const Fit& found,
                                const std::vector<int>& counts) {
  constexpr int kFewSteps = 4;
  Line line = found.line;
  for (int i = 0; i < kFewSteps; ++i)
    if (!refine(blocks, found.max_offset, counts, found.scale, line)) return std::nullopt;
  return std::log(line.slope);
}

// Of the logarithm of the ratio, by drawing tiles: chance.
// source: bootstrap of blocks, Efron & Tibshirani 1993
std::optional<double> sampling_variance(const std::vector<Block>& blocks, const Fit& found) {
  std::mt19937 rng(1);
  std::uniform_int_distribution<std::size_t> pick(0, kTiles - 1);
  std::vector<double> logs;
  std::vector<int> counts(blocks.size());
  for (int n = 0; n < kDraws; ++n) {
    std::array<int, kTiles> draws{};
    for (int t = 0; t < kTiles; ++t) ++draws[pick(rng)];
    for (std::size_t i = 0; i < blocks.size(); ++i)
      counts[i] = draws[static_cast<std::size_t>(blocks[i].tile)];
    if (const auto l = log_ratio(blocks, found, counts)) logs.push_back(*l);
  }
  if (logs.size() < kDraws / 2) return std::nullopt;
  return variance(logs);
}

// The same by leaving out one range of signals after the other: what dark and bright parts tell
// apart, because the curve does not fit.
// source: jackknife, Efron & Tibshirani 1993
double curve_variance(const std::vector<Block>& blocks, const Fit& found) {
  std::vector<double> logs;
  std::vector<int> counts(blocks.size());
  for (int bin = 0; bin < kBins; ++bin) {
    bool any = false;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      counts[i] = blocks[i].bin != bin;
      any |= blocks[i].bin == bin;
    }
    if (!any) continue;
    if (const auto l = log_ratio(blocks, found, counts)) logs.push_back(*l);
  }
  const auto n = static_cast<double>(logs.size());
  return n > 1 ? variance(logs) * (n - 1) * (n - 1) / n : 0;
}

// Blocks whose signals stand apart from those of the others that are as bright, which a wrong curve
// would move together.
double moved_fraction(const std::vector<Block>& all, const Line& line) {
  constexpr double kApart = .12;  // relative: more than codes, noise and a small misalignment
  constexpr double kSpreads = 8;  // robust standard deviations
  std::array<std::vector<double>, std::size_t{kBins} * 3> apart;
  const auto group = [](const Block& k) { return static_cast<std::size_t>(3 * k.bin + k.channel); };
  for (const Block& k : all) apart[group(k)].push_back(off(k, line) / sigma(k, line));
  std::size_t moved = 0;
  for (std::vector<double>& of : apart) {
    if (of.size() < kFewestOfBin) continue;
    const double middle = median(of);
    for (double& v : of) v = std::abs(v - middle);
    const double limit = std::max(kApart, kSpreads * 1.4826 * median(of));
    moved +=
        static_cast<std::size_t>(std::ranges::count_if(of, [&](double v) { return v > limit; }));
  }
  return static_cast<double>(moved) / static_cast<double>(all.size());
}

}  // namespace

Result<ExposureRatio> estimate_exposure_ratio(const Image<Rgb8>& a, const Image<Rgb8>& b,
                                              const ResponseTable& curve, double exponent_sigma) {
  if (!a.same_size(b))
    return fail(ErrorCode::kInvalid, "exposure ratio", "the two pictures differ in size");
  const std::vector<Block> all = read_blocks(a, b, curve);
  const auto undetermined = [](const std::string& why) {
    return fail(ErrorCode::kUndetermined, "exposure ratio",
                why + ": take exposures that lie closer together");
  };
  if (all.size() < kFewestBlocks)
    return undetermined(
        fmt::format("only {} blocks are neither clipped nor dark in both pictures", all.size()));
  const std::vector<Block> blocks = chosen(all);
  const auto found = fit(blocks);
  const auto sampling = found ? sampling_variance(blocks, *found) : std::nullopt;
  if (!sampling) return undetermined("what both pictures show tells no ratio");
  ExposureRatio out;
  const double side = kBlockSide * apart_in(a);
  out.fraction = std::min(
      1., static_cast<double>(all.size()) * side * side / (3. * static_cast<double>(a.area())));
  out.blocks = blocks.size();
  out.moved_fraction = moved_fraction(all, found->line);
  out.ratio = found->line.slope;
  const double of_exponent = std::pow(exponent_sigma * std::log(out.ratio), 2);
  const double sd = std::sqrt(*sampling + curve_variance(blocks, *found) + of_exponent);
  out.low = out.ratio * std::exp(-1.96 * sd);
  out.high = out.ratio * std::exp(1.96 * sd);
  return out;
}

}  // namespace penumbra::capture
