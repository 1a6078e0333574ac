#include "capture/device/internal/exposure_schedule.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "capture/hdr/merge.h"
#include "capture/hdr/merge_math.h"
#include "core/conventions.h"

namespace penumbra::capture {

namespace {

constexpr int kMaxExposures = 6;
constexpr double kClearly = .25;  // of the budget
// Under the clip level: noise and small changes need no new schedule
constexpr double kHeadroom = .8;
constexpr double kHalfStop = 1.4142135623730951;
// The mean square cosine over the sphere's lit half, against the mean cosine: noise of an
// irradiance over that of the mean radiance.
constexpr double kIrradianceNoise = 1.63;
constexpr double kSigmas = 2;  // of noise count as its error
// Pixels of a row that are looked at: the sun is two or three wide in a fisheye
constexpr int kMaxReadColumns = 960;

// What a whole wall may be off by when its radiance lies anywhere between two codes: noise turns
// the error of rounding into noise.
// source: first harmonic of the rounding error under Gaussian dither, Widrow & Kollar 2008
double rounding_bias(double step, double sigma) {
  const double r = sigma / step;
  return step > 0 ? step / kPi * std::exp(-2 * kPi * kPi * r * r) : 0;
}

// Codes end at zero, noise does not: mean of max(0, y + n) less y.
double bias_at_zero(double y, double sigma) {
  if (sigma <= 0) return 0;
  const double z = y / sigma;
  return sigma * std::exp(-z * z / 2) / std::sqrt(2 * kPi) -
         y * std::erfc(z / std::numbers::sqrt2) / 2;
}

// What the sphere would send if all of it were like its darker half: what faces away from the light
// sees no less.
double darker_half(const std::vector<RadianceBin>& light) {
  double whole = 0, seen = 0, sum = 0;
  for (const RadianceBin& bin : light) whole += bin.solid_angle;
  for (const RadianceBin& bin : light) {
    const double part = std::clamp(whole / 2 - seen, 0., bin.solid_angle);
    sum += 2 * part * bin.radiance;
    seen += part;
  }
  return std::max(sum, 1e-300);
}

// Within flicker, and nearer than the half stops of a plan.
bool same_exposure(const Exposure& a, const Exposure& b) {
  return std::abs(std::log(a.product() / b.product())) < .17;
}

Exposure within_limits(double product, const ExposureLimits& limits) {
  const double time = std::min(product, limits.longest.count());
  return {Seconds(time), Gain(std::clamp(product / time, 1., limits.max_gain.value()))};
}

}  // namespace

ExposurePlanner::ExposurePlanner(const CameraInfo& camera, int bits)
    : curve_(make_response_table(camera.response, bits, camera.black_level)),
      noise_(camera.noise),
      black_(camera.black_level),
      clip_signal_(kClipLevel - camera.black_level) {}

double ExposurePlanner::clip(const Exposure& exposure) const {
  return clip_signal_ / exposure.product();
}

SchedulePlan ExposurePlanner::judge(std::vector<Exposure> exposures,
                                    const std::vector<RadianceBin>& light, double headroom) const {
  const QuantisationStep step(curve_);
  SchedulePlan out{std::move(exposures)};
  const double dark = darker_half(light);
  double all = 0, variance = 0;
  for (const RadianceBin& bin : light) {
    all += bin.solid_angle * bin.radiance;
    // The longest exposure that does not clip it tells most.
    const auto best = std::ranges::find_if(
        out.exposures, [&](const Exposure& e) { return bin.brightest < headroom * clip(e); });
    if (best == out.exposures.end()) {
      out.clipped += bin.solid_angle * bin.radiance *
                     (1 - headroom * clip(out.exposures.back()) / bin.brightest);
      continue;
    }
    const double e = best->product(), signal = e * bin.radiance;
    const double sigma = std::sqrt(noise_.variance(signal, best->gain.value())) / e;
    const double code = std::sqrt(12 * step.variance(1, signal)) / e;
    // What sees the bin at all sees this much.
    const double seen = dark + bin.solid_angle * bin.radiance;
    if (bin.pixels > 0) variance += std::pow(bin.solid_angle * sigma / seen, 2) / bin.pixels;
    out.codes += bin.solid_angle / seen *
                 std::min(bin.radiance + sigma, rounding_bias(code, sigma) +
                                                    bias_at_zero(bin.radiance + black_ / e, sigma));
  }
  if (all <= 0) return out;
  out.noise = kSigmas * kIrradianceNoise * std::sqrt(variance);
  out.clipped /= all;
  return out;
}

SchedulePlan ExposurePlanner::plan(const std::vector<RadianceBin>& light,
                                   const ExposureLimits& limits, double budget) const {
  const double first = limits.shortest.count(),
               last = limits.longest.count() * limits.max_gain.value();
  const int rungs = 1 + std::max(0, static_cast<int>(2 * std::log2(last / first)));
  const auto rung = [&](double i) {
    return within_limits(std::min(last, first * std::pow(kHalfStop, std::round(i))), limits);
  };
  const auto best_of = [&](int count) {
    SchedulePlan best;
    for (int low = 0; low < rungs; ++low)
      for (int high = count == 1 ? low : low + count - 1; high < (count == 1 ? low + 1 : rungs);
           ++high) {
        std::vector<Exposure> exposures;
        for (int k = 0; k < count; ++k)
          exposures.push_back(rung(count == 1 ? low : high - double(high - low) * k / (count - 1)));
        SchedulePlan plan = judge(std::move(exposures), light, kHeadroom);
        // Within the budget only what is clearly better is worth a longer time or more gain.
        const double margin = best.error() <= budget ? kClearly * budget : 0;
        if (best.exposures.empty() || plan.error() < best.error() - margin) best = std::move(plan);
      }
    return best;
  };
  std::vector<SchedulePlan> plans;
  for (int count = 1; count <= std::min(kMaxExposures, rungs); ++count) {
    plans.push_back(best_of(count));
    if (plans.back().error() <= budget) return plans.back();
  }
  const double smallest = std::ranges::min_element(plans, {}, &SchedulePlan::error)->error();
  return *std::ranges::find_if(
      plans, [&](const SchedulePlan& p) { return p.error() <= (1 + kClearly) * smallest; });
}

namespace {

// Bins of a quarter of a stop, from dark to bright: a plan tries a thousand schedules on them.
std::vector<RadianceBin> coarser(std::vector<RadianceBin> fine) {
  constexpr double kQuarterStop = 1.189207115002721;
  std::ranges::sort(fine, {}, &RadianceBin::brightest);
  std::vector<RadianceBin> out;
  double from = 0;
  for (const RadianceBin& bin : fine) {
    if (out.empty() || bin.brightest > kQuarterStop * from) {
      out.push_back(bin);
      from = bin.brightest;
      continue;
    }
    RadianceBin& sum = out.back();
    const double all = sum.solid_angle + bin.solid_angle;
    if (all > 0) {
      const double fraction = bin.solid_angle / all;
      sum.radiance += fraction * (bin.radiance - sum.radiance);
    }
    sum.brightest = bin.brightest;
    sum.solid_angle = all;
    sum.pixels += bin.pixels;
  }
  std::ranges::sort(out, {}, &RadianceBin::radiance);
  return out;
}

}  // namespace

LightHistogram::LightHistogram(const CameraInfo& camera) : weights_(camera.projection) {
  for (std::size_t code = 0; code < decode_.size(); ++code)
    decode_[code] = std::max(
        0., camera.response.decode(static_cast<double>(code) / 255, 1) - camera.black_level);
}

void LightHistogram::add(const FramePixels& pixels, const Exposure& exposure,
                         std::size_t max_count) {
  SeenExposure seen;
  seen.exposure = exposure;
  const auto gather = [&](const auto& image, int shift) {
    const int step = std::max(1, image.width() / kMaxReadColumns);
    const double stands_for = static_cast<double>(step) * step;
    for (int y = step / 2; y < image.height(); y += step)
      for (int x = step / 2; x < image.width(); x += step) {
        const double weight = stands_for * static_cast<double>(weights_.of(x, y));
        if (weight <= 0) continue;
        const auto& p = image.at(x, y);
        CodeLight& light = seen.code[static_cast<std::size_t>(std::max({p.r, p.g, p.b}) >> shift)];
        light.solid_angle += weight;
        light.green += weight * decode_[static_cast<std::size_t>(p.g >> shift)];
        light.pixels += stands_for;
      }
  };
  if (const auto* bytes = std::get_if<Image<Rgb8>>(&pixels))
    gather(*bytes, 0);
  else if (const auto* words = std::get_if<Image<Rgb16>>(&pixels))
    gather(*words, 8);
  else
    return;
  std::erase_if(seen_, [&](const SeenExposure& s) { return same_exposure(s.exposure, exposure); });
  seen_.push_back(seen);
  while (seen_.size() > max_count) seen_.pop_front();
}

bool LightHistogram::holds(std::span<const Exposure> exposures) const {
  return std::ranges::all_of(exposures, [&](const Exposure& e) {
    return std::ranges::any_of(seen_,
                               [&](const SeenExposure& s) { return same_exposure(s.exposure, e); });
  });
}

std::vector<RadianceBin> LightHistogram::light(const ExposurePlanner& planner) const {
  std::vector<const SeenExposure*> longest_first;
  for (const SeenExposure& s : seen_) longest_first.push_back(&s);
  std::ranges::stable_sort(longest_first, [](const SeenExposure* a, const SeenExposure* b) {
    return a->exposure.product() > b->exposure.product();
  });
  std::vector<RadianceBin> out;
  double from = 0;  // radiance that a longer exposure has counted
  for (const SeenExposure* seen : longest_first) {
    const double e = seen->exposure.product(), to = planner.clip(seen->exposure);
    for (std::size_t code = 0; code < 256; ++code) {
      const CodeLight& sum = seen->code[code];
      if (sum.pixels <= 0) continue;
      const double brightest = decode_[code] / e;
      if (brightest < from) continue;
      RadianceBin bin{brightest, sum.green / (sum.solid_angle * e), sum.solid_angle, sum.pixels};
      if (brightest >= to) {
        if (seen != longest_first.back()) continue;
        bin.radiance *= kBeyond * to / brightest, bin.brightest = kBeyond * to;
      }
      out.push_back(bin);
    }
    from = std::max(from, to);
  }
  return coarser(std::move(out));
}

std::vector<Exposure> AutoSchedule::probe(const ExposureLimits& limits) {
  constexpr double kApart = 8;  // three stops: every radiance well exposed in one of them
  limits_ = limits;
  const double first = limits.shortest.count(), last = std::max(first, limits.longest.count());
  const int steps = static_cast<int>(std::ceil(std::log(last / first) / std::log(kApart) - 1e-9));
  plan_ = {};
  for (int k = 0; k <= steps; ++k)
    plan_.exposures.push_back(
        {Seconds(last * std::pow(first / last, steps > 0 ? double(k) / steps : 0.)), Gain(1)});
  probing_ = true;
  histogram_.clear();
  until_settled_ = 0;
  return plan_.exposures;
}

bool AutoSchedule::see(const FramePixels& pixels, const Exposure& exposure, TimestampNs time) {
  constexpr double kOver = 1, kUnder = .9;  // of the budget
  constexpr Seconds kPatience{2};
  constexpr std::size_t kLatest = 4;  // frames until a request shows, with some room
  if (!planner_) planner_.emplace(camera_, std::holds_alternative<Image<Rgb8>>(pixels) ? 8 : 16);
  histogram_.add(pixels, exposure, plan_.exposures.size());
  if (until_settled_ > 0) --until_settled_;
  if (until_settled_ > 0 || !histogram_.holds(plan_.exposures)) return false;
  const auto light = histogram_.light(*planner_);
  SchedulePlan now = planner_->judge(plan_.exposures, light);
  const bool over = now.error() > kOver * budget_, rested = (time - planned_) > kPatience;
  plan_ = std::move(now);
  // What no plan could mend is looked at again when it grows, or after a while.
  constexpr double kGrown = 1.1;
  const bool grown = over && plan_.error() > kGrown * min_error_;
  if (!probing_ && !grown && !rested) return false;
  SchedulePlan next = planner_->plan(light, limits_, kUnder * budget_);
  planned_ = time;
  const bool better =
      over ? next.error() < plan_.error()
           : next.exposures.size() < plan_.exposures.size() && next.error() <= budget_;
  min_error_ = over && !better ? plan_.error() : 0;
  if (!probing_ && !better) return false;
  probing_ = false;
  plan_ = std::move(next);
  until_settled_ = plan_.exposures.size() + kLatest;
  return true;
}

}  // namespace penumbra::capture
