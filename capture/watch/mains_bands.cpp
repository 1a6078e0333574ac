#include "capture/watch/mains_bands.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "capture/hdr/merge_math.h"
#include "core/conventions.h"
#include "core/median.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

namespace {

constexpr int kMinBandFrames = 8;                   // in the mean, before anything is believed
constexpr float kBright = .75f;                     // of full scale
constexpr double kMedian = 1.57;                    // variance of a median over that of a mean
constexpr double kScene = .005;                     // what a row is uncertain by beside noise
constexpr double kChange = .02;                     // of the light, by which a scene has changed
constexpr double kOfLate = .9;                      // of the figures before
constexpr double kExplained = .7;                   // of the rows' change, by a wave
constexpr double kSeen = .002;                      // of the light
constexpr double kFlicker = .25;                    // a third of a stop: more is a change of light
constexpr double kPhaseOfLate = .85, kStands = .6;  // of the waves' mean place: 1 where they stand
constexpr double kReachOfLate = .98;
constexpr double kMeanWave = .03;  // a frame, of the mean wave
constexpr int kPatience = 4;       // frames that no wave explains
constexpr int kMinRows = PictureHistory::kGrid.rows / 2;
constexpr double kAgrees = .6;                // cosine, in the mean of late
constexpr int kFirstOvertone = 4, kWave = 2;  // terms beside the constant

double row_place(int row) {
  return (row + .5) / PictureHistory::kGrid.rows;
}

// Gauss's elimination of the normal equations of at most five unknowns.
template <int n>
MainsBands::WaveFit fit_wave(std::span<const MainsBands::RowChange> rows,
                             const MainsBands::Basis& basis_of) {
  double matrix[n][n + 1] = {};
  MainsBands::WaveFit out;
  double weights = 0;
  for (int row = 0; row < std::ssize(rows); ++row) {
    const auto& [y, weight] = rows[static_cast<std::size_t>(row)];
    const auto& basis = basis_of[static_cast<std::size_t>(row)];
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) matrix[i][j] += weight * basis[i] * basis[j];
      matrix[i][n] += weight * basis[i] * y;
    }
    out.left += weight * y * y;
    weights += weight;
  }
  double right[n];
  for (int i = 0; i < n; ++i) right[i] = matrix[i][n];
  for (int i = 0; i < n; ++i) {
    matrix[i][i] += 1e-4 * weights;  // terms that the rows cannot tell apart stay small
    for (int j = i + 1; j < n; ++j) {
      const double factor = matrix[j][i] / matrix[i][i];
      for (int k = i; k <= n; ++k) matrix[j][k] -= factor * matrix[i][k];
    }
  }
  for (int i = n - 1; i >= 0; --i) {
    double value = matrix[i][n];
    for (int k = i + 1; k < n; ++k) value -= matrix[i][k] * out.terms[static_cast<std::size_t>(k)];
    out.terms[static_cast<std::size_t>(i)] = value / matrix[i][i];
    out.left -= out.terms[static_cast<std::size_t>(i)] * right[i];
  }
  out.left = std::max(out.left, 0.);
  return out;
}

// Of a cell's signal: shot noise of 20,000 electrons, and what is read.
double cell_variance(double signal) {
  constexpr double kSamples =
      PictureHistory::kGrid.samples_across * PictureHistory::kGrid.samples_down;
  return (5e-5 * std::max(0., signal) + 2e-7) / kSamples;
}

// Of every wavelength: constant, cosine, sine, and of the overtone, by row.
const std::vector<MainsBands::Basis>& bases() {
  static const std::vector<MainsBands::Basis> all = [] {
    std::vector<MainsBands::Basis> out(MainsBands::kCandidates);
    for (std::size_t k = 0; k < out.size(); ++k)
      for (std::size_t row = 0; row < out[k].size(); ++row) {
        const double angle = 2 * kPi * MainsBands::cycles(k) * row_place(static_cast<int>(row));
        out[k][row] = {1, std::cos(angle), std::sin(angle), std::cos(2 * angle),
                       std::sin(2 * angle)};
      }
    return out;
  }();
  return all;
}

