// How a camera's codes follow from light.
// threads: every function is reentrant
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Camera response f: linear signal in 0..1 of full scale -> code in 0..1, per channel, monotone.
class Response {
 public:
  static Response linear();
  static Response srgb();  // IEC 61966-2-1
  static Response gamma(double exponent);
  /// Inverse response sampled at `decode.size()` equidistant codes, per channel; must be monotone
  /// non-decreasing, 2 samples or more.
  /// errors: kInvalid
  static Result<Response> from_table(std::array<std::vector<float>, 3> decode);

  /// The same behind gains per channel between sensor and response. Only their ratios matter: the
  /// smallest counts as 1, the exposure has the rest.
  /// errors: kInvalid (not positive and finite)
  Result<Response> with_white_balance(const std::array<double, 3>& gains) const;
  const std::array<double, 3>& white_balance() const { return white_balance_; }

  double decode(double code, int channel) const;    // code 0..1 -> linear 0..1
  double encode(double linear, int channel) const;  // clamps to 0..1
  /// Decoded value of each of 2^bits codes (bits 8 or 16), for one channel.
  std::vector<float> decode_table(int bits, int channel) const;
  bool same_for_all_channels() const;
  bool is_linear() const;
  std::string describe() const;  // "srgb", "gamma:2.2", "table of 256"

 private:
  enum class Form { kLinear, kSrgb, kGamma, kTable };
  Form form_ = Form::kLinear;
  double curve_decode(double code, int channel) const;
  double curve_encode(double linear, int channel) const;
  double exponent_ = 1;
  std::array<double, 3> white_balance_{1, 1, 1};
  std::shared_ptr<const std::array<std::vector<float>, 3>> table_;
};

/// "linear", "srgb", "gamma:2.2", or the path of a TOML file (relative to `folder`) with
/// `version = 1` and `decode = [[..], [..], [..]]` (one list serves all three channels).
/// errors: kInvalid, kNotFound, kUnreadable
Result<Response> parse_response(const std::string& text, const std::filesystem::path& folder = {});
/// Writes print_response_file's text.
/// errors: kUnwritable
Result<void> write_response(const std::filesystem::path& path, const Response& response);
/// Such a file's text; `path` names it in errors.
Result<Response> parse_response_file(std::string_view text, const std::filesystem::path& path);
/// Text that parse_response_file reads: a table's own samples, or 1021 of a formula.
std::string print_response_file(const Response& response);

}  // namespace penumbra::calib
#pragma GCC visibility pop
