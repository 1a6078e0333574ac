// Baked objects kept between runs: the bake is asked for by what its result depends on.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "prt/bake/bake.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// $XDG_CACHE_HOME/penumbra or ~/.cache/penumbra; nothing where neither is told.
std::optional<std::filesystem::path> cache_folder();

/// From $XDG_CACHE_HOME/penumbra or ~/.cache/penumbra when it was baked before, otherwise baked and
/// put there. The folder keeps what was used last, at most `kCacheBytes`; one that cannot be
/// written costs time, not the result. One program at a time bakes the same; others wait for it.
/// errors: of prt::bake, naming `name`; kNotFound (not there, and BakeCache::kOnly)
Result<prt::BakedObject> bake_or_recall(const std::string& name, prt::Mesh mesh,
                                        const prt::BakeOptions& options, BakeCache cache);

/// The bakes of one scene: an asset is baked once, however many copies of it stand there, and those
/// on floors of one albedo share their transfer.
/// threads: thread-bound
class AssetBakes {
 public:
  explicit AssetBakes(BakeCache cache) : cache_(cache) {}
  /// floor: its albedo; the options keep the floor apart
  /// errors: of prt::bake, naming `name`
  Result<prt::BakedObject> get(const std::string& name, prt::Mesh mesh,
                               const prt::BakeOptions& options, const Rgb& floor);

 private:
  struct OnFloor {
    Rgb albedo;
    prt::BakedObject baked;
  };
  struct Asset {
    prt::BakedObject baked;
    std::vector<OnFloor> floors;
  };
  BakeCache cache_;
  std::map<std::string, Asset> assets_;  // by cache name
};

/// The same for a clip. Frames that a bake finished before it was stopped are kept there as well.
/// errors: of prt::bake_frames, naming `name`
Result<prt::BakedSequence> bake_or_recall(const std::string& name, const prt::Character& character,
                                          int clip, const prt::SequenceOptions& options,
                                          BakeCache cache);

/// Says what a clip's bake takes, in time and in room for its journal, before one that takes more
/// than a minute begins.
void tell_work(const std::string& name, const prt::Character& character, int clip,
               const prt::SequenceOptions& options);

inline constexpr std::uintmax_t kCacheBytes = std::uintmax_t{1} << 30;

/// Removes the baked files that were used longest ago until the rest is within `max_bytes`.
void prune_cache(const std::filesystem::path& folder, std::uintmax_t max_bytes);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