double mean_of(const Rgb& cell) {
  return (double(cell.r) + double(cell.g) + double(cell.b)) / 3;
}

}  // namespace

double MainsBands::Wave::at(double place) const {
  const double angle = 2 * kPi * cycles * place;
  return offset + amplitudes[0] * std::cos(angle) + amplitudes[1] * std::sin(angle) +
         amplitudes[2] * std::cos(2 * angle) + amplitudes[3] * std::sin(2 * angle);
}

double MainsBands::Wave::amplitude() const {
  return std::hypot(amplitudes[0], amplitudes[1]);
}

MainsBands::OfExposure& MainsBands::of(int exposure) {
  const auto found = std::ranges::find(exposures_, exposure, &OfExposure::exposure);
  if (found != exposures_.end()) return *found;
  if (exposures_.size() >= 16) exposures_.erase(exposures_.begin());
  return exposures_.emplace_back(OfExposure{exposure});
}

// Weighted median change of each row's cells: bright ones tell most.
void MainsBands::find_rows(const PictureHistory::Comparison& seen) {
  constexpr auto kColumns = static_cast<std::size_t>(PictureHistory::kGrid.columns);
  rows_.clear();
  for (std::size_t first = 0; first < seen.now.size(); first += kColumns) {
    row_.clear();
    double weights = 0;
    for (std::size_t i = first; i < first + kColumns; ++i) {
      const double usual = mean_of(seen.usual[i]), now = mean_of(seen.now[i]);
      const Rgb& u = seen.usual[i];
      // Of a cell that clips now and then only the dark part would be seen.
      if (std::isnan(now) || !(usual > 0) || std::max({u.r, u.g, u.b}) > kBright) continue;
      row_.push_back({now / usual, usual * usual / cell_variance(usual)});
      weights += row_.back().weight;
    }
    std::ranges::sort(row_, {}, &CellChange::ratio);
    double below = 0;
    auto middle = row_.begin();
    while (middle != row_.end() && (below += middle->weight) < weights / 2) ++middle;
    const bool tells = middle != row_.end() && middle->ratio > .2;
    const double variance = kMedian / std::max(weights, 1e-9) + kScene * kScene;
    rows_.push_back(tells ? RowChange{std::log(middle->ratio), 1 / variance} : RowChange{0, 0});
  }
}

// The wavelength that has explained most of the rows' change of late.
std::size_t MainsBands::best_candidate(double varied) {
  for (std::size_t k = 0; k < kCandidates; ++k) {
    const double left = fit_wave<1 + kWave>(rows_, bases()[k]).left / varied;
    left_[k] = kOfLate * left_[k] + (1 - kOfLate) * left;
  }
  return static_cast<std::size_t>(std::ranges::min_element(left_) - left_.begin());
}

