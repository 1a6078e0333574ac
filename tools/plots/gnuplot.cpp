#include "tools/plots/gnuplot.h"

#include <fmt/format.h>

#include <string_view>

#include "core/io/files.h"
#include "tools/common/child_program.h"

namespace penumbra::tools {

namespace {

// gnuplot marks the place of an error with lines of its own around it.
std::string complaint(const std::string& errors) {
  std::string out;
  for (const char c : errors.substr(0, 2048)) {
    const bool space = c == '\n' || c == ' ' || c == '\t';
    if (!space)
      out += c;
    else if (!out.empty() && out.back() != ' ')
      out += ' ';
  }
  return out.empty() ? "gnuplot failed without a word" : "gnuplot: " + out;
}

// Control characters become spaces, characters outside ASCII '?'.
std::string printable(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x80 && byte < 0xc0) continue;  // continues a character that is '?' already
    out += byte >= 0xc0 ? '?' : byte < 0x20 || byte == 0x7f ? ' ' : c;
  }
  return out;
}

}  // namespace

std::string gnuplot_quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : printable(text)) out += c == '\'' ? "''" : std::string(1, c);
  return out + "'";
}

std::string gnuplot_cell(const std::string& text) {
  std::string out = "\"";
  for (const char c : printable(text)) out += c == '"' || c == '`' ? '?' : c;
  return out + "\"";
}

std::string gnuplot_block(const std::string& name, const std::string& rows) {
  constexpr std::string_view kEnd = "END_OF_BLOCK";
  std::string out = fmt::format("${} << {}\n", name, kEnd);
  for (std::size_t from = 0; from < rows.size();) {
    const std::size_t to = std::min(rows.find('\n', from), rows.size());
    const std::string_view row = std::string_view(rows).substr(from, to - from);
    if (row.starts_with(kEnd)) out += '?';
    for (const char c : row) out += c == '`' ? '?' : c;
    out += '\n';
    from = to + 1;
  }
  return fmt::format("{}{}\n", out, kEnd);
}

Result<void> run_gnuplot(const std::string& script, const std::filesystem::path& target) {
  return replace_file(target, [&](const std::filesystem::path& temporary) -> Result<void> {
    const auto answer = run_child({"gnuplot", "-d", "-"}, script, temporary);
    if (!answer && answer.error().code == ErrorCode::kUnavailable)
      return fail(ErrorCode::kUnavailable, "gnuplot",
                  answer.error().detail + "; the Debian package gnuplot-nox has it");
    if (!answer) return std::unexpected(answer.error());
    if (answer->status != 0)
      return fail(ErrorCode::kUnwritable, "gnuplot", complaint(answer->complaint));
    std::error_code error;
    if (std::filesystem::file_size(temporary, error) == 0 || error)
      return fail(ErrorCode::kUnwritable, target.string(), complaint(answer->complaint));
    return {};
  });
}

}  // namespace penumbra::tools
