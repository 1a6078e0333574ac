#include "tools/penumbra/inspect_report.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <sstream>
#include <string_view>
#include <vector>

#include "calib/estimate/boards.h"
#include "core/io/files.h"

namespace penumbra::tools {

namespace {

Result<std::string> read_text(const std::string& file) {
  PENUMBRA_ASSIGN(bytes, read_bytes(file));
  return std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size());
}

// What stands between two texts, the first of them found first; empty without both.
std::string_view between(std::string_view text, std::string_view before, std::string_view after) {
  const std::size_t from = text.find(before);
  if (from == std::string_view::npos) return {};
  text.remove_prefix(from + before.size());
  const std::size_t to = text.find(after);
  return to == std::string_view::npos ? std::string_view() : text.substr(0, to);
}

}  // namespace

namespace {

// Names between commas; one in quotes may hold commas.
std::vector<std::string> names_in(std::string_view line) {
  std::vector<std::string> out(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"')
      quoted = !quoted;
    else if (c == ',' && !quoted)
      out.emplace_back();
    else
      out.back() += c;
  }
  return out;
}

}  // namespace

Result<nlohmann::json> inspect_table(const std::string& file) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF", kBlanks = ", \r\t";
  std::ifstream lines(file, std::ios::binary);
  if (!lines) return fail(ErrorCode::kNotFound, file, "cannot be read");
  std::string line;
  std::getline(lines, line);
  if (line.starts_with(kByteOrderMark)) line.erase(0, kByteOrderMark.size());
  const std::size_t last = line.find_last_not_of(" \r");
  if (line.find('\0') != std::string::npos || line.find_first_not_of(kBlanks) == std::string::npos)
    return fail(ErrorCode::kUnreadable, file, "is no table: its first line names no columns");
  const std::vector<std::string> columns = names_in(std::string_view(line).substr(0, last + 1));
  std::size_t rows = 0;
  while (std::getline(lines, line)) rows += line.find_first_not_of(" \r") != std::string::npos;
  return nlohmann::json{{"kind", "table"}, {"columns", columns}, {"rows", rows}};
}

Result<nlohmann::json> inspect_plot(const std::string& file) {
  PENUMBRA_ASSIGN(text, read_text(file));
  if (text.find("<svg") == std::string::npos)
    return fail(ErrorCode::kUnreadable, file, "is no SVG");
  const std::string_view head = between(text, "<svg", ">");
  nlohmann::json out = {{"kind", "plot"}};
  for (const char* const side : {"width", "height"})
    for (const char* const blank : {" ", "\n", "\t"})
      if (const auto value = between(head, fmt::format("{}{}=\"", blank, side), "\"");
          !value.empty())
        out[side] = value;
  if (const auto title = between(text, "<title>", "</title>"); !title.empty()) out["title"] = title;
  return out;
}

Result<nlohmann::json> inspect_page(const std::string& file) {
  PENUMBRA_ASSIGN(text, read_text(file));
  const std::string board(between(text, "(--board ", ")"));
  if (!text.starts_with("%PDF-") || !calib::parse_board(board))
    return fail(ErrorCode::kUnreadable, file, "is no page of a calibration board");
  nlohmann::json out = {{"kind", "calibration board"}, {"board", board}};
  std::istringstream box(std::string(between(text, "/MediaBox [", "]")));
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  constexpr double kMm_per_point = 25.4 / 72;
  if (box >> x0 >> y0 >> x1 >> y1)
    out["page_mm"] = {std::round((x1 - x0) * kMm_per_point), std::round((y1 - y0) * kMm_per_point)};
  return out;
}

}  // namespace penumbra::tools
