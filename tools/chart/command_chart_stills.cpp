// Bits a pixel against error of ways to keep HDR pictures.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include "codec/codec.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/rate_chart.h"
#include "tools/chart/measures/flip.h"
#include "tools/chart/measures/luminance_error.h"
#include "tools/chart/measures/sarnoff.h"
#include "tools/chart/peers/still_coders.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

constexpr int kMinSide = 64;

// Of a picture that a coder kept as it is a ratio to its error is none, and counts in no mean.
class MeanRatio {
 public:
  void add(double db) {
    if (!std::isfinite(db)) return;
    sum_ += db;
    ++count_;
  }
  double db() const { return count_ > 0 ? sum_ / count_ : std::numeric_limits<double>::infinity(); }

 private:
  double sum_ = 0;
  int count_ = 0;
};

// What a coder makes of the pictures, in the mean over them.
struct StillFigures {
  std::string coder, setting;
  double bits_per_pixel = 0, bytes = 0, log10_luminance_rms = 0, pixel_rel_max = 0, sarnoff = 0,
         flip = 0;
  MeanRatio psnr, pu21_psnr;
  double encode_ms = 0, decode_ms = 0;  // of a megapixel
};

// Coders for video take even sides. What is not finite no coder takes.
Result<Image<Rgb>> read_still(const std::string& path) {
  PENUMBRA_ASSIGN(image, codec::read_hdr(path));
  if (image.non_finite > 0)
    return fail(ErrorCode::kNonFinite, path, "has pixels that are not finite");
  Image<Rgb> out(image.pixels.width() & ~1, image.pixels.height() & ~1);
  if (std::min(out.width(), out.height()) < kMinSide)
    return fail(ErrorCode::kInvalid, path,
                fmt::format("has a side below {} pixels: heads of files would count", kMinSide));
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x)
      for (int c = 0; c < 3; ++c) out.at(x, y)[c] = std::max(0.f, image.pixels.at(x, y)[c]);
  return out;
}

// Over pixels that are not black. What a coder made black is off by three decades.
double log_luminance_error(const Image<Rgb>& truth, const Image<Rgb>& decoded) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const double a = luminance(truth.pixels()[i]), b = luminance(decoded.pixels()[i]);
    if (!(a > 0)) continue;
    sum += std::pow(std::log10(std::max(b / a, 1e-3)), 2);
    ++count;
  }
  return count > 0 ? std::sqrt(sum / count) : 0;
}

// Of a channel over the largest of its pixel, where that is normal for RGBE: what formats that keep
// every pixel promise (Xu 2005, table 4.3).
double largest_error(const Image<Rgb>& truth, const Image<Rgb>& decoded) {
  double largest = 0;
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const Rgb &a = truth.pixels()[i], &b = decoded.pixels()[i];
    const double of = std::max({a.r, a.g, a.b});
    if (of < 0x1p-126) continue;
    for (int c = 0; c < 3; ++c) largest = std::max(largest, std::abs(double{b[c]} - a[c]) / of);
  }
  return largest;
}

// Shown so that the middle of the picture has 10 cd/m^2.
double display_scale(const Image<Rgb>& picture) {
  std::vector<float> values;
  for (const Rgb& p : picture.pixels()) values.push_back(luminance(p));
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return 10 / std::max(1e-6, double{*middle});
}

Result<void> add_picture(const StillCoder& coder, const Image<Rgb>& picture, double fraction,
                         StillFigures& out) {
  const auto result = coder.code(picture);
  if (!result)
    return fail(result.error().code, fmt::format("{}, {}", coder.coder, coder.setting),
                result.error().where + ": " + result.error().detail);
  const CodedPicture& coded = *result;
  const double area = static_cast<double>(picture.area()), megapixels = area / 1e6;
  PENUMBRA_ASSIGN(linear, luminance_error(picture, coded.decoded));
  PENUMBRA_ASSIGN(sarnoff, sarnoff_map(picture, coded.decoded));
  PENUMBRA_ASSIGN(pu21, pu21_error(picture, coded.decoded, display_scale(picture)));
  PENUMBRA_ASSIGN(flips, hdr_flip(picture, coded.decoded));
  out.bits_per_pixel += fraction * 8 * static_cast<double>(coded.bytes) / area;
  out.bytes += fraction * static_cast<double>(coded.bytes);
  out.log10_luminance_rms += fraction * std::pow(log_luminance_error(picture, coded.decoded), 2);
  out.sarnoff += fraction * mean_sarnoff(sarnoff);
  out.pixel_rel_max = std::max(out.pixel_rel_max, largest_error(picture, coded.decoded));
  out.psnr.add(linear.psnr_db);
  out.pu21_psnr.add(pu21.psnr_db);
  out.flip += fraction * mean_flip(flips);
  out.encode_ms += fraction * coded.encode_ms / megapixels;
  out.decode_ms += fraction * coded.decode_ms / megapixels;
  return {};
}

