#include "core/io/files.h"
#include "core/exceptions.h"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <fstream>

namespace penumbra {
namespace fs = std::filesystem;

namespace {

// Keeps the extension, since image libraries choose the format by it.
fs::path temporary_beside(const fs::path& target) {
  static std::atomic<unsigned> counter = 0;  // threads may write the same target
  std::string name = ".";
  name += target.stem().string();
  name += ".partial-" + std::to_string(::getpid()) + "-" + std::to_string(counter++);
  name += target.extension().string();
  return target.parent_path() / name;
}

}  // namespace

Result<void> replace_file(const fs::path& target,
                          const std::function<Result<void>(const fs::path&)>& write) {
  const fs::path temporary = temporary_beside(target);
  std::error_code ignored;
  if (fs::is_directory(target, ignored))
    return fail(ErrorCode::kUnwritable, target.string(), "is a folder, not a file");
  Result<void> written;
  try {
    written = write(temporary);
  } catch (const std::exception& e) {
    written = fail(ErrorCode::kUnwritable, target.string(), reason_of(e));
  } catch (...) {
    written = fail(ErrorCode::kUnwritable, target.string(),
                   "cannot be written for a reason that is not known");
  }
  if (!written) {
    fs::remove(temporary, ignored);
    return written;
  }
  std::error_code error;
  fs::rename(temporary, target, error);
  if (error) {
    fs::remove(temporary, ignored);
    return fail(ErrorCode::kUnwritable, target.string(), error.message());
  }
  return {};
}

std::string lower_extension(const std::filesystem::path& path) {
  std::string text = path.extension().string();
  std::ranges::transform(text, text.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

Result<void> write_bytes(const fs::path& target, std::string_view bytes) {
  return replace_file(target, [&](const fs::path& temporary) -> Result<void> {
    std::ofstream out(temporary, std::ios::binary);
    out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    out.flush();
    if (!out) return fail(ErrorCode::kUnwritable, target.string(), std::strerror(errno));
    return {};
  });
}

Result<void> check_writable(const fs::path& target) {
  const fs::path temporary = temporary_beside(target);
  std::error_code ignored;
  if (fs::is_directory(target, ignored))
    return fail(ErrorCode::kUnwritable, target.string(), "is a folder, not a file");
  errno = 0;
  const bool made = std::ofstream(temporary).is_open();
  const int reason = errno;
  fs::remove(temporary, ignored);
  if (!made) return fail(ErrorCode::kUnwritable, target.string(), std::strerror(reason));
  return {};
}

Result<std::vector<unsigned char>> read_bytes(const fs::path& path, std::size_t limit_bytes) {
  std::error_code error;
  if (!fs::exists(path, error)) return fail(ErrorCode::kNotFound, path.string(), "no such file");
  if (!fs::is_regular_file(path, error))
    return fail(ErrorCode::kUnreadable, path.string(), "is not a regular file");
  const auto size = fs::file_size(path, error);
  if (error) return fail(ErrorCode::kUnreadable, path.string(), error.message());
  if (size > limit_bytes)
    return fail(
        ErrorCode::kInvalid, path.string(),
        std::to_string(size) + " bytes are more than the limit of " + std::to_string(limit_bytes));
  std::vector<unsigned char> bytes(size);
  std::ifstream in(path, std::ios::binary);
  in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(size));
  if (!in) return fail(ErrorCode::kUnreadable, path.string(), std::strerror(errno));
  return bytes;
}

Result<std::string> read_text(const fs::path& path, std::size_t limit_bytes) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path, limit_bytes));
  constexpr std::string_view kMark = "\xef\xbb\xbf";
  std::string text(bytes.begin(), bytes.end());
  if (text.starts_with(kMark)) text.erase(0, kMark.size());
  return text;
}

Result<void> make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return fail(ErrorCode::kUnwritable, folder.string(), error.message());
  if (!fs::is_directory(folder))
    return fail(ErrorCode::kUnwritable, folder.string(), "is not a folder");
  return {};
}

}  // namespace penumbra
