#include "tools/farm/shard_file.h"

#include <fmt/format.h>

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <random>

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;

// What attempts write to: of one machine and process, and of chance, as containers share both.
constexpr const char* kAttempt = ".attempt-";

fs::path own_attempt(const fs::path& file) {
  std::array<char, 256> host{};
  if (gethostname(host.data(), host.size() - 1) != 0 || host[0] == '\0') host = {"host"};
  return fmt::format("{}{}{}-{}-{:08x}", file.string(), kAttempt, host.data(), getpid(),
                     std::random_device()());
}

std::vector<fs::path> attempts_at(const fs::path& file) {
  std::vector<fs::path> out;
  const fs::path folder = file.has_parent_path() ? file.parent_path() : ".";
  const std::string start = file.filename().string() + kAttempt;
  std::error_code error;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error))
    if (at->path().filename().string().starts_with(start)) out.push_back(at->path());
  return out;
}

void remove_attempts(const fs::path& file) {
  std::error_code ignored;
  for (const fs::path& attempt : attempts_at(file)) fs::remove(attempt, ignored);
}

// Until the bytes are on the disk: one that is renamed before may be empty after a loss of power.
// Whether it is there at all its renaming tells.
Result<void> sync_file(const fs::path& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return {};
  const bool synced = ::fsync(file) == 0;
  const int error = errno;
  ::close(file);
  if (synced) return {};
  return fail(ErrorCode::kUnwritable, path.string(), std::strerror(error));
}

using IsWhole = std::function<Result<bool>(const fs::path&)>;

// Of the attempts and a file that is not whole, what has the most in it; empty: there is none. What
// another bake has left is none.
fs::path furthest(const fs::path& file, const IsWhole& is_whole) {
  fs::path out;
  std::uintmax_t most = 0;
  std::vector<fs::path> known = attempts_at(file);
  known.push_back(file);
  for (const fs::path& path : known) {
    std::error_code error;
    const std::uintmax_t bytes = fs::file_size(path, error);
    if (!error && bytes > most && is_whole(path)) most = bytes, out = path;
  }
  return out;
}

}  // namespace

fs::path shard_file(const std::string& output, int index, int count, int round) {
  const std::string of_round = round > 0 ? fmt::format(".round-{}", round) : "";
  return fmt::format("{}.shard-{}-of-{}{}", output, index + 1, count, of_round);
}

std::vector<fs::path> shard_files(const std::string& output, int count, int round) {
  std::vector<fs::path> out;
  for (int i = 0; i < count; ++i) out.push_back(shard_file(output, i, count, round));
  return out;
}

Result<void> make_shard(const fs::path& file,
                        const std::function<Result<bool>(const fs::path&)>& is_whole,
                        const std::function<Result<void>(const fs::path&)>& bake) {
  std::error_code error;
  if (fs::exists(file, error)) {
    PENUMBRA_ASSIGN(whole, is_whole(file));
    if (whole) {
      remove_attempts(file);
      return {};
    }
  }
  const fs::path own = own_attempt(file);
  const fs::path best = furthest(file, is_whole);
  if (!best.empty()) {
    fs::copy_file(best, own, fs::copy_options::overwrite_existing, error);
    // One that another attempt has just renamed or removed: what it held is baked again at worst.
    if (error) fs::remove(own, error);
  }
  PENUMBRA_TRY(bake(own));
  PENUMBRA_TRY(sync_file(own));
  fs::rename(own, file, error);
  if (error) {
    // Another attempt was faster, and took this one's file for a dead one's.
    std::error_code ignored;
    if (!fs::exists(file, ignored))
      return fail(ErrorCode::kUnwritable, file.string(), error.message());
    PENUMBRA_ASSIGN(whole, is_whole(file));
    if (!whole)
      return fail(ErrorCode::kUnwritable, file.string(),
                  "is damaged: another attempt left it so; remove it");
  }
  remove_attempts(file);
  return {};
}

int count_of_shards(const std::string& output) {
  const fs::path path(output), folder = path.has_parent_path() ? path.parent_path() : ".";
  const std::string start = path.filename().string() + ".shard-";
  int count = 0;
  std::error_code error;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    const std::string name = at->path().filename().string();
    const std::size_t of = name.find("-of-");
    if (!name.starts_with(start) || of == std::string::npos) continue;
    int found = 0;
    std::from_chars(name.data() + of + 4, name.data() + name.size(), found);
    if (count != 0 && found != count) return 0;
    count = found;
  }
  return count;
}

void remove_shards(const std::vector<fs::path>& files) {
  std::error_code ignored;
  for (const fs::path& file : files) {
    remove_attempts(file);
    fs::remove(file, ignored);
  }
}

}  // namespace penumbra::tools
