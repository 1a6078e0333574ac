#include "service/http/http_api.h"
#include "capture/capture.h"
#include "lighting/lighting.h"

#include <gtest/gtest.h>
#include <httplib.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>
#include <vector>

#include "codec/gain_map_jpeg.h"
#include "core/conventions.h"
#include "core/half.h"
#include "service/http/internal/context.h"
#include "service/scene/scene_reload.h"
#include "tests/support/gl.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {

namespace {

HttpOptions on_any_port() {
  HttpOptions out;
  out.port = 0;
  return out;
}

// Before any light.
struct Served {
  test::TempFolder folder;
  PublishedState state;
  StageTimes times;
  SceneControl objects;
  CameraControl cameras;
  LiveRecording recording{folder.path()};
  std::unique_ptr<HttpApi> api;
  std::optional<httplib::Client> client;

  explicit Served(const HttpOptions& options = on_any_port()) {
    auto started = start(options);
    if (!started) return;
    api = std::move(*started);
    if (api->port() > 0) client.emplace("127.0.0.1", api->port());
  }
  Result<std::unique_ptr<HttpApi>> start(const HttpOptions& options) {
    return HttpApi::start(options, {state, times, objects, recording, cameras});
  }
};

TEST(HttpApi, TakesAnyFreePortAndRefusesOneInUse) {
  Served first, second;
  ASSERT_TRUE(first.api && second.api);
  EXPECT_GT(first.api->port(), 0);
  EXPECT_NE(second.api->port(), first.api->port());
  ::usleep(200'000);  // both threads listen; see the next test
}

TEST(HttpApi, ASecondOneDoesNotShareAPort) {
  Served first;
  HttpOptions same = on_any_port();
  same.port = first.api->port();
  const auto second = first.start(same);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kUnavailable);
  ::usleep(200'000);  // the first one listens
}

// A socket that only its owner may open answers without looking at names.
TEST(HttpApi, AUnixSocketIsItsOwnersAlone) {
  const test::TempFolder folder;
  HttpOptions options;
  options.socket = folder.path() / "run" / "http.sock";
  {
    Served s(options);
    ASSERT_TRUE(s.api);
    EXPECT_EQ(s.api->port(), 0);
    struct stat about {};
    ASSERT_EQ(::stat(options.socket.c_str(), &about), 0);
    EXPECT_EQ(about.st_mode & 0777, 0600u);
    httplib::Client client(options.socket.string());
    client.set_address_family(AF_UNIX);
    const auto response = client.Get("/healthz", {{"Host", "any.example"}});
    ASSERT_TRUE(response);
    EXPECT_EQ(response->status, 503) << "no light yet";
    const auto second = s.start(options);
    ASSERT_FALSE(second);
    EXPECT_EQ(second.error().code, ErrorCode::kUnavailable) << "somebody listens there";
  }
  EXPECT_FALSE(std::filesystem::exists(options.socket));
  // What a service that was killed leaves is taken over.
  const int left = ::socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  options.socket.string().copy(name.sun_path, sizeof name.sun_path - 1);
  ASSERT_EQ(::bind(left, reinterpret_cast<const sockaddr*>(&name), sizeof name), 0);
  ::close(left);
  EXPECT_TRUE(Served(options).api);
  options.socket = folder.path() / std::string(200, 'x');
  EXPECT_FALSE(Served(options).api);
}

TEST(HttpApi, AnAddressThatOthersReachNeedsTheToken) {
  HttpOptions options = on_any_port();
  options.address = "0.0.0.0";
  EXPECT_FALSE(Served(options).api) << "no token";
  options.token = "a-token-of-some-length";
  Served s(options);
  ASSERT_TRUE(s.api);
  const auto status = [&](const httplib::Headers& headers, const char* path = "/v1/light") {
    const auto response = s.client->Get(path, headers);
    return response ? response->status : -1;
  };
  constexpr int kNoLight = 503;
  EXPECT_EQ(status({}), 401);
  EXPECT_EQ(status({{"Authorization", "Bearer a-token-of-some-lengtg"}}), 401);
  EXPECT_EQ(status({{"Authorization", "Bearer a-token-of-some-length"}}), kNoLight);
  EXPECT_EQ(status({}, "/v1/light?token=a-token-of-some"), 401);
  const auto first = s.client->Get("/v1/light?token=a-token-of-some-length");
  ASSERT_TRUE(first);
  EXPECT_EQ(first->status, kNoLight);
  const std::string cookie = first->get_header_value("Set-Cookie");
  EXPECT_NE(cookie.find("HttpOnly; SameSite=Strict"), std::string::npos);
  EXPECT_EQ(status({{"Cookie", "a=b; " + cookie.substr(0, cookie.find(';'))}}), kNoLight);
  const std::string name = cookie.substr(0, cookie.find('='));
  EXPECT_EQ(name, fmt::format("penumbra_token_{}", s.api->port())) << "of several services";
  EXPECT_EQ(status({{"Cookie", name + "=wrong"}}), 401);
  EXPECT_EQ(status({{"Cookie", name + "=wrong; " + cookie.substr(0, cookie.find(';'))}}), kNoLight);
  EXPECT_EQ(status({{"Cookie", "x" + cookie.substr(0, cookie.find(';'))}}), 401);
}

TEST(HttpApi, OnlyPagesOfListedOriginsMayRead) {
  HttpOptions options = on_any_port();
  options.origins = {"https://engine.example"};
  Served s(options);
  const auto allowed = [&](const char* origin, const char* method) {
    httplib::Request request;
    request.method = method;
    request.path = "/v1/light";
    request.headers = {{"Origin", origin}, {"Host", "localhost"}};
    const auto response = s.client->send(request);
    return response ? response->get_header_value("Access-Control-Allow-Origin") : "none";
  };
  for (const char* method : {"GET", "OPTIONS"}) {
    EXPECT_EQ(allowed("https://engine.example", method), "https://engine.example");
    EXPECT_EQ(allowed("https://engine.example.evil.example", method), "");
    EXPECT_EQ(allowed("null", method), "");
  }
  const auto response = s.client->Get("/healthz");
  ASSERT_TRUE(response);
  EXPECT_EQ(response->get_header_value("Cross-Origin-Resource-Policy"), "same-origin");
}

// Bytes that are no UTF-8 come back in an error, and the service goes on.
TEST(HttpApi, AnyPathIsAnswered) {
  Served s;
  for (const char* path : {"/%ff", "/%c3%28", "/%00", "/..%2f..%2fetc", "/%"}) {
    const auto response = s.client->Get(path);
    ASSERT_TRUE(response) << path;
    EXPECT_EQ(response->status, 404) << path;
    EXPECT_TRUE(nlohmann::json::accept(response->body)) << path << ": " << response->body;
  }
}

TEST(HttpApi, AHostThatIsNoLoopbackNameIsRefused) {
  Served s;
  const auto status = [&](const char* host) {
    const auto response = s.client->Get("/v1/light", {{"Host", host}});
    return response ? response->status : -1;
  };
  for (const char* host :
       {"localhost", "LocalHost:8080", "127.0.0.1:8080", "127.1.2.3", "[::1]", "[::1]:8080"})
    EXPECT_EQ(status(host), 503) << host << ": no light yet";
  for (const char* host : {"evil.example", "evil.example:8080", "127.evil.example", "10.0.0.1",
                           "127.1.2.3.4", "[", "localhost.evil.example", ":8080",
                           "[::1]evil.example", "localhost:80.evil.example", "[::1]:80x"})
    EXPECT_EQ(status(host), 403) << host;
}

void start_and_stop_often() {
  ::alarm(60);  // ends a process that hangs; no measure of speed
  Served s;
  for (int i = 0; i < 300; ++i)
    if (!s.start(on_any_port())) std::exit(1);
  std::exit(0);
}

TEST(HttpApiDeathTest, StopsEvenBeforeItsThreadListens) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(start_and_stop_often(), testing::ExitedWithCode(0), "");
}

TEST(HttpApi, HealthTellsWhatBecameOfEachCamerasFrames) {
  Served s;
  PublishedState& state = s.state;
  capture::CameraCounts sky, view;
  sky.frames = 70, sky.lost = 3, sky.rejected = 2, sky.reconnected = 1, sky.delay_frames = 2;
  sky.overrun = 4;
  view.ignores_controls = true;
  std::vector<capture::CameraInfo> cameras(2);
  cameras[0].name = "sky", cameras[1].name = "view";
  state.publish_cameras(cameras, {sky, view});
  state.publish({1}, nullptr, {5, 6});
  const auto response = s.client->Get("/healthz");
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
    const auto response = s.client->Patch("/v1/objects/box", body, type);
    EXPECT_TRUE(response) << body;
    return response ? std::pair(response->status, response->body) : std::pair(0, std::string());
  };
  EXPECT_EQ(answer("{}").first, 503) << "no scene yet";
  EXPECT_EQ(s.client->Get("/v1/objects")->status, 503);
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
  const auto refused = s.client->Patch("/v1/objects/box", large, "application/json");
  EXPECT_TRUE(!refused || refused->status == 413);
  EXPECT_EQ(s.client->Patch("/v1/light", "{}", "application/json")->status, 405);
  for (const char* file : {"../x.mkv", "/tmp/x.mkv", "x.mp4", ".x.mkv", "a b.mkv"})
    EXPECT_EQ(
        s.client->Post("/v1/recording", nlohmann::json{{"file", file}}.dump(), "application/json")
            ->status,
        400)
        << file;
  for (const char* body : {R"({"light": "sun"})", R"({"light": 3})", R"({"lihgt": "track"})"}) {
    const auto refused_light = s.client->Post("/v1/recording", body, "application/json");
    EXPECT_EQ(refused_light->status, 400) << body;
    EXPECT_NE(refused_light->body.find("light"), std::string::npos) << refused_light->body;
  }
  // A product beyond what radiance holds would have ended the service.
  for (const char* body :
       {R"({"exposures_s": [1e-13]})", R"({"exposures_s": [1e-5], "gains": [1e-300]})",
        R"({"exposures_s": [100]})", R"({"exposures_s": [0.01], "gains": [1e9]})"})
    EXPECT_EQ(s.client->Put("/v1/cameras/environment/exposures", body, "application/json")->status,
              400)
        << body;
  EXPECT_EQ(s.client->Post("/v1/recording", "{}", "application/json")->status, 503);
  EXPECT_EQ(s.client->Delete("/v1/recording")->status, 404);
  EXPECT_EQ(s.client->Post("/v1/snapshot", "{}", "application/json")->status, 503);
  const auto whole = s.client->Get("/v1/stages", {{"Range", "bytes=0-1,2-3,4-5"}});
  EXPECT_EQ(whole->status, 200);
  EXPECT_TRUE(nlohmann::json::accept(whole->body)) << "ranges are not looked at";
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
  options.bake.max_edge_fraction = .2f;
  options.bake.bounces = 1;
  options.bake.cache = runtime::BakeCache::kNotUsed;
  auto pipeline = Pipeline::create(cameras, scene, options);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline);
  pipeline->set_light(*lighting::estimate_map(capture::make_room_environment(128, 64), {}));
  Served s;
  SceneControl& objects = s.objects;
  httplib::Client& client = *s.client;
  ::setenv("XDG_CACHE_HOME", s.folder.path().c_str(), 1);  // what comes again is not baked again
  runtime::BakeSettings kept = options.bake;
  kept.cache = runtime::BakeCache::kUsed;
  SceneKeeper keeper(kept, options.progress,
                     [&](const runtime::Scene&, runtime::PreparedScene prepared) {
                       return pipeline->change_scene(std::move(prepared));
                     });
  objects.attach(&*pipeline, &keeper);
  objects.set_scene(scene);
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

  EXPECT_EQ(change("box", R"({"position_m": [0.2, -0.5, 0.1]})"), 400) << "below its floor";
  EXPECT_EQ(change("box", R"({"position_m": [0.2, 20000, 0.1]})"), 400) << "out of the world";
  EXPECT_EQ(change("box", R"({"turn_deg": 90, "speed": 2})"), 400) << "it plays nothing";
  EXPECT_EQ(change("crate", R"({"visible": false})"), 404);
  EXPECT_TRUE(drawn() == elsewhere) << "what is refused changes nothing";

  EXPECT_EQ(change("box", R"({"visible": false})"), 200);
  EXPECT_TRUE(drawn() == *frame.pixels);
  EXPECT_EQ(change("box", R"({"visible": true, "position_m": [0, 0, 0], "turn_deg": 0})"), 200);
  EXPECT_TRUE(drawn() == at_first);
  EXPECT_EQ(change("box", R"({"position_m": [0, 0.1, 0], "lean_deg": 20, "lean_towards_deg": 90})"),
            200);
  EXPECT_FALSE(drawn() == at_first);
  const auto lifted = nlohmann::json::parse(client.Get("/v1/objects")->body)["objects"][0];
  EXPECT_NEAR(lifted["height_m"].get<double>(), .1, 1e-9);
  EXPECT_NEAR(lifted["lean_deg"].get<double>(), 20, 1e-9);
  EXPECT_TRUE(lifted["lifts"].get<bool>());
  EXPECT_EQ(change("box", R"({"position_m": [0, 0, 0], "lean_deg": 0})"), 200);
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

  // Others come and go.
  const auto add = [&](const char* body) {
    return client.Post("/v1/objects", body, "application/json")->status;
  };
  EXPECT_EQ(add(R"({"name": "box", "asset": "builtin:box"})"), 400) << "the name is taken";
  EXPECT_EQ(add(R"({"name": "other", "asset": "/etc/passwd"})"), 400);
  EXPECT_EQ(add(R"({"name": "other", "asset": "https://x.example/a.glb"})"), 400);
  EXPECT_EQ(add(R"({"name": "other", "asset": "builtin:box", "size_m": 0})"), 400);
  EXPECT_EQ(add(R"({"name": "other", "assett": "builtin:box"})"), 400);
  EXPECT_EQ(add(R"({"name": "other", "asset": "builtin:box", "emission_lights": 1})"), 400);
  EXPECT_EQ(add(R"({"name": "other", "asset": "builtin:box", "position_m": [0.3, 0, 0],
                    "size_m": 0.2, "emission_lights": true})"),
            202);
  while (keeper.is_busy()) ::usleep(10'000);
  EXPECT_FALSE(drawn() == at_first);
  EXPECT_EQ(pipeline->objects().size(), 2u);
  EXPECT_EQ(client.Delete("/v1/objects/other")->status, 200);
  EXPECT_TRUE(drawn() == at_first) << "out of the picture at once";
  while (keeper.is_busy()) ::usleep(10'000);
  EXPECT_TRUE(drawn() == at_first);
  EXPECT_EQ(pipeline->objects().size(), 1u) << "and out of the scene";
  EXPECT_EQ(client.Delete("/v1/objects/other")->status, 404);
  // A lamp comes, moves and goes.
  const auto lamp = [&](auto response) {
    while (keeper.is_busy()) ::usleep(10'000);
    return response->status;
  };
  constexpr const char* kJson = "application/json";
  EXPECT_EQ(lamp(client.Post("/v1/lamps",
                             R"({"position_m": [0.3, 0.8, 0.3], "irradiance_at_1m": [300, 200, 100],
                                 "radius_m": 0.05})",
                             kJson)),
            202);
  const FramePixels under_lamp = drawn();
  EXPECT_FALSE(under_lamp == at_first);
  EXPECT_EQ(lamp(client.Patch("/v1/lamps/0", R"({"position_m": [-0.3, 0.8, 0.3]})", kJson)), 202);
  EXPECT_FALSE(drawn() == under_lamp);
  EXPECT_EQ(lamp(client.Patch("/v1/lamps/1", "{}", kJson)), 404);
  EXPECT_EQ(lamp(client.Patch("/v1/lamps/99999999999999999999", "{}", kJson)), 404);
  EXPECT_EQ(lamp(client.Patch("/v1/lamps/0", R"({"radius_m": 0})", kJson)), 400);
  EXPECT_EQ(lamp(client.Patch("/v1/lamps/0", R"({"irradiance_at_1m": [1, 1, -1]})", kJson)), 400);
  const auto told = nlohmann::json::parse(client.Get("/v1/scene")->body)["lamps"];
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0]["position_m"][0], -.3);
  EXPECT_EQ(lamp(client.Delete("/v1/lamps/0")), 202);
  EXPECT_TRUE(drawn() == at_first);
  for (const char* file : {"../scene.toml", "/etc/passwd", "scene.txt", ""})
    EXPECT_EQ(client.Put("/v1/scene", nlohmann::json{{"file", file}}.dump(), kJson)->status, 400);
  EXPECT_EQ(client.Patch("/v1/budget", R"({"max_shadow_error": 0.1})", "application/json")->status,
            200);
  EXPECT_EQ(pipeline->max_shadow_error(), .1);
  EXPECT_EQ(client.Patch("/v1/budget", R"({"max_shadow_error": 0})", "application/json")->status,
            400);
  EXPECT_EQ(client.Patch("/v1/budget", R"({"error": 1})", "application/json")->status, 400);
  objects.attach(nullptr, nullptr);
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
    state.publish_light(light);
    state.publish({i}, frame);
    const auto s = state.snapshot();
    EXPECT_EQ(s.now.value, i);
    EXPECT_EQ(s.frame, frame);
    EXPECT_EQ(s.frames, std::uint64_t(i));
    EXPECT_TRUE(s.light.valid);
    EXPECT_GE(s.idle_s, 0);
  }
}

