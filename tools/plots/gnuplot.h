// Runs gnuplot on a script.
#pragma once

#include <filesystem>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// Text as gnuplot reads it back literally: in single quotes nothing is substituted. Control
/// characters become spaces and characters outside ASCII '?', so that an SVG stays well-formed.
std::string gnuplot_quoted(const std::string& text);

/// Text as one quoted cell of a block of data: what could end the cell or the line is replaced.
std::string gnuplot_cell(const std::string& text);

/// Rows as a block of data that a script reads as $name.
std::string gnuplot_block(const std::string& name, const std::string& rows);

/// Runs gnuplot with `script` as its input and writes what it prints to `target`, whole or not at
/// all.
/// The script names no output. The user's own gnuplot settings are not read.
/// errors:  kUnavailable (no gnuplot), kUnwritable (target, or gnuplot's own first complaint)
/// threads: reentrant; waits for a child process, no shell is involved
Result<void> run_gnuplot(const std::string& script, const std::filesystem::path& target);

}  // namespace penumbra::tools
