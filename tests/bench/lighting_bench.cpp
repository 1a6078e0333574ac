#include <Eigen/Core>
#include <random>
#include <span>

#include "bench/harness.h"
#include "core/half.h"
#include "core/parallel.h"
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

// Peer: Eigen's product of a 100k x 25 float matrix with a 25 x 3 one, its rows on as many threads.
void relight(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
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
        constexpr Eigen::Index kRows = 2048;
        parallel_for(Eigen::Index{0}, matrix.rows(), kRows, [&](const auto& rows) {
          const auto size = static_cast<Eigen::Index>(rows.size());
          product.middleRows(rows.begin(), size).noalias() =
              matrix.middleRows(rows.begin(), size) * columns;
        });
        benchmark::DoNotOptimize(product.data());
      });
}
BENCHMARK(relight)
    ->Name("prt/relight_100k_25_rgb_vs_eigen")
    ->Apply(one_and_two_threads)
    ->Iterations(101);

}  // namespace
}  // namespace penumbra::bench
