// Runs gnuplot on a script.
#pragma once

#include <filesystem>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// Text as gnuplot reads it back literally: in single quotes nothing is substituted. Control
/// characters become spaces and characters outside ASCII '?', so that an SVG stays well-formed.
std::string gnuplot_quoted(const std::string& text);

/// Runs gnuplot with `script` as its input and writes what it prints to `target`, whole or not at
/// all.
/// The script names no output. The user's own gnuplot settings are not read.
/// errors:  kUnavailable (no gnuplot), kUnwritable (target, or gnuplot's own first complaint)
/// threads: reentrant; waits for a child process, no shell is involved
Result<void> run_gnuplot(const std::string& script, const std::filesystem::path& target);

}  // namespace penumbra::tools
