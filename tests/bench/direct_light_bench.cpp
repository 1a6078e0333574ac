// A light that moves: what tracing its light anew costs, against every vertex and every node of the
// map with all rays.
#include <cmath>

#include "bench/harness.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::bench {
namespace {

struct DirectLightSetup {
  prt::Mesh mesh = prt::make_knot(.5f, 480, 80, {.6f, .6f, .6f});
  shadows::SilhouetteMesh silhouette{mesh};
  prt::RayWorld world = *prt::RayWorld::create();
  prt::Plane plane;
  DirectLightSetup() { (void)world.add(mesh); }
  shadows::RayOccluders occluders() const { return {&world, nullptr, 3e-5f}; }
};

const DirectLightSetup& direct_light_setup() {
  static const DirectLightSetup one;
  return one;
}

// A little further with every call.
lighting::DistantLight source(double radius_deg, int step) {
  lighting::DistantLight out;
  const double azimuth = .3 + .002 * step, elevation = .7;
  out.direction = {std::cos(elevation) * std::cos(azimuth), std::sin(elevation),
                   std::cos(elevation) * std::sin(azimuth)};
  out.radius = Radians{radius_deg * kPi / 180};
  out.radiance = {1, 1, 1};
  return out;
}

void by_radius(benchmark::internal::Benchmark* b) {
  b->ArgName("radius_1/100_deg")->Arg(28)->Arg(340)->Arg(1000);
  b->Iterations(kRepeats)->UseManualTime()->Unit(benchmark::kMillisecond);
}

void vertices(benchmark::State& state) {
  const Threads threads(1);
  const double radius = static_cast<double>(state.range(0)) / 100;
  const shadows::Caster caster{&direct_light_setup().mesh, &direct_light_setup().silhouette, {}};
  std::vector<float> out(direct_light_setup().mesh.positions.size());
  int step = 0;
  const shadows::SilhouetteMesh none{prt::Mesh{}};  // nobody shares rays
  const shadows::Caster alone{&direct_light_setup().mesh, &none, {}};
  const auto trace = [&](const shadows::Caster& object, int samples) {
    shadows::trace_direct_light(direct_light_setup().occluders(), {{&object, 1}, {}, 3e-5f}, object,
                                &direct_light_setup().plane, source(radius, step++), samples, out);
  };
  compare(
      state, [&] { trace(caster, 4); }, [&] { trace(alone, 16); });
}
BENCHMARK(vertices)->Name("shadows/distant_light_on_the_knot_vs_16_rays_each")->Apply(by_radius);

void floor_map(benchmark::State& state) {
  const Threads threads(1);
  const double radius = static_cast<double>(state.range(0)) / 100;
  const shadows::Caster caster{&direct_light_setup().mesh, &direct_light_setup().silhouette, {}};
  std::vector<shadows::ShadowMap> maps(1);
  int step = 0;
  prt::Mesh nodes;  // no triangles: each for itself
  shadows::DirectLightAtVertices dense;
  const auto trace = [&] {
    shadows::render_shadow_maps({{&caster, 1}, {}, 3e-5f}, direct_light_setup().plane,
                                source(radius, step++), {}, maps);
  };
  trace();
  const shadows::ShadowMap& shadow = maps[0];
  for (int y = 0; y < shadow.virtual_occlusion.height(); ++y)
    for (int x = 0; x < shadow.virtual_occlusion.width(); ++x)
      nodes.positions.emplace_back(shadow.world_from_map *
                                   glm::dvec3(x * shadow.cell_m, 0., y * shadow.cell_m));
  nodes.normals.assign(nodes.positions.size(), {0, 1, 0});
  compare(state, trace, [&] {
    shadows::trace_direct_light_at_vertices(direct_light_setup().occluders(), nodes,
                                            source(radius, step), 16, dense);
  });
}
BENCHMARK(floor_map)->Name("shadows/shadow_map_vs_16_rays_a_node")->Apply(by_radius);

}  // namespace
}  // namespace penumbra::bench
