// What `penumbra bake` is asked for.
#pragma once

#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/clip/sequence.h"
#include "runtime/scene/animated.h"
#include "tools/farm/slurm_flags.h"

namespace penumbra::tools {

struct BakeCommandOptions {
  std::string asset, output;
  int bands = 5, bounces = 4, samples = 1024, max_vertices = 100'000;
  std::vector<double> albedo{.7, .7, .7};
  double receiver_albedo = 0;
  bool json = false;
  // Of a clip:
  std::string animation;
  double fps = 30, error = .005, interpolation_error = .02;
  std::string light_map;  // "256x128", or empty: at vertices
  std::string shard;      // "i/n", "auto", "auto/n"
  int round = 0;          // of frames between, for the shard
  int merge = 0;          // so many shards
  int ground_texels = 64;
  SlurmFlags slurm;
  bool copy = false;  // the asset to the machines, for that
};
Rgb albedo_of(const BakeCommandOptions& options);
/// Of a clip: transfer over its frames.
Result<void> bake_clip(const BakeCommandOptions& options);
/// The same in shards on Slurm, of what bake_clip has prepared.
Result<void> bake_on_slurm(const BakeCommandOptions& options, const runtime::StandingCharacter& of,
                           const prt::SequenceOptions& sequence);

}  // namespace penumbra::tools