std::optional<MainsBands::Wave> MainsBands::find(const PictureHistory::Comparison& compared) {
  scene_changed_ = light_changed_ = false;
  OfExposure& seen = of(compared.exposure);
  if (compared.frames == 0) seen = {compared.exposure};  // its mean begins anew
  if (compared.frames < kMinBandFrames || compared.now.empty()) return std::nullopt;
  find_rows(compared);
  if (rows_that_tell() < kMinRows) return std::nullopt;
  double mean = centre_rows(), weights = 0;
  for (const RowChange& r : rows_) weights += r.weight;
  if (squares_of_rows() < weights * kSeen * kSeen / 2) {  // the usual case, and a cheap one
    seen.waves = std::max(0, seen.waves - 2);
    return std::nullopt;
  }
  const std::size_t best = best_candidate(squares_of_rows());
  // A thing that moves changes its own rows by itself.
  drop_outliers(fit_wave<1 + kFirstOvertone>(rows_, bases()[best]), best);
  if (rows_that_tell() < kMinRows) return std::nullopt;
  mean += centre_rows();
  const WaveFit fit = fit_wave<1 + kFirstOvertone>(rows_, bases()[best]);
  weights = 0;
  for (const RowChange& r : rows_) weights += r.weight;
  const double varied = squares_of_rows();
  const bool explained = fit.left < (1 - kExplained) * varied;
  const bool seen_at_all = varied / weights > kSeen * kSeen / 2;
  Wave wave{
      cycles(best), mean + fit.terms[0], {fit.terms[1], fit.terms[2], fit.terms[3], fit.terms[4]}};
  follow_level(seen, wave);
  seen.strange = varied / weights > kChange * kChange && !explained ? seen.strange + 1 : 0;
  scene_changed_ = seen.strange >= kPatience;
  const bool is_wave = seen_at_all && explained && advances_with_mains(seen, wave, compared.time);
  seen.waves = std::clamp(seen.waves + (is_wave ? 1 : -2), 0, 2 * kMinBandFrames);
  if (!is_wave || seen.waves < kMinBandFrames) return std::nullopt;
  const double overtone = std::hypot(wave.amplitudes[2], wave.amplitudes[3]);
  seen.reach =
      std::max(kReachOfLate * seen.reach, wave.amplitude() + overtone + std::abs(wave.offset));
  wave.reach = seen.reach;
  const double fraction = std::max(kMeanWave, 1. / ++seen.averaged);
  for (std::size_t i = 0; i < seen.mean.size(); ++i)
    seen.mean[i] += fraction * (wave.amplitudes[i] - seen.mean[i]);
  standing_ = {wave.cycles, 0, seen.mean, 0};
  return wave;
}

// Takes the weighted mean from all rows.
double MainsBands::centre_rows() {
  double mean = 0, weights = 1e-30;
  for (const RowChange& r : rows_) mean += r.weight * r.log, weights += r.weight;
  mean /= weights;
  for (RowChange& r : rows_) r.log -= mean;
  return mean;
}

double MainsBands::squares_of_rows() const {
  double squares = 1e-9;
  for (const RowChange& r : rows_) squares += r.weight * r.log * r.log;
  return squares;
}

void MainsBands::drop_outliers(const WaveFit& fit, std::size_t candidate) {
  constexpr double kFar = 5, kNoise = .005;
  std::vector<double>& off = offs_;
  off.clear();
  const auto residual = [&](std::size_t row) {
    double wave = 0;
    for (std::size_t k = 0; k < fit.terms.size(); ++k)
      wave += fit.terms[k] * bases()[candidate][row][k];
    return std::abs(rows_[row].log - wave);
  };
  for (std::size_t row = 0; row < rows_.size(); ++row)
    if (rows_[row].weight > 0) off.push_back(residual(row));
  if (off.empty()) return;
  const double usual = median(off);
  for (std::size_t row = 0; row < rows_.size(); ++row)
    if (residual(row) > kFar * usual + kNoise) rows_[row].weight = 0;
}

int MainsBands::rows_that_tell() const {
  constexpr double kOfBest = .05;
  double best = 1e-9;
  for (const RowChange& r : rows_) best = std::max(best, r.weight);
  return static_cast<int>(
      std::ranges::count_if(rows_, [&](const RowChange& r) { return r.weight > kOfBest * best; }));
}

// From one frame of an exposure to its next the light swells so many times, and the wave stands
// elsewhere by what is left of a whole number. Other changes do not keep to that, and what stands
// still is the scene's.
bool MainsBands::advances_with_mains(OfExposure& seen, const Wave& wave, TimestampNs time) {
  const auto place = std::polar(1., std::atan2(wave.amplitudes[1], wave.amplitudes[0]));
  phase_ = kPhaseOfLate * phase_ + (1 - kPhaseOfLate) * place;
  const double passed = (time - seen.time).count();
  std::size_t at = 0;
  for (const double frequency_hz : {100., 120., -100., -120.}) {  // either way over the rows
    const double turn = 2 * kPi * std::fmod(frequency_hz * passed, 1.);
    const double agrees = (place * std::conj(seen.place) * std::polar(1., -turn)).real();
    seen.agrees[at] = kPhaseOfLate * seen.agrees[at] + (1 - kPhaseOfLate) * agrees;
    ++at;
  }
  seen.place = place;
  seen.time = time;
  return std::ranges::max(seen.agrees) > kAgrees && std::abs(phase_) < kStands;
}

