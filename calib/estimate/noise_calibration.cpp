#include "calib/estimate/noise_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include "calib/estimate/internal/noise_correlation.h"
#include "core/image.h"
#include "core/io/toml_keys.h"
#include "core/median.h"
#include "core/threads/background_task.h"

namespace penumbra::calib {

namespace {

constexpr std::size_t kFewestFrames = 8, kMaxFrames = 64;
constexpr double kClip = .95;

std::unexpected<Error> noise_undetermined(std::string detail) {
  return fail(ErrorCode::kUndetermined, "noise calibration", std::move(detail));
}

// One channel's light over its codes, and the step from code to code there.
class Curve {
 public:
  Curve(const Response& response, int bits, int channel)
      : light_(response.decode_table(bits, channel)) {}
  double light(std::uint16_t code) const { return static_cast<double>(light_[code]); }
  // Around a light, by the codes next to it.
  double step(double light) const {
    const auto above = std::ranges::upper_bound(light_, static_cast<float>(light));
    const auto i = std::clamp<std::ptrdiff_t>(above - light_.begin(), 1, std::ssize(light_) - 2);
    const auto n = static_cast<std::size_t>(i);
    return static_cast<double>(light_[n + 1] - light_[n - 1]) / 2;
  }

 private:
  std::vector<float> light_;
};

// Through time, of one pixel and channel.
struct PixelNoise {
  double mean, variance, step;
};

// How bright each frame is against the mean of all, by the usual pixel: lamps and clouds are no
// noise of the camera, and who walks through is no lamp.
std::vector<double> brightness_of_frames(const StillSeries& series, const Curve& green,
                                         double black_level) {
  constexpr double kBright = .03;
  constexpr std::size_t kFewest = 100;
  const auto& frames = series.codes();
  const auto light = [&](std::size_t t, std::size_t i) {
    return green.light(frames[t][i]) - black_level;
  };
  std::vector<std::pair<std::size_t, double>> pixels;  // index, mean
  for (std::size_t i = 1; i < frames[0].size(); i += 3) {
    double sum = 0;
    bool clipped = false;
    for (std::size_t t = 0; t < frames.size(); ++t)
      sum += light(t, i), clipped |= green.light(frames[t][i]) > kClip;
    const double mean = sum / static_cast<double>(frames.size());
    if (!clipped && mean > kBright) pixels.emplace_back(i, mean);
  }
  std::vector<double> out(frames.size(), 1);
  if (pixels.size() < kFewest) return out;
  std::vector<double> ratios(pixels.size());
  for (std::size_t t = 0; t < frames.size(); ++t) {
    for (std::size_t k = 0; k < pixels.size(); ++k)
      ratios[k] = light(t, pixels[k].first) / pixels[k].second;
    const auto middle = ratios.begin() + std::ssize(ratios) / 2;
    std::ranges::nth_element(ratios, middle);
    out[t] = *middle;
  }
  return out;
}

std::optional<PixelNoise> sample_of(const StillSeries& series, std::size_t i, const Curve& curve,
                                    const std::vector<double>& brightness, double black_level) {
  double sum = 0, square = 0;
  for (std::size_t t = 0; t < series.frames(); ++t) {
    const std::uint16_t code = series.codes()[t][i];
    const double light = curve.light(code);
    if (code == 0 || light > kClip) return std::nullopt;
    const double y = (light - black_level) / brightness[t];
    sum += y, square += y * y;
  }
  const auto n = static_cast<double>(series.frames());
  const double mean = sum / n;
  return PixelNoise{mean, (square - sum * mean) / (n - 1), curve.step(mean + black_level)};
}

// Above it something moved: chance explains five standard deviations. The quietest quarter tells
// the scale, whatever happens to the others.
// source: quantiles of chi squared, Wilson & Hilferty 1931
double largest_variance(std::vector<PixelNoise>& samples, double freedom) {
  constexpr double kQuarter = -.6745;  // standard deviations, of a normal distribution
  const auto quarter = samples.begin() + std::ssize(samples) / 4;
  std::ranges::nth_element(samples, quarter, {}, &PixelNoise::variance);
  const double spread = 2 / (9 * freedom);
  const double scale = quarter->variance / std::pow(1 - spread + kQuarter * std::sqrt(spread), 3);
  return scale * (1 + 5 * std::sqrt(2 / freedom));
}

// The largest of all series.
void add_correlation(std::span<const StillSeries> still, const Response& response,
                     NoiseCalibration& out) {
  const auto raise = [](double& largest, double value) {
    if (std::abs(value) > std::abs(largest)) largest = value;
  };
  for (const StillSeries& s : still) {
    if (s.frames() < kFewestFrames) continue;
    const Curve green(response, s.bits(), 1);
    const auto found =
        noise_correlation(s, response, brightness_of_frames(s, green, out.black_level));
    raise(out.neighbour_correlation, found.neighbours);
    raise(out.frame_correlation, found.frames);
  }
}

// Means by half stops of brightness, without samples that something moved over.
void add_points(const StillSeries& series, const Response& response, double black_level,
                std::vector<NoisePoint>& out) {
  constexpr double kQuiet = .1;  // variance in squared steps
  constexpr std::size_t kFewestSamples = 200;
  std::map<int, std::vector<PixelNoise>> bins;
  const Curve green(response, series.bits(), 1);
  const auto brightness = brightness_of_frames(series, green, black_level);
  for (int c = 0; c < 3; ++c) {
    const Curve curve(response, series.bits(), c);
    for (std::size_t i = static_cast<std::size_t>(c); i < series.codes()[0].size(); i += 3)
      if (const auto s = sample_of(series, i, curve, brightness, black_level); s && s->mean > 0)
        bins[static_cast<int>(std::floor(2 * std::log2(s->mean)))].push_back(*s);
  }
  for (auto& [bin, samples] : bins) {
    if (samples.size() < kFewestSamples) continue;
    const double largest = largest_variance(samples, static_cast<double>(series.frames() - 1));
    NoisePoint point{0, series.gain(), 0, 0};
    double rounding = 0;
    for (const PixelNoise& s : samples) {
      if (s.variance > largest) continue;
      point.signal += s.mean, point.variance += s.variance, rounding += s.step * s.step;
      ++point.samples;
    }
    if (point.samples == 0) continue;
    point.signal /= point.samples, point.variance /= point.samples, rounding /= point.samples;
    point.variance -= rounding / 12;
    // Too quiet for its codes, or so near black that noise is cut off at zero.
    if (point.variance < kQuiet * rounding ||
        point.signal + black_level < 3 * std::sqrt(point.variance))
      continue;
    point.samples *= static_cast<double>(series.frames() - 1);
    out.push_back(point);
  }
}

struct Dark {
  double level = 0, variance = 0, samples = 0;
};
// Of the capped lens; nothing where black is cut off at code 0.
std::optional<Dark> dark_of(const StillSeries& series, const Response& response) {
  constexpr double kMaxAtZero = .05;
  double sum = 0, variance = 0, rounding = 0;
  std::size_t at_zero = 0, all = 0, pixels = 0;
  for (int c = 0; c < 3; ++c) {
    const Curve curve(response, series.bits(), c);
    for (std::size_t i = static_cast<std::size_t>(c); i < series.codes()[0].size(); i += 3) {
      double s = 0, q = 0;
      for (const auto& codes : series.codes()) {
        at_zero += codes[i] == 0, ++all;
        const double y = curve.light(codes[i]);
        s += y, q += y * y;
      }
      const auto n = static_cast<double>(series.frames());
      sum += s / n;
      variance += (q - s * s / n) / (n - 1);
      const double step = curve.step(s / n);
      rounding += step * step;
      ++pixels;
    }
  }
  if (static_cast<double>(at_zero) > kMaxAtZero * static_cast<double>(all)) return std::nullopt;
  const auto n = static_cast<double>(pixels);
  const double noise = (variance - rounding / 12) / n;
  return Dark{sum / n, noise > .1 * rounding / n ? noise : 0,
              n * static_cast<double>(series.frames() - 1)};
}

// Means through time of the pixels that are neither clipped nor at code 0; NaN elsewhere.
std::vector<double> means_of(const StillSeries& series, const Response& response) {
  std::vector<double> out(series.codes()[0].size(), 0);
  for (int c = 0; c < 3; ++c) {
    const Curve curve(response, series.bits(), c);
    for (std::size_t i = static_cast<std::size_t>(c); i < out.size(); i += 3) {
      for (const auto& codes : series.codes()) {
        const double light = curve.light(codes[i]);
        out[i] += codes[i] == 0 || light > kClip ? NAN : light;
      }
      out[i] /= static_cast<double>(series.frames());
    }
  }
  return out;
}

// What does not grow with the exposure, by the shortest and the longest that have the frames.
std::optional<double> black_of_exposures(std::span<const StillSeries> still,
                                         const Response& response) {
  constexpr double kApart = 2;
  constexpr std::size_t kFewest = 200;
  const StillSeries *shortest = nullptr, *longest = nullptr;
  for (const StillSeries& s : still) {
    if (s.frames() < kFewestFrames || !(s.product() > 0)) continue;
    if (!shortest || s.product() < shortest->product()) shortest = &s;
    if (!longest || s.product() > longest->product()) longest = &s;
  }
  if (!shortest || longest->product() < kApart * shortest->product() ||
      shortest->codes()[0].size() != longest->codes()[0].size() ||
      shortest->bits() != longest->bits())
    return std::nullopt;
  const std::vector<double> a = means_of(*shortest, response), b = means_of(*longest, response);
  const double ratio = longest->product() / shortest->product();
  std::vector<std::pair<double, double>> found;  // longer exposure's light, black
  for (std::size_t i = 0; i < a.size(); ++i)
    if (std::isfinite(a[i] + b[i])) found.emplace_back(b[i], (ratio * a[i] - b[i]) / (ratio - 1));
  if (found.size() < kFewest) return std::nullopt;
  // In the dark, where a curve that is a little wrong adds least, and apart from it: what differs
  // there is no black level but a wrong curve or time.
  std::ranges::sort(found);
  const auto middle_of = [&](std::size_t first, std::size_t last) {
    std::vector<double> part;
    for (std::size_t i = first; i < last; ++i) part.push_back(found[i].second);
    return median(part);
  };
  const double dark = middle_of(0, found.size() / 4),
               rest = middle_of(found.size() / 4, found.size() / 2);
  constexpr double kAgree = .002;
  if (std::abs(dark - rest) > kAgree) return std::nullopt;
  return std::max(0., dark);
}

// var = g y a + g^2 b with weights by the model's own variance; a = 1 / full well, b = read^2.
struct NoiseFit {
  double a = 0, b = 0, var_a = 0, var_b = 0, error = 0;
};
// Of a wrong black level b takes all, and falls below 0 where it is too low: then a stays as it is,
// unless the level is known.
std::optional<NoiseFit> fit_model(const std::vector<NoisePoint>& points, bool black_known) {
  NoiseFit fit;
  // Between points a curve or a camera's own noise reduction is off by this at least.
  constexpr double kModel = .02;
  for (int round = 0; round < 8; ++round) {
    double aa = 0, ab = 0, bb = 0, a = 0, b = 0;
    for (const NoisePoint& p : points) {
      const double expected =
          round == 0 ? p.variance
                     : std::max(1e-16, p.gain * p.signal * fit.a + p.gain * p.gain * fit.b);
      const double relative = std::sqrt(2 / p.samples) + kModel;
      const double w = 1 / (relative * relative * expected * expected);
      const double u = p.gain * p.signal, v = p.gain * p.gain;
      aa += w * u * u, ab += w * u * v, bb += w * v * v;
      a += w * u * p.variance, b += w * v * p.variance;
    }
    const double determinant = aa * bb - ab * ab;
    if (!(determinant > 1e-9 * aa * bb)) return std::nullopt;
    fit.a = (bb * a - ab * b) / determinant;
    fit.b = (aa * b - ab * a) / determinant;
    if (fit.b < 0 && black_known) fit.a = a / aa, fit.b = 0;
    fit.var_a = bb / determinant, fit.var_b = aa / determinant;
  }
  double square = 0;
  for (const NoisePoint& p : points) {
    const double expected = p.gain * p.signal * fit.a + p.gain * p.gain * fit.b;
    const double off = std::sqrt(p.variance / std::max(expected, 1e-16)) - 1;
    square += off * off;
  }
  fit.error = std::sqrt(square / static_cast<double>(points.size()));
  return fit;
}

}  // namespace

Result<void> StillSeries::add(const FramePixels& frame, const std::string& name) {
  constexpr double kEnough = 30'000;
  const auto take = [&](const auto& image, int bits) -> Result<void> {
    if (codes_.empty()) bits_ = bits, width_ = image.width(), height_ = image.height();
    if (bits != bits_ || image.width() != width_ || image.height() != height_)
      return fail(ErrorCode::kInvalid, name, "has another size or bit depth than the first frame");
    if (codes_.size() >= kMaxFrames) return {};
    const auto area = static_cast<double>(image.area());
    const int apart = std::max(1, static_cast<int>(std::ceil(std::sqrt(area / kEnough))));
    auto& codes = codes_.emplace_back();
    auto& beside = beside_.emplace_back();
    for (int y = apart / 2; y < image.height(); y += apart)
      for (int x = apart / 2; x < image.width(); x += apart) {
        const auto& p = image.at(x, y);
        codes.insert(codes.end(), {p.r, p.g, p.b});
        beside.push_back(image.at(x + 1 < image.width() ? x + 1 : std::max(x - 1, 0), y).g);
      }
    return {};
  };
  if (const auto* bytes = std::get_if<Image<Rgb8>>(&frame)) return take(*bytes, 8);
  if (const auto* words = std::get_if<Image<Rgb16>>(&frame)) return take(*words, 16);
  return fail(ErrorCode::kInvalid, name,
              "has float pixels, which do not have the noise of a sensor");
}

Result<NoiseCalibration> calibrate_noise(std::span<const StillSeries> still,
                                         std::span<const StillSeries> capped,
                                         const Response& response, double black_level) {
  constexpr double kMaxUncertain = .1;
  std::size_t frames = 0;
  for (const StillSeries& s : still) frames = std::max(frames, s.frames());
  if (frames < kFewestFrames)
    return noise_undetermined(fmt::format(
        "has at most {} frames of one exposure, and {} are needed", frames, kFewestFrames));
  NoiseCalibration out;
  out.black_level = black_level;
  std::vector<std::pair<double, Dark>> darks;  // gain
  for (const StillSeries& s : capped)
    if (s.frames() >= kFewestFrames)
      if (const auto dark = dark_of(s, response)) darks.emplace_back(s.gain(), *dark);
  out.black_measured = !darks.empty();
  if (const auto black = darks.empty() ? black_of_exposures(still, response) : std::nullopt)
    out.black_level = *black, out.black_measured = true;
  if (!darks.empty()) {
    out.black_level = 0;
    for (const auto& [gain, dark] : darks)
      out.black_level += dark.level / static_cast<double>(darks.size());
  }
  for (const StillSeries& s : still)
    if (s.frames() >= kFewestFrames) add_points(s, response, out.black_level, out.points);
  for (const auto& [gain, dark] : darks)
    if (dark.variance > 0) out.points.push_back({0, gain, dark.variance, dark.samples});
  if (out.points.size() < 3)
    return noise_undetermined(
        "the noise hardly exceeds the quantisation of the codes: raise the gain, or take raw "
        "frames");
  const auto fit = fit_model(out.points, out.black_measured);
  const auto [dimmest, brightest] = std::ranges::minmax(out.points, {}, &NoisePoint::signal);
  const std::string more =
      "show it everything from dark to bright, at two exposures four stops apart";
  if (!fit || !(fit->a > 0) || brightest.signal < 8 * dimmest.signal)
    return noise_undetermined("everything in the scene has about one brightness: " + more);
  if (std::sqrt(fit->var_a) > kMaxUncertain * fit->a)
    return noise_undetermined(fmt::format("the full well stays uncertain by {:.0f} %: {}",
                                          100 * std::sqrt(fit->var_a) / fit->a, more));
  out.model.full_well_electrons = 1 / fit->a;
  out.full_well_sigma = std::sqrt(fit->var_a) / (fit->a * fit->a);
  out.model.read_noise = std::sqrt(std::max(0., fit->b));
  const double sigma_b = std::sqrt(fit->var_b);
  out.read_sigma = fit->b > sigma_b ? sigma_b / (2 * out.model.read_noise) : std::sqrt(sigma_b);
  out.error = fit->error;
  add_correlation(still, response, out);
  return out;
}

std::string print_noise_file(const NoiseCalibration& c) {
  return fmt::format(
      "version = 1\n\n[noise]\nfull_well_electrons = {:.6g}\nfull_well_sigma = {:.3g}  # one "
      "standard "
      "deviation\nread_noise = {:.5g}\nread_sigma = {:.3g}\nblack_level = {:.6g}\n",
      c.model.full_well_electrons, c.full_well_sigma, c.model.read_noise, c.read_sigma,
      c.black_level);
}

}  // namespace penumbra::calib
