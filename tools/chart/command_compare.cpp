#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "codec/codec.h"
#include "codec/display.h"
#include "codec/gain_map_jpeg.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/commands.h"
#include "tools/chart/measures/flip.h"
#include "tools/chart/measures/luminance_error.h"
#include "tools/chart/measures/picture_pairs.h"
#include "tools/chart/measures/sarnoff.h"
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
  double nits = 100;   // luminance of 1, cd/m^2
  std::optional<std::string> map;
  std::string map_of = "flip";
  bool json = false;
};

struct ReadPicture {
  Image<Rgb> values;   // 8 and 16 bit codes stay codes in 0..1
  bool codes = false;  // else linear
};

Result<ReadPicture> read_any(const std::string& path) {
  PENUMBRA_ASSIGN(frame, codec::read_picture(path));
  if (auto* linear = std::get_if<Image<Rgb>>(&frame)) return ReadPicture{std::move(*linear)};
  const auto scaled = [](const auto& in, float full) {
    Image<Rgb> out(in.width(), in.height());
    for (std::size_t i = 0; i < in.area(); ++i) {
      const auto& p = in.pixels()[i];
      out.pixels()[i] = {p.r / full, p.g / full, p.b / full};
    }
    return out;
  };
  if (const auto* f8 = std::get_if<Image<Rgb8>>(&frame))
    return ReadPicture{scaled(*f8, 255.f), true};
  return ReadPicture{scaled(std::get<Image<Rgb16>>(frame), 65535.f), true};
}

// What an sRGB display shows of codes.
Image<Rgb> linear_of(const ReadPicture& picture) {
  Image<Rgb> out = picture.values;
  if (picture.codes)
    for (Rgb& p : out.pixels())
      for (int c = 0; c < 3; ++c) p[c] = codec::linear_from_srgb(p[c]);
  return out;
}

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

struct Figures {
  double rel_rmse = 0, log10_rmse = 0, psnr_db = 0, max_abs = 0, scale = 1;
  std::size_t compared = 0, non_finite = 0;
  std::size_t black_in_one = 0;  // of those compared: no part of the logarithm's error
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
    f.black_in_one += (ya > 0) != (yb > 0);
  }
  const double n = static_cast<double>(std::max<std::size_t>(1, f.compared)),
               rmse = std::sqrt(square / n);
  // Nothing is a part of black, and without a pixel that is above it in both there is no logarithm.
  f.rel_rmse = mean > 0 ? rmse / (mean / n) : (rmse > 0 ? kUnknown : 0);
  f.log10_rmse = logs > 0 ? std::sqrt(log_square / logs) : kUnknown;
  f.psnr_db = rmse > 0 ? (peak > 0 ? 20 * std::log10(peak / rmse) : kUnknown) : HUGE_VAL;
  return f;
}

// Measures of an eye, of the whole pictures as a display shows them: a mask or a factor has no
// place in them. What cannot be measured is NaN.
struct SeenFigures {
  double mse = kUnknown, luminance_psnr_db = kUnknown, pu21_psnr_db = kUnknown,
         pu21_ssim = kUnknown, sarnoff = kUnknown, flip = kUnknown;
};

// Errors of pixels as --map draws them: 0..1.
struct SeenMaps {
  Result<Image<float>> flip, pu21, sarnoff;
};

SeenFigures measure_seen(const ReadPicture& a, const ReadPicture& b, double nits, SeenMaps& maps) {
  const Image<Rgb> test = linear_of(a), reference = linear_of(b);
  SeenFigures out;
  if (const auto error = luminance_error(reference, test))
    out.mse = error->mse, out.luminance_psnr_db = error->psnr_db;
  if (auto error = pu21_error(reference, test, nits)) {
    out.pu21_psnr_db = error->psnr_db, out.pu21_ssim = error->ssim;
    maps.pu21 = std::move(error->difference);
    for (float& v : maps.pu21->pixels()) v /= 64;  // a quarter of an ordinary display's range
  } else {
    maps.pu21 = std::unexpected(error.error());
  }
  maps.sarnoff = sarnoff_map(reference, test);
  if (maps.sarnoff) out.sarnoff = mean_sarnoff(*maps.sarnoff);
  // Codes are what a display shows; radiance may be shown at any exposure.
  if (a.codes && b.codes)
    maps.flip = flip(reference, test);
  else
    maps.flip = hdr_flip(reference, test);
  if (maps.flip) out.flip = mean_flip(*maps.flip);
  return out;
}

Result<void> write_map(const CompareOptions& o, SeenMaps& maps) {
  Result<Image<float>>& map = o.map_of == "pu21"      ? maps.pu21
                              : o.map_of == "sarnoff" ? maps.sarnoff
                                                      : maps.flip;
  if (!map) return fail(map.error().code, "--map-of " + o.map_of, map.error().detail);
  if (o.map_of == "sarnoff")
    for (float& v : map->pixels()) v *= 20;  // a twentieth is a plain difference of contrast
  return codec::write_frame(*o.map, heat_picture(*map));
}

// A figure with its unit, or "none" where there is none to tell.
std::string figure(double value, int digits, bool fixed, std::string_view unit = "") {
  if (std::isnan(value)) return "none";
  return (fixed ? fmt::format("{:.{}f}", value, digits) : fmt::format("{:.{}g}", value, digits)) +
         std::string(unit);
}

