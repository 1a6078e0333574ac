// What `penumbra chart` is asked for.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/farm/slurm_flags.h"

namespace penumbra::tools {

struct ChartOptions {
  std::string output = "out/chart";
  std::vector<std::string> environments;  // files
  bool with_procedural = false;           // the built-in ones beside the files
  std::vector<std::string> assets;
  std::vector<int> bands;  // only these, with `lights`; else the whole sweep
  int lights = 0;
  std::optional<double> error;    // of the reference; nothing: as the chart's kind needs it
  int governor = 0;               // prove the governor on so many scenes instead
  double max_shadow_error = .05;  // of the shadow's RMS error in s, for that
  bool truncated = false;  // compare under the same truncated light instead of the whole light
  bool through_sensor = false;
  bool stills = false;                      // of each case, for that
  int bits = 8;                             // of both cameras, for that
  double shortest_exposure_s = 1. / 64000;  // of the environment camera, for that
  std::string view_lens = "pinhole";        // of the view camera, for that
  bool direct_light = false;                // chart ways to trace one light at vertices instead
  bool materials = false;                   // chart ways to draw what mirrors instead
  bool light_track = false;                 // chart the coding of maps of the surroundings instead
  std::vector<std::string> stills_charted;  // chart the coding of these HDR pictures instead
  std::string animation;  // of the first asset: chart the compression of its transfer instead
  std::string light_map = "128x128";
  int frames = 100, samples = 512;
  bool json = false;
  std::string shard;  // "i/n", "auto", "auto/n"
  int merge = 0;      // so many shards
  SlurmFlags slurm;
};
/// Bytes against rendered error of ways to code transfer over a clip.
Result<void> chart_clip(const ChartOptions& options);
/// Error against time of ways to trace a distant light at an object's vertices.
Result<void> chart_direct_light(const ChartOptions& options);
/// Error against time of ways to draw metal and plastic.
Result<void> chart_materials(const ChartOptions& options);
/// Bytes against the light's error of ways to keep maps of the surroundings.
Result<void> chart_light_track(const ChartOptions& options);
/// Bits a pixel against error of ways to keep HDR pictures.
Result<void> chart_stills(const ChartOptions& options);
/// Errors of the joined chain, from both cameras' sensors to the picture.
Result<void> chart_through_sensor(const ChartOptions& options);

}  // namespace penumbra::tools
