#include "tools/common/arguments.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cstdlib>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "core/io/renamed.h"
#include "core/io/spelling.h"

namespace penumbra::tools {

namespace {

// ---- Help. ----

std::string wrapped(const std::string& text, std::size_t indent, std::size_t width) {
  std::string out, line;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find_first_of(" \n", at), text.size());
    const std::string word = text.substr(at, end - at);
    if (!line.empty() && indent + line.size() + 1 + word.size() > width) {
      out += std::string(indent, ' ') + line + '\n';
      line.clear();
    }
    line += (line.empty() ? "" : " ") + word;
    at = end + 1;
  }
  return out + std::string(indent, ' ') + line + '\n';
}

class HelpFormat : public CLI::Formatter {
 public:
  std::string make_option(const CLI::Option* option, bool positional) const override {
    std::string label = option->get_name(positional, !positional);
    label = label.substr(0, label.find('{'));  // of a flag that clears: "--no-video{false}"
    if (!positional && option->get_expected_max() > 0) label += " VALUE";
    if (option->get_expected_max() > 1) label += "...";
    std::string text = option->get_description();
    if (!option->get_default_str().empty())
      text += fmt::format(" (default {})", option->get_default_str());
    if (option->get_required()) text += " (required)";
    return "  " + label + '\n' + wrapped(text, 6, 100);
  }
};

// ---- Errors. ----

// The command that the first words name, and the word after them that is none of its commands.
struct FoundCommand {
  const CLI::App* app;
  std::string_view unknown;
};

FoundCommand command_of(const CLI::App& app, std::span<char* const> arguments) {
  const CLI::App* at = &app;
  for (const std::string_view word : arguments) {
    const auto commands = at->get_subcommands([](const CLI::App*) { return true; });
    const auto next = std::ranges::find(commands, word, &CLI::App::get_name);
    if (next == commands.end())
      return {at, commands.empty() || word.starts_with('-') ? std::string_view() : word};
    at = *next;
  }
  return {at, {}};
}

std::vector<std::string> commands_of(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* c : app.get_subcommands([](const CLI::App*) { return true; }))
    names.push_back(c->get_name());
  return names;
}

// "light estimate", where some command has a command of that name; empty: none has.
std::string inner_command(const CLI::App& app, std::string_view name) {
  for (const CLI::App* c : app.get_subcommands([](const CLI::App*) { return true; }))
    for (const std::string& inner : commands_of(*c))
      if (inner == name) return c->get_name() + " " + inner;
  return {};
}

// What a flag of before is now, or a mistyped command or flag should have been, where something is
// near.
std::optional<Error> misspelling(const FoundCommand& found, std::span<char* const> arguments) {
  if (!found.unknown.empty()) {
    const std::vector<std::string> names = commands_of(*found.app);
    const std::string inner = inner_command(*found.app, found.unknown);
    const auto near = inner.empty() ? nearest_word(found.unknown, names) : inner;
    return Error{ErrorCode::kInvalid, std::string(found.unknown),
                 near ? fmt::format("is no command: did you mean {}?", *near)
                      : fmt::format("is no command: there are {}", fmt::join(names, ", "))};
  }
  std::vector<std::string> flags;
  for (const CLI::Option* option : found.app->get_options())
    for (const std::string& name : option->get_lnames()) flags.push_back("--" + name);
  for (const std::string_view argument : arguments) {
    const std::string_view flag = argument.substr(0, argument.find('='));
    // One dash too few.
    if (const std::string twice = "-" + std::string(flag);
        flag.starts_with('-') && std::ranges::find(flags, twice) != flags.end())
      return Error{ErrorCode::kInvalid, std::string(flag),
                   fmt::format("is no flag here: did you mean {}?", twice)};
    if (!flag.starts_with("--") || std::ranges::find(flags, flag) != flags.end()) continue;
    if (const auto now = new_name(kRenamedFlags, flag);
        now && std::ranges::find(flags, *now) != flags.end())
      return Error{ErrorCode::kInvalid, std::string(flag), fmt::format("is now {}", *now)};
    if (const auto near = nearest_word(flag, flags))
      return Error{ErrorCode::kInvalid, std::string(flag),
                   fmt::format("is no flag here: did you mean {}?", *near)};
  }
  return std::nullopt;
}

