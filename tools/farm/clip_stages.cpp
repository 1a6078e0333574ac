#include "tools/farm/clip_stages.h"

#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>

namespace penumbra::tools {

namespace {

// A shard of that length loses little when it is begun again, and hides what it takes to begin.
constexpr double kShard_s = 600;
constexpr int kMaxClipShards = 64;
// Times are asked for thrice over: cores differ, and frames do, too.
constexpr double kTimeMargin = 3;
constexpr std::uint64_t kSpareBytes = std::uint64_t{256} << 20;
// Whoever reads all frames holds them as halves, and two streams of them as floats: 2.6 bytes for
// each byte of the journals was measured.
constexpr double kReadBytes = 4, kReadBytes_s = 2e6;

}  // namespace

Result<ClipEstimate> estimate_clip(const prt::Character& character, int clip,
                                   const prt::SequenceOptions& options, int cores) {
  PENUMBRA_ASSIGN(work, prt::estimate_work(character, clip, options));
  rusage used{};  // with the peak of the frame that was baked
  getrusage(RUSAGE_SELF, &used);
  return ClipEstimate{work.frames, work.core_seconds / work.frames / cores,
                      work.journal_bytes / static_cast<std::uint64_t>(work.frames),
                      2 * static_cast<std::uint64_t>(used.ru_maxrss) * 1024 + kSpareBytes};
}

int shards_for(const ClipEstimate& e) {
  return std::clamp(static_cast<int>(std::ceil(e.frames * e.frame_s / kShard_s)), 1,
                    std::min(e.frames, kMaxClipShards));
}

SlurmStage clip_array(const ClipEstimate& e, std::vector<std::string> arguments, int shards,
                      int round) {
  SlurmStage out;
  out.name = round == 0 ? "shards" : fmt::format("round-{}", round);
  out.arguments = std::move(arguments);
  out.arguments.insert(out.arguments.end(), {"--shard", fmt::format("auto/{}", shards)});
  if (round > 0) out.arguments.insert(out.arguments.end(), {"--round", fmt::format("{}", round)});
  out.tasks = shards;
  // A round bakes at most as many frames as there are before it, and reads all of those.
  const double frames = std::ldexp(e.frames, std::max(0, round - 1));
  const double read = round == 0 ? 0 : frames * static_cast<double>(e.frame_bytes);
  out.seconds = kTimeMargin * (std::ceil(frames / shards) * e.frame_s + read / kReadBytes_s);
  out.bytes = e.task_bytes + static_cast<std::uint64_t>(kReadBytes * read);
  return out;
}

SlurmStage clip_merge(const ClipEstimate& e, std::vector<std::string> arguments, int shards,
                      int frames) {
  SlurmStage out;
  out.name = "merge";
  out.arguments = std::move(arguments);
  out.arguments.insert(out.arguments.end(), {"--merge", fmt::format("{}", shards)});
  const double read = static_cast<double>(frames) * static_cast<double>(e.frame_bytes);
  out.seconds = kTimeMargin * read / kReadBytes_s;
  out.bytes = e.task_bytes + static_cast<std::uint64_t>(kReadBytes * read);
  return out;
}

}  // namespace penumbra::tools
