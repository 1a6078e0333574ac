#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "codec/codec.h"
#include "codec/gain_map_jpeg.h"
#include "codec/tone/tone_mapping.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"
#include "tools/penumbra/tonemap_sequence.h"

namespace penumbra::tools {

namespace fs = std::filesystem;

namespace {

struct TonemapOptions {
  std::vector<std::string> inputs;
  std::string output, op = "level-set";
  std::optional<std::string> detail;
  tone::ToneOptions tone;
  double fps = 30, adaptation_s = .4;  // of a sequence
  bool gain_map = false, json = false;
  std::vector<std::string_view> given;  // flags of flags_of_operators()
};

// What belongs to some operators alone; given to another one it would do nothing.
struct ToneFlag {
  const char* name;
  std::vector<std::string_view> operators;
};
const std::vector<ToneFlag>& flags_of_operators() {
  static const std::vector<ToneFlag> all = {
      {"--steps", {"level-set"}},
      {"--contrast", {"level-set"}},
      {"--base-decades", {"bilateral"}},
      {"--white", {"photographic", "photographic-local", "filmic"}},
      {"--saturation", {"level-set", "photographic", "photographic-local", "bilateral"}},
      {"--detail", {"level-set", "bilateral"}},
  };
  return all;
}

Result<void> check_flags(const TonemapOptions& o) {
  for (const ToneFlag& f : flags_of_operators())
    if (std::ranges::find(o.given, std::string_view(f.name)) != o.given.end() &&
        std::ranges::find(f.operators, std::string_view(o.op)) == f.operators.end())
      return fail(ErrorCode::kInvalid, f.name,
                  fmt::format("belongs to {}, and not to {}", fmt::join(f.operators, ", "), o.op));
  return {};
}

// Grey where there is none; a hundred steps of the code to a factor of e.
Image<Rgb8> picture_of_detail(const Image<float>& detail) {
  Image<Rgb8> out(detail.width(), detail.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const float code = std::clamp(128 + 100 * detail.pixels()[i], 0.f, 255.f);
    const auto v = static_cast<std::uint8_t>(std::lround(code));
    out.pixels()[i] = {v, v, v};
  }
  return out;
}

double rms(const Image<float>& values) {
  double sum = 0;
  for (const float v : values.pixels()) sum += double{v} * v;
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.area()));
}

void report_tone(const TonemapOptions& o, const tone::ToneMapped& mapped) {
  const tone::ToneStatistics& s = mapped.statistics;
  const auto luminance = [&](double logarithm) { return s.black ? 0 : std::exp(logarithm); };
  if (o.json) {
    print_json({{"operator", o.op},
                {"width", mapped.pixels.width()},
                {"height", mapped.pixels.height()},
                {"mean_luminance", luminance(s.mean)},
                {"median_luminance", luminance(s.median)},
                {"low_luminance", luminance(s.low)},
                {"high_luminance", luminance(s.high)},
                {"negative", s.negative},
                {"detail_rms", rms(mapped.detail)}});
    return;
  }
  fmt::print("{}: {}x{} by {}, luminance {:.4g} to {:.4g}, {:.4g} in the middle\n", o.output,
             mapped.pixels.width(), mapped.pixels.height(), o.op, luminance(s.low),
             luminance(s.high), luminance(s.median));
}

// Of the channel that is off most, of its sum and a twentieth of the brightest one's.
double light_off(const Image<Rgb>& truth, const Image<Rgb>& decoded) {
  std::array<double, 3> light{}, kept{};
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      light[static_cast<std::size_t>(c)] += std::max(0., double{truth.pixels()[i][c]});
      kept[static_cast<std::size_t>(c)] += double{decoded.pixels()[i][c]};
    }
  const double part = std::ranges::max(light) / 20;
  double out = 0;
  for (std::size_t c = 0; c < 3 && part > 0; ++c)
    out = std::max(out, std::abs((kept[c] + part) / (light[c] + part) - 1));
  return out;
}

// What a reader gets is held against the picture: a lamp of few pixels on black is what two JPEGs
// keep worst.
Result<void> write_gain_map(const std::string& path, const Image<Rgb>& radiance,
                            const Image<Rgb8>& base) {
  constexpr double kWorthAWord = .05;
  PENUMBRA_ASSIGN(jpeg, codec::encode_gain_map_jpeg(radiance, base));
  PENUMBRA_ASSIGN(back, codec::decode_gain_map_jpeg(jpeg, path));
  if (const double off = light_off(radiance, back.pixels); off > kWorthAWord)
    log_warning(
        "{}: the light of a channel comes back off by {:.0f} % of it and a twentieth of the "
        "brightest: `penumbra encode` keeps it",
        path, 100 * off);
  return write_bytes(path, {reinterpret_cast<const char*>(jpeg.data()), jpeg.size()});
}

Result<void> check_is_jpeg(const std::string& path) {
  const std::string extension = lower_extension(path);
  if (extension == ".jpg" || extension == ".jpeg") return {};
  return fail(ErrorCode::kInvalid, "--gain-map", "needs a JPEG: " + path + " is none by its name");
}

