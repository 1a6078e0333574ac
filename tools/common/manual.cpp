#include "tools/common/manual.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <vector>

namespace penumbra::tools {

namespace {

// Lines that begin with a dot or an apostrophe are requests to troff, hyphens and backslashes its own.
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

}  // namespace

std::string manual_page(const CLI::App& app, const std::string& version) {
  std::string upper = app.get_name(), out;
  std::ranges::transform(upper, upper.begin(), [](unsigned char c) { return std::toupper(c); });
  out = fmt::format(
      ".TH {} 1 \"\" \"penumbra {}\"\n.SH NAME\n{} \\- {}\n.SH SYNOPSIS\n.B {}\n"
      "COMMAND [OPTIONS]\n",
      upper, version, escaped(app.get_name()), escaped(app.get_description()),
      escaped(app.get_name()));
  for (const CLI::App* command : app.get_subcommands({}))
    add_command(*command, command->get_name(), out);
  return out;
}

std::string bash_completion(const CLI::App& app) {
  std::string cases;
  add_cases(app, "", cases);
  return fmt::format(R"(# bash completion of {0}
_{1}() {{
  local path="" words="" word
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    [[ $word == -* ]] || path="${{path:+$path }}$word"
  done
  case "$path" in
{2}  esac
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}")
}}
complete -o default -F _{1} {0}
)",
                     app.get_name(), identifier(app.get_name()), cases);
}

}  // namespace penumbra::tools
