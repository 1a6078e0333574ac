#include "runtime/scene/bake_cache.h"

#include <fmt/format.h>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <utility>
#include <vector>

#include "core/io/files.h"
#include "core/io/hash.h"
#include "core/io/log.h"
#include "prt/bake/baked_file.h"
#include "prt/geometry/receiver.h"

namespace penumbra::runtime {

namespace fs = std::filesystem;

namespace {

constexpr const char *kClipKind = ".shlm", *kJournalKind = ".journal";

// Everything that the bake's result depends on; the version changes with the bake's own code.
std::string cache_name(const prt::Mesh& mesh, const prt::BakeOptions& o) {
  constexpr std::uint64_t kBakeVersion = 14;
  Fnv1a h;
  h.add(kBakeVersion).add(mesh.positions).add(mesh.normals).add(mesh.albedo).add(mesh.triangles);
  for (const int n : {o.bands, o.bounces, o.rays, o.ground_rays, static_cast<int>(o.visibility),
                      static_cast<int>(o.floor_apart), o.receiver ? o.receiver->grid.size : 0})
    h.add(n);
  if (o.receiver) {
    const prt::GroundGrid& g = o.receiver->grid;
    h.add(g.centre).add(g.half_extent).add(g.height).add(o.receiver->albedo);
  }
  return fmt::format("{:016x}.glb", h.value());
}

}  // namespace

std::optional<fs::path> cache_folder() {
  const char* cache = std::getenv("XDG_CACHE_HOME");
  const char* home = std::getenv("HOME");
  if (cache && *cache) return fs::path(cache) / "penumbra";
  if (home && *home) return fs::path(home) / ".cache" / "penumbra";
  return std::nullopt;
}

void prune_cache(const fs::path& folder, std::uintmax_t max_bytes) {
  struct CacheEntry {
    fs::file_time_type used;
    std::uintmax_t bytes;
    fs::path path;
  };
  std::vector<CacheEntry> entries;
  std::error_code error;
  for (fs::directory_iterator file(folder, error), end; !error && file != end;
       file.increment(error)) {
    const fs::path kind = file->path().extension();
    if (kind != ".glb" && kind != kClipKind && kind != kJournalKind) continue;
    std::error_code gone;
    const CacheEntry e{file->last_write_time(gone), file->file_size(gone), file->path()};
    if (!gone) entries.push_back(e);
  }
  std::ranges::sort(entries, std::ranges::greater(), &CacheEntry::used);
  std::uintmax_t kept = 0;
  for (const CacheEntry& e : entries)
    if ((kept += e.bytes) > max_bytes) fs::remove(e.path, error);
}

namespace {

std::optional<fs::path> folder_of(BakeCache cache) {
  return cache == BakeCache::kNotUsed ? std::nullopt : cache_folder();
}

std::unexpected<Error> not_baked(const std::string& name) {
  return fail(ErrorCode::kNotFound, name, "is not in the cache");
}

// Held by the one program that bakes something into the cache. Others wait: on the same processors
// both bakes would take as long as one after the other.
class Lock {
 public:
  /// name: of what is baked, for the log
  Lock(fs::path file, const std::string& name)
      : file_(std::move(file)),
        descriptor_(::open(file_.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0644)) {
    if (descriptor_ < 0) return;
    held_ = ::flock(descriptor_, LOCK_EX | LOCK_NB) == 0;
    if (held_ || errno != EWOULDBLOCK) return;
    log_info("{}: another program bakes it: waiting for that", name);
    held_ = ::flock(descriptor_, LOCK_EX) == 0;
  }
  ~Lock() {
    std::error_code ignored;
    if (held_) fs::remove(file_, ignored);
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;
  bool held() const { return held_; }

 private:
  fs::path file_;
  int descriptor_;
  bool held_ = false;
};

// Of a file in the cache; none without a cache that can be written.
std::optional<Lock> lock_for(const std::optional<fs::path>& folder, const fs::path& file,
                             const std::string& name) {
  if (!folder || !make_folder(*folder)) return {};
  return std::optional<Lock>(std::in_place, fs::path(file).replace_extension(".lock"), name);
}

// 1: it is over, also where it fails.
void tell_progress(const auto& options, double done) {
  if (options.progress) options.progress(done);
}

template <class Baked>
void mark_used(const Result<Baked>& recalled, const fs::path& file) {
  std::error_code ignored;
  if (recalled) fs::last_write_time(file, fs::file_time_type::clock::now(), ignored);
}

}  // namespace

Result<prt::BakedObject> bake_or_recall(const std::string& name, prt::Mesh mesh,
                                        const prt::BakeOptions& options, BakeCache cache) {
  const auto folder = folder_of(cache);
  const fs::path file = folder ? *folder / cache_name(mesh, options) : fs::path();
  const auto recall = [&] {
    auto recalled = prt::read_baked(file);
    mark_used(recalled, file);
    return recalled;
  };
  if (folder)
    if (auto recalled = recall()) return recalled;
  if (cache == BakeCache::kOnly) return not_baked(name);
  tell_progress(options, 0);  // also of one that waits for another program
  const std::optional<Lock> lock = lock_for(folder, file, name);
  if (lock)  // who held it before has baked it
    if (auto recalled = recall()) {
      tell_progress(options, 1);
      return recalled;
    }
  auto baked = prt::bake(std::move(mesh), options);
  if (!baked) {
    tell_progress(options, 1);
    return fail(baked.error().code, name, baked.error().detail);
  }
  log_info(
      "{}: baked {} vertices with {:.1f} million rays in {:.1f} s, standard error {:.2f} % of the "
      "first coefficient",
      name, baked->mesh.positions.size(), static_cast<double>(baked->report.rays) * 1e-6,
      baked->report.seconds, 100 * baked->report.standard_error);
  if (lock) {
    // A cache that cannot be written costs time, not the result.
    if (const auto written = prt::write_baked(file, *baked); !written)
      log_warning("the bake is not kept in the cache: {}: {}", written.error().where,
                  written.error().detail);
    prune_cache(*folder, kCacheBytes);
  }
  return baked;
}

Result<prt::BakedObject> AssetBakes::get(const std::string& name, prt::Mesh mesh,
                                         const prt::BakeOptions& options, const Rgb& floor) {
  const std::string key = cache_name(mesh, options);
  auto asset = assets_.find(key);
  if (asset == assets_.end()) {
    PENUMBRA_ASSIGN(baked, bake_or_recall(name, std::move(mesh), options, cache_));
    asset = assets_.emplace(key, Asset{std::move(baked), {}}).first;
  }
  std::vector<OnFloor>& floors = asset->second.floors;
  const auto same = std::ranges::find(floors, floor, &OnFloor::albedo);
  if (same != floors.end()) return same->baked;
  return floors.emplace_back(floor, prt::on_floor(asset->second.baked, floor)).baked;
}

namespace {

// A folder of this run's own, gone with it.
class PrivateFolder {
 public:
  PrivateFolder() {
    std::error_code ignored;
    std::string name = (fs::temp_directory_path(ignored) / "penumbra-bake-XXXXXX").string();
    if (::mkdtemp(name.data())) path_ = name;
  }
  ~PrivateFolder() {
    std::error_code ignored;
    if (!path_.empty()) fs::remove_all(path_, ignored);
  }
  PrivateFolder(const PrivateFolder&) = delete;
  PrivateFolder& operator=(const PrivateFolder&) = delete;
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

Result<prt::BakedSequence> bake_into(const fs::path& journal, const prt::Character& character,
                                     int clip, const prt::SequenceOptions& options) {
  PENUMBRA_TRY(prt::bake_frames(character, clip, options, {}, journal));
  const fs::path journals[] = {journal};
  auto sequence = prt::compress_frames(character, clip, options, journals);
  std::error_code ignored;
  fs::remove(journal, ignored);
  return sequence;
}

}  // namespace

void tell_work(const std::string& name, const prt::Character& character, int clip,
               const prt::SequenceOptions& options) {
  constexpr double kWorthSaying_s = 60, kLong_s = 1800;
  const auto work = prt::estimate_work(character, clip, options);
  if (!work || work->seconds < kWorthSaying_s) return;  // what is wrong the bake itself says
  log_info(
      "{}: its clip is {} key frames of {} points: about {:.0f} minutes on this machine, {:.1f} GB "
      "on disk meanwhile, and more where frames are baked between them; a bake that is stopped "
      "goes "
      "on where it was",
      name, work->frames, work->points, std::ceil(work->seconds / 60),
      static_cast<double>(work->journal_bytes) * 1e-9);
  if (work->seconds > kLong_s)
    log_warning(
        "{}: to see it sooner, play it by transfer = \"live\", or bake it with fewer key frames "
        "(penumbra bake --animation NAME --fps 10) or in shards",
        name);
}

Result<prt::BakedSequence> bake_or_recall(const std::string& name, const prt::Character& character,
                                          int clip, const prt::SequenceOptions& options,
                                          BakeCache cache) {
  const auto named = [&](const Error& e) { return fail(e.code, name, e.where + ": " + e.detail); };
  const auto key = prt::bake_key(character, clip, options);
  if (!key) return named(key.error());
  std::optional<fs::path> folder = folder_of(cache);
  if (folder && !make_folder(*folder)) folder.reset();
  const std::string stem = fmt::format(
      "{:016x}", Fnv1a().add(*key).add(options.error).add(options.interpolation_error).value());
  const fs::path file = folder ? *folder / (stem + kClipKind) : fs::path();
  const auto recall = [&] {
    auto recalled = prt::read_sequence(file, character, clip);
    mark_used(recalled, file);
    return recalled;
  };
  if (folder)
    if (auto recalled = recall()) return recalled;
  if (cache == BakeCache::kOnly) return not_baked(name);
  tell_progress(options, 0);  // also of one that waits for another program
  const std::optional<Lock> lock = lock_for(folder, file, name);
  if (lock)  // who held it before has baked it
    if (auto recalled = recall()) {
      tell_progress(options, 1);
      return recalled;
    }
  tell_work(name, character, clip, options);
  Result<prt::BakedSequence> sequence =
      fail(ErrorCode::kUnwritable, name, "cannot keep its baked frames");
  if (lock && lock->held()) {
    const fs::path journal = *folder / (stem + kJournalKind);
    sequence = bake_into(journal, character, clip, options);
    std::error_code ignored;
    if (!sequence) fs::remove(journal, ignored);
  }
  if (!sequence) {  // without a cache, or past a journal that cannot be used
    const PrivateFolder own;
    sequence = bake_into(own.path() / (stem + kJournalKind), character, clip, options);
  }
  if (!sequence) {
    tell_progress(options, 1);
    return named(sequence.error());
  }
  const prt::SequenceReport& r = sequence->report;
  log_info(
      "{}: baked {} key frames of {} points with {:.1f} million rays in {:.1f} s, standard error "
      "{:.2f} % of the first coefficient, error of compression {:.2f} %",
      name, sequence->surface.frames(), sequence->surface.points(),
      static_cast<double>(r.rays) * 1e-6, r.seconds, 100 * r.standard_error,
      100 * r.compression_error);
  if (!folder) return sequence;
  if (const auto written = prt::write_sequence(file, character, clip, *sequence); !written)
    log_warning("the bake is not kept in the cache: {}: {}", written.error().where,
                written.error().detail);
  prune_cache(*folder, kCacheBytes);
  return sequence;
}

}  // namespace penumbra::runtime
