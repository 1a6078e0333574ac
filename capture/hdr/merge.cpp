#include "capture/hdr/merge.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bitset>
#include <cmath>
#include <limits>
#include <numeric>

#include "capture/frames.h"
#include "capture/hdr/contradiction.h"
#include "capture/hdr/merge_math.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

ResponseTable make_response_table(const calib::Response& response, int bits, double black_level) {
  return ResponseTable({response.decode_table(bits, 0), response.decode_table(bits, 1),
                        response.decode_table(bits, 2)},
                       static_cast<float>(black_level));
}

Result<void> check_exposures(std::span<const Exposure> exposures) {
  for (std::size_t k = 0; k < exposures.size(); ++k) {
    const double t = exposures[k].time.count(), g = exposures[k].gain.value();
    if (!(std::isfinite(t) && t > 0) || !(std::isfinite(g) && g > 0))
      return fail(
          ErrorCode::kInvalid, fmt::format("exposure {}", k + 1),
          fmt::format("its time of {} s or its gain of {} is not positive and finite", t, g));
    constexpr double kLargest = 1e12;  // beyond, radiance leaves the range of floats
    if (t * g > kLargest || t * g < 1 / kLargest)
      return fail(
          ErrorCode::kInvalid, fmt::format("exposure {}", k + 1),
          fmt::format("its time of {} s times its gain of {} is not within 1e-12..1e12 s", t, g));
  }
  return {};
}

namespace {

bool shows(const ExposureStack& in, std::size_t k, std::size_t i) {
  return in.valid.empty() || in.valid[k].area() == 0 || in.valid[k].pixels()[i] != 0;
}

// Float pictures have no full scale of their own, but many were developed to one: then samples at
// the largest value of a channel are brighter by what shorter exposures show there.
float clip_level(const ExposureStack& in, int c) {
  constexpr float kNowhere = std::numeric_limits<float>::infinity();
  constexpr std::size_t kFewest = 32;
  constexpr double kBrighter = 1.05;  // in the mean
  const auto sample = [&](std::size_t k, std::size_t i) {
    return std::get<Image<Rgb>>(*in.frames[k]).pixels()[i][c];
  };
  const std::size_t pixels = std::get<Image<Rgb>>(*in.frames[0]).pixels().size();
  float largest = 0;
  for (std::size_t k = 0; k < in.frames.size(); ++k)
    for (std::size_t i = 0; i < pixels; ++i)
      if (const float v = sample(k, i); std::isfinite(v) && shows(in, k, i))
        largest = std::max(largest, v);
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t k = 0; k < in.frames.size(); ++k)
    for (std::size_t i = 0; i < pixels; ++i) {
      if (sample(k, i) != largest || !shows(in, k, i)) continue;
      for (std::size_t j = 0; j < in.frames.size(); ++j) {
        const double ratio = in.exposures[k].product() / in.exposures[j].product();
        const float shorter = sample(j, i);
        if (ratio <= 1 || !std::isfinite(shorter) || shorter >= largest || !shows(in, j, i))
          continue;
        sum += (double(shorter) - in.black_level) * ratio / (double(largest) - in.black_level);
        ++count;
      }
    }
  return count >= kFewest && sum > kBrighter * double(count) ? largest : kNowhere;
}

template <class Pixel>
class Stack {
 public:
  Stack(const ExposureStack& in, const ResponseTable* curve)
      : in_(in),
        curve_(curve),
        noise_(in.noise),
        sigmas_(max_sigmas(in.noise_known)),
        order_(in.priority) {
    for (const auto& f : in.frames) images_.push_back(&std::get<Image<Pixel>>(*f));
    if (curve) {
      step_ = apart_ = QuantisationStep(*curve);
      // Developed pictures of 8 bits have noise of about a code, whatever a sensor's would be under
      // their curve, and in the dark glare, or the base of a film.
      if (std::is_same_v<Pixel, Rgb8> && !in.noise_known) {
        constexpr double kGlare = .001;  // of the light of a bright code
        noise_ = {1e12, kGlare * double(curve->decode(1, 240))};
        apart_ = QuantisationStep(*curve, 1);
        sigmas_ = kMaxSigmas;
      }
      last_code_ = in.last_code * curve->largest_code();
      first_code_ = in.first_code * curve->largest_code();
      for (int c = 0; c < 3; ++c)
        first_signal_[static_cast<std::size_t>(c)] =
            double(curve->decode(c, static_cast<unsigned>(std::lround(first_code_))));
    }
    if constexpr (std::is_same_v<Pixel, Rgb>)
      parallel_for(0, 3,
                   [&](int c) { clip_level_[static_cast<std::size_t>(c)] = clip_level(in, c); });
    if (order_.empty()) {
      order_.resize(in.exposures.size());
      std::iota(order_.begin(), order_.end(), std::size_t{0});
    }
    if constexpr (std::is_same_v<Pixel, Rgb8>) tabulate_contradictions();
  }
  int width() const { return images_[0]->width(); }
  int height() const { return images_[0]->height(); }

