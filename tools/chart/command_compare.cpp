#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <cmath>
#include <limits>

#include "codec/codec.h"
#include "core/conventions.h"
#include "runtime/pipeline/report.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/commands.h"
#include "tools/chart/measures/flip.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

struct CompareOptions {
  std::string a, b;
  // "blue": pixels that are pure blue in this picture are left out
  std::optional<std::string> mask;
  bool scale = false;  // allow one scale factor
  bool json = false;
};

// Any picture as linear floats: 8 and 16 bit codes stay codes in 0..1.
Result<Image<Rgb>> read_any(const std::string& path) {
  PENUMBRA_ASSIGN(frame, codec::read_frame(path));
  if (auto* linear = std::get_if<Image<Rgb>>(&frame)) return std::move(*linear);
  const auto scaled = [](const auto& in, float full) {
    Image<Rgb> out(in.width(), in.height());
    for (std::size_t i = 0; i < in.area(); ++i) {
      const auto& p = in.pixels()[i];
      out.pixels()[i] = {p.r / full, p.g / full, p.b / full};
    }
    return out;
  };
  if (const auto* f8 = std::get_if<Image<Rgb8>>(&frame)) return scaled(*f8, 255.f);
  return scaled(std::get<Image<Rgb16>>(frame), 65535.f);
}

struct Figures {
  double rel_rmse = 0, log10_rmse = 0, psnr_db = 0, max_abs = 0, scale = 1;
  std::size_t compared = 0, non_finite = 0;
};

// Least squares in the logarithm for one factor, so that bright and dark count alike.
double log_scale(const Image<Rgb>& a, const Image<Rgb>& b, const std::vector<bool>& use) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    const double ya = luminance(a.pixels()[i]), yb = luminance(b.pixels()[i]);
    if (!use[i] || !(ya > 0) || !(yb > 0) || !std::isfinite(ya) || !std::isfinite(yb)) continue;
    sum += std::log(yb / ya);
    ++count;
  }
  return count > 0 ? std::exp(sum / count) : 1;
}

Figures measure(const Image<Rgb>& a, const Image<Rgb>& b, const std::vector<bool>& use,
                bool scale) {
  Figures f;
  if (scale) f.scale = log_scale(a, b, use);
  double square = 0, mean = 0, log_square = 0, logs = 0, peak = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    if (!use[i]) continue;
    const Rgb &pa = a.pixels()[i], &pb = b.pixels()[i];
    if (!is_finite(pa) || !is_finite(pb)) {
      ++f.non_finite;
      continue;
    }
    ++f.compared;
    for (int c = 0; c < 3; ++c) {
      const double d = f.scale * pa[c] - pb[c];
      square += d * d / 3;
      f.max_abs = std::max(f.max_abs, std::abs(d));
      peak = std::max(peak, double(pb[c]));
    }
    const double ya = f.scale * luminance(pa), yb = luminance(pb);
    mean += yb;
    if (ya > 0 && yb > 0) log_square += std::pow(std::log10(ya / yb), 2), ++logs;
  }
  const double n = static_cast<double>(std::max<std::size_t>(1, f.compared)),
               rmse = std::sqrt(square / n);
  f.rel_rmse = mean > 0 ? rmse / (mean / n) : (rmse > 0 ? HUGE_VAL : 0);
  // Without a pixel that is above black in both there is no logarithm to compare.
  f.log10_rmse = logs > 0 ? std::sqrt(log_square / logs) : std::numeric_limits<double>::quiet_NaN();
  f.psnr_db = rmse > 0 ? 20 * std::log10(peak / rmse) : HUGE_VAL;
  return f;
}

}  // namespace

Result<void> compare(const CompareOptions& o) {
  PENUMBRA_ASSIGN(a, read_any(o.a));
  PENUMBRA_ASSIGN(b, read_any(o.b));
  if (!a.same_size(b))
    return fail(ErrorCode::kInvalid, o.a,
                fmt::format("has {}x{} pixels, but {} has {}x{}", a.width(), a.height(), o.b,
                            b.width(), b.height()));
  std::vector<bool> use(a.area(), true);
  if (o.mask) {
    PENUMBRA_ASSIGN(mask, read_any(*o.mask));
    if (!mask.same_size(a))
      return fail(ErrorCode::kInvalid, *o.mask, "has another size than the pictures");
    for (std::size_t i = 0; i < use.size(); ++i) {
      const Rgb& p = mask.pixels()[i];
      use[i] = !(p.r == 0 && p.g == 0 && p.b == 1);
    }
  }
  const Figures f = measure(a, b, use, o.scale);
  if (f.compared == 0) return fail(ErrorCode::kUndetermined, o.a, "has no pixel left to compare");
  // Of the pictures as they are: a mask or a factor has no place in a model of the eye.
  const auto map = hdr_flip(b, a);
  const double flip = map ? mean_flip(*map) : std::numeric_limits<double>::quiet_NaN();
  if (o.json) {
    print_json({{"rel_rmse", f.rel_rmse},
                {"log10_rmse", f.log10_rmse},
                {"psnr_db", f.psnr_db},
                {"max_abs", f.max_abs},
                {"flip", flip},
                {"scale", f.scale},
                {"compared_pixels", f.compared},
                {"non_finite", f.non_finite}});
  } else {
    fmt::print(
        "relative RMSE {:.5g}, log10 luminance RMSE {:.5g}, PSNR {:.2f} dB, largest difference "
        "{:.5g}, mean HDR-FLIP {:.4f}\n"
        "{} pixels compared, {} not finite, {} scaled by {:.5g}\n",
        f.rel_rmse, f.log10_rmse, f.psnr_db, f.max_abs, flip, f.compared, f.non_finite, o.a,
        f.scale);
  }
  return {};
}

void add_compare(CLI::App& parent, Action& action) {
  static CompareOptions compare_options;
  auto* c = parent.add_subcommand("compare",
                                  "Measure the difference between two pictures of the same size");
  c->add_option("a", compare_options.a, "Picture to judge")->required();
  c->add_option("b", compare_options.b, "Reference picture")->required();
  c->add_option("--mask", compare_options.mask,
                "Mask of the same size: pixels that are pure blue in it are left out");
  c->add_flag("--scale", compare_options.scale,
              "First scale the picture by one factor, fitted in the logarithm of luminance");
  add_json(c, compare_options.json);
  c->callback([&] { action = [] { return compare(compare_options); }; });
}

}  // namespace penumbra::tools