void print_figures(const CompareOptions& o, const Figures& f, const SeenFigures& seen,
                   const SeenMaps& maps) {
  fmt::print("relative RMSE {}, log10 luminance RMSE {}, PSNR {}, largest difference {:.5g}\n",
             figure(f.rel_rmse, 5, false), figure(f.log10_rmse, 5, false),
             figure(f.psnr_db, 2, true, " dB"), f.max_abs);
  fmt::print(
      "luminance: MSE {}, PSNR {}; as seen: PU21-PSNR {}, PU21-SSIM {}, Sarnoff {}, mean "
      "FLIP {}\n",
      figure(seen.mse, 5, false), figure(seen.luminance_psnr_db, 2, true, " dB"),
      figure(seen.pu21_psnr_db, 2, true, " dB"), figure(seen.pu21_ssim, 4, true),
      figure(seen.sarnoff, 4, true), figure(seen.flip, 4, true));
  fmt::print(
      "{} pixels compared, {} not finite, {} black in one alone and without a logarithm, {} "
      "scaled by {:.5g}\n",
      f.compared, f.non_finite, f.black_in_one, o.a, f.scale);
  if (std::isnan(f.rel_rmse)) fmt::print("no relative RMSE and no PSNR: {} is black\n", o.b);
  if (std::isnan(f.log10_rmse))
    fmt::print("no log10 luminance RMSE: no pixel is above black in both\n");
  if (std::isnan(seen.luminance_psnr_db))
    fmt::print("no PSNR of luminance: {} has one luminance alone\n", o.b);
  if (!maps.sarnoff) fmt::print("no Sarnoff figure: {} {}\n", o.b, maps.sarnoff.error().detail);
  if (!maps.flip) fmt::print("no FLIP: {} {}\n", o.b, maps.flip.error().detail);
}

std::string one_of_maps(const std::string& text) {
  const bool known = text == "flip" || text == "pu21" || text == "sarnoff";
  return known ? std::string() : "is none of flip, pu21 and sarnoff";
}

}  // namespace

Result<void> compare(const CompareOptions& o) {
  if (o.map) PENUMBRA_TRY(check_writable(*o.map));
  PENUMBRA_ASSIGN(picture, read_any(o.a));
  PENUMBRA_ASSIGN(reference, read_any(o.b));
  // Codes beside linear light are what a display shows of them.
  const bool mixed = picture.codes != reference.codes;
  const Image<Rgb> a = mixed ? linear_of(picture) : picture.values,
                   b = mixed ? linear_of(reference) : reference.values;
  if (mixed)
    log_info("{}: its codes count as sRGB, beside the linear light of {}",
             picture.codes ? o.a : o.b, picture.codes ? o.b : o.a);
  if (!a.same_size(b))
    return fail(ErrorCode::kInvalid, o.a,
                fmt::format("has {}x{} pixels, but {} has {}x{}", a.width(), a.height(), o.b,
                            b.width(), b.height()));
  std::vector<bool> use(a.area(), true);
  if (o.mask) {
    PENUMBRA_ASSIGN(mask_picture, read_any(*o.mask));
    const Image<Rgb>& mask = mask_picture.values;
    if (!mask.same_size(a))
      return fail(ErrorCode::kInvalid, *o.mask, "has another size than the pictures");
    for (std::size_t i = 0; i < use.size(); ++i) {
      const Rgb& p = mask.pixels()[i];
      use[i] = !(p.r == 0 && p.g == 0 && p.b == 1);
    }
  }
  const Figures f = measure(a, b, use, o.scale);
  if (f.compared == 0) return fail(ErrorCode::kUndetermined, o.a, "has no pixel left to compare");
  SeenMaps maps;
  const SeenFigures seen = measure_seen(picture, reference, o.nits, maps);
  if (o.map) PENUMBRA_TRY(write_map(o, maps));
  if (o.json) {
    print_json({{"rel_rmse", f.rel_rmse},
                {"log10_rmse", f.log10_rmse},
                {"psnr_db", f.psnr_db},
                {"max_abs", f.max_abs},
                {"mse", seen.mse},
                {"luminance_psnr_db", seen.luminance_psnr_db},
                {"pu21_psnr_db", seen.pu21_psnr_db},
                {"pu21_ssim", seen.pu21_ssim},
                {"sarnoff", seen.sarnoff},
                {"flip", seen.flip},
                {"scale", f.scale},
                {"compared_pixels", f.compared},
                {"black_in_one", f.black_in_one},
                {"non_finite", f.non_finite}});
  } else {
    print_figures(o, f, seen, maps);
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
  c->add_option("--nits", compare_options.nits,
                "Luminance that a value of 1 is shown at, cd/m^2, for the PU21 measures")
      ->capture_default_str()
      ->check(within(1e-6, 1e6));
  c->add_option("--map", compare_options.map, "Also write a picture of the error");
  c->add_option("--map-of", compare_options.map_of, "What --map shows: flip, pu21 or sarnoff")
      ->capture_default_str()
      ->check(one_of_maps);
  add_json(c, compare_options.json);
  c->callback([&] { action = [] { return compare(compare_options); }; });
}

}  // namespace penumbra::tools