  SignalSample sample(std::size_t k, std::size_t i, int c) const {
    return sample_of(code_at(k, i, c), c);
  }
  auto code_at(std::size_t k, std::size_t i, int c) const {
    const Pixel& p = images_[k]->pixels()[i];
    return c == 0 ? p.r : c == 1 ? p.g : p.b;
  }
  template <class Code>
  SignalSample sample_of(Code code, int c) const {
    if constexpr (std::is_same_v<Pixel, Rgb>) {
      const bool finite = std::isfinite(code);
      return {finite ? static_cast<double>(code) - in_.black_level : 0,
              !finite || code >= clip_level_[static_cast<std::size_t>(c)]};
    } else {
      const double signal = static_cast<double>(curve_->decode(c, code));
      SignalSample out{signal, signal + in_.black_level >= kClipLevel || code > last_code_};
      if (code < first_code_) out.at_most = first_signal_[static_cast<std::size_t>(c)];
      return out;
    }
  }

  struct MergedValue {
    double radiance;
    bool clipped, black;
  };
  /// The exposures that count: all that show the pixel or, with an order of trust, from the most
  /// trusted on those whose samples agree with all before, in every channel.
  void counting(std::size_t i, std::vector<std::size_t>& out) const {
    out.clear();
    for (const std::size_t k : order_) {
      if (!shows(in_, k, i)) continue;
      const bool fits = in_.priority.empty() || std::ranges::none_of(out, [&](std::size_t j) {
                          for (int c = 0; c < 3; ++c)
                            if (samples_contradict(j, k, i, c)) return true;
                          return false;
                        });
      if (fits) out.push_back(k);
    }
  }
  MergedValue merge(std::size_t i, int c, std::span<const std::size_t> exposures) const {
    thread_local std::vector<Measurement> measured, dark;
    measured.clear();
    dark.clear();
    double lower_bound = 0, longest = 0, longest_gain = 1;
    for (const std::size_t k : exposures) {
      const SignalSample s = sample(k, i, c);
      const double e = in_.exposures[k].product(), g = in_.exposures[k].gain.value();
      if (s.clipped) {
        lower_bound = std::max(lower_bound, s.signal / e);
        continue;
      }
      (s.at_most ? dark : measured).push_back({s.signal, e, g});
      if (e > longest) longest = e, longest_gain = g;
    }
    // What is dark in all is told best by the longest.
    if (measured.empty() && !dark.empty())
      measured.push_back(*std::ranges::max_element(dark, {}, &Measurement::product));
    if (measured.empty()) return {lower_bound, true, false};
    const double x = estimate_radiance(measured, in_.noise, step_, c);
    const double floor = in_.noise.variance(0, longest_gain) + step_.variance(c, 0);
    return {x, false, x * longest < 2 * std::sqrt(floor)};
  }

 private:
  // All that two codes of a channel can say of each other: a bit for each pair.
  using CodePairs = std::bitset<256 * 256>;
  static std::size_t pair_of(std::uint8_t a, std::uint8_t b) { return std::size_t{a} << 8 | b; }
  std::size_t table_of(std::size_t j, std::size_t k, int c) const {
    return (j * images_.size() + k) * 3 + static_cast<std::size_t>(c);
  }

  // Where pictures have more pixels than there are pairs of codes.
  void tabulate_contradictions() {
    constexpr std::size_t kMany = std::size_t{1} << 18;
    if (in_.priority.empty() || images_[0]->area() < kMany) return;
    contradictions_.resize(images_.size() * images_.size() * 3);
    parallel_for(std::size_t{0}, order_.size(), [&](std::size_t last) {
      for (std::size_t first = 0; first < last; ++first)
        for (int c = 0; c < 3; ++c) {
          const std::size_t j = order_[first], k = order_[last];
          CodePairs& table = contradictions_[table_of(j, k, c)];
          for (int a = 0; a < 256; ++a)
            for (int b = 0; b < 256; ++b) {
              const auto code = static_cast<std::uint8_t>(a), other = static_cast<std::uint8_t>(b);
              table[pair_of(code, other)] =
                  contradict(sample_of(code, c), in_.exposures[j], sample_of(other, c),
                             in_.exposures[k], noise_, apart_, c, sigmas_);
            }
        }
    });
  }

  bool samples_contradict(std::size_t j, std::size_t k, std::size_t i, int c) const {
    if constexpr (std::is_same_v<Pixel, Rgb8>)
      if (!contradictions_.empty())
        return contradictions_[table_of(j, k, c)][pair_of(code_at(j, i, c), code_at(k, i, c))];
    return contradict(sample(j, i, c), in_.exposures[j], sample(k, i, c), in_.exposures[k], noise_,
                      apart_, c, sigmas_);
  }

