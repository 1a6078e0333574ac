#include <fmt/format.h>
#include <algorithm>
#include <cassert>
#include <charconv>
#include <cmath>
#include <iterator>

#include "calib/camera/response.h"
#include "core/io/files.h"
#include "core/io/toml_keys.h"

namespace penumbra::calib {
namespace fs = std::filesystem;
namespace {

constexpr std::size_t kMaxSamples = 1 << 20;

// NaN stays NaN: it must not turn into a plausible black.
double clamp01(double x) {
  return std::isnan(x) ? x : std::clamp(x, 0., 1.);
}

// IEC 61966-2-1, section 5.2 and 5.3.
double srgb_decode(double code) {
  return code <= .04045 ? code / 12.92 : std::pow((code + .055) / 1.055, 2.4);
}
double srgb_encode(double linear) {
  return linear <= .0031308 ? linear * 12.92 : 1.055 * std::pow(linear, 1 / 2.4) - .055;
}

double table_decode(const std::vector<float>& table, double code) {
  if (std::isnan(code)) return code;
  const double position = code * static_cast<double>(table.size() - 1);
  const auto below = std::min(static_cast<std::size_t>(position), table.size() - 2);
  const double t = position - static_cast<double>(below);
  return (1 - t) * table[below] + t * table[below + 1];
}

// Where several codes mean the same light (a flat piece), the lowest, except at the top: light at
// or above the last value saturates, and saturation is the full code.
double table_encode(const std::vector<float>& table, double linear) {
  if (std::isnan(linear)) return linear;
  if (linear >= table.back()) return 1;
  if (linear <= table.front()) return 0;
  const auto above = std::lower_bound(table.begin(), table.end(), linear);
  const double high = *above, low = *std::prev(above);
  const auto index = static_cast<double>(std::prev(above) - table.begin());
  return (index + (linear - low) / (high - low)) / static_cast<double>(table.size() - 1);
}

Result<void> check_table(const std::vector<float>& table, int channel) {
  const std::string where = fmt::format("response, channel {}", channel);
  if (table.size() < 2 || table.size() > kMaxSamples)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("has {} samples instead of 2..{}", table.size(), kMaxSamples));
  for (std::size_t i = 0; i < table.size(); ++i) {
    if (!(table[i] >= 0 && table[i] <= 1))  // also NaN
      return fail(ErrorCode::kInvalid, where,
                  fmt::format("sample {} is {} instead of within 0..1", i, table[i]));
    if (i > 0 && table[i] < table[i - 1])
      return fail(ErrorCode::kInvalid, where,
                  fmt::format("is not monotone: sample {} is below sample {}", i, i - 1));
  }
  if (table.back() == table.front())
    return fail(ErrorCode::kInvalid, where, "has samples that are all equal");
  return {};
}

// ------------------------------------------------------------------------------- files

std::string at_line(const fs::path& path, const toml::source_region& source) {
  return fmt::format("{}:{}", path.string(), source.begin.line);
}

Result<std::vector<float>> read_samples(const fs::path& path, const toml::array& array) {
  std::vector<float> samples;
  samples.reserve(array.size());
  for (const toml::node& node : array) {
    const auto number = node.value<double>();
    if (!number || !node.is_number())
      return fail(ErrorCode::kInvalid, at_line(path, node.source()), "decode: is not a number");
    samples.push_back(static_cast<float>(*number));
  }
  return samples;
}

/// One list, or a list of one or three lists.
Result<std::array<std::vector<float>, 3>> read_decode(const fs::path& path,
                                                      const toml::array& decode) {
  std::array<std::vector<float>, 3> channels;
  if (decode.empty() || !decode[0].is_array()) {
    PENUMBRA_ASSIGN(samples, read_samples(path, decode));
    channels.fill(samples);
    return channels;
  }
  if (decode.size() != 1 && decode.size() != 3)
    return fail(ErrorCode::kInvalid, at_line(path, decode.source()),
                fmt::format("decode: has {} lists instead of 1 or 3", decode.size()));
  for (std::size_t c = 0; c < 3; ++c) {
    const toml::node& node = decode[decode.size() == 1 ? 0 : c];
    if (!node.is_array())
      return fail(ErrorCode::kInvalid, at_line(path, node.source()),
                  "decode: is not a list of numbers");
    PENUMBRA_ASSIGN(samples, read_samples(path, *node.as_array()));
    channels[c] = std::move(samples);
  }
  return channels;
}

Result<Response> read_response(const fs::path& path, const toml::table& table) {
  for (const auto& [key, node] : table)
    if (key.str() != "version" && key.str() != "decode")
      return fail(
          ErrorCode::kInvalid, at_line(path, key.source()),
          fmt::format("unknown key \"{}\": a response file has version and decode", key.str()));
  const toml::node* version = table.get("version");
  if (!version) return fail(ErrorCode::kInvalid, path.string(), "version = 1 is missing");
  if (!version->is_integer() || version->value<std::int64_t>() != 1)
    return fail(ErrorCode::kInvalid, at_line(path, version->source()), "version: is not 1");
  const toml::node* decode = table.get("decode");
  if (!decode) return fail(ErrorCode::kInvalid, path.string(), "decode is missing");
  if (!decode->is_array())
    return fail(ErrorCode::kInvalid, at_line(path, decode->source()), "decode: is not a list");
  PENUMBRA_ASSIGN(channels, read_decode(path, *decode->as_array()));
  auto response = Response::from_table(std::move(channels));
  if (!response)
    return fail(response.error().code, at_line(path, decode->source()),
                response.error().where + ": " + response.error().detail);
  return response;
}

/// A table has its own number of samples. A formula is sampled at four points per 8-bit code, so
/// that every 8-bit code lies on a sample.
int sample_count(const Response& response) {
  const std::string text = response.describe();
  constexpr std::string_view prefix = "table of ";
  int count = 4 * 255 + 1;
  if (text.starts_with(prefix))
    std::from_chars(text.data() + prefix.size(), text.data() + text.size(), count);
  return count;
}

}  // namespace

