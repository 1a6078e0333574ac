#include <random>
#include <span>

#include "bench/eigen_relight.h"
#include "bench/harness.h"
#include "core/half.h"
#include "core/threads/parallel.h"
#include "lighting/lighting.h"
#include "prt/prt.h"

namespace penumbra::bench {
namespace {

std::uint64_t sum_of(std::span<const std::uint64_t> words) {
  std::uint64_t s[8] = {}, sum = 0;
  for (std::size_t i = 0; i + 8 <= words.size(); i += 8)
    for (std::size_t k = 0; k < 8; ++k) s[k] += words[i + k];
  for (const std::uint64_t v : s) sum += v;
  return sum;
}

// Peer: reading the map once, at the bandwidth of this run (eight independent sums), on as many
// threads. Maps in turn, so that no cache holds them.
void sh_projection(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const int bands = static_cast<int>(state.range(1));
  std::vector<Image<Rgb>> maps(6, Image<Rgb>(2048, 1024));
  std::mt19937 rng(1);
  std::lognormal_distribution<float> heavy(0, 1);
  for (Rgb& c : maps[0].pixels()) c = {heavy(rng), heavy(rng), heavy(rng)};
  std::fill(maps.begin() + 1, maps.end(), maps[0]);
  lighting::LatLongProjector projector(2048, 1024, bands);
  const auto words_of = [](const Image<Rgb>& map) {
    return std::span(reinterpret_cast<const std::uint64_t*>(map.pixels().data()),
                     map.area() * sizeof(Rgb) / sizeof(std::uint64_t));
  };
  std::size_t next = 0;
  compare(
      state, [&] { benchmark::DoNotOptimize(projector.project(maps[++next % maps.size()])); },
      [&] {
        const auto words = words_of(maps[++next % maps.size()]);
        parallel_for(std::size_t{0}, words.size(), std::size_t{1} << 16, [&](const auto& part) {
          benchmark::DoNotOptimize(sum_of(words.subspan(part.begin(), part.size())));
        });
      });
  state.counters["times_of_streaming"] = 1 / state.counters["ratio"];
  state.counters["stream_GB_s"] =
      static_cast<double>(words_of(maps[0]).size_bytes()) * 1e-6 / state.counters["peer_ms"];
}
BENCHMARK(sh_projection)
    ->Name("lighting/project_2048x1024_vs_streaming")
    ->ArgNames({"threads", "bands"})
    ->ArgsProduct({{1, 2}, {3, 5, 9}})
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

// Peer: Eigen's product of a 100k x 25 float matrix with a 25 x 3 one, built with -O3 -mavx2 -mfma.
// The bound: the bytes of the transfer read once and those of the radiance written once, on as many
// threads.
void relight(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  constexpr std::size_t kVertices = 100'000;
  if (EigenRelight::missing()) return state.SkipWithError("this machine has no AVX2 or no FMA");
  prt::Transfer transfer(5, 1, kVertices);
  std::mt19937 rng(2);
  std::normal_distribution<float> gauss(0, .2f);
  std::vector<float> matrix, columns;
  for (int n = 0; n < 25; ++n)
    for (std::size_t p = 0; p < kVertices; ++p) {
      matrix.push_back(gauss(rng));
      transfer.set(0, n, p, matrix.back());
    }
  RadianceSh light(5);
  for (int n = 0; n < 25; ++n)
    for (int c = 0; c < 3; ++c) columns.push_back(light[n][c] = gauss(rng));
  std::vector<float> out(3 * transfer.stride), written(3 * transfer.stride);
  EigenRelight eigen(matrix, columns);
  const auto run = [&] {
    prt::relight(transfer, light, out);
    benchmark::DoNotOptimize(out.data());
  };
  const std::span words(reinterpret_cast<const std::uint64_t*>(transfer.values.data()),
                        transfer.values.size() / 4);
  const auto move_bytes = [&] {
    constexpr std::size_t kParts = 64;
    parallel_for(std::size_t{0}, kParts, [&](std::size_t k) {
      const auto part = [&](std::size_t size) {
        return std::pair(k * size / kParts, (k + 1) * size / kParts);
      };
      const auto [first, last] = part(words.size());
      benchmark::DoNotOptimize(sum_of(words.subspan(first, last - first)));
      const auto [begin, end] = part(written.size());
      std::fill(written.begin() + std::ptrdiff_t(begin), written.begin() + std::ptrdiff_t(end),
                1.f);
    });
    benchmark::DoNotOptimize(written.data());
  };
  compare(state, run, [&] { eigen.run(); });
  std::vector<double> bound;
  for (int i = 0; i < 101; ++i) bound.push_back(time_ms(move_bytes));
  state.counters["bound_ms"] = median(bound);
}
BENCHMARK(relight)
    ->Name("prt/relight_100k_25_rgb_vs_eigen")
    ->Apply(one_and_two_threads)
    ->Iterations(101);

}  // namespace
}  // namespace penumbra::bench
