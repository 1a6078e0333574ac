// What materials cost: reflections at the light's rate, and a glossy object beside the same in
// chalk.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>

#include "bench/harness.h"
#include "compositor/composite/compositor.h"
#include "core/conventions.h"
#include "lighting/reflections/reflection_map.h"
#include "prt/geometry/material.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::bench {
namespace {

constexpr int kPicture = 2048;

Image<Rgb> sloped_map() {
  Image<Rgb> map(1024, 512);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 1024; ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, 1024, 512);
      map.at(x, y) = {static_cast<float>(1 + .8 * d.x), static_cast<float>(1 + .8 * d.y), .5f};
    }
  return map;
}

lighting::SurfaceRoughness roughness_of(std::int64_t least_percent, std::int64_t most_percent) {
  lighting::SurfaceRoughness out;
  out.add_range(static_cast<float>(least_percent) / 100, static_cast<float>(most_percent) / 100);
  return out;
}

// Of hundredths. Peer: a copy of the map.
void reflections(benchmark::State& state) {
  const Threads threads(2);
  const Image<Rgb> map = sloped_map();
  lighting::ReflectionFilter filter(roughness_of(state.range(0), state.range(1)));
  lighting::ReflectionMap out;
  Image<Rgb> copy = map;
  compare(
      state, [&] { filter.filter(map, {}, RadianceSh(1), out); },
      [&] {
        std::memcpy(copy.pixels().data(), map.pixels().data(), map.area() * sizeof(Rgb));
        benchmark::DoNotOptimize(copy.pixels().data());
      });
}
BENCHMARK(reflections)
    ->Name("lighting/reflections_vs_map_copy")
    ->ArgNames({"least_roughness_percent", "most"})
    ->Args({0, 0})
    ->Args({25, 25})
    ->Args({0, 100})
    ->Args({30, 50})
    ->Args({60, 100})
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

std::shared_ptr<const prt::TexturePicture> checks(prt::Rgba8 a, prt::Rgba8 b) {
  auto out = std::make_shared<prt::TexturePicture>();
  out->codes = Image<prt::Rgba8>(kPicture, kPicture);
  for (int y = 0; y < kPicture; ++y)
    for (int x = 0; x < kPicture; ++x) out->codes.at(x, y) = ((x ^ y) & 64) ? a : b;
  return out;
}

prt::SurfaceMaterials materials(const prt::Mesh& mesh, int mapped) {
  prt::Material m{.metallic = 1, .roughness = .4f};
  const auto map = [&](int bit, prt::Texture& texture, prt::Rgba8 one, prt::Rgba8 other) {
    if (mapped & bit) texture.picture = checks(one, other);
  };
  map(1, m.base_colour_map, {200, 160, 60, 255}, {180, 150, 90, 255});
  map(2, m.metallic_roughness_map, {255, 120, 255, 255}, {200, 200, 0, 255});
  map(4, m.normal_map, {128, 128, 255, 255}, {150, 120, 250, 255});
  map(8, m.emission_map, {0, 0, 0, 255}, {20, 20, 20, 255});
  if (mapped & 8) m.emission = {1, 1, 1};
  if (mapped & 2) m.occlusion_map = m.metallic_roughness_map;  // one picture for both, as is usual
  if (mapped & 16) m.occlusion_map.picture = checks({255, 0, 0, 255}, {200, 0, 0, 255});
  prt::SurfaceMaterials out;
  out.materials = {m};
  out.material.assign(mesh.positions.size(), 0);
  for (const glm::vec3& p : mesh.positions) out.coordinates[0].emplace_back(4 * p.x, 4 * p.y);
  for (const glm::vec3& n : mesh.normals) {
    const glm::vec3 along =
        glm::cross(std::abs(n.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0), n);
    out.tangents.emplace_back(glm::normalize(along), 1.f);
  }
  return out;
}

// The camera moves. Peer: the same knot in chalk, drawn with as many samples a pixel as its edges
// ask for. maps: bits of pictures of 2048^2: colour, metal and roughness
// with occlusion, normals, emission, occlusion apart.
void glossy_vs_chalk(benchmark::State& state) {
  const Threads threads(2);
  constexpr int kWidth = 1280, kHeight = 720;
  prt::Mesh mesh = prt::make_knot(.5f, static_cast<int>(state.range(1)), 40, {.6f, .6f, .6f});
  prt::BakeOptions o;
  o.rays = o.ground_rays = 64;
  o.bounces = 1;
  prt::BakedObject baked = *prt::bake(std::move(mesh), o);
  RadianceSh light(5);
  light[0] = {3, 3, 3};
  std::vector<float> relit(3 * baked.transfer.stride);
  prt::relight(baked.transfer, light, relit);
  auto map = std::make_shared<lighting::ReflectionMap>();
  const bool mapped = (state.range(0) & 2) != 0;
  lighting::ReflectionFilter(mapped ? roughness_of(10, 80) : roughness_of(40, 40))
      .filter(sloped_map(), {}, RadianceSh(1), *map);
  std::unique_ptr<compositor::Compositor> compositors[2];
  for (int i = 0; i < 2; ++i) {
    auto made = compositor::Compositor::create(kWidth, kHeight,
                                               compositor::Compositor::Surface::kOffscreen);
    if (!made) return state.SkipWithError(made.error().detail.c_str());
    compositors[i] = std::move(*made);
    if (i == 0)
      baked.surface = std::make_shared<const prt::SurfaceMaterials>(
          materials(baked.mesh, static_cast<int>(state.range(0))));
    else
      baked.surface.reset();
    compositors[i]->set_surroundings({map, {{{0, 1, 0}, .01, {1, 1, 1}}}, light});
    compositors[i]->set_light(compositors[i]->add_object(baked), relit, {});
  }
  const glm::dvec3 eye(.25, .62, 1.8),
      back = glm::normalize(eye - glm::dvec3(0, .2, 0)),
      right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back));
  compositor::View view{{kWidth,
                         kHeight,
                         {kWidth * .82, kWidth * .82},
                         {640, 360},
                         {glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back)), eye}}};
  FramePixels frame = Image<Rgb>(kWidth, kHeight, {.5f, .4f, .3f}), work = frame;
  double touched = 0;
  const auto run = [&](int i) {
    view.camera.world_from_camera.translation.x += 1e-4;
    touched = compositors[i]->composite(view, frame, work)->fraction;
  };
  compare(
      state, [&] { run(0); }, [&] { run(1); });
  state.counters["touched"] = touched;
}
BENCHMARK(glossy_vs_chalk)
    ->Name("compositor/glossy_vs_chalk")
    ->ArgNames({"maps", "segments"})
    ->Args({0, 240})
    ->Args({1, 240})
    ->Args({3, 240})
    ->Args({4, 240})
    ->Args({15, 240})
    ->Args({31, 240})
    ->Args({31, 900})
    ->Iterations(21)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
