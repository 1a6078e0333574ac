#include "service/http_api.h"
#include "capture/capture.h"
#include "lighting/lighting.h"

#include <gtest/gtest.h>
#include <httplib.h>
#include <unistd.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

namespace penumbra::service {

namespace {

TEST(HttpApi, TakesAnyFreePortAndRefusesOneInUse) {
  const PublishedState state;
  const StageTimes times;
  const auto first = HttpApi::start("127.0.0.1", 0, state, times, 1);
  ASSERT_TRUE(first) << first.error().detail;
  EXPECT_GT((*first)->port(), 0);
  const auto second = HttpApi::start("127.0.0.1", 0, state, times, 1);
  ASSERT_TRUE(second);
  EXPECT_NE((*second)->port(), (*first)->port());
  ::usleep(200'000);  // both threads listen; see the next test
}

TEST(HttpApi, ASecondOneDoesNotShareAPort) {
  const PublishedState state;
  const StageTimes times;
  const auto first = HttpApi::start("127.0.0.1", 0, state, times, 1);
  ASSERT_TRUE(first);
  const auto second = HttpApi::start("127.0.0.1", (*first)->port(), state, times, 1);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kUnavailable);
  ::usleep(200'000);  // the first one listens
}

// Before any light.
struct Served {
  PublishedState state;
  StageTimes times;
  std::unique_ptr<HttpApi> api = *HttpApi::start("127.0.0.1", 0, state, times, 1);
  httplib::Client client{"127.0.0.1", api->port()};
};

// Bytes that are no UTF-8 come back in an error, and the service goes on.
TEST(HttpApi, AnyPathIsAnswered) {
  Served s;
  for (const char* path : {"/%ff", "/%c3%28", "/%00", "/..%2f..%2fetc", "/%"}) {
    const auto response = s.client.Get(path);
    ASSERT_TRUE(response) << path;
    EXPECT_EQ(response->status, 404) << path;
    EXPECT_TRUE(nlohmann::json::accept(response->body)) << path << ": " << response->body;
  }
}

TEST(HttpApi, AHostThatIsNoLoopbackNameIsRefused) {
  Served s;
  const auto status = [&](const char* host) {
    const auto response = s.client.Get("/v1/light", {{"Host", host}});
    return response ? response->status : -1;
  };
  for (const char* host :
       {"localhost", "LocalHost:8080", "127.0.0.1:8080", "127.1.2.3", "[::1]", "[::1]:8080"})
    EXPECT_EQ(status(host), 503) << host << ": no light yet";
  for (const char* host : {"evil.example", "evil.example:8080", "127.evil.example", "10.0.0.1",
                           "127.1.2.3.4", "[", "localhost.evil.example", ":8080"})
    EXPECT_EQ(status(host), 403) << host;
}

void start_and_stop_often() {
  ::alarm(60);  // ends a process that hangs; no measure of speed
  const PublishedState state;
  const StageTimes times;
  for (int i = 0; i < 300; ++i)
    if (!HttpApi::start("127.0.0.1", 0, state, times, 1)) std::exit(1);
  std::exit(0);
}

TEST(HttpApiDeathTest, StopsEvenBeforeItsThreadListens) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(start_and_stop_often(), testing::ExitedWithCode(0), "");
}

TEST(HttpApi, HealthTellsWhatBecameOfEachCamerasFrames) {
  PublishedState state;
  const StageTimes times;
  capture::CameraCounts sky, view;
  sky.frames = 70, sky.lost = 3, sky.rejected = 2, sky.reconnected = 1, sky.delay_frames = 2;
  sky.overrun = 4;
  view.ignores_controls = true;
  std::vector<capture::CameraInfo> cameras(2);
  cameras[0].name = "sky", cameras[1].name = "view";
  state.publish_cameras(cameras, {sky, view});
  state.publish({}, {1}, nullptr, {5, 6});
  const auto api = HttpApi::start("127.0.0.1", 0, state, times, 1);
  ASSERT_TRUE(api);
  httplib::Client client("127.0.0.1", (*api)->port());
  const auto response = client.Get("/healthz");
  ASSERT_TRUE(response);
  const auto body = nlohmann::json::parse(response->body);
  EXPECT_EQ(body["cameras"]["sky"]["frames"], 70);
  EXPECT_EQ(body["cameras"]["sky"]["lost"], 3);
  EXPECT_EQ(body["cameras"]["sky"]["rejected"], 2);
  EXPECT_EQ(body["cameras"]["sky"]["overrun"], 4);
  EXPECT_EQ(body["dropped"]["view"], 5);
  EXPECT_EQ(body["dropped"]["environment"], 6);
  EXPECT_EQ(body["cameras"]["sky"]["reconnected"], 1);
  EXPECT_EQ(body["cameras"]["sky"]["delay_frames"], 2);
  EXPECT_EQ(body["cameras"]["view"]["follows_exposure"], false);
  EXPECT_TRUE(body["cameras"]["view"]["delay_frames"].is_null());
}

TEST(PublishedState, HandsOutTheNewest) {
  PublishedState state;
  EXPECT_FALSE(state.snapshot().light.valid);
  EXPECT_FALSE(state.snapshot().frame);
  lighting::LightEstimate light;
  light.valid = true;
  for (std::int64_t i = 1; i <= 3; ++i) {
    const auto frame = std::make_shared<const FramePixels>(Image<Rgb>(4, 2));
    state.publish(light, {i}, frame);
    const auto s = state.snapshot();
    EXPECT_EQ(s.now.value, i);
    EXPECT_EQ(s.frame, frame);
    EXPECT_EQ(s.frames, std::uint64_t(i));
    EXPECT_TRUE(s.light.valid);
    EXPECT_GE(s.idle_s, 0);
  }
}

}  // namespace
}  // namespace penumbra::service
