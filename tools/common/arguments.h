// How a table of arguments checks, explains and refuses, in the program's own words.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// For CLI::Option::check(): why a text is refused, empty where it is not.
using ArgumentCheck = std::function<std::string(const std::string&)>;
std::string not_empty(const std::string& text);
std::string above_zero(const std::string& text);
ArgumentCheck within(double lowest, double highest);

/// Help whose lines end at 100 columns: a flag and what stands behind it, then what it means.
std::shared_ptr<CLI::FormatterBase> help_format();

/// What is wrong with the arguments of a program: the flag or the word, and why.
Error argument_error(const CLI::App& app, std::span<char* const> arguments,
                     const CLI::ParseError& error);

}  // namespace penumbra::tools
