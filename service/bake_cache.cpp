#include "service/bake_cache.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdlib>
#include <optional>
#include <vector>

#include "core/files.h"

namespace penumbra::service {

namespace fs = std::filesystem;

namespace {

std::uint64_t hash(std::uint64_t h, const void* data, std::size_t bytes) {  // FNV-1a
  const auto* p = static_cast<const unsigned char*>(data);
  for (std::size_t i = 0; i < bytes; ++i) h = (h ^ p[i]) * 0x100000001b3ull;
  return h;
}

// Everything that the bake's result depends on; the version changes with the bake's own code.
std::string cache_name(const prt::Mesh& mesh, const prt::BakeOptions& o) {
  constexpr std::uint64_t kBakeVersion = 8;
  std::uint64_t h = hash(0xcbf29ce484222325ull, &kBakeVersion, sizeof kBakeVersion);
  h = hash(h, mesh.positions.data(), mesh.positions.size() * sizeof(glm::vec3));
  h = hash(h, mesh.normals.data(), mesh.normals.size() * sizeof(glm::vec3));
  h = hash(h, mesh.albedo.data(), mesh.albedo.size() * sizeof(Rgb));
  h = hash(h, mesh.triangles.data(), mesh.triangles.size() * sizeof(mesh.triangles[0]));
  const int numbers[] = {o.bands, o.bounces, o.rays, o.ground_rays,
                         o.receiver ? o.receiver->grid.size : 0};
  h = hash(h, numbers, sizeof numbers);
  if (o.receiver) {
    const prt::GroundGrid& g = o.receiver->grid;
    const float floats[] = {
        g.centre.x,           g.centre.y,           g.half_extent,       g.height,
        o.receiver->albedo.r, o.receiver->albedo.g, o.receiver->albedo.b};
    h = hash(h, floats, sizeof floats);
  }
  return fmt::format("{:016x}.glb", h);
}

std::optional<fs::path> cache_folder() {
  const char* cache = std::getenv("XDG_CACHE_HOME");
  const char* home = std::getenv("HOME");
  if (cache && *cache) return fs::path(cache) / "penumbra";
  if (home && *home) return fs::path(home) / ".cache" / "penumbra";
  return std::nullopt;
}

}  // namespace

void prune_cache(const fs::path& folder, std::uintmax_t most_bytes) {
  struct Entry {
    fs::file_time_type used;
    std::uintmax_t bytes;
    fs::path path;
  };
  std::vector<Entry> entries;
  std::error_code error;
  for (fs::directory_iterator file(folder, error), end; !error && file != end;
       file.increment(error)) {
    if (file->path().extension() != ".glb") continue;
    std::error_code gone;
    const Entry e{file->last_write_time(gone), file->file_size(gone), file->path()};
    if (!gone) entries.push_back(e);
  }
  std::ranges::sort(entries, std::ranges::greater(), &Entry::used);
  std::uintmax_t kept = 0;
  for (const Entry& e : entries)
    if ((kept += e.bytes) > most_bytes) fs::remove(e.path, error);
}

Result<prt::BakedObject> bake_or_recall(const std::string& name, prt::Mesh mesh,
                                        const prt::BakeOptions& options, bool use_cache) {
  const auto folder = use_cache ? cache_folder() : std::nullopt;
  const fs::path file = folder ? *folder / cache_name(mesh, options) : fs::path();
  if (folder)
    if (auto recalled = prt::read_baked(file)) {
      std::error_code ignored;
      fs::last_write_time(file, fs::file_time_type::clock::now(), ignored);
      return recalled;
    }
  auto baked = prt::bake(std::move(mesh), options);
  if (!baked) return fail(baked.error().code, name, baked.error().detail);
  spdlog::info("{}: baked {} vertices, {:.1f} M rays in {:.1f} s, standard error {:.2f} % of t_0",
               name, baked->mesh.positions.size(), static_cast<double>(baked->report.rays) * 1e-6,
               baked->report.seconds, 100 * baked->report.standard_error);
  if (folder && make_folder(*folder)) {
    // A cache that cannot be written costs time, not the result.
    if (const auto written = prt::write_baked(file, *baked); !written)
      spdlog::warn("bake cache: {}: {}", written.error().where, written.error().detail);
    prune_cache(*folder, kCacheBytes);
  }
  return baked;
}

}  // namespace penumbra::service