// What the whole frame changes by is the mains' where it comes and goes: what the usual frame of
// late does not have.
void MainsBands::follow_level(OfExposure& seen, Wave& wave) {
  const double level = wave.offset;
  seen.levels[seen.level_count++ % kLevels] = level;
  std::array<double, kLevels> sorted = seen.levels;
  const auto count = static_cast<std::ptrdiff_t>(std::min(seen.level_count, kLevels));
  std::nth_element(sorted.begin(), sorted.begin() + count / 2, sorted.begin() + count);
  wave.offset = level - sorted[static_cast<std::size_t>(count / 2)];
  light_changed_ = std::abs(wave.offset) > kFlicker;
  if (!light_changed_) return;
  seen.level_count = 0;
  wave.offset = 0;
}

namespace {

// Codes of one bit depth, once a row is known to be too bright.
class CodeScaler {
 public:
  explicit CodeScaler(const BandRemoval& removal)
      : removal_(removal), seen_below_(kClipLevel * std::exp(-removal.wave.reach)) {}
  struct ScaledCode {
    unsigned code;
    bool seen;  // by every frame of the exposure: others clip it
  };
  ScaledCode scaled(int channel, unsigned code, float factor) const {
    if (is_clipped(channel, code)) return {code, false};
    const float linear = removal_.curve.decode(channel, code) * factor;
    if (linear <= 0) return {code, true};
    const bool seen = static_cast<double>(linear) + removal_.black_level < seen_below_;
    return {removal_.curve.encode(channel, linear), seen};
  }
  // Nothing where the shorter frame, which is older, shows something darker there.
  std::optional<unsigned> from_shorter(int channel, unsigned code) const {
    constexpr double kAlike = .8;
    const double expected =
        static_cast<double>(removal_.curve.decode(channel, code)) * removal_.ratio;
    if (!is_clipped(channel, code) && expected + removal_.black_level < kAlike * seen_below_)
      return std::nullopt;
    return scaled_code(removal_.curve, removal_.black_level, channel, code, removal_.ratio);
  }

 private:
  bool is_clipped(int channel, unsigned code) const {
    return static_cast<double>(removal_.curve.decode(channel, code)) + removal_.black_level >=
           kClipLevel;
  }
  const BandRemoval& removal_;
  double seen_below_;
};

// The same for codes of 8 bits by tables, one for each step of a row's logarithm.
class CodeTables {
 public:
  static constexpr double kStep = .002;
  struct CodeTable {
    std::array<std::array<std::uint8_t, 256>, 3> code;
    std::array<std::array<bool, 256>, 3> seen;
  };

  CodeTables(const CodeScaler& scaler, double low, double high) : first_(step(low)) {
    tables_.reserve(static_cast<std::size_t>(step(high) - first_ + 1));
    for (long s = first_; s <= step(high); ++s) {
      CodeTable& table = tables_.emplace_back();
      const auto factor = static_cast<float>(std::exp(-static_cast<double>(s) * kStep));
      for (std::size_t c = 0; c < 3; ++c)
        for (unsigned code = 0; code < 256; ++code) {
          const auto scaled = scaler.scaled(static_cast<int>(c), code, factor);
          table.code[c][code] = static_cast<std::uint8_t>(scaled.code);
          table.seen[c][code] = scaled.seen;
        }
    }
    for (std::size_t c = 0; c < 3; ++c)
      for (unsigned code = 0; code < 256; ++code)
        shorter_[c][code] = scaler.from_shorter(static_cast<int>(c), code);
  }
  const CodeTable& of(double log) const {
    return tables_[static_cast<std::size_t>(step(log) - first_)];
  }
  std::optional<unsigned> from_shorter(std::size_t channel, std::uint8_t code) const {
    return shorter_[channel][code];
  }

