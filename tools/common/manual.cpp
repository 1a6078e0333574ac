#include "tools/common/manual.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <set>
#include <vector>

namespace penumbra::tools {

namespace {

// Lines that begin with a dot or an apostrophe are requests to troff, hyphens and backslashes its
// own.
std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\')
      out += "\\e";
    else if (c == '-')
      out += "\\-";
    else if (c == '\n')
      out += ' ';
    else if ((c == '.' || c == '\'') && (out.empty()))
      out += std::string("\\&") + c;
    else
      out += c;
  }
  return out;
}

// "--flag" or "--flag VALUE", and the default where help tells one.
std::string label_of(const CLI::Option& option) {
  std::string label =
      option.get_positional() ? option.get_name(true) : option.get_name(false, true);
  label = label.substr(0, label.find('{'));  // a flag that clears: "--no-video{false}"
  if (option.get_expected_max() > 0 && !option.get_positional()) label += " VALUE";
  return label;
}

void add_options(const CLI::App& app, std::string& out) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;  // hidden
    out += fmt::format(".TP\n.B {}\n{}", escaped(label_of(*option)),
                       escaped(option->get_description()));
    if (!option->get_default_str().empty())
      out += fmt::format(" (default {})", escaped(option->get_default_str()));
    if (option->get_required()) out += " (required)";
    out += ".\n";
  }
}

void add_command(const CLI::App& app, const std::string& name, std::string& out) {
  out += fmt::format(".SH {}\n{}.\n", escaped(name), escaped(app.get_description()));
  add_options(app, out);
  for (const CLI::App* command : app.get_subcommands({}))
    add_command(*command, name + " " + command->get_name(), out);
}

std::string identifier(std::string name) {
  std::ranges::replace_if(
      name, [](unsigned char c) { return !std::isalnum(c); }, '_');
  return name;
}

// One case a command: the words that may follow it.
void add_cases(const CLI::App& app, const std::string& path, std::string& out) {
  std::string words;
  for (const CLI::App* command : app.get_subcommands({})) words += command->get_name() + " ";
  for (const CLI::Option* option : app.get_options())
    if (!option->get_positional() && !option->get_group().empty())
      for (const std::string& flag : option->get_lnames()) words += "--" + flag + " ";
  out += fmt::format("    \"{}\") words=\"{}\" ;;\n", path, words);
  for (const CLI::App* command : app.get_subcommands({}))
    add_cases(*command, path.empty() ? command->get_name() : path + " " + command->get_name(), out);
}

// Every command's path, and every flag that a value follows.
void collect(const CLI::App& app, const std::string& path, std::string& paths,
             std::set<std::string>& flags) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_positional() || option->get_expected_max() == 0) continue;
    for (const std::string& flag : option->get_lnames()) flags.insert("--" + flag);
    for (const std::string& flag : option->get_snames()) flags.insert("-" + flag);
  }
  for (const CLI::App* command : app.get_subcommands({})) {
    const std::string own = path.empty() ? command->get_name() : path + " " + command->get_name();
    paths += own + "|";
    collect(*command, own, paths, flags);
  }
}

// After a sibling's command its own completion answers, as if it had been called by its name.
std::string delegation(std::span<const Sibling> siblings) {
  std::string out;
  for (const Sibling& s : siblings)
    out += fmt::format(R"(    {0})
      _completion_loader {1} 2> /dev/null || return
      COMP_WORDS=({1} "${{COMP_WORDS[@]:{2}}}")
      COMP_CWORD=$((COMP_CWORD - {3}))
      _{4}
      return ;;
)",
                       s.command, s.program, s.is_subcommand ? 1 : 2, s.is_subcommand ? 0 : 1,
                       identifier(s.program));
  return out.empty()
             ? out
             : fmt::format("  ((COMP_CWORD < 2)) || case ${{COMP_WORDS[1]}} in\n{}  esac\n", out);
}

}  // namespace

std::string manual_page(const CLI::App& app, const std::string& version,
                        std::span<const Sibling> siblings) {
  std::string upper = app.get_name(), out;
  std::ranges::transform(upper, upper.begin(), [](unsigned char c) { return std::toupper(c); });
  const auto commands = app.get_subcommands({});
  out = fmt::format(
      ".TH {} 1 \"\" \"penumbra {}\"\n.SH NAME\n{} \\- {}\n.SH SYNOPSIS\n.B {}\n{}[OPTIONS]\n",
      upper, version, escaped(app.get_name()), escaped(app.get_description()),
      escaped(app.get_name()), commands.empty() ? "" : "COMMAND ");
  if (commands.empty()) {
    out += ".SH OPTIONS\n";
    add_options(app, out);
  }
  for (const CLI::App* command : commands) add_command(*command, command->get_name(), out);
  if (siblings.empty()) return out;
  std::set<std::string> programs;
  for (const Sibling& s : siblings) programs.insert(fmt::format(".BR {} (1)", escaped(s.program)));
  return out + fmt::format(".SH SEE ALSO\n{}\n", fmt::join(programs, ",\n"));
}

std::string bash_completion(const CLI::App& app, std::span<const Sibling> siblings) {
  std::string cases, paths = "|";
  std::set<std::string> flags;
  add_cases(app, "", cases);
  collect(app, "", paths, flags);
  return fmt::format(R"(# bash completion of {0}
_{1}() {{
{5}  local path="" words="" word
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    [[ "{3}" != *"|${{path:+$path }}$word|"* ]] || path="${{path:+$path }}$word"
  done
  # The value of a flag: a file name, which is bash's own default.
  [[ " {4} " != *" ${{COMP_WORDS[COMP_CWORD-1]}} "* ]] || return
  case "$path" in
{2}  esac
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}")
}}
complete -o default -F _{1} {0}
)",
                     app.get_name(), identifier(app.get_name()), cases, paths,
                     fmt::join(flags, " "), delegation(siblings));
}

}  // namespace penumbra::tools
