// Files that are never half-written.
// threads: reentrant; several may write one target, of which the last stays
#pragma once

#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra {

/// Lets `write` make a file under a temporary name beside `target` (same extension), then renames
/// it. On any error, or an exception from `write`, the temporary file is removed and `target`
/// untouched.
/// errors:  kUnwritable, or what `write` returned
Result<void> replace_file(const std::filesystem::path& target,
                          const std::function<Result<void>(const std::filesystem::path&)>& write);

/// The extension with its dot, in lower case: ".exr" of "MAP.EXR".
std::string lower_extension(const std::filesystem::path& path);

/// replace_file for bytes at hand.
Result<void> write_bytes(const std::filesystem::path& target, std::string_view bytes);

/// Whole file, refused above `limit_bytes`.
/// errors:  kNotFound, kUnreadable, kInvalid (too large)
Result<std::vector<unsigned char>> read_bytes(const std::filesystem::path& path,
                                              std::size_t limit_bytes = std::size_t{1} << 31);

/// Whole file as text, without the byte order mark that some programs put before UTF-8.
/// errors:  as read_bytes
Result<std::string> read_text(const std::filesystem::path& path,
                              std::size_t limit_bytes = std::size_t{1} << 31);

/// Whether a file could be made there: asked before long work, so that a wrong path costs no time.
/// Leaves nothing.
/// errors: kUnwritable
Result<void> check_writable(const std::filesystem::path& target);

/// Makes the folder (and its parents) if it is not there.
/// errors: kUnwritable
Result<void> make_folder(const std::filesystem::path& folder);

}  // namespace penumbra
#pragma GCC visibility pop
