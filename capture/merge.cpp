#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>

#include "capture/merge_math.h"
#include "core/parallel.h"

namespace penumbra::capture {

CodeCurve make_code_curve(const calib::Response& response, int bits, double black_level) {
  return CodeCurve({response.decode_table(bits, 0), response.decode_table(bits, 1),
                    response.decode_table(bits, 2)},
                   static_cast<float>(black_level));
}

Result<void> check_exposures(std::span<const Exposure> exposures) {
  for (std::size_t k = 0; k < exposures.size(); ++k) {
    const double t = exposures[k].time.count(), g = exposures[k].gain.value();
    if (!(std::isfinite(t) && t > 0) || !(std::isfinite(g) && g > 0))
      return fail(ErrorCode::kInvalid, fmt::format("exposure {}", k + 1),
                  fmt::format("{} s at gain {}: both must be positive and finite", t, g));
  }
  return {};
}

namespace {

// Linear signal of one channel of one pixel, and whether it may count.
struct Sample {
  double signal;
  bool clipped;
};

template <class Pixel>
class Stack {
 public:
  Stack(const ExposureStack& in, const CodeCurve* curve) : in_(in), curve_(curve) {
    for (const auto& f : in.frames) images_.push_back(&std::get<Image<Pixel>>(*f));
    if (curve) step_ = QuantisationStep(*curve);
  }
  int width() const { return images_[0]->width(); }
  int height() const { return images_[0]->height(); }

  Sample sample(std::size_t k, std::size_t i, int c) const {
    const Pixel& p = images_[k]->pixels()[i];
    const auto code = c == 0 ? p.r : c == 1 ? p.g : p.b;
    if constexpr (std::is_same_v<Pixel, Rgb>) {
      const bool finite = std::isfinite(code);
      return {finite ? static_cast<double>(code) - in_.black_level : 0, !finite};
    } else {
      const double signal = static_cast<double>(curve_->decode(c, code));
      return {signal, signal + in_.black_level >= kClipLevel};
    }
  }

  struct Value {
    double radiance;
    bool clipped, black;
  };
  Value merge(std::size_t i, int c) const {
    thread_local std::vector<Measurement> measured;
    measured.clear();
    double lower_bound = 0, longest = 0, longest_gain = 1;
    for (std::size_t k = 0; k < images_.size(); ++k) {
      const Sample s = sample(k, i, c);
      const double e = in_.exposures[k].product(), g = in_.exposures[k].gain.value();
      if (s.clipped) {
        lower_bound = std::max(lower_bound, s.signal / e);
        continue;
      }
      measured.push_back({s.signal, e, g});
      if (e > longest) longest = e, longest_gain = g;
    }
    if (measured.empty()) return {lower_bound, true, false};
    const double x = estimate_radiance(measured, in_.noise, step_, c);
    const double floor = in_.noise.variance(0, longest_gain) + step_.variance(c, 0);
    return {x, false, x * longest < 2 * std::sqrt(floor)};
  }

 private:
  const ExposureStack& in_;
  const CodeCurve* curve_;
  QuantisationStep step_;
  std::vector<const Image<Pixel>*> images_;
};

template <class Pixel>
MergedFloat merge_pixels(const ExposureStack& in, const CodeCurve* curve) {
  const Stack<Pixel> stack(in, curve);
  MergedFloat out;
  out.radiance = Image<Rgb>(stack.width(), stack.height());
  out.clipped = Image<std::uint8_t>(stack.width(), stack.height());
  std::atomic<std::size_t> clipped = 0, black = 0;
  parallel_for(0, stack.height(), 8, [&](const auto& rows) {
    std::size_t clipped_here = 0, black_here = 0;
    const auto first =
        static_cast<std::size_t>(rows.begin()) * static_cast<std::size_t>(stack.width());
    const auto last =
        static_cast<std::size_t>(rows.end()) * static_cast<std::size_t>(stack.width());
    for (std::size_t i = first; i < last; ++i) {
      bool any_clipped = false, all_black = true;
      for (int c = 0; c < 3; ++c) {
        const auto v = stack.merge(i, c);
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
        fmt::format("{} frames but {} exposures", stack.frames.size(), stack.exposures.size()));
  PENUMBRA_TRY(check_exposures(stack.exposures));
  const FramePixels& first = *stack.frames[0];
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    const FramePixels& f = *stack.frames[k];
    if (f.index() != first.index())
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1),
                  "another bit depth than the first");
    if (width(f) != width(first) || height(f) != height(first))
      return fail(ErrorCode::kInvalid, fmt::format("frame {}", k + 1),
                  fmt::format("{}x{}, expected {}x{} as the first", width(f), height(f),
                              width(first), height(first)));
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
    const CodeCurve curve = make_code_curve(stack.response, wide ? 16 : 8, stack.black_level);
    out = wide ? merge_pixels<Rgb16>(stack, &curve) : merge_pixels<Rgb8>(stack, &curve);
  }
  if (out.clipped_fraction == 1)
    return fail(ErrorCode::kUndetermined, "exposure stack",
                "every pixel is clipped in every exposure; expose shorter");
  if (out.black_fraction == 1)
    return fail(ErrorCode::kUndetermined, "exposure stack",
                "every pixel is black in every exposure; expose longer or open the lens");
  return out;
}

}  // namespace penumbra::capture
