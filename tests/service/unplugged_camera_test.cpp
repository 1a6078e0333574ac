// The whole service on cameras that live in memory: what clients hear while the environment camera
// is away.
#include <gtest/gtest.h>
#include <httplib.h>

#include <atomic>
#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "calib/calib.h"
#include "capture/capture.h"
#include "prt/prt.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/pipeline/runner.h"
#include "runtime/shading/composite_stage.h"
#include "service/http/http_api.h"
#include "tests/support/fake_camera.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {

using namespace runtime;
namespace {

using Clock = std::chrono::steady_clock;

const Clock::time_point start = Clock::now();
std::atomic<bool> plugged_in = true;
std::atomic<int> opened = 0;

double seconds() {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

Result<std::unique_ptr<capture::CameraDevice>> open_fake(const capture::CameraSettings& settings) {
  const bool sky = settings.device == "sky";
  if (sky && !plugged_in) return fail(ErrorCode::kNotFound, settings.device, "no such camera");
  test::FakeCameraBehaviour b;
  b.fps = 60, b.paced = true;
  b.begins_s = seconds();
  if (sky && opened++ == 0) b.gone_after = 90;
  return std::make_unique<test::FakeCamera>(Image<Rgb>(64, 32, {40, 40, 40}), b);
}

std::vector<capture::RigCamera> cameras() {
  std::vector<capture::RigCamera> out(2);
  out[0].info.name = out[0].settings.device = "sky";
  out[0].info.projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 64, 32);
  out[1].info.name = out[1].settings.device = "view";
  out[1].info.role = capture::Role::kView;
  out[1].info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 64, 32);
  out[1].info.world_from_camera = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  for (capture::RigCamera& c : out) {
    c.info.response = calib::Response::srgb();
    c.schedule = {{Seconds(.004), Gain(1)}};
    c.settings.fps = 60;
  }
  return out;
}

PreparedScene one_sphere() {
  prt::Mesh mesh = prt::make_sphere({0, .2f, 0}, .2f, 2, {.5f, .5f, .5f});
  prt::BakeOptions bake;
  bake.rays = bake.ground_rays = 64;
  bake.bounces = 1;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
  PreparedScene scene;
  scene.objects.push_back({"sphere", *prt::bake(std::move(mesh), bake), {}, 0});
  return scene;
}

struct Heard {
  std::vector<std::string> statuses;  // each once in a row
  std::vector<int> codes;
  int reconnected = 0;
  double back_s = 0;  // from plugged in to fresh light
};

// Asks until it has heard `ok`, `stale` and `ok` again, or half a minute is over.
Heard listen(int port, const std::atomic<bool>& over) {
  Heard heard;
  httplib::Client client("127.0.0.1", port);
  const auto give_up = Clock::now() + std::chrono::seconds(30);
  auto plugged_at = give_up;
  while (Clock::now() < give_up && !over) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const auto answer = client.Get("/healthz");
    if (!answer) continue;
    const auto body = nlohmann::json::parse(answer->body);
    const std::string status = body["status"];
    if (heard.statuses.empty() || heard.statuses.back() != status) {
      heard.statuses.push_back(status);
      heard.codes.push_back(answer->status);
    }
    if (status == "stale" && !plugged_in) {
      plugged_in = true;
      plugged_at = Clock::now();
    }
    if (body.contains("cameras")) heard.reconnected = body["cameras"]["sky"]["reconnected"];
    const auto& s = heard.statuses;
    if (s.size() >= 3 && s.back() == "ok" && s[s.size() - 2] == "stale") {
      heard.back_s = Seconds(Clock::now() - plugged_at).count();
      break;
    }
  }
  return heard;
}

TEST(UnpluggedCamera, ItsLightIsToldStaleAndFreshAgainWhenItIsBack) {
  StageTimes times;
  PublishedState state;
  const PreparedScene scene = one_sphere();
  auto rig = capture::Rig::open(cameras(), open_fake);
  ASSERT_TRUE(rig) << rig.error().detail;
  plugged_in = false;  // what opens it again waits until somebody has heard
  auto light = *LightEstimationStage::create((*rig)->cameras(), {.bands = 3}, times);
  auto compose = CompositeStage::create((*rig)->cameras(), scene,
                                        compositor::Compositor::Surface::kOffscreen, times);
  if (!compose && compose.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << compose.error().detail;
  constexpr double kStaleAfter_s = .4;
  const test::TempFolder folder;
  SceneControl objects;
  CameraControl control;
  LiveRecording recording(folder.path());
  HttpOptions options;
  options.port = 0;
  options.stale_after_s = kStaleAfter_s;
  const auto api = HttpApi::start(options, {state, times, objects, recording, control});
  ASSERT_TRUE(api);
  std::atomic<bool> stop = false, over = false;
  Heard heard;
  std::jthread client([&] {
    heard = listen((*api)->port(), over);
    stop = true;
  });
  int while_stale = 0;
  const auto counts = run_live(
      **rig, light, **compose,
      [&](const Output& out) {
        // Before the picture, whose news the client may read at once.
        state.publish_cameras((*rig)->cameras(), (*rig)->counts());
        state.publish_light(out.light);
        state.publish(out.source.time, out.pixels);
        while_stale += (out.source.time - out.light.time).count() > kStaleAfter_s;
        return true;
      },
      times, stop);
  over = true;
  client.join();
  ASSERT_TRUE(counts) << counts.error().detail;
  ASSERT_GE(heard.statuses.size(), 3u);
  const std::size_t last = heard.statuses.size() - 1;
  EXPECT_EQ(heard.statuses[last - 2], "ok");
  EXPECT_EQ(heard.statuses[last - 1], "stale");
  EXPECT_EQ(heard.statuses[last], "ok");
  EXPECT_EQ(heard.codes[last - 1], 503);
  EXPECT_EQ(heard.codes[last], 200);
  EXPECT_EQ(heard.reconnected, 1);
  std::printf("unplugged: fresh light %.1f s after it is back\n", heard.back_s);
  EXPECT_GT(while_stale, 0) << "the view goes on with the light that it had";
}

}  // namespace
}  // namespace penumbra::service
