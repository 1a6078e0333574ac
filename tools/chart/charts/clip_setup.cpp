#include "tools/chart/charts/clip_setup.h"

#include <algorithm>

#include "core/image.h"
#include "prt/geometry/animation.h"
#include "tools/common/number_pairs.h"
#include "tools/common/progress.h"
#include "tools/farm/shard_file.h"

namespace penumbra::tools {

Result<ChartedClip> charted_clip(const ChartOptions& o) {
  const std::string asset = o.assets.empty() ? "builtin:walker" : o.assets[0];
  PENUMBRA_ASSIGN(size, read_map_size("--light-map", o.light_map));
  PENUMBRA_ASSIGN(
      standing, runtime::standing_character(asset, {.5f, .5f, .5f}, o.animation, size[0], size[1]));
  // Grey, so that every coder has one channel to code.
  std::ranges::fill(standing.character.albedo, Rgb{.5f, .5f, .5f});
  const prt::Clip& clip = standing.character.clips[static_cast<std::size_t>(standing.clip)];
  ChartedClip out;
  out.options.bands = o.bands.empty() ? 3 : o.bands[0];
  out.options.map_width = size[0];
  out.options.map_height = size[1];
  out.options.rays = o.samples;
  out.options.frames_per_second = clip.seconds > 0 ? o.frames / clip.seconds : 1;
  out.options.interpolation_error = 0;  // every coder has the same frames, evenly apart
  out.options.progress = progress_bar("bake " + std::filesystem::path(asset).filename().string());
  out.standing = std::move(standing);
  return out;
}

std::string clip_shards_stem(const ChartOptions& o) {
  return (std::filesystem::path(o.output) / "clip").string();
}

Result<std::string> bake_charted_shard(const ChartOptions& o, const ChartedClip& clip,
                                       ShardChoice shard) {
  const prt::Shard part{shard.index, shard.count};
  const prt::Character& character = clip.standing.character;
  const auto file = shard_file(clip_shards_stem(o), shard.index, shard.count);
  PENUMBRA_TRY(make_shard(
      file,
      [&](const std::filesystem::path& path) -> Result<bool> {
        PENUMBRA_ASSIGN(missing, prt::missing_frames(character, clip.standing.clip, clip.options,
                                                     part, {}, path));
        return missing == 0;
      },
      [&](const std::filesystem::path& path) {
        return prt::bake_frames(character, clip.standing.clip, clip.options, part, path);
      }));
  return file.string();
}

Result<std::vector<std::filesystem::path>> charted_journals(const ChartOptions& o,
                                                            const ChartedClip& clip,
                                                            const std::filesystem::path& whole) {
  if (o.merge > 0) {
    auto files = shard_files(clip_shards_stem(o), o.merge);
    PENUMBRA_TRY(
        prt::check_shards(clip.standing.character, clip.standing.clip, clip.options, files));
    return files;
  }
  PENUMBRA_TRY(
      prt::bake_frames(clip.standing.character, clip.standing.clip, clip.options, {}, whole));
  return std::vector{whole};
}

}  // namespace penumbra::tools
