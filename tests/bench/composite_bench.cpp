#include <cmath>
#include <cstring>

#include "bench/harness.h"
#include "compositor/composite/compositor.h"
#include "compositor/view_lens.h"
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

compositor::View view_of_knot(int width, int height, const ResponseTable& curve) {
  const glm::dvec3 eye(.25, .62, 1.8);
  const glm::dvec3 back = glm::normalize(eye - glm::dvec3(0, .2, 0)),
                   right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back));
  return {{width,
           height,
           {width * .82, width * .82},
           {width / 2., height / 2.},
           {glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back)), eye}},
          &curve,
          .2f};
}

ResponseTable power_curve() {
  std::vector<float> decode(256);
  for (std::size_t z = 0; z < 256; ++z)
    decode[z] = static_cast<float>(std::pow(static_cast<double>(z) / 255, 2.2));
  return {{decode, decode, decode}, 0};
}

const Setup& knot_setup() {
  static const Setup setup;
  return setup;
}

// Peer: copying the frame once, which any compositor must do.
void composite(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const int width = static_cast<int>(state.range(1)), height = width * 9 / 16;
  const Setup& setup = knot_setup();
  auto compositor =
      compositor::Compositor::create(width, height, compositor::Compositor::Surface::kOffscreen);
  if (!compositor) return state.SkipWithError(compositor.error().detail.c_str());
  const int handle = (*compositor)->add_object(setup.object);
  (*compositor)->set_light(handle, setup.relit, setup.shadow);
  const ResponseTable curve = power_curve();
  compositor::View view = view_of_knot(width, height, curve);
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

// The camera moves. Peer: the same through a pinhole of the same focal length. lens: 0 a webcam's
// barrel distortion, 1 a fisheye of 150 degrees across the width.
void composite_through_lens(benchmark::State& state) {
  const Threads threads(2);
  constexpr int kWidth = 1280, kHeight = 720;
  const Setup& setup = knot_setup();
  const ResponseTable curve = power_curve();
  const bool fisheye = state.range(0) == 1;
  calib::CameraModel model{calib::ProjectionKind::kPinhole, kWidth, kHeight, {}, {640, 360}, {}};
  model.focal_px = glm::dvec2(kWidth * .82);
  model.distortion = {-.12, .03, .001, -.001, 0};
  if (fisheye) {
    model.kind = calib::ProjectionKind::kKannalaBrandt;
    model.focal_px = glm::dvec2(kWidth / 2.618);
    model.distortion = {-.02, .004, -.001, 0, 0};
  }
  const auto lens = compositor::ViewLens::create(model, "lens");
  if (!lens) return state.SkipWithError(lens.error().detail.c_str());
  std::unique_ptr<compositor::Compositor> compositors[2];
  compositor::View views[2];
  for (int i = 0; i < 2; ++i) {
    auto made = compositor::Compositor::create(kWidth, kHeight,
                                               compositor::Compositor::Surface::kOffscreen);
    if (!made) return state.SkipWithError(made.error().detail.c_str());
    compositors[i] = std::move(*made);
    views[i] = view_of_knot(kWidth, kHeight, curve);
    views[i].camera.focal_px = model.focal_px;
    if (i == 0) views[i].lens = *lens, compositors[i]->use_lens(**lens);
    const int handle = compositors[i]->add_object(setup.object);
    compositors[i]->set_light(handle, setup.relit, setup.shadow);
  }
  const FramePixels frame = Image<Rgb8>(kWidth, kHeight, {120, 110, 100});
  FramePixels work = frame;
  double touched[2] = {};
  const auto run = [&](int i) {
    views[i].camera.world_from_camera.translation.x += 1e-4;
    touched[i] = compositors[i]->composite(views[i], frame, work)->fraction;
  };
  compare(
      state, [&] { run(0); }, [&] { run(1); });
  state.counters["touched"] = touched[0];
  state.counters["touched_pinhole"] = touched[1];
}
BENCHMARK(composite_through_lens)
    ->Name("compositor/lens_vs_pinhole")
    ->ArgName("fisheye")
    ->Arg(0)
    ->Arg(1)
    ->Iterations(41)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
