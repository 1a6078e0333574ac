// A manual page and bash completion from the same table of options as --help.
// threads: reentrant
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace penumbra::tools {

/// The manual page of a program and all its subcommands, in troff's man macros.
std::string manual_page(const CLI::App& app, const std::string& version);

/// A bash function that completes subcommands, flags and file names.
std::string bash_completion(const CLI::App& app);

}  // namespace penumbra::tools