Response Response::linear() {
  return {};
}

Response Response::srgb() {
  Response response;
  response.form_ = Form::kSrgb;
  return response;
}

Response Response::gamma(double exponent) {
  assert(std::isfinite(exponent) && exponent > 0);
  Response response;
  response.form_ = Form::kGamma;
  response.exponent_ = exponent;
  return response;
}

Result<Response> Response::from_table(std::array<std::vector<float>, 3> decode) {
  for (std::size_t c = 0; c < 3; ++c) {
    PENUMBRA_TRY(check_table(decode[c], static_cast<int>(c)));
    if (decode[c].size() != decode[0].size())
      return fail(ErrorCode::kInvalid, "response",
                  "has channels with different numbers of samples");
  }
  Response response;
  response.form_ = Form::kTable;
  response.table_ = std::make_shared<const std::array<std::vector<float>, 3>>(std::move(decode));
  return response;
}

Result<Response> Response::with_white_balance(const std::array<double, 3>& gains) const {
  for (const double gain : gains)
    if (!(gain > 0 && std::isfinite(gain)))
      return fail(ErrorCode::kInvalid, "white balance",
                  fmt::format("gain {} is not positive and finite", gain));
  Response out = *this;
  const double smallest = std::ranges::min(gains);
  for (std::size_t c = 0; c < 3; ++c) out.white_balance_[c] = gains[c] / smallest;
  return out;
}

double Response::decode(double code, int channel) const {
  assert(channel >= 0 && channel < 3);
  return curve_decode(code, channel) / white_balance_[static_cast<std::size_t>(channel)];
}

double Response::encode(double linear, int channel) const {
  assert(channel >= 0 && channel < 3);
  return curve_encode(linear * white_balance_[static_cast<std::size_t>(channel)], channel);
}

