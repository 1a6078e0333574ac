#include <cmath>
#include <cstdint>
#include <random>
#include <span>
#include <string>
#include <vector>

#include "bench/durand_filter.h"
#include "bench/harness.h"
#include "codec/display.h"
#include "codec/tone/tone_mapping.h"
#include "core/threads/parallel.h"

namespace penumbra::bench {
namespace {

// Rooms behind windows: large steps of light, waves and grain on them, five decades in all.
Image<Rgb> bright_rooms(int width, int height) {
  std::mt19937 rng(1);
  std::normal_distribution<float> grain(0, .08f);
  Image<Rgb> out(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const auto fx = static_cast<float>(x), fy = static_cast<float>(y);
      const float room = static_cast<float>((x / 96 + 3 * (y / 80)) % 5) * 2.3f;
      const float l = std::exp(room + .4f * std::sin(.11f * fx) * std::cos(.07f * fy) + grain(rng));
      out.at(x, y) = {l, .8f * l, .6f * l};
    }
  return out;
}

Image<float> logarithms(const Image<Rgb>& radiance, float base) {
  Image<float> out(radiance.width(), radiance.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = std::log(radiance.pixels()[i].g) / std::log(base);
  return out;
}

// Peer: the bilateral filter of Durand & Dorsey by FFT, which gives the same kind of base.
void level_set_vs_durand(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const Image<Rgb> rooms = bright_rooms(768, 512);
  const Image<float> natural = logarithms(rooms, 2.718282f), decimal = logarithms(rooms, 10);
  compare(
      state, [&] { benchmark::DoNotOptimize(tone::level_set_profile(natural, 11.5)); },
      [&] { benchmark::DoNotOptimize(durand_base(decimal, .02 * 768, .4)); });
  state.counters["ms_per_megapixel_and_step"] =
      state.counters["ours_ms"] / (natural.area() * 1e-6 * tone::LevelSetOptions{}.steps);
}
BENCHMARK(level_set_vs_durand)
    ->Name("tone/level_set_768x512_vs_durand02")
    ->Apply(one_and_two_threads);

// Peer: ours of the other kind.
void bilateral_vs_durand(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const Image<Rgb> rooms = bright_rooms(768, 512);
  const Image<float> decimal = logarithms(rooms, 10);
  compare(
      state,
      [&] {
        benchmark::DoNotOptimize(tone::bilateral_base(decimal, {.02 * 768, .4}));
      },
      [&] { benchmark::DoNotOptimize(durand_base(decimal, .02 * 768, .4)); });
}
BENCHMARK(bilateral_vs_durand)
    ->Name("tone/bilateral_768x512_vs_durand02")
    ->Apply(one_and_two_threads);

// Peer: a copy of the picture for each step, the least that steps one after another would move.
// Below 1 since a strip of rows makes many steps before it leaves the cache.
void level_set_vs_copies(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const Image<float> large = logarithms(bright_rooms(4096, 2048), 2.718282f);
  const tone::LevelSetOptions options;
  Image<float> copy(large.width(), large.height());
  compare(
      state, [&] { benchmark::DoNotOptimize(tone::level_set_profile(large, 11.5, options)); },
      [&] {
        for (int k = 0; k < options.steps; ++k) {
          parallel_for(0, large.height(), 64, [&](const auto& rows) {
            for (int y = rows.begin(); y < rows.end(); ++y)
              std::ranges::copy(large.row(y), copy.row(y).begin());
          });
          benchmark::ClobberMemory();
        }
      });
  state.counters["times_of_copies"] = 1 / state.counters["ratio"];
  state.counters["ms_per_megapixel_and_step"] =
      state.counters["ours_ms"] / (large.area() * 1e-6 * options.steps);
}
BENCHMARK(level_set_vs_copies)
    ->Name("tone/level_set_4096x2048_vs_copies")
    ->Apply(one_and_two_threads);

// Peer: exposure and sRGB alone, which every picture on a display needs.
void whole_vs_display(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  tone::ToneOptions options;
  options.op = static_cast<tone::ToneOperator>(state.range(1));
  const FramePixels frame = bright_rooms(1280, 720);
  compare(
      state,
      [&] { benchmark::DoNotOptimize(tone::tone_map(std::get<Image<Rgb>>(frame), options)); },
      [&] { benchmark::DoNotOptimize(codec::to_display(frame, .01f)); });
}
BENCHMARK(whole_vs_display)
    ->Name("tone/tone_map_1280x720_vs_display")
    ->ArgNames({"threads", "operator"})
    ->ArgsProduct({{1, 2}, {0, 1, 2, 3, 4}})
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