// A measured light, a frame and a map.
void publish_something(PublishedState& state) {
  Environment room;
  room.radiance = capture::make_room_environment(128, 64);
  room.time = {900'000};
  lighting::LightEstimate light = *lighting::estimate_map(room.radiance, {});
  light.time = room.time;
  light.valid = true;
  state.publish_environment(room);
  Image<Rgb8> grey(32, 16);
  for (Rgb8& p : grey.pixels()) p = {100, 120, 140};
  state.publish_light(light);
  state.publish({1'000'000}, std::make_shared<const FramePixels>(grey));
}

TEST(HttpApi, PicturesAndMapsComeInTheFormatsThatAreAskedFor) {
  Served s;
  EXPECT_EQ(s.client->Get("/v1/environment.exr")->status, 503) << "no light yet";
  publish_something(s.state);
  for (const auto& [path, begin] : {std::pair{"/v1/frame.jpg", "\xff\xd8\xff"},
                                    {"/v1/frame.png", "\x89PNG"},
                                    {"/v1/environment.jpg", "\xff\xd8\xff"},
                                    {"/v1/environment.hdr", "#?RADIANCE"},
                                    {"/v1/environment.ktx", "\xabKTX 11\xbb\r\n\x1a\n"},
                                    {"/v1/environment.exr", "\x76\x2f\x31\x01"}}) {
    const auto response = s.client->Get(path);
    ASSERT_TRUE(response) << path;
    EXPECT_EQ(response->status, 200) << path;
    EXPECT_TRUE(response->body.starts_with(begin)) << path;
    EXPECT_EQ(response->get_header_value("Penumbra-Time-Ns"),
              std::string(path).starts_with("/v1/frame") ? "1000000" : "900000")
        << path;
  }
  EXPECT_EQ(s.client->Get("/v1/light")->get_header_value("Penumbra-Time-Ns"), "900000");
  EXPECT_EQ(s.client->Get("/v1/environment.png")->status, 404);
  const auto map = nlohmann::json::parse(s.client->Get("/v1/environment")->body);
  EXPECT_EQ(map["width"], 128);
  double sum = 0;
  for (const auto& part : map["histogram"]["fraction"]) sum += part.get<double>();
  EXPECT_NEAR(sum, 1, 1e-9);
}

// Whoever asks gets the radiance, not its picture alone; the light lasts, and so do its bytes.
TEST(HttpApi, TheEnvironmentsJpegHoldsItsRadiance) {
  Served s;
  publish_something(s.state);
  const std::string jpeg = s.client->Get("/v1/environment.jpg")->body;
  const auto got = codec::decode_gain_map_jpeg(
      {reinterpret_cast<const unsigned char*>(jpeg.data()), jpeg.size()}, "environment.jpg");
  ASSERT_TRUE(got) << got.error().detail;
  const Image<Rgb> truth = capture::make_room_environment(128, 64);
  const RadianceSh light = lighting::project_latlong(truth, 3)->light,
                   back = lighting::project_latlong(got->pixels, 3)->light;
  for (int n = 0; n < light.size(); ++n)
    EXPECT_NEAR(luminance(back[n]), luminance(light[n]), .01f * luminance(light[0])) << n;
  EXPECT_EQ(s.client->Get("/v1/environment.jpg")->body, jpeg);
}

// Solid angle of a texel of a cube, S and T from -1 to 1.
double texel_sr(double s, double t, double edge) {
  return 4 / (edge * edge) / std::pow(1 + s * s + t * t, 1.5);
}

TEST(HttpApi, TheCubeSendsTheLightOfTheMap) {
  Served s;
  publish_something(s.state);
  const std::string ktx = s.client->Get("/v1/environment.ktx")->body;
  constexpr std::size_t kEdge = 128, kHead = 12 + 14 * 4;
  ASSERT_EQ(ktx.size(), kHead + 6 * kEdge * kEdge * 8);
  std::uint32_t words[14];
  std::memcpy(words, ktx.data() + 12, sizeof words);
  EXPECT_EQ(words[0], 0x04030201u);
  EXPECT_EQ(words[10], 6u) << "faces";
  EXPECT_EQ(words[13], kEdge * kEdge * 8) << "bytes of one";
  double light[3]{};  // of all, and its moments along z and y
  for (std::size_t face = 0; face < 6; ++face)
    for (std::size_t row = 0; row < kEdge; ++row)
      for (std::size_t column = 0; column < kEdge; ++column) {
        std::uint16_t texel[4];
        std::memcpy(texel, ktx.data() + kHead + ((face * kEdge + row) * kEdge + column) * 8, 8);
        const double u = (2. * double(column) + 1) / kEdge - 1,
                     v = (2. * double(row) + 1) / kEdge - 1;
        const glm::dvec3 towards[] = {{1, -v, -u}, {-1, -v, u}, {u, 1, v},
                                      {u, -1, -v}, {u, -v, 1},  {-u, -v, -1}};
        const double power = texel_sr(u, v, kEdge) *
                             luminance(Rgb{float_from_half(texel[0]), float_from_half(texel[1]),
                                           float_from_half(texel[2])});
        const glm::dvec3 d = glm::normalize(towards[face]);
        light[0] += power, light[1] += power * d.y, light[2] += power * d.z;
        EXPECT_EQ(float_from_half(texel[3]), 1);
      }
  const RadianceSh truth =
      lighting::project_latlong(capture::make_room_environment(128, 64), 2)->light;
  const double all = std::sqrt(4 * kPi) * luminance(truth[0]);
  EXPECT_NEAR(light[0] / all, 1, .01);
  const double moment = std::sqrt(4 * kPi / 3);
  EXPECT_NEAR(light[1] / all, moment * luminance(truth[1]) / all, .01);
  EXPECT_NEAR(light[2] / all, moment * luminance(truth[2]) / all, .01);
}

TEST(HttpApi, EnginesGetTheLightInTheirOwnConvention) {
  Served s;
  publish_something(s.state);
  const auto light = nlohmann::json::parse(s.client->Get("/v1/light")->body);
  const auto as = [&](const std::string& name) {
    return nlohmann::json::parse(s.client->Get("/v1/light?as=" + name)->body);
  };
  const auto& ours = light["residual"]["coefficients"];
  const auto three = as("three"), godot = as("godot"), filament = as("filament");
  for (int n = 0; n < 9; ++n) {
    EXPECT_EQ(three["sh"][n], ours[n]) << n;
    const bool flips = n == 2 || n == 5 || n == 7;  // odd in z
    EXPECT_NEAR(godot["sh"][n][1].get<double>(), (flips ? -1 : 1) * ours[n][1].get<double>(), 1e-3);
  }
  EXPECT_NEAR(filament["sh"][0][0].get<double>(), .282095 * ours[0][0].get<double>(), 1e-2);
  ASSERT_EQ(three["lights"].size(), light["lights"].size());
  ASSERT_GT(light["lights"].size(), 0u);
  const auto& sun = light["lights"][0];
  EXPECT_NEAR(three["lights"][0]["irradiance"][0].get<double>(),
              sun["radiance"][0].get<double>() * sun["solid_angle_sr"].get<double>(), 1e-2);
  EXPECT_NEAR(as("unreal")["lights"][0]["direction"][2].get<double>(),
              sun["direction"][1].get<double>(), 1e-6)
      << "z is up";
  const auto refused = s.client->Get("/v1/light?as=unrael");
  EXPECT_EQ(refused->status, 400);
  EXPECT_NE(refused->body.find("unreal"), std::string::npos);
}

TEST(HttpApi, EventsAndFramesStreamUntilTheClientLeaves) {
  Served s;
  publish_something(s.state);
  std::string events;
  s.client->Get("/v1/events?rate_hz=30", [&](const char* data, std::size_t size) {
    events.append(data, size);
    return events.find("\n\n", events.find("\n\n") + 1) == std::string::npos;  // two of them
  });
  ASSERT_TRUE(events.starts_with("event: state\ndata: "));
  const auto state = nlohmann::json::parse(events.substr(19, events.find("\n\n") - 19));
  EXPECT_EQ(state["status"], "ok");
  EXPECT_TRUE(state["light"]["coefficients"].is_array());
  EXPECT_TRUE(state["objects"].is_null()) << "no pipeline";
  httplib::Client viewer("127.0.0.1", s.api->port());
  std::string frames;
  viewer.Get("/v1/frame.mjpeg", [&](const char* data, std::size_t size) {
    frames.append(data, size);
    return frames.find("\xff\xd9") == std::string::npos;  // a whole picture
  });
  EXPECT_TRUE(frames.starts_with("--penumbra-frame\r\nContent-Type: image/jpeg\r\n"));
  for (const char* rate : {"0", "-1", "nan", "1e9", "1e-300", "0x1p2", "x", ""})
    EXPECT_EQ(s.client->Get(std::string("/v1/events?rate_hz=") + rate)->status, 400) << rate;
}

// As many as are allowed, and none more; what they hold comes back.
// Who knows no chunks would take their sizes for events.
TEST(HttpApi, AStreamToAnOldClientHasNoChunks) {
  Served s;
  publish_something(s.state);
  const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<std::uint16_t>(s.api->port()));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(::connect(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  const std::string request = "GET /v1/events?rate_hz=30 HTTP/1.0\r\nHost: localhost\r\n\r\n";
  ASSERT_EQ(::send(socket, request.data(), request.size(), 0),
            static_cast<ssize_t>(request.size()));
  std::string answer;
  std::array<char, 4096> part{};
  for (ssize_t n = 0; answer.find("\n\nevent") == std::string::npos &&
                      (n = ::recv(socket, part.data(), part.size(), 0)) > 0;)
    answer.append(part.data(), static_cast<std::size_t>(n));
  ::close(socket);
  EXPECT_EQ(answer.find("Transfer-Encoding"), std::string::npos);
  EXPECT_NE(answer.find("\r\n\r\nevent: state\ndata: {"), std::string::npos);
  EXPECT_NE(answer.find("\n\nevent: state\ndata: {"), std::string::npos) << answer.substr(0, 400);
}

// Each of many clients encoded its own: hundreds of megabytes, and kept.
TEST(EncodedFiles, AreMadeOnceAndNewestWins) {
  const auto map_at = [](double s) {
    auto out = std::make_shared<Environment>();
    out->radiance = Image<Rgb>(64, 32);
    out->time = TimestampNs{0} + Seconds(s);
    return out;
  };
  EnvironmentFiles files;
  const auto first = map_at(5), second = map_at(5.2), anew = map_at(1);
  for (const auto of : {&EnvironmentFiles::exr, &EnvironmentFiles::hdr, &EnvironmentFiles::jpeg,
                        &EnvironmentFiles::cube}) {
    const auto a = (files.*of)(first), again = (files.*of)(first);
    ASSERT_TRUE(a && again) << a.error().detail;
    EXPECT_EQ(a->bytes, again->bytes);
    const auto b = (files.*of)(second);
    EXPECT_EQ(b->time, second->time);
    EXPECT_NE(b->bytes, a->bytes);
    EXPECT_EQ((files.*of)(first)->time, second->time) << "it waited, and gets the newer one";
    EXPECT_EQ((files.*of)(anew)->time, anew->time) << "the capture began anew";
  }
}

TEST(HttpApi, StreamsAreBounded) {
  Served s;
  publish_something(s.state);
  const auto refused = [&] {
    httplib::Client one_more("127.0.0.1", s.api->port());
    bool stream = false;
    const auto response = one_more.Get("/v1/events", [&](const char* data, std::size_t) {
      stream = data[0] == 'e';
      return false;
    });
    return !stream;
  };
  {
    std::atomic<int> begun = 0;
    std::atomic<bool> leave = false;
    std::vector<std::jthread> clients;
    for (int i = 0; i < 32; ++i)
      clients.emplace_back([&] {
        httplib::Client client("127.0.0.1", s.api->port());
        bool first = true;
        client.Get("/v1/events?rate_hz=20", [&](const char*, std::size_t) {
          begun += std::exchange(first, false);
          return !leave;
        });
      });
    for (int i = 0; i < 1000 && begun < 32; ++i) ::usleep(10'000);
    EXPECT_EQ(begun, 32);
    EXPECT_TRUE(refused());
    EXPECT_EQ(s.client->Get("/v1/stages")->status, 200) << "others are answered";
    leave = true;
  }
  bool again = false;
  for (int i = 0; i < 300 && !again; ++i) {
    again = !refused();
    ::usleep(10'000);
  }
  EXPECT_TRUE(again);
}

TEST(HttpApi, MetricsAreWellFormedAndCountersOnlyGrow) {
  Served s;
  s.times.add("merge", 3);
  s.times.add("merge", 2000);
  publish_something(s.state);
  capture::CameraCounts counts;
  counts.frames = 7;
  std::vector<capture::CameraInfo> cameras(1);
  cameras[0].name = "a \"quoted\" \\ name";
  s.state.publish_cameras(cameras, {counts});
  const auto read = [&] { return s.client->Get("/metrics")->body; };
  const std::string text = read();
  EXPECT_NE(text.find("penumbra_stage_seconds_bucket{stage=\"merge\",le=\"0.004\"} 1\n"),
            std::string::npos);
  EXPECT_NE(text.find("penumbra_stage_seconds_bucket{stage=\"merge\",le=\"+Inf\"} 2\n"),
            std::string::npos);
  EXPECT_NE(text.find("penumbra_stage_seconds_sum{stage=\"merge\"} 2.003\n"), std::string::npos);
  EXPECT_NE(text.find("camera=\"a \\\"quoted\\\" \\\\ name\",result=\"delivered\"} 7\n"),
            std::string::npos);
  const auto frames = [](const std::string& all) {
    const std::string name = "\npenumbra_frames_composited_total ";
    return std::stod(all.substr(all.find(name) + name.size()));
  };
  publish_something(s.state);
  EXPECT_EQ(frames(read()), frames(text) + 1);
}

TEST(HttpApi, ThePageAllowsNothingFromElsewhere) {
  Served s;
  for (const auto& [path, type] : {std::pair{"/", "text/html"},
                                   {"/page.js", "text/javascript"},
                                   {"/page.css", "text/css"},
                                   {"/openapi.json", "application/json"}}) {
    const auto response = s.client->Get(path);
    ASSERT_TRUE(response);
    EXPECT_EQ(response->status, 200) << path;
    EXPECT_EQ(response->get_header_value("Content-Type"), type);
    EXPECT_NE(response->get_header_value("Content-Security-Policy").find("default-src 'none'"),
              std::string::npos);
  }
  EXPECT_EQ(s.client->Get("/page.html")->status, 404);
}

TEST(PublishedState, FramesThatComeSlowlyAreSaid) {
  PublishedState state;
  state.describe_source({}, 1000);
  publish_something(state);
  PublishedState::Snapshot s = state.snapshot();
  EXPECT_EQ(s.status(1), "ok") << "just begun";
  s.uptime_s = 60;
  s.frame_rate_hz = 100;  // of one frame in less than a millisecond it would be any
  EXPECT_EQ(s.status(1), "slow");
  s.frame_rate_hz = 900;
  EXPECT_EQ(s.status(1), "ok");
  s.idle_s = 5;
  EXPECT_EQ(s.status(1), "stale");
}

}  // namespace
}  // namespace penumbra::service
