// encode and decode: HDR stills that take little and lose what is not seen.
#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "codec/codec.h"
#include "codec/dct/rgbe_still.h"
#include "codec/log/log_jpeg2000.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

constexpr double kErrorPercent = 2;

struct EncodeOptions {
  std::string input, output;
  double error_percent = kErrorPercent;
  std::optional<double> size_kb;
  std::string base;
  bool every_pixel = false, json = false;
};

struct DecodeOptions {
  std::string input, output;
  bool json = false;
};

constexpr double kBytesPerKb = 1000;

codec::StillGoal goal_of(const EncodeOptions& o) {
  codec::StillGoal goal;
  goal.deviation = std::log10(1 + o.error_percent / 100);
  if (o.size_kb) goal.max_bytes = static_cast<std::size_t>(*o.size_kb * kBytesPerKb);
  return goal;
}

constexpr const char* kContinuous = "continuous";
constexpr const char* kAdaptive = "adaptive";
constexpr const char* kLossless = "lossless";

using Encoding = std::function<Result<codec::CodedStill>(const codec::HdrImage&)>;

Encoding by_wavelets(const EncodeOptions& o, codec::WaveletCoder coder) {
  const auto encode =
      o.every_pixel ? codec::encode_log_jpeg2000_exactly : codec::encode_log_jpeg2000;
  return [=, goal = goal_of(o)](const codec::HdrImage& in) {
    return encode(in.pixels, goal, coder, in.environment);
  };
}

Encoding by_cosines(const EncodeOptions& o) {
  if (o.base == kLossless)
    return [](const codec::HdrImage& in) {
      return codec::encode_rgbe_still_as(in.pixels, {.base = codec::RgbeBase::kLossless},
                                         in.environment);
    };
  const auto base =
      o.base == kAdaptive ? codec::RgbeBase::kAdaptiveJpeg : codec::RgbeBase::kContinuous;
  return [=, goal = goal_of(o)](const codec::HdrImage& in) {
    return codec::encode_rgbe_still(in.pixels, goal, base, in.environment);
  };
}

Result<Encoding> encoding_of(const EncodeOptions& o) {
  const std::string extension = lower_extension(o.output);
  if (extension == ".pnr") {
    if (o.every_pixel)
      return fail(ErrorCode::kInvalid, "--every-pixel",
                  "goes with .jph and .jp2; --base lossless keeps what RGBE holds of each pixel");
    if (o.base == kLossless && (o.size_kb || o.error_percent != kErrorPercent))
      return fail(ErrorCode::kInvalid, "--base",
                  "lossless takes what it takes: no --error and no --size-kb");
    return by_cosines(o);
  }
  if (!o.base.empty()) return fail(ErrorCode::kInvalid, "--base", "goes with .pnr alone");
  if (extension == ".jph") return by_wavelets(o, codec::WaveletCoder::kFast);
  if (extension == ".jp2") return by_wavelets(o, codec::WaveletCoder::kSmall);
  return fail(ErrorCode::kInvalid, o.output, "ends neither in .jph, .jp2 nor .pnr");
}

bool has_unseen(const codec::HdrImage& image) {
  return std::ranges::any_of(image.alpha.pixels(), [](float a) { return a < 1; });
}

void report_encoded(const EncodeOptions& o, const Image<Rgb>& pixels,
                    const codec::CodedStill& coded) {
  const double bits = 8. * static_cast<double>(coded.bytes.size()) / double(pixels.area());
  const auto percent = [](double log10_error) { return 100 * (std::pow(10, log10_error) - 1); };
  const codec::StillError& e = coded.error;
  if (o.json) {
    print_json({{"width", pixels.width()},
                {"height", pixels.height()},
                {"bytes", coded.bytes.size()},
                {"bits_per_pixel", bits},
                {"log10_luminance_rms", e.luminance_rms},
                {"luminance_error_percent", percent(e.luminance_rms)},
                {"worst_luminance_error_percent", percent(e.luminance_max)},
                {"light_error_percent", percent(e.light)}});
    return;
  }
  fmt::print(
      "{}: {}x{}, {:.1f} KB, {:.2f} bits a pixel; luminance off by {:.3g} % (RMS), at worst {:.3g} "
      "%; light of a channel off by {:.3g} % of it and a twentieth of the brightest\n",
      o.output, pixels.width(), pixels.height(), double(coded.bytes.size()) / kBytesPerKb, bits,
      percent(e.luminance_rms), percent(e.luminance_max), percent(e.light));
}

