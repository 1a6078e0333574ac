#include "tools/farm/shard_file.h"

#include <fmt/format.h>
#include <unistd.h>

#include <array>

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;

// What attempts write to: of one machine and process, so that no two share one.
constexpr const char* kAttempt = ".attempt-";

fs::path own_attempt(const fs::path& file) {
  std::array<char, 256> host{};
  if (gethostname(host.data(), host.size() - 1) != 0 || host[0] == '\0') host = {"host"};
  return fmt::format("{}{}{}-{}", file.string(), kAttempt, host.data(), getpid());
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

// Of the attempts and a file that is not whole, what has the most in it; empty: there is none.
fs::path furthest(const fs::path& file, const fs::path& own) {
  fs::path out;
  std::uintmax_t most = 0;
  std::vector<fs::path> known = attempts_at(file);
  known.push_back(file);
  for (const fs::path& path : known) {
    std::error_code error;
    const std::uintmax_t bytes = fs::file_size(path, error);
    // An attempt of this very name is one of a container that was started anew.
    if (!error && (bytes > most || (bytes == most && path == own))) most = bytes, out = path;
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
  const fs::path best = furthest(file, own);
  if (!best.empty() && best != own) {
    fs::copy_file(best, own, fs::copy_options::overwrite_existing, error);
    // One that another attempt has just renamed or removed: what it held is baked again at worst.
    if (error) fs::remove(own, error);
  }
  PENUMBRA_TRY(bake(own));
  fs::rename(own, file, error);
  if (error) {
    // Another attempt was faster, and took this one's file for a dead one's.
    std::error_code ignored;
    if (!fs::exists(file, ignored))
      return fail(ErrorCode::kUnwritable, file.string(), error.message());
    PENUMBRA_ASSIGN(whole, is_whole(file));
    if (!whole) return fail(ErrorCode::kUnwritable, file.string(), "another attempt has spoilt it");
  }
  remove_attempts(file);
  return {};
}

void remove_shards(const std::vector<fs::path>& files) {
  std::error_code ignored;
  for (const fs::path& file : files) {
    remove_attempts(file);
    fs::remove(file, ignored);
  }
}

}  // namespace penumbra::tools
