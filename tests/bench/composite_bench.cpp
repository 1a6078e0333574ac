#include <cmath>
#include <cstring>

#include "bench/harness.h"
#include "compositor/composite/compositor.h"
#include "core/conventions.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::bench {
namespace {

struct Setup {
  prt::BakedObject object;
  std::vector<float> relit;
  shadows::PlanarShadow shadow;
  Setup() {
    prt::Mesh mesh = prt::make_knot(.5f, 240, 40, {.6f, .6f, .6f});
    prt::BakeOptions o;
    o.rays = o.ground_rays = 256;
    o.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0), {.4f, .4f, .4f}};
    object = *prt::bake(std::move(mesh), o);
    RadianceSh light(5);
    light[0] = {3, 3, 3};
    light[1] = {2, 2, 2};
    light[3] = {1, .8f, .5f};
    relit.resize(3 * object.transfer.stride);
    prt::relight(object.transfer, light, relit);
    (void)shadows::compose_planar_shadow(object, light, shadow);
  }
};

// Peer: copying the frame once, which any compositor must do.
void composite(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const int width = static_cast<int>(state.range(1)), height = width * 9 / 16;
  static const Setup setup;
  auto compositor =
      compositor::Compositor::create(width, height, compositor::Compositor::Surface::kOffscreen);
  if (!compositor) return state.SkipWithError(compositor.error().detail.c_str());
  const int handle = (*compositor)->add_object(setup.object);
  (*compositor)->set_light(handle, setup.relit, setup.shadow);
  std::vector<float> decode(256);
  for (std::size_t z = 0; z < 256; ++z)
    decode[z] = static_cast<float>(std::pow(static_cast<double>(z) / 255, 2.2));
  const ResponseTable curve({decode, decode, decode}, 0);
  const glm::dvec3 eye(.25, .62, 1.8);
  const glm::dvec3 back = glm::normalize(eye - glm::dvec3(0, .2, 0)),
                   right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back));
  compositor::View view{{width,
                         height,
                         {width * .82, width * .82},
                         {width / 2., height / 2.},
                         {glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back)), eye}},
                        &curve,
                        .2f};
  const FramePixels frame = Image<Rgb8>(width, height, {120, 110, 100});
  FramePixels work = frame;
  Image<Rgb8> copy(width, height);
  double touched = 0;
  const bool moving = state.range(2) != 0;
  compare(
      state,
      [&] {
        if (moving) view.camera.world_from_camera.translation.x += 1e-4;  // or the layers are kept
        touched = (*compositor)->composite(view, frame, work)->fraction;
      },
      [&] {
        std::memcpy(copy.pixels().data(), std::get<Image<Rgb8>>(frame).pixels().data(),
                    copy.area() * 3);
        benchmark::DoNotOptimize(copy.pixels().data());
      });
  state.counters["touched"] = touched;
}
BENCHMARK(composite)
    ->Name("compositor/composite_vs_frame_copy")
    ->ArgNames({"threads", "width", "moving"})
    ->Args({1, 1280, 1})
    ->Args({2, 1280, 1})
    ->Args({2, 1920, 1})
    ->Args({1, 1920, 0})
    ->Args({2, 1280, 0})
    ->Iterations(21)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
