#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "bench/harness.h"
#include "runtime/foreground/foreground_stage.h"
#include "tests/support/hand_world.h"

namespace penumbra::bench {
namespace {

calib::CameraModel pinhole(int width, double focal) {
  const int height = width * 3 / 4;
  return {calib::ProjectionKind::kPinhole, width, height, {focal * width, focal * width},
          {width / 2., height / 2.},       {}};
}

capture::Frame still(int camera, FramePixels pixels, const Pose& pose) {
  capture::Frame out;
  out.camera = camera;
  out.exposure = {Seconds(1), Gain(1)};
  out.world_from_camera = pose;
  out.pixels = std::make_shared<const FramePixels>(std::move(pixels));
  return out;
}

// A hand before a view of 640x480, on one thread; three times as thick it is half of the picture.
// Peer: copying the view's frame once.
void foreground(benchmark::State& state) {
  test::HandWorld world = test::HandWorld::usual();
  for (test::Rod& rod : world.rods) rod.radius *= static_cast<double>(state.range(1));
  const calib::CameraModel view = pinhole(640, .875),
                           depth = pinhole(static_cast<int>(state.range(0)), .84);
  const Pose pose = test::HandWorld::view();
  Pose beside = pose;
  beside.translation += pose.rotation * glm::dvec3(.05, .01, 0);
  std::vector<capture::CameraInfo> cameras(2);
  cameras[0].role = capture::Role::kView, cameras[0].projection = view;
  cameras[1].role = capture::Role::kDepth, cameras[1].projection = depth;
  const Image<Rgb> signal = film(world, view, pose, 1).signal;
  Image<Rgb8> codes(view.width, view.height, Rgb8{});
  for (std::size_t i = 0; i < signal.area(); ++i)
    for (int c = 0; c < 3; ++c)
      (&codes.pixels()[i].r)[c] =
          static_cast<std::uint8_t>(255 * std::min(signal.pixels()[i][c], 1.f));
  std::vector<float> decode(256);
  for (std::size_t z = 0; z < 256; ++z) decode[z] = static_cast<float>(z) / 255;
  const ResponseTable curve({decode, decode, decode}, 0);
  const capture::Frame frame = still(0, codes, pose);
  const prt::Plane table;
  const Vignetting none;
  const std::vector<shadows::BoundingSphere> near_hand{{{0, 0, 0}, 1}};
  auto stage = runtime::ForegroundStage::create(cameras, {&table, 1});
  if (!stage) return state.SkipWithError(stage.error().detail.c_str());
  const capture::Frame seen = still(1, film_depth(world, depth, beside, {}, 1), beside);
  double part = 0;
  std::shared_ptr<const compositor::Foreground> newest;
  Image<Rgb8> copy(view.width, view.height, Rgb8{});
  compare(
      state,
      [&] {
        if (!stage->add(seen)) return;
        const auto found = stage->in_front_of(frame, {view, nullptr, &curve, none}, near_hand);
        part = double(found->area.width()) * found->area.height() / double(codes.area());
        newest = found;
      },
      [&] {
        std::memcpy(copy.pixels().data(), codes.pixels().data(), copy.area() * 3);
        benchmark::DoNotOptimize(copy.pixels().data());
      });
  state.counters["area"] = part;
  if (!newest) return;
  const auto covered =
      std::ranges::count_if(newest->cover, [](const glm::vec4& c) { return c.a > 0; });
  state.counters["covered"] = double(covered) / double(codes.area());
}
BENCHMARK(foreground)
    ->Name("runtime/foreground_vs_frame_copy")
    ->ArgNames({"depth_width", "thickness"})
    ->Args({320, 1})
    ->Args({640, 1})
    ->Args({640, 3})
    ->Iterations(21)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
