// TOML tables read strictly: unknown keys, wrong kinds and values out of range are errors that name
// the file, the line and the key. Included by the few files that read TOML.
// threads: const members reentrant
#pragma once

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/io/files.h"
#include "core/io/renamed.h"
#include "core/io/spelling.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra {

/// One table of the file; every error names file, line and key.
class TomlKeys {
 public:
  TomlKeys(const std::filesystem::path& path, const toml::table& table)
      : path_(path), table_(table) {}

  std::unexpected<Error> invalid(const toml::node& at, std::string_view key,
                                 const std::string& detail,
                                 ErrorCode code = ErrorCode::kInvalid) const {
    return fail(code, fmt::format("{}:{}", path_.string(), at.source().begin.line),
                fmt::format("{}: {}", key, detail));
  }
  std::unexpected<Error> invalid(std::string_view key, const std::string& detail) const {
    const toml::node* node = table_.get(key);
    return invalid(node ? *node : static_cast<const toml::node&>(table_), key, detail);
  }

  bool has(std::string_view key) const { return table_.contains(key); }

  Result<void> only(std::span<const std::string_view> known) const {
    for (const auto& [key, node] : table_)
      if (std::ranges::find(known, key.str()) == known.end())
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}:{}", path_.string(), key.source().begin.line),
                    unknown(key.str(), known));
    return {};
  }

  static std::string unknown(std::string_view key, std::span<const std::string_view> known = {}) {
    if (const auto now = new_name(kRenamedKeys, key);
        now && (known.empty() || std::ranges::find(known, *now) != known.end()))
      return fmt::format("\"{}\" is now \"{}\"", key, *now);
    if (const auto near = nearest_word(key, known))
      return fmt::format("unknown key \"{}\": did you mean \"{}\"?", key, *near);
    return fmt::format("unknown key \"{}\"", key);
  }

  Result<std::string> text(std::string_view key) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    if (!node->is_string()) return invalid(key, "is not text in quotes");
    return node->value_or(std::string());
  }

  Result<double> number(std::string_view key) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    return number(*node, key);
  }

  /// A whole number within [low, high].
  Result<int> integer(std::string_view key, int low, int high) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    const auto value = node->is_integer() ? node->value_or(std::int64_t{0}) : 0;
    if (!node->is_integer() || value < low || value > high)
      return invalid(key, fmt::format("is not a whole number within {}..{}", low, high));
    return static_cast<int>(value);
  }

  Result<bool> flag(std::string_view key) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    if (!node->is_boolean()) return invalid(key, "is neither true nor false");
    return node->value_or(false);
  }

  /// A time with its offset from universal time: without one it would be anybody's.
  Result<std::chrono::sys_seconds> time(std::string_view key) const {
    using namespace std::chrono;
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    const auto* const value = node->as_date_time();
    if (!value || !value->get().offset)
      return invalid(key, "is not a time with an offset, such as 2026-06-21T12:30:00+02:00");
    const toml::date_time& t = value->get();
    const year_month_day date(year(t.date.year), month(t.date.month), day(t.date.day));
    return sys_days(date) + hours(t.time.hour) + minutes(t.time.minute) + seconds(t.time.second) -
           minutes(t.offset->minutes);
  }

  /// `count` numbers, or any count when 0.
  Result<std::vector<double>> numbers(std::string_view key, std::size_t count = 0) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    if (!node->is_array()) return invalid(key, "is not a list of numbers");
    std::vector<double> values;
    for (const toml::node& element : *node->as_array()) {
      PENUMBRA_ASSIGN(value, number(element, key));
      values.push_back(value);
    }
    if (count != 0 && values.size() != count)
      return invalid(key, fmt::format("has {} numbers instead of {}", values.size(), count));
    return values;
  }

  /// A list of texts, at least one.
  Result<std::vector<std::string>> texts(std::string_view key) const {
    const toml::node* node = table_.get(key);
    if (!node) return invalid(key, "is missing");
    std::vector<std::string> values;
    if (const toml::array* list = node->as_array())
      for (const toml::node& element : *list) {
        const auto text = element.value<std::string>();
        if (!text) return invalid(element, key, "is not a list of texts");
        values.push_back(*text);
      }
    if (values.empty()) return invalid(key, "is not a list of texts");
    return values;
  }

  /// The tables of [[key]]; empty where there is none.
  Result<std::vector<const toml::table*>> tables(std::string_view key) const {
    std::vector<const toml::table*> out;
    const toml::node* node = table_.get(key);
    if (!node) return out;
    if (!node->is_array()) return invalid(key, fmt::format("must be tables [[{}]]", key));
    for (const toml::node& element : *node->as_array()) {
      if (!element.is_table())
        return invalid(element, key, "must be a table [[" + std::string(key) + "]]");
      out.push_back(element.as_table());
    }
    return out;
  }

  /// The table [key].
  Result<TomlKeys> table(std::string_view key) const {
    const toml::table* table = table_.get_as<toml::table>(key);
    if (!table) return invalid(key, fmt::format("must be a table [{}]", key));
    return TomlKeys(path_, *table);
  }
  const std::filesystem::path& path() const { return path_; }

  Result<void> version(int expected) const {
    const toml::node* node = table_.get("version");
    if (!node || !node->is_integer() || node->value_or(std::int64_t{0}) != expected)
      return invalid("version", node ? fmt::format("is not {}", expected) : "is missing");
    return {};
  }

 private:
  Result<double> number(const toml::node& node, std::string_view key) const {
    const auto value = node.is_number() ? node.value<double>() : std::nullopt;
    if (!value || !std::isfinite(*value)) return invalid(node, key, "is not a finite number");
    return *value;
  }

  const std::filesystem::path& path_;
  const toml::table& table_;
};

/// A text as a TOML basic string, with its quotes.
inline std::string toml_quoted(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f)
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    else
      out += c;
  }
  return out + '"';
}

/// `path` only names the text in errors.
inline Result<toml::table> parse_toml_text(std::string_view text,
                                           const std::filesystem::path& path) {
  try {
    return toml::parse(text, path.string());
  } catch (const toml::parse_error& e) {
    return fail(ErrorCode::kUnreadable, fmt::format("{}:{}", path.string(), e.source().begin.line),
                std::string(e.description()));
  }
}

inline Result<toml::table> parse_toml(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path, std::size_t{1} << 26));
  return parse_toml_text({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path);
}

}  // namespace penumbra
#pragma GCC visibility pop
