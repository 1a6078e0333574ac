// After warm-up a frame takes nothing from the heap but what leaves the program with it.
#include "tests/support/allocations.h"

#include <gtest/gtest.h>

#include "capture/capture.h"
#include "service/pipeline.h"

namespace penumbra::service {
namespace {

struct Counted {
  std::size_t calls, bytes;
};
template <class Work>
Counted count(Work work) {
  const std::size_t calls = test::allocations, bytes = test::allocated_bytes;
  work();
  return {test::allocations - calls, test::allocated_bytes - bytes};
}

TEST(Allocations, OfALightUpdateAndAFrame) {
  auto world = *capture::FloorWorld::make(capture::make_room_environment(256, 128));
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, world->mean_floor_albedo(), {}});
  prt::Mesh mesh = prt::make_sphere({0, .2f, 0}, .2f, 4, {.5f, .5f, .5f});
  prt::BakeOptions bake;
  bake.rays = bake.ground_rays = 64;
  bake.bounces = 1;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
  scene.objects.push_back({"sphere", *prt::bake(std::move(mesh), bake), {}, 0, nullptr});
  capture::StudioOptions options;
  options.environment_width = 256, options.environment_height = 128;
  options.view_width = 320, options.view_height = 180, options.view_focal_px = 240;
  options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  options.sensor.response = calib::Response::srgb();
  options.view_frames = 60;
  capture::Studio studio(world, options);
  StageTimes times;
  auto light = *LightStage::create(studio.cameras(), {}, times);
  auto compose = ComposeStage::create(studio.cameras(), scene,
                                      compositor::Compositor::Surface::kOffscreen, times);
  if (!compose && compose.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << compose.error().detail;
  lighting::LightEstimate estimate;
  std::size_t seen = 0;
  while (auto frame = *studio.next()) {
    ++seen;
    Counted c{};
    const bool is_light = frame->camera == light.camera();
    if (is_light) {
      c = count([&] { estimate = *light.process(*frame); });
    } else {
      c = count([&] { (void)*(*compose)->process(*frame, estimate); });
    }
    if (seen > 80)
      std::printf("%s %zu allocations, %zu bytes\n", is_light ? "light" : "frame", c.calls, c.bytes);
    if (seen % 10 == 9) {  // a disc that moves
      lighting::LightEstimate moved = estimate;
      for (auto& d : moved.discs)
        d.direction = glm::normalize(d.direction + .001 * double(seen) * glm::dvec3(1, 0, 0));
      const Counted m = count([&] { (*compose)->update_light(moved, 0); });
      std::printf("moved %zu discs: %zu allocations, %zu bytes\n", moved.discs.size(), m.calls,
                  m.bytes);
    }
  }
}

}  // namespace
}  // namespace penumbra::service