Result<void> show_sequence(const TonemapOptions& o, std::vector<fs::path> pictures) {
  if (o.gain_map || o.detail)
    return fail(ErrorCode::kInvalid, o.gain_map ? "--gain-map" : "--detail",
                "is for a single picture");
  const std::size_t count = pictures.size();
  PENUMBRA_TRY(tonemap_sequence({std::move(pictures), o.output, o.tone, o.fps, o.adaptation_s}));
  if (o.json)
    print_json({{"operator", o.op}, {"pictures", count}});
  else
    fmt::print("{}: {} pictures by {}\n", o.output, count, o.op);
  return {};
}

Result<void> tonemap(TonemapOptions o) {
  auto op = tone::parse_tone_operator(o.op);
  if (!op) return fail(op.error().code, "--operator " + o.op, op.error().detail);
  o.tone.op = *op;
  PENUMBRA_TRY(check_flags(o));
  std::vector<fs::path> pictures;
  for (const std::string& input : o.inputs) {
    PENUMBRA_ASSIGN(found, pictures_of(input));
    pictures.insert(pictures.end(), found.begin(), found.end());
  }
  std::error_code ignored;
  if (pictures.size() > 1 || fs::is_directory(o.inputs[0], ignored))
    return show_sequence(o, std::move(pictures));
  const std::string& input_path = o.inputs[0];
  if (o.gain_map) PENUMBRA_TRY(check_is_jpeg(o.output));
  PENUMBRA_TRY(check_writable(o.output));
  if (o.detail) PENUMBRA_TRY(check_writable(*o.detail));
  PENUMBRA_ASSIGN(input, codec::read_hdr(input_path));
  auto mapped = tone::tone_map(input.pixels, o.tone);
  if (!mapped)
    return fail(mapped.error().code,
                mapped.error().where == "picture" ? input_path : mapped.error().where,
                mapped.error().detail);
  if (mapped->statistics.negative > 0)
    log_warning("{}: {} pixels have components below 0, which count as 0", input_path,
                mapped->statistics.negative);
  PENUMBRA_TRY(o.gain_map ? write_gain_map(o.output, input.pixels, mapped->pixels)
                          : codec::write_frame(o.output, mapped->pixels));
  if (o.detail) PENUMBRA_TRY(codec::write_frame(*o.detail, picture_of_detail(mapped->detail)));
  report_tone(o, *mapped);
  return {};
}

}  // namespace

void add_tonemap(CLI::App& parent, Action& action) {
  static TonemapOptions o;
  auto* c = parent.add_subcommand("tonemap", "Show HDR pictures on an ordinary display");
  c->add_option(
       "input", o.inputs,
       "HDR picture: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map; several, or a folder "
       "of them, follow each other as a video")
      ->required();
  c->add_option(
       "-o,--output", o.output,
       "Picture to write: PNG, JPEG or TIFF; of several pictures a video, .mp4, or a folder "
       "for PNG")
      ->required();
  c->add_option("--fps", o.fps, "Pictures a second of several, 0.1 to 1000")
      ->capture_default_str()
      ->check(within(.1, 1000));
  c->add_option(
       "--adaptation", o.adaptation_s,
       "Time in seconds in which several pictures' brightness is followed to 63 %, 0 to 60; "
       "0: each by itself")
      ->capture_default_str()
      ->check(within(0, 60));
  c->add_option("--operator", o.op,
                "level-set, photographic, photographic-local, bilateral or filmic")
      ->capture_default_str();
  c->add_option("--exposure", o.tone.exposure_stops, "Brighten by so many stops, -32 to 32")
      ->capture_default_str()
      ->check(within(-32, 32));
  c->add_option("--key", o.tone.key,
                "Luminance that the scene's middle is shown as, 0.01 to 0.9 of white; level-set: "
                "0.18, else by where the middle lies between dark and bright")
      ->check(within(.01, .9));
  c->add_option("--saturation", o.tone.saturation,
                "Part of each colour's distance from grey that is kept, 0 to 2; not for filmic")
      ->capture_default_str()
      ->check(within(0, 2));
  c->add_option("--steps", o.tone.level_set.steps,
                "Steps of the level set, 0 to 1000: more give more detail")
      ->capture_default_str()
      ->check(within(0, 1000));
  c->add_option("--contrast", o.tone.contrast,
                "Exponent of the curve that compresses the level set's profile, 0.1 to 4")
      ->capture_default_str()
      ->check(within(.1, 4));
  c->add_option("--white", o.tone.white,
                "Luminance shown white by photographic and filmic, in multiples of the middle, "
                "above 1")
      ->check(within(1, 1e6));
  c->add_option("--base-decades", o.tone.base_decades,
                "Decades that the bilateral base is compressed to, 0.1 to 8")
      ->capture_default_str()
      ->check(within(.1, 8));
  c->add_flag("--gain-map", o.gain_map,
              "Keep the radiance in the JPEG, beside the picture that old viewers show");
  c->add_option("--detail", o.detail, "Also write the detail, as a grey picture");
  add_json(c, o.json);
  c->callback([&action, c] {
    for (const ToneFlag& f : flags_of_operators())
      if (c->count(f.name) > 0) o.given.push_back(f.name);
    action = [] { return tonemap(o); };
  });
}

}  // namespace penumbra::tools
