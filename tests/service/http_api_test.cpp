#include "service/http_api.h"
#include "capture/capture.h"
#include "lighting/lighting.h"

#include <gtest/gtest.h>
#include <httplib.h>
#include <unistd.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

#include "service/scene_reload.h"
#include "tests/support/gl.h"

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

// A worker each for as long as they may be idle: with few workers the ninth would not be answered.
TEST(HttpApi, ClientsThatKeepTheirConnectionsHoldNobodyUp) {
  Served s;
  std::vector<std::unique_ptr<httplib::Client>> clients;
  for (int i = 0; i < 40; ++i) {
    clients.push_back(std::make_unique<httplib::Client>("127.0.0.1", s.api->port()));
    clients.back()->set_keep_alive(true);
    clients.back()->set_read_timeout(3);
    EXPECT_TRUE(clients.back()->Get("/healthz")) << i;
  }
}

// Changes of objects before there is any, and those that are none.
TEST(HttpApi, ChangesThatAreNoneAreRefusedByName) {
  Served s;
  const auto answer = [&](const char* body, const char* type = "application/json") {
    const auto response = s.client.Patch("/v1/objects/box", body, type);
    EXPECT_TRUE(response) << body;
    return response ? std::pair(response->status, response->body) : std::pair(0, std::string());
  };
  EXPECT_EQ(answer("{}").first, 503) << "no scene yet";
  EXPECT_EQ(s.client.Get("/v1/objects")->status, 503);
  EXPECT_EQ(answer("{}", "text/plain").first, 415) << "what a foreign page may send unasked";
  for (const auto& [body, words] : {std::pair{"", "JSON object"},
                                    {"[1]", "JSON object"},
                                    {"{\"position_m\": 3}", "position_m"},
                                    {"{\"position_m\": [1, 2]}", "three numbers"},
                                    {"{\"position_m\": [1, 2, \"x\"]}", "number"},
                                    {"{\"turn_deg\": true}", "turn_deg"},
                                    {"{\"speed\": 1e308}", "within"},
                                    {"{\"visible\": 1}", "true nor false"},
                                    {"{\"visble\": true}", "did you mean visible"},
                                    {"{\"speed\": 1e999}", "JSON object"},
                                    {"{\"\\u0000\": 1}", "no key"},
                                    {"{\"position_m\": [1, 2, 3]", "JSON object"}}) {
    const auto [status, said] = answer(body);
    EXPECT_EQ(status, 400) << body;
    EXPECT_NE(said.find(words), std::string::npos) << body << ": " << said;
  }
  const std::string deep(30'000, '[');
  EXPECT_EQ(answer(deep.c_str()).first, 400);
  const std::string large(1 << 17, ' ');
  const auto refused = s.client.Patch("/v1/objects/box", large, "application/json");
  EXPECT_TRUE(!refused || refused->status == 413);
  EXPECT_EQ(s.client.Patch("/v1/light", "{}", "application/json")->status, 405);
  EXPECT_EQ(s.client.Get("/healthz", {{"Range", "bytes=0-1,2-3,4-5"}})->status, 416);
}

TEST(HttpApi, ANewObjectPlaceIsInTheNextFrame) {
  auto world = capture::FloorWorld::make(capture::make_room_environment(128, 64));
  ASSERT_TRUE(world);
  capture::StudioOptions studio_options;
  studio_options.view_width = 96;
  studio_options.view_height = 64;
  studio_options.view_focal_px = 80;
  studio_options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  capture::Studio studio(*world, studio_options);
  std::vector<capture::CameraInfo> cameras = studio.cameras();
  std::erase_if(cameras, [](const auto& c) { return c.role != capture::Role::kView; });
  capture::Frame frame;
  while (frame.pixels == nullptr) {
    auto next = *studio.next();
    if (studio.cameras()[static_cast<std::size_t>(next->camera)].role == capture::Role::kView)
      frame = std::move(*next);
  }
  frame.camera = 0;
  runtime::Scene scene;
  scene.objects.emplace_back();
  scene.objects[0].name = "box";
  scene.objects[0].asset = "builtin:box";
  scene.objects[0].place_on_floor = true;
  scene.objects[0].fit_size_m = .3;
  scene.real.emplace_back();
  scene.real[0].plane = runtime::RealPlane{};
  PipelineOptions options;
  options.bake = runtime::BakeSettings::coarse();
  options.bake.rays = options.bake.ground_rays = 64;
  options.bake.use_cache = false;
  auto pipeline = Pipeline::create(cameras, scene, options);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline);
  pipeline->set_light(*lighting::estimate_map(capture::make_room_environment(128, 64), {}));
  const PublishedState state;
  SceneControl objects;
  const auto api = HttpApi::start("127.0.0.1", 0, state, pipeline->timings(), 1, &objects);
  ASSERT_TRUE(api);
  httplib::Client client("127.0.0.1", (*api)->port());
  objects.attach(&*pipeline);
  const auto drawn = [&] { return pipeline->composite(frame)->pixels; };
  const auto change = [&](const char* object, const char* body) {
    return client.Patch(std::string("/v1/objects/") + object, body, "application/json")->status;
  };
  const FramePixels at_first = drawn();
  ASSERT_FALSE(at_first == *frame.pixels);
  EXPECT_EQ(change("box", R"({"position_m": [0.2, 0, 0.1], "turn_deg": 30})"), 200);
  const FramePixels elsewhere = drawn();
  EXPECT_FALSE(elsewhere == at_first);
  const auto listed = nlohmann::json::parse(client.Get("/v1/objects")->body)["objects"];
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0]["name"], "box");
  EXPECT_EQ(listed[0]["position_m"], nlohmann::json({.2, 0, .1}));
  EXPECT_NEAR(listed[0]["turn_deg"].get<double>(), 30, 1e-9);

  EXPECT_EQ(change("box", R"({"position_m": [0.2, 0.5, 0.1]})"), 400) << "off its floor";
  EXPECT_EQ(change("box", R"({"turn_deg": 90, "speed": 2})"), 400) << "it plays nothing";
  EXPECT_EQ(change("crate", R"({"visible": false})"), 404);
  EXPECT_TRUE(drawn() == elsewhere) << "what is refused changes nothing";

  EXPECT_EQ(change("box", R"({"visible": false})"), 200);
  EXPECT_TRUE(drawn() == *frame.pixels);
  EXPECT_EQ(change("box", R"({"visible": true, "position_m": [0, 0, 0], "turn_deg": 0})"), 200);
  EXPECT_TRUE(drawn() == at_first);

  // The same from a scene file.
  runtime::Scene edited = scene;
  edited.objects[0].position = {.2, 0, .1};
  edited.objects[0].rotation = glm::angleAxis(glm::radians(30.), glm::dvec3(0, 1, 0));
  apply_scene(scene, scene, edited, objects);
  EXPECT_TRUE(drawn() == elsewhere);
  EXPECT_EQ(change("box", R"({"position_m": [0, 0, 0], "turn_deg": 0})"), 200);
  apply_scene(scene, edited, edited, objects);
  EXPECT_TRUE(drawn() == at_first) << "what the file does not change stays where a client put it";
  apply_scene(scene, edited, scene, objects);
  EXPECT_TRUE(drawn() == at_first);
  runtime::Scene none = scene;
  none.objects.clear();
  apply_scene(scene, scene, none, objects);
  EXPECT_TRUE(drawn() == *frame.pixels);
  apply_scene(scene, none, scene, objects);
  EXPECT_TRUE(drawn() == at_first);
  objects.attach(nullptr);
  EXPECT_EQ(change("box", R"({"visible": true})"), 503);
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