Result<std::vector<StillFigures>> measure_coders(const std::vector<Image<Rgb>>& pictures,
                                                 const std::filesystem::path& folder) {
  const std::vector<StillCoder> coders = still_coders(folder);
  std::vector<StillFigures> out;
  const auto progress = progress_bar("coding");
  const double fraction = 1 / static_cast<double>(pictures.size());
  double done = 0;
  for (const StillCoder& coder : coders) {
    StillFigures& figures = out.emplace_back();
    figures.coder = coder.coder, figures.setting = coder.setting;
    for (const Image<Rgb>& picture : pictures) {
      PENUMBRA_TRY(add_picture(coder, picture, fraction, figures));
      progress(++done / static_cast<double>(coders.size() * pictures.size()));
    }
    figures.log10_luminance_rms = std::sqrt(figures.log10_luminance_rms);
  }
  return out;
}

nlohmann::json to_json(const StillFigures& f) {
  return {{"coder", f.coder},
          {"setting", f.setting},
          {"bytes", f.bytes},
          {"bits_per_pixel", f.bits_per_pixel},
          {"log10_luminance_rms", f.log10_luminance_rms},
          {"pixel_rel_max", f.pixel_rel_max},
          {"sarnoff", f.sarnoff},
          {"psnr_db", f.psnr.db()},
          {"pu21_psnr_db", f.pu21_psnr.db()},
          {"flip", f.flip},
          {"encode_ms_per_megapixel", f.encode_ms},
          {"decode_ms_per_megapixel", f.decode_ms}};
}

std::string still_table(const std::vector<StillFigures>& figures) {
  std::string out =
      "coder,setting,bytes,bits_per_pixel,log10_luminance_rms,pixel_rel_max,sarnoff,psnr_db,"
      "pu21_psnr_db,flip,"
      "encode_ms_per_megapixel,decode_ms_per_megapixel\n";
  for (const StillFigures& f : figures)
    out += fmt::format(
        "\"{}\",{},{:.0f},{:.4g},{:.5g},{:.4g},{:.4g},{:.4g},{:.4g},{:.4g},{:.4g},{:.4g}\n",
        f.coder, f.setting, f.bytes, f.bits_per_pixel, f.log10_luminance_rms, f.pixel_rel_max,
        f.sarnoff, f.psnr.db(), f.pu21_psnr.db(), f.flip, f.encode_ms, f.decode_ms);
  return out;
}

}  // namespace

Result<void> chart_stills(const ChartOptions& o) {
  std::vector<Image<Rgb>> pictures;
  for (const std::string& path : o.stills_charted) {
    PENUMBRA_ASSIGN(picture, read_still(path));
    pictures.push_back(std::move(picture));
  }
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_TRY(output.begin());
  PENUMBRA_ASSIGN(figures, measure_coders(pictures, output.work()));
  std::vector<RatePoint> points;
  for (const StillFigures& f : figures)
    points.push_back({f.coder, f.setting, static_cast<std::size_t>(f.bytes),
                      std::pow(10, f.log10_luminance_rms) - 1});
  PENUMBRA_TRY(write_rates(output, points,
                           {fmt::format("{} pictures", pictures.size()),
                            "Error of luminance: RMS of its logarithm (per cent)",
                            "luminance_rel_rms", "Kilobytes a picture", 1000}));
  PENUMBRA_TRY(write_bytes(output.file("stills.csv"), still_table(figures)));
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    nlohmann::json rows = nlohmann::json::array();
    for (const StillFigures& f : figures) rows.push_back(to_json(f));
    print_json({{"pictures", pictures.size()}, {"rows", rows}});
    return {};
  }
  fmt::print("{:<32} {:<17} {:>8} {:>8} {:>8} {:>8} {:>7} {:>7} {:>6} {:>14}\n", "coder", "setting",
             "KB", "log10", "worst", "Sarnoff", "PSNR dB", "PU21 dB", "FLIP", "ms/MP in, out");
  for (const StillFigures& f : figures)
    fmt::print(
        "{:<32} {:<17} {:>8.1f} {:>8.4f} {:>8.4f} {:>8.4f} {:>7.2f} {:>7.2f} {:>6.3f} {:>7.0f} "
        "{:>6.0f}\n",
        f.coder, f.setting, f.bytes / 1000, f.log10_luminance_rms, f.pixel_rel_max, f.sarnoff,
        f.psnr.db(), f.pu21_psnr.db(), f.flip, f.encode_ms, f.decode_ms);
  fmt::print("{0}/stills.csv, {0}/rate-distortion.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
