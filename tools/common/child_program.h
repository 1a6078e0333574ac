// Runs another program to its end.
// threads: reentrant
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace penumbra::tools {

/// What a program said. Of each, the first megabyte.
struct ChildAnswer {
  int status = 0;  // exit status, or 128 and the signal that ended it
  std::string output, complaint;
};

/// Runs `command` (the program by name or path, then its arguments) without a shell, with `input`
/// on its standard input, and waits for it. Its output goes into `output_file`, whole, if one is
/// named.
/// errors: kUnavailable (not installed, no memory), kUnwritable (the file's folder is not there)
Result<ChildAnswer> run_child(const std::vector<std::string>& command, std::string_view input = {},
                              const std::filesystem::path& output_file = {});

}  // namespace penumbra::tools
