#include "tools/common/command.h"

#include <fmt/ranges.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/log.h"
#include "core/renamed.h"
#include "core/spelling.h"
#include "tools/common/manual.h"

namespace penumbra::tools {

namespace {

int report(const Error& e) {
  std::string line = "penumbra: " + e.where + ": " + e.detail;
  for (char& ch : line)
    if (ch == '\n' || ch == '\r') ch = ' ';
  std::fprintf(stderr, "%s\n", line.c_str());
  return 2;
}

// A flag of before, given as "--flag" or "--flag=value".
Result<void> check_flags(std::span<char* const> arguments) {
  for (const std::string_view argument : arguments) {
    const std::string_view flag = argument.substr(0, argument.find('='));
    if (const auto now = new_name(kRenamedFlags, flag))
      return fail(ErrorCode::kInvalid, std::string(flag), fmt::format("is now {}", *now));
  }
  return {};
}

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

// What a mistyped command or flag should have been, where something is near.
std::optional<Error> misspelling(const CLI::App& app, std::span<char* const> arguments) {
  const auto [command, unknown] = command_of(app, arguments);
  if (!unknown.empty()) {
    std::vector<std::string> names;
    for (const CLI::App* c : command->get_subcommands([](const CLI::App*) { return true; }))
      names.push_back(c->get_name());
    const auto near = nearest_word(unknown, names);
    return Error{ErrorCode::kInvalid, std::string(unknown),
                 near ? fmt::format("is no command: did you mean {}?", *near)
                      : fmt::format("is no command: there are {}", fmt::join(names, ", "))};
  }
  std::vector<std::string> flags;
  for (const CLI::Option* option : command->get_options())
    for (const std::string& name : option->get_lnames()) flags.push_back("--" + name);
  for (const std::string_view argument : arguments) {
    const std::string_view flag = argument.substr(0, argument.find('='));
    if (!flag.starts_with("--") || std::ranges::find(flags, flag) != flags.end()) continue;
    if (const auto near = nearest_word(flag, flags))
      return Error{ErrorCode::kInvalid, std::string(flag),
                   fmt::format("is no flag here: did you mean {}?", *near)};
  }
  return std::nullopt;
}

}  // namespace

std::string not_empty(const std::string& text) {
  return text.empty() ? "is empty" : "";
}

void add_json(CLI::App* app, bool& json) {
  app->add_flag("--json", json, "Print one JSON object on standard output and nothing else");
}

int run_program(int argc, char** argv, const std::string& name, const std::string& description,
                const std::function<void(CLI::App&, Action&)>& add_commands,
                std::span<const Sibling> siblings) {
  const auto logger = spdlog::stderr_color_mt(name);
  logger->set_pattern("%^%l%$: %v");
  set_log_sink([logger](LogLevel level, std::string_view line) {
    logger->log(level == LogLevel::kInfo ? spdlog::level::info : spdlog::level::warn, "{}", line);
  });
  CLI::App app(description, name);
  app.set_version_flag("--version", name + " " + PENUMBRA_VERSION);
  Action action;
  add_commands(app, action);
  for (const Sibling& s : siblings) app.add_subcommand(s.command, s.help);
  const std::string_view first = argc > 1 ? argv[1] : "";
  if (first == "--print-manual" || first == "--print-completion") {
    const std::string text = first == "--print-manual"
                                 ? manual_page(app, PENUMBRA_VERSION, siblings)
                                 : bash_completion(app, siblings);
    std::fwrite(text.data(), 1, text.size(), stdout);
    return 0;
  }
  if (const auto flags = check_flags({argv, static_cast<std::size_t>(argc)}); !flags)
    return report(flags.error());
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    return app.exit(e);  // help and version
  } catch (const CLI::ParseError& e) {
    const auto meant = misspelling(app, std::span(argv, static_cast<std::size_t>(argc)).subspan(1));
    return report(meant ? *meant : Error{ErrorCode::kInvalid, "arguments", e.what()});
  }
  try {
    if (const auto result = action(); !result) return report(result.error());
  } catch (const std::exception& e) {
    return report({ErrorCode::kUnavailable, "internal", e.what()});
  }
  return 0;
}

}  // namespace penumbra::tools