double Response::curve_decode(double code, int channel) const {
  const double x = clamp01(code);
  switch (form_) {
    case Form::kSrgb:
      return srgb_decode(x);
    case Form::kGamma:
      return std::pow(x, exponent_);
    case Form::kTable:
      return table_decode((*table_)[static_cast<std::size_t>(channel)], x);
    default:
      return x;
  }
}

double Response::curve_encode(double linear, int channel) const {
  const double x = clamp01(linear);
  switch (form_) {
    case Form::kSrgb:
      return srgb_encode(x);
    case Form::kGamma:
      return std::pow(x, 1 / exponent_);
    case Form::kTable:
      return table_encode((*table_)[static_cast<std::size_t>(channel)], x);
    default:
      return x;
  }
}

std::vector<float> Response::decode_table(int bits, int channel) const {
  assert(bits >= 1 && bits <= 16);
  const int last = (1 << bits) - 1;
  std::vector<float> table;
  table.reserve(static_cast<std::size_t>(last) + 1);
  for (int code = 0; code <= last; ++code)
    table.push_back(static_cast<float>(decode(static_cast<double>(code) / last, channel)));
  return table;
}

bool Response::same_for_all_channels() const {
  if (white_balance_ != std::array<double, 3>{1, 1, 1}) return false;
  return form_ != Form::kTable || ((*table_)[0] == (*table_)[1] && (*table_)[0] == (*table_)[2]);
}

bool Response::is_linear() const {
  if (white_balance_ != std::array<double, 3>{1, 1, 1}) return false;
  return form_ == Form::kLinear || (form_ == Form::kGamma && exponent_ == 1);
}

std::string Response::describe() const {
  switch (form_) {
    case Form::kSrgb:
      return "srgb";
    case Form::kGamma:
      return fmt::format("gamma:{}", exponent_);
    case Form::kTable:
      return fmt::format("table of {}", (*table_)[0].size());
    default:
      return "linear";
  }
}

Result<Response> parse_response(const std::string& text, const fs::path& folder) {
  constexpr std::string_view known = "known are linear, srgb, gamma:EXPONENT or a file";
  if (text == "linear") return Response::linear();
  if (text == "srgb") return Response::srgb();
  if (text.starts_with("gamma:")) {
    double exponent = 0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data() + 6, end, exponent);
    if (error != std::errc{} || stop != end || !std::isfinite(exponent) || exponent <= 0)
      return fail(ErrorCode::kInvalid, text, "the exponent is not a positive number");
    return Response::gamma(exponent);
  }
  if (text.empty())
    return fail(ErrorCode::kInvalid, "response", fmt::format("is empty; {}", known));
  const fs::path path = folder / text;
  std::error_code ignored;
  if (!fs::exists(path, ignored))
    return fail(ErrorCode::kNotFound, path.string(),
                fmt::format("is neither a response nor a file; {}", known));
  PENUMBRA_ASSIGN(table, parse_toml(path));
  return read_response(path, table);
}

Result<Response> parse_response_file(std::string_view text, const fs::path& path) {
  PENUMBRA_ASSIGN(table, parse_toml_text(text, path));
  return read_response(path, table);
}

std::string print_response_file(const Response& response) {
  const int count = sample_count(response);
  const int channels = response.same_for_all_channels() ? 1 : 3;
  std::string text =
      "version = 1\n# linear light at equidistant codes; one list serves all channels\n";
  text += "decode = [\n";
  for (int c = 0; c < channels; ++c) {
    std::vector<float> samples;
    samples.reserve(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i)
      samples.push_back(
          static_cast<float>(response.decode(static_cast<double>(i) / (count - 1), c)));
    text += fmt::format("  [{}],\n", fmt::join(samples, ", "));
  }
  return text + "]\n";
}

Result<void> write_response(const fs::path& path, const Response& response) {
  return write_bytes(path, print_response_file(response));
}

}  // namespace penumbra::calib