// What stands before and after the first `mark` behind `head`; the parser's messages have no other
// form.
std::pair<std::string, std::string> parts(const std::string& text, std::string_view head,
                                          std::string_view mark) {
  const std::string rest = text.starts_with(head) ? text.substr(head.size()) : text;
  const std::size_t at = rest.find(mark);
  if (at == std::string::npos) return {rest, ""};
  return {rest.substr(0, at), rest.substr(at + mark.size())};
}

Error not_convertible(const CLI::App& command, const std::string& text) {
  const auto [name, value] = parts(text, "Could not convert: ", " = ");
  const CLI::Option* option = command.get_option_no_throw(name);
  const bool whole = option != nullptr && option->get_type_name().find("INT") != std::string::npos;
  return {ErrorCode::kInvalid, name,
          fmt::format("\"{}\" is not a {}", value, whole ? "whole number" : "number")};
}

Error missing(const CLI::App& command, const std::string& text) {
  if (text.starts_with("A subcommand"))
    return {ErrorCode::kInvalid, "command",
            fmt::format("is missing: give one of {}", fmt::join(commands_of(command), ", "))};
  return {ErrorCode::kInvalid, parts(text, "", " is required").first, "is missing"};
}

Error wrong_count(const std::string& text) {
  const auto [name, why] = parts(text, "", ": ");
  if (why.ends_with(" missing")) return {ErrorCode::kInvalid, name, "needs a value"};
  if (why.starts_with("At Most 1 ")) return {ErrorCode::kInvalid, name, "is given more than once"};
  if (why.empty())
    return {ErrorCode::kInvalid, parts(text, "", " was given").first, "takes no value"};
  return {ErrorCode::kInvalid, name, "has too many values or too few"};
}

}  // namespace

std::string not_empty(const std::string& text) {
  return text.empty() ? "is empty" : "";
}

// What is no number is refused when it is read.
std::string above_zero(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return end == text.c_str() || value > 0 ? "" : "is not above 0";
}

ArgumentCheck within(double lowest, double highest) {
  return [=](const std::string& text) -> std::string {
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (end == text.c_str() || (value >= lowest && value <= highest)) return "";
    return fmt::format("is not within {}..{}", lowest, highest);
  };
}

std::shared_ptr<CLI::FormatterBase> help_format() {
  return std::make_shared<HelpFormat>();
}

Error argument_error(const CLI::App& app, std::span<char* const> arguments,
                     const CLI::ParseError& error) {
  const FoundCommand found = command_of(app, arguments);
  if (auto meant = misspelling(found, arguments)) return *meant;
  const std::string text = error.what(), kind = error.get_name();
  if (kind == "ConversionError") return not_convertible(*found.app, text);
  if (kind == "RequiredError") return missing(*found.app, text);
  if (kind == "ArgumentMismatch") return wrong_count(text);
  const auto of = [](const std::pair<std::string, std::string>& words, const std::string& why) {
    return Error{ErrorCode::kInvalid, words.first, why + words.second};
  };
  if (kind == "ValidationError") return of(parts(text, "", ": "), "");
  if (kind == "RequiresError") return of(parts(text, "", " requires "), "needs ");
  if (kind == "ExcludesError") return of(parts(text, "", " excludes "), "cannot go with ");
  if (dynamic_cast<const CLI::ExtrasError*>(&error) != nullptr)  // its name is the command's
    return {ErrorCode::kInvalid, parts(text, "", "expected: ").second, "is not expected here"};
  return {ErrorCode::kInvalid, "arguments", text};
}

}  // namespace penumbra::tools