  const ExposureStack& in_;
  const ResponseTable* curve_;
  calib::NoiseModel noise_;  // for contradictions, as `apart_` and `sigmas_`
  double sigmas_;
  QuantisationStep step_, apart_;
  double first_code_ = 0, last_code_ = 0;
  std::array<double, 3> first_signal_{};
  std::array<float, 3> clip_level_{};  // of float pictures
  std::vector<std::size_t> order_;
  std::vector<const Image<Pixel>*> images_;
  std::vector<CodePairs> contradictions_;  // by the more trusted picture, the other and channel
};

template <class Pixel>
MergedFloat merge_pixels(const ExposureStack& in, const ResponseTable* curve) {
  const Stack<Pixel> stack(in, curve);
  MergedFloat out;
  out.radiance = Image<Rgb>(stack.width(), stack.height());
  out.clipped = Image<std::uint8_t>(stack.width(), stack.height());
  std::atomic<std::size_t> clipped = 0, black = 0;
  parallel_for(0, stack.height(), 8, [&](const auto& rows) {
    std::size_t clipped_here = 0, black_here = 0;
    std::vector<std::size_t> exposures;
    const auto first =
        static_cast<std::size_t>(rows.begin()) * static_cast<std::size_t>(stack.width());
    const auto last =
        static_cast<std::size_t>(rows.end()) * static_cast<std::size_t>(stack.width());
    for (std::size_t i = first; i < last; ++i) {
      bool any_clipped = false, all_black = true;
      stack.counting(i, exposures);
      for (int c = 0; c < 3; ++c) {
        const auto v = stack.merge(i, c, exposures);
        out.radiance.pixels()[i][c] = static_cast<float>(v.radiance);
        any_clipped |= v.clipped;
        all_black &= v.black;
      }
      out.clipped.pixels()[i] = any_clipped;
      clipped_here += any_clipped;
      black_here += all_black;
    }
    clipped += clipped_here;
    black += black_here;
  });
  const auto area = static_cast<double>(out.radiance.area());
  out.clipped_fraction = static_cast<double>(clipped) / area;
  out.black_fraction = static_cast<double>(black) / area;
  return out;
}

Result<void> check_stack(const ExposureStack& stack) {
  if (stack.frames.empty()) return fail(ErrorCode::kInvalid, "exposure stack", "has no frames");
  if (stack.frames.size() != stack.exposures.size())
    return fail(
        ErrorCode::kInvalid, "exposure stack",
        fmt::format("has {} frames but {} exposures", stack.frames.size(), stack.exposures.size()));
  PENUMBRA_TRY(check_exposures(stack.exposures));
  std::vector<std::size_t> priority = stack.priority;
  std::ranges::sort(priority);
  for (std::size_t k = 0; k < priority.size(); ++k)
    if (priority[k] != k || priority.size() != stack.frames.size())
      return fail(ErrorCode::kInvalid, "exposure stack",
                  "has an order of priority that does not name each frame once");
  if (!stack.valid.empty() && stack.valid.size() != stack.frames.size())
    return fail(ErrorCode::kInvalid, "exposure stack",
                fmt::format("has {} frames but {} masks", stack.frames.size(), stack.valid.size()));
  const FramePixels& first = *stack.frames[0];
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    const FramePixels& f = *stack.frames[k];
    if (f.index() != first.index())
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1),
                  "has another bit depth than the first frame");
    if (width(f) != width(first) || height(f) != height(first))
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1),
                  fmt::format("has {}x{} pixels, but the first frame has {}x{}", width(f),
                              height(f), width(first), height(first)));
    if (!stack.valid.empty() && stack.valid[k].area() > 0 &&
        (stack.valid[k].width() != width(f) || stack.valid[k].height() != height(f)))
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1),
                  "has another size than its mask");
    if (width(f) == 0 || height(f) == 0)
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1), "has no pixels");
  }
  return {};
}

}  // namespace

Result<MergedFloat> merge(const ExposureStack& stack) {
  PENUMBRA_TRY(check_stack(stack));
  MergedFloat out;
  if (std::holds_alternative<Image<Rgb>>(*stack.frames[0])) {
    out = merge_pixels<Rgb>(stack, nullptr);
  } else {
    const bool wide = std::holds_alternative<Image<Rgb16>>(*stack.frames[0]);
    const ResponseTable curve =
        make_response_table(stack.response, wide ? 16 : 8, stack.black_level);
    out = wide ? merge_pixels<Rgb16>(stack, &curve) : merge_pixels<Rgb8>(stack, &curve);
  }
  if (out.clipped_fraction == 1)
    return fail(ErrorCode::kUndetermined, "exposure stack",
                "every pixel is clipped in every exposure: expose shorter");
  if (out.black_fraction == 1)
    return fail(ErrorCode::kUndetermined, "exposure stack",
                "every pixel is black in every exposure: expose longer or open the lens");
  return out;
}

}  // namespace penumbra::capture