 private:
  static long step(double log) { return std::lround(log / kStep); }
  long first_;
  std::vector<CodeTable> tables_;
  std::array<std::array<std::optional<unsigned>, 256>, 3> shorter_{};
};

template <class Pixel, class Row>
std::shared_ptr<const FramePixels> map_rows(const Image<Pixel>& in, const BandRemoval& removal,
                                            const Row& row) {
  Image<Pixel> out(in.width(), in.height());
  const auto* const shorter =
      removal.shorter ? std::get_if<Image<Pixel>>(removal.shorter) : nullptr;
  const auto width = static_cast<std::size_t>(in.width());
  parallel_for(std::size_t{0}, static_cast<std::size_t>(in.height()), 16, [&](const auto& range) {
    for (std::size_t y = range.begin(); y < range.end(); ++y)
      row(removal.wave.at((static_cast<double>(y) + .5) / in.height()),
          std::span(&in.pixels()[y * width], width),
          shorter ? &shorter->pixels()[y * width] : nullptr, &out.pixels()[y * width]);
  });
  return std::make_shared<const FramePixels>(std::move(out));
}

std::shared_ptr<const FramePixels> without_bands8(const Image<Rgb8>& in,
                                                  const BandRemoval& removal) {
  double low = removal.wave.offset, high = low;
  for (int y = 0; y < in.height(); ++y) {
    const double log = removal.wave.at((y + .5) / in.height());
    low = std::min(low, log), high = std::max(high, log);
  }
  const CodeTables codes(CodeScaler(removal), low, high);
  return map_rows(
      in, removal, [&](double log, std::span<const Rgb8> row, const Rgb8* shorter, Rgb8* out) {
        const CodeTables::CodeTable& table = codes.of(log);
        for (std::size_t x = 0; x < row.size(); ++x) {
          const auto code = [&](std::size_t c, std::uint8_t was, std::uint8_t dark) {
            const std::uint8_t scaled = table.code[c][was];
            if (table.seen[c][was] || !shorter) return scaled;
            return static_cast<std::uint8_t>(codes.from_shorter(c, dark).value_or(scaled));
          };
          const Rgb8 dark = shorter ? shorter[x] : Rgb8{};
          out[x] = {code(0, row[x].r, dark.r), code(1, row[x].g, dark.g),
                    code(2, row[x].b, dark.b)};
        }
      });
}

std::shared_ptr<const FramePixels> without_bands16(const Image<Rgb16>& in,
                                                   const BandRemoval& removal) {
  const CodeScaler scaler(removal);
  return map_rows(
      in, removal, [&](double log, std::span<const Rgb16> row, const Rgb16* shorter, Rgb16* out) {
        const auto factor = static_cast<float>(std::exp(-log));
        for (std::size_t x = 0; x < row.size(); ++x) {
          const auto code = [&](int c, std::uint16_t was, std::uint16_t dark) {
            const auto scaled = scaler.scaled(c, was, factor);
            if (scaled.seen || !shorter) return static_cast<std::uint16_t>(scaled.code);
            return static_cast<std::uint16_t>(scaler.from_shorter(c, dark).value_or(scaled.code));
          };
          const Rgb16 dark = shorter ? shorter[x] : Rgb16{};
          out[x] = {code(0, row[x].r, dark.r), code(1, row[x].g, dark.g),
                    code(2, row[x].b, dark.b)};
        }
      });
}

}  // namespace

std::shared_ptr<const FramePixels> without_bands(const FramePixels& pixels,
                                                 const BandRemoval& removal) {
  if (const auto* codes8 = std::get_if<Image<Rgb8>>(&pixels))
    return without_bands8(*codes8, removal);
  return without_bands16(std::get<Image<Rgb16>>(pixels), removal);
}

}  // namespace penumbra::capture
