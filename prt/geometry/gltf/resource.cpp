// What URIs name: data in the file, or files beside it.
#include <fmt/format.h>

#include <array>
#include <cctype>
#include <string_view>

#include "prt/geometry/gltf/internal/document.h"
#include "prt/geometry/internal/asset_files.h"

namespace penumbra::prt::gltf {

namespace {

std::optional<unsigned> hex_digit(char c) {
  if (c >= '0' && c <= '9') return static_cast<unsigned>(c - '0');
  if (c >= 'a' && c <= 'f') return static_cast<unsigned>(c - 'a' + 10);
  if (c >= 'A' && c <= 'F') return static_cast<unsigned>(c - 'A' + 10);
  return std::nullopt;
}

// RFC 3986, 2.1; nothing where a digit is missing.
std::optional<std::string> percent_decoded(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      out += text[i];
      continue;
    }
    const auto high = i + 2 < text.size() ? hex_digit(text[i + 1]) : std::nullopt;
    const auto low = i + 2 < text.size() ? hex_digit(text[i + 2]) : std::nullopt;
    if (!high || !low) return std::nullopt;
    out += static_cast<char>(*high << 4 | *low);
    i += 2;
  }
  return out;
}

// RFC 4648, 4; nothing where another character stands.
std::optional<std::vector<unsigned char>> base64_decoded(std::string_view text) {
  static constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  static constexpr std::array<std::uint8_t, 256> kValues = [] {
    std::array<std::uint8_t, 256> out{};
    out.fill(255);
    for (std::size_t i = 0; i < kDigits.size(); ++i)
      out[static_cast<unsigned char>(kDigits[i])] = static_cast<std::uint8_t>(i);
    return out;
  }();
  while (text.ends_with('=')) text.remove_suffix(1);
  std::vector<unsigned char> out;
  out.reserve(text.size() / 4 * 3 + 3);
  std::uint32_t bits = 0;
  int held = 0;
  for (const char c : text) {
    const std::uint8_t value = kValues[static_cast<unsigned char>(c)];
    if (value == 255) return std::nullopt;
    bits = bits << 6 | value;
    held += 6;
    if (held < 8) continue;
    held -= 8;
    out.push_back(static_cast<unsigned char>(bits >> held & 255));
  }
  return out;
}

// RFC 3986, 3.1.
bool has_scheme(std::string_view uri) {
  const std::size_t colon = uri.find(':');
  if (colon == std::string_view::npos || colon == 0) return false;
  for (std::size_t i = 0; i < colon; ++i) {
    const auto c = static_cast<unsigned char>(uri[i]);
    if (!(std::isalpha(c) || (i > 0 && (std::isdigit(c) || c == '+' || c == '-' || c == '.'))))
      return false;
  }
  return true;
}

}  // namespace

Result<std::vector<unsigned char>> Document::resource(const std::string& uri,
                                                      const std::string& whose) const {
  if (uri.starts_with("data:")) {
    const std::size_t comma = uri.find(',');
    if (comma == std::string::npos || !std::string_view(uri).substr(0, comma).ends_with(";base64"))
      return invalid(whose + " has a data URI that is not base64");
    auto bytes = base64_decoded(std::string_view(uri).substr(comma + 1));
    if (!bytes) return invalid(whose + " has a data URI with damaged base64");
    return std::move(*bytes);
  }
  if (has_scheme(uri) || uri.starts_with("//"))
    return invalid(fmt::format("{} names \"{}\": nothing is fetched, only files beside the asset",
                               whose, shown(uri)));
  const auto name = percent_decoded(uri);
  if (!name || name->empty() || name->find('\0') != std::string::npos)
    return invalid(fmt::format("{} has a damaged URI \"{}\"", whose, shown(uri)));
  return read_beside(path_, *name, whose);
}

}  // namespace penumbra::prt::gltf
