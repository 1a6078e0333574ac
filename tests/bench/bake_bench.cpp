#include <oneapi/tbb/parallel_for.h>

#include "bench/harness.h"
#include "prt/prt.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::bench {
namespace {

// Peer: the same rays through Embree's packets of sixteen and nothing else.
void bake(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const prt::Mesh mesh = prt::make_knot(1, 200, 40, {.6f, .6f, .6f});
  prt::BakeOptions options;
  options.bounces = static_cast<int>(state.range(1));
  options.rays = 1024;
  const auto scene = prt::RayScene::build(mesh);
  const prt::RayPatterns patterns(options.rays);
  compare(
      state, [&] { benchmark::DoNotOptimize(prt::bake(mesh, options)); },
      [&] {
        tbb::parallel_for(std::size_t{0}, mesh.positions.size(), [&](std::size_t i) {
          const auto turn = prt::RayPatterns::turn_of(i);
          const glm::mat3 frame = prt::frame_around(mesh.normals[i]);
          prt::RayScene::RayPacket packet;
          std::uint32_t blocked = 0;
          for (int b = 0; b < options.rays / 16; ++b) {
            patterns.cosine_block(turn, b, frame, packet);
            blocked += scene->occluded(mesh.positions[i] + 1e-4f * mesh.normals[i], 1e-4f, packet);
          }
          benchmark::DoNotOptimize(blocked);
        });
      });
  state.counters["share_of_bare_rate"] = state.counters["ratio"];
  state.counters["Mrays_s"] =
      static_cast<double>(mesh.positions.size()) * options.rays * 1e-3 / state.counters["ours_ms"];
}
BENCHMARK(bake)
    ->Name("prt/bake_25_coefficients_vs_bare_embree")
    ->ArgNames({"threads", "bounces"})
    ->Args({1, 0})
    ->Args({2, 0})
    ->Args({1, 4})
    ->Args({2, 4})
    ->Iterations(7)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