Result<void> encode(const EncodeOptions& o) {
  if (o.every_pixel && o.size_kb)
    return fail(ErrorCode::kInvalid, "--size-kb",
                "does not go with --every-pixel, which takes what it takes");
  PENUMBRA_ASSIGN(encode_as, encoding_of(o));
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(input, codec::read_hdr(o.input));
  if (has_unseen(input))
    log_warning("{}: its alpha, which says what was seen, is not kept", o.input);
  const auto coded = encode_as(input);
  if (!coded) {
    const bool of_goal = coded.error().where == "goal";
    const bool halves_colour = of_goal && !o.size_kb && lower_extension(o.output) == ".pnr";
    return fail(
        coded.error().code, of_goal ? (o.size_kb ? "--size-kb" : "--error") : o.input,
        (of_goal || coded.error().where == "picture"
             ? coded.error().detail
             : coded.error().where + " " + coded.error().detail) +
            (halves_colour ? "; .jph or --base lossless keep colours at full resolution" : ""));
  }
  PENUMBRA_TRY(write_bytes(
      o.output, {reinterpret_cast<const char*>(coded->bytes.data()), coded->bytes.size()}));
  if (coded->error.negative > 0)
    log_warning("{}: {} pixels have components below 0, which come back as 0", o.input,
                coded->error.negative);
  report_encoded(o, input.pixels, *coded);
  return {};
}

Result<void> decode(const DecodeOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(input, codec::read_hdr(o.input));
  const bool is_exr = lower_extension(o.output) != ".hdr";
  if (!is_exr && has_unseen(input))
    log_warning("{}: its alpha, which says what was seen, is not kept in .hdr", o.input);
  PENUMBRA_TRY(codec::write_hdr(o.output, input.pixels, codec::Depth::kFloat, input.environment,
                                is_exr ? input.alpha : Image<float>()));
  if (o.json)
    print_json({{"width", input.pixels.width()}, {"height", input.pixels.height()}});
  else
    fmt::print("{}: {}x{}\n", o.output, input.pixels.width(), input.pixels.height());
  return {};
}

}  // namespace

void add_encode(CLI::App& parent, Action& action) {
  static EncodeOptions o;
  auto* c = parent.add_subcommand("encode", "Make an HDR picture small, to a stated error");
  c->add_option("input", o.input,
                "HDR picture: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map")
      ->required();
  c->add_option("-o,--output", o.output,
                "Picture to write: .jph (High-Throughput JPEG 2000), .jp2 (JPEG 2000: a tenth "
                "smaller, several times as slow to write), or .pnr (RGBE by cosines)")
      ->required();
  auto* error =
      c->add_option("--error", o.error_percent,
                    "Largest error in per cent: of luminance, RMS over the pixels, and of the "
                    "light of each channel (with a twentieth of the brightest one's; over the "
                    "sphere for pictures of 2:1); 0.01 to 100")
          ->capture_default_str()
          ->check(within(.01, 100));
  c->add_option("--size-kb", o.size_kb,
                "Largest size in kilobytes (1000 bytes), in place of --error, 0.1 to 1000000")
      ->check(within(.1, 1e6))
      ->excludes(error);
  c->add_flag("--every-pixel", o.every_pixel,
              "Keep --error in each pixel, not in the mean over them");
  c->add_option("--base", o.base,
                "Of .pnr, how RGBE's bases are coded: continuous (the default), adaptive (finer "
                "steps where exponents differ), lossless (RGBE as it is)")
      ->check(CLI::IsMember({kContinuous, kAdaptive, kLossless}));
  add_json(c, o.json);
  c->callback([&] { action = [] { return encode(o); }; });
}

void add_decode(CLI::App& parent, Action& action) {
  static DecodeOptions o;
  auto* c = parent.add_subcommand("decode", "Write any HDR picture as OpenEXR or Radiance");
  c->add_option("input", o.input,
                "HDR picture: .jph, .jp2, .pnr, .exr, .hdr, or .jpg with a gain map")
      ->required();
  c->add_option("-o,--output", o.output, "Picture to write: .exr or .hdr")->required();
  add_json(c, o.json);
  c->callback([&] { action = [] { return decode(o); }; });
}

}  // namespace penumbra::tools
