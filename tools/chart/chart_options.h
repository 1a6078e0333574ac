// What `penumbra chart` is asked for.
#pragma once

#include <string>
#include <vector>

#include "core/result.h"

namespace penumbra::tools {

struct ChartOptions {
  std::string output = "out/chart";
  std::vector<std::string> environments;  // files
  bool with_procedural = false;           // the built-in ones beside the files
  std::vector<std::string> assets;
  std::vector<int> bands;  // only these, with `lights`; else the whole sweep
  int lights = 0;
  double error = .004;
  int governor = 0;        // prove the governor on so many scenes instead
  double budget = .05;     // of the shadow's RMS error in s, for that
  bool truncated = false;  // compare under the same truncated light instead of the whole light
  std::string animation;   // of the first asset: chart the compression of its transfer instead
  std::string light_map = "128x128";
  int frames = 100, samples = 512;
  bool json = false;
};
/// Bytes against rendered error of ways to code transfer over a clip.
Result<void> chart_clip(const ChartOptions& options);

}  // namespace penumbra::tools
