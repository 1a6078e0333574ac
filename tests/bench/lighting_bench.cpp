#include <Eigen/Core>
#include <random>

#include "bench/harness.h"
#include "core/half.h"
#include "lighting/lighting.h"
#include "prt/prt.h"

namespace penumbra::bench {
namespace {

// Peer: reading the map once, at the bandwidth of this run (eight independent sums).
void sh_projection(benchmark::State& state) {
  const Threads threads(1);
  const int bands = static_cast<int>(state.range(0));
  Image<Rgb> map(2048, 1024);
  std::mt19937 rng(1);
  std::lognormal_distribution<float> heavy(0, 1);
  for (Rgb& c : map.pixels()) c = {heavy(rng), heavy(rng), heavy(rng)};
  lighting::LatLongProjector projector(2048, 1024, bands);
  const auto* words = reinterpret_cast<const std::uint64_t*>(map.pixels().data());
  const std::size_t count = map.area() * sizeof(Rgb) / 64;
  std::uint64_t sink = 0;
  compare(
      state, [&] { benchmark::DoNotOptimize(projector.project(map)); },
      [&] {
        std::uint64_t s[8] = {};
        for (std::size_t i = 0; i < count; ++i)
          for (int k = 0; k < 8; ++k) s[k] += words[8 * i + static_cast<std::size_t>(k)];
        for (std::uint64_t v : s) sink += v;
        benchmark::DoNotOptimize(sink);
      });
  state.counters["times_of_streaming"] = 1 / state.counters["ratio"];
  state.counters["stream_GB_s"] = static_cast<double>(count) * 64e-6 / state.counters["peer_ms"];
}
BENCHMARK(sh_projection)
    ->Name("lighting/project_2048x1024_vs_streaming")
    ->ArgName("bands")
    ->Arg(3)
    ->Arg(5)
    ->Arg(9)
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

// Peer: Eigen's product of a 100k x 25 float matrix with a 25 x 3 one.
void relight(benchmark::State& state) {
  const Threads threads(1);
  constexpr std::size_t kVertices = 100'000;
  prt::Transfer transfer(5, 1, kVertices);
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic> matrix(kVertices, 25);
  std::mt19937 rng(2);
  std::normal_distribution<float> gauss(0, .2f);
  for (int n = 0; n < 25; ++n)
    for (std::size_t p = 0; p < kVertices; ++p) {
      const float v = gauss(rng);
      transfer.set(0, n, p, v);
      matrix(static_cast<Eigen::Index>(p), n) = v;
    }
  RadianceSh light(5);
  Eigen::Matrix<float, 25, 3> columns;
  for (int n = 0; n < 25; ++n)
    for (int c = 0; c < 3; ++c) columns(n, c) = light[n][c] = gauss(rng);
  std::vector<float> out(3 * transfer.stride);
  Eigen::Matrix<float, Eigen::Dynamic, 3> product(kVertices, 3);
  compare(
      state,
      [&] {
        prt::relight(transfer, light, out);
        benchmark::DoNotOptimize(out.data());
      },
      [&] {
        product.noalias() = matrix * columns;
        benchmark::DoNotOptimize(product.data());
      });
}
BENCHMARK(relight)
    ->Name("prt/relight_100k_25_rgb_vs_eigen")
    ->Iterations(31)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
