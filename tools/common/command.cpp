#include "tools/common/command.h"

#include <fmt/format.h>
#include <malloc.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <cstdio>
#include <cstdlib>
#include <span>
#include <string_view>

#include "core/exceptions.h"
#include "core/io/log.h"
#include "tools/common/arguments.h"
#include "tools/common/manual.h"

namespace penumbra::tools {

namespace {

// Programs of single commands answer as `penumbra`, which starts them.
int report(const std::string& program, const Error& e) {
  std::string line = program + ": " + e.where + ": " + e.detail;
  for (char& ch : line)
    if (ch == '\n' || ch == '\r') ch = ' ';
  std::fprintf(stderr, "%s\n", line.c_str());
  return 2;
}

}  // namespace

void add_json(CLI::App* app, bool& json) {
  app->add_flag("--json", json, "Print one JSON object on standard output and nothing else");
}

void keep_freed_memory() {
  constexpr int kLargest = 32 << 20;  // that malloc(3) takes
  mallopt(M_MMAP_THRESHOLD, kLargest);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
}

int run_program(int argc, char** argv, const std::string& name, const std::string& description,
                const std::function<void(CLI::App&, Action&)>& add_commands,
                std::span<const Sibling> siblings) {
  const auto logger = spdlog::stderr_color_mt(name);
  // The journal of systemd takes levels in front of a line, see sd-daemon(3).
  const bool to_journal = std::getenv("JOURNAL_STREAM") != nullptr;
  logger->set_pattern(to_journal ? "%v" : "%^%l%$: %v");
  set_log_sink([logger, to_journal](LogLevel level, std::string_view line) {
    const bool is_info = level == LogLevel::kInfo;
    logger->log(is_info ? spdlog::level::info : spdlog::level::warn, "{}{}",
                !to_journal ? ""
                : is_info   ? "<6>"
                            : "<4>",
                line);
  });
  CLI::App app(description, name);
  app.set_version_flag("--version", name + " " + PENUMBRA_VERSION);
  app.formatter(help_format());
  const std::string answers_as = name.starts_with("penumbra-") ? "penumbra" : name;
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
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    return app.exit(e);  // help and version
  } catch (const CLI::ParseError& e) {
    const std::span words(argv, static_cast<std::size_t>(argc));
    return report(answers_as, argument_error(app, words.subspan(1), e));
  }
  try {
    if (const auto result = action(); !result) return report(answers_as, result.error());
  } catch (const std::bad_alloc& e) {
    return report(answers_as, {ErrorCode::kUnavailable, "this command", reason_of(e)});
  } catch (const std::exception& e) {
    return report(answers_as, {ErrorCode::kUnavailable, "internal", e.what()});
  }
  return 0;
}

}  // namespace penumbra::tools
