#include <filesystem>

#include "bench/harness.h"
#include "prt/prt.h"

namespace penumbra::bench {
namespace {

// The dissertation's size of setting: two maps of 128x128 texels, a hundred frames. Peer: the same
// frame's transfer uncompressed, as a static object's, which the memory of a hundred frames would
// not hold.
void relight_clip(benchmark::State& state) {
  const int bands = static_cast<int>(state.range(1));
  const prt::Character walker = prt::make_walker({.6f, .6f, .6f});
  prt::SequenceOptions options;
  options.frames_per_second = 100 / walker.clips[0].seconds;
  options.bands = bands;
  options.bounces = 1;
  options.rays = 256;
  options.map_width = 256;
  options.map_height = 128;
  const auto folder = std::filesystem::temp_directory_path();
  const std::filesystem::path journals[] = {
      folder / ("penumbra-bench-" + std::to_string(bands) + ".journal")};
  std::error_code ignored;
  const auto baked = prt::bake_frames(walker, 0, options, {}, journals[0]);
  const auto sequence = prt::compress_frames(walker, 0, options, journals);
  std::filesystem::remove(journals[0], ignored);
  if (!baked || !sequence) return state.SkipWithError("no bake");
  const Threads threads(static_cast<int>(state.range(0)));
  RadianceSh light(bands);
  for (int n = 0; n < light.size(); ++n) light[n] = {1.f / (1 + n), .8f / (1 + n), .5f / (1 + n)};
  const auto turns = prt::bone_turns(walker, prt::sample(walker, walker.clips[0], .4));
  std::vector<float> out(3 * sequence->surface.stride());
  prt::Transfer frame;
  sequence->surface.decode(36.4, turns, frame);
  compare(
      state, [&] { sequence->surface.relight(36.4, light, turns, out); },
      [&] { prt::relight(frame, light, out); });
  state.counters["points"] = static_cast<double>(sequence->surface.points());
  state.counters["components"] = sequence->surface.max_components();
}
BENCHMARK(relight_clip)
    ->Name("prt/relight_compressed_clip_vs_one_frame_uncompressed")
    ->ArgNames({"threads", "bands"})
    ->Args({1, 3})
    ->Args({1, 5})
    ->Args({2, 5})
    ->Iterations(7)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
