#include "runtime/scene/scene.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtx/quaternion.hpp>
#include <set>

#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

namespace fs = std::filesystem;

class SceneFile : public testing::Test {
 protected:
  fs::path path() const { return folder_.path() / "scene.toml"; }
  Result<Scene> read(const std::string& text) {
    std::ofstream(path(), std::ios::binary) << text;
    return read_scene(path());
  }
  void expect_invalid(const std::string& text, int line, const std::string& word) {
    const auto scene = read(text);
    ASSERT_FALSE(scene) << text;
    EXPECT_EQ(scene.error().code, ErrorCode::kInvalid) << scene.error().detail;
    EXPECT_EQ(scene.error().where, path().string() + ":" + std::to_string(line))
        << scene.error().detail;
    EXPECT_NE(scene.error().detail.find(word), std::string::npos) << scene.error().detail;
  }
  Scene round_trip(const Scene& scene) {
    EXPECT_TRUE(write_scene(path(), scene));
    const auto back = read_scene(path());
    EXPECT_TRUE(back) << back.error().where << ": " << back.error().detail;
    return back ? *back : Scene{};
  }
  test::TempFolder folder_;
};

SceneObject placed_object() {
  SceneObject o;
  o.name = "bunny";
  o.asset = "/somewhere/bunny.obj";
  o.albedo = {.1f, .25f, .7f};
  o.position = {1. / 3, -2.5, 1e-7};
  o.rotation = glm::angleAxis(.7, glm::normalize(glm::dvec3(1, 2, 3)));
  o.scale = .0371;
  o.spin_rpm = -12.5;
  o.max_vertices = 5000;
  o.visible = false;
  o.emission_lights = true;
  return o;
}

void expect_same_placement(const Placement& a, const Placement& b) {
  EXPECT_EQ(a.position, b.position);
  EXPECT_LT(glm::length(a.rotation - b.rotation), 1e-15);
  EXPECT_EQ(a.place_on_floor, b.place_on_floor);
  if (a.place_on_floor) {
    EXPECT_EQ(a.fit_size_m, b.fit_size_m);
  } else {
    EXPECT_EQ(a.scale, b.scale);
  }
}

void expect_same(const SceneObject& a, const SceneObject& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.asset, b.asset);
  EXPECT_EQ(a.albedo, b.albedo);
  expect_same_placement(a, b);
  EXPECT_EQ(a.spin_rpm, b.spin_rpm);
  EXPECT_EQ(a.max_vertices, b.max_vertices);
  EXPECT_EQ(a.visible, b.visible);
  EXPECT_EQ(a.emission_lights, b.emission_lights);
}

TEST_F(SceneFile, WhatIsWrittenIsRead) {
  SceneObject standing;
  standing.name = "knot";
  standing.asset = "builtin:knot";
  standing.place_on_floor = true;
  standing.fit_size_m = .35;
  RealGeometry floor, table;
  floor.plane = RealPlane{{.1, .2, .3}, glm::normalize(glm::dvec3(.1, 1, -.2))};
  floor.albedo = Rgb{.4f, .5f, .6f};
  table.mesh = "/somewhere/table.ply";
  table.position = {1, .5, -2};
  table.rotation = glm::angleAxis(.3, glm::dvec3(0, 1, 0));
  table.scale = .01;
  const shadows::Lamp lamp{{.1, 2, -.3}, .05, {3, 2, 1}};
  const Scene scene{{placed_object(), standing}, {floor, table}, {lamp}};
  const Scene back = round_trip(scene);
  ASSERT_EQ(back.lamps.size(), 1U);
  EXPECT_EQ(back.lamps[0].position, lamp.position);
  EXPECT_EQ(back.lamps[0].radius_m, lamp.radius_m);
  EXPECT_EQ(back.lamps[0].irradiance_at_1m, lamp.irradiance_at_1m);
  ASSERT_EQ(back.objects.size(), 2U);
  ASSERT_EQ(back.real.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) expect_same(back.objects[i], scene.objects[i]);
  ASSERT_TRUE(back.real[0].plane);
  EXPECT_EQ(back.real[0].plane->point, floor.plane->point);
  EXPECT_LT(glm::distance(back.real[0].plane->normal, floor.plane->normal), 1e-15);
  EXPECT_EQ(back.real[0].albedo, floor.albedo);
  EXPECT_EQ(back.real[1].mesh, table.mesh);
  expect_same_placement(back.real[1], table);
  EXPECT_FALSE(back.real[1].albedo);
}

TEST_F(SceneFile, NamesAndPathsMayHoldAnyCharacter) {
  for (const std::string name :
       {"a \"quoted\" bunny", "back\\slash", "two\nlines", "h\xc3\xa4schen", "tab\there"}) {
    SceneObject o = placed_object();
    o.name = name;
    o.asset = "/somewhere/" + name + ".obj";
    const Scene back = round_trip({{o}, {}});
    ASSERT_EQ(back.objects.size(), 1U) << name;
    EXPECT_EQ(back.objects[0].name, name);
    EXPECT_EQ(back.objects[0].asset, o.asset);
  }
}

TEST_F(SceneFile, BlendsOfClipsComeBackLive) {
  const auto scene = read(
      "version = 1\n[[object]]\nasset = \"a.glb\"\nanimation = \"Walk\"\nblend = \"Wave\"\n"
      "blend_weight = 0.25\ntransfer_ms = 3\n[[object]]\nasset = \"b.glb\"\nanimation = \"0\"\n"
      "transfer = \"live\"\n");
  ASSERT_TRUE(scene) << scene.error().detail;
  const Scene back = round_trip(*scene);
  ASSERT_EQ(back.objects.size(), 2u);
  EXPECT_TRUE(back.objects[0].live);
  EXPECT_EQ(back.objects[0].blend, "Wave");
  EXPECT_EQ(back.objects[0].blend_weight, .25);
  EXPECT_EQ(back.objects[0].transfer_ms, 3);
  EXPECT_TRUE(back.objects[1].live);
  EXPECT_EQ(back.objects[1].transfer, "");
  EXPECT_EQ(back.objects[1].blend, "");
}

TEST_F(SceneFile, RelativePathsAreMeantFromTheScene) {
  const auto scene =
      read("version = 1\n[[object]]\nasset = \"meshes/a.obj\"\n[[real]]\nmesh = \"b.ply\"\n");
  ASSERT_TRUE(scene) << scene.error().detail;
  EXPECT_EQ(scene->objects[0].asset, (folder_.path() / "meshes/a.obj").string());
  EXPECT_EQ(scene->objects[0].name, "a");
  EXPECT_EQ(scene->real[0].mesh, (folder_.path() / "b.ply").string());
}

// A request or a file that is read anew would mean either.
TEST_F(SceneFile, NoTwoObjectsShareAName) {
  expect_invalid(
      "version = 1\n[[object]]\nasset = \"a.obj\"\nname = \"x\"\n"
      "[[object]]\nasset = \"b.obj\"\nname = \"x\"\n",
      7, "name");
  const auto scene = read(
      "version = 1\n[[object]]\nasset = \"a.obj\"\n[[object]]\nasset = \"a.obj\"\n"
      "[[object]]\nasset = \"b.obj\"\nname = \"a\"\n");
  ASSERT_TRUE(scene) << scene.error().detail;
  EXPECT_EQ(scene->objects[0].name, "a 2");
  EXPECT_EQ(scene->objects[1].name, "a 3");
  EXPECT_EQ(scene->objects[2].name, "a");
}

TEST_F(SceneFile, UnknownKeysAreNamedWithFileAndLine) {
  expect_invalid("version = 1\nobjects = 3\n", 2, "objects");
  expect_invalid("version = 1\n[[object]]\nasset = \"a.obj\"\ncolor = [1, 1, 1]\n", 4, "color");
  expect_invalid(
      "version = 1\n\n[[real]]\nplane = { point = [0,0,0], normal = [0,1,0] }\nmass = 3\n", 5,
      "mass");
  expect_invalid("version = 1\n[[real]]\nplane = { point = [0,0,0], normal = [0,1,0], size = 3 }\n",
                 3, "size");
}

TEST_F(SceneFile, BadValuesAreNamedWithFileAndLine) {
  const std::string head = "version = 1\n[[object]]\nasset = \"a.obj\"\n";
  for (const auto& [line, word] : {std::pair{"albedo = [1, 2, 0]", "albedo"},
                                   {"albedo = [1, 0]", "albedo"},
                                   {"albedo = [-0.1, 0, 0]", "albedo"},
                                   {"position = [0, nan, 0]", "position"},
                                   {"position = [0, inf, 0]", "position"},
                                   {"position = 3", "position"},
                                   {"rotation = [0, 0, 0, 2]", "rotation"},
                                   {"rotation = [0, 0, 0, 0]", "rotation"},
                                   {"scale = 0", "scale"},
                                   {"scale = -1", "scale"},
                                   {"scale = nan", "scale"},
                                   {"scale = \"big\"", "scale"},
                                   {"scale = 1e-30", "scale"},
                                   {"position = [0, 1e20, 0]", "position"},
                                   {"spin_rpm = 1e308", "spin_rpm"},
                                   {"fit_size_m = 0", "fit_size_m"},
                                   {"spin_rpm = inf", "spin_rpm"},
                                   {"name = 3", "name"},
                                   {"visible = 1", "visible"},
                                   {"emission_lights = 8", "emission_lights"},
                                   {"animation = 1", "animation"}})
    expect_invalid(head + line + "\n", 4, word);
  expect_invalid(head + "scale = 2\nfit_size_m = 1\n", 5, "fit_size_m");
  const std::string walks = head + "animation = \"Walk\"\n";
  for (const std::string line : {"blend_weight = 0.5", "transfer_ms = 3", "blend = \"\"",
                                 "blend = 3", "light_map = [7, 64]"})
    expect_invalid(walks + line + "\n", 5, line.substr(0, line.find(' ')));
  expect_invalid(head + "blend = \"Wave\"\n", 4, "blend");
  const std::string blends = walks + "blend = \"Wave\"\n";
  for (const std::string line :
       {"blend_weight = 1.5", "blend_weight = nan", "transfer_ms = 0", "transfer_ms = 1e9",
        "light_map = [64, 64]", "transfer = \"a.shlm\""})
    expect_invalid(blends + line + "\n", 6, line.substr(0, line.find(' ')));
  expect_invalid("version = 2\n", 1, "version");
  expect_invalid("version = 1\nobject = 3\n", 2, "object");
  expect_invalid("version = 1\n[[real]]\nplane = { point = [0,0,0], normal = [0,0,0] }\n", 3,
                 "normal");
  expect_invalid("version = 1\n[[real]]\nplane = 3\n", 3, "plane");
  const std::string mesh = "version = 1\n[[real]]\nmesh = \"a.obj\"\n";
  expect_invalid(mesh + "position = [0, 1e5, 0]\n", 4, "position");
  expect_invalid(mesh + "scale = 1\nfit_size_m = 1\n", 5, "fit_size_m");
  for (const std::string key : {"position = [0, 0, 0]", "scale = 2", "fit_size_m = 1"})
    expect_invalid(
        "version = 1\n[[real]]\nplane = { point = [0, 0, 0], normal = [0, 1, 0] }\n" + key + "\n",
        4, key.substr(0, key.find(' ')));
  const std::string lamp = "version = 1\n[[lamp]]\nirradiance_at_1m = [1, 1, 1]\n";
  expect_invalid(lamp + "position = [0, 1e20, 0]\n", 4, "position");
  expect_invalid(lamp + "position = [0, 1, 0]\nradius_m = -1\n", 5, "radius_m");
  expect_invalid("version = 1\n[[lamp]]\nposition = [0, 1, 0]\nirradiance_at_1m = [1, -1, 1]\n", 4,
                 "irradiance_at_1m");
  expect_invalid(lamp + "colour = 3\n", 4, "colour");
  const std::string sun = "version = 1\n[sun]\nlatitude_deg = 50\n";
  expect_invalid(sun, 2, "longitude_deg");
  expect_invalid("version = 1\n[sun]\nlatitude_deg = 91\nlongitude_deg = 8\n", 3, "latitude_deg");
  expect_invalid(sun + "longitude_deg = 181\n", 4, "longitude_deg");
  for (const std::string line :
       {"north_deg = 400", "time = 2026-06-21T12:00:00", "time = \"noon\"", "time = 2026-06-21",
        "time = 1900-01-01T00:00:00Z", "height_m = 3"})
    expect_invalid(sun + "longitude_deg = 8\n" + line + "\n", 5, line.substr(0, line.find(' ')));
}

TEST_F(SceneFile, TheSunsPlaceComesBackInUniversalTime) {
  using namespace std::chrono;
  const auto scene = read(
      "version = 1\n[sun]\nlatitude_deg = 50.1\nlongitude_deg = -8.7\nnorth_deg = 30\n"
      "time = 2026-06-21T12:30:05+02:00\n");
  ASSERT_TRUE(scene && scene->sun);
  EXPECT_EQ(scene->sun->time, sys_days{2026y / June / 21} + 10h + 30min + 5s);
  const Scene back = round_trip(*scene);
  ASSERT_TRUE(back.sun);
  EXPECT_EQ(back.sun->latitude_deg, 50.1);
  EXPECT_EQ(back.sun->longitude_deg, -8.7);
  EXPECT_EQ(back.sun->north_deg, 30);
  EXPECT_EQ(back.sun->time, scene->sun->time);
  Scene now;
  now.sun = lighting::SunSite{1, 2, 3, {}};
  EXPECT_FALSE(round_trip(now).sun->time);
}

TEST_F(SceneFile, WhatIsMissingIsNamed) {
  for (const auto& [text, word] : {std::pair{"", "version"},
                                   {"version = 1\n[[object]]\nname = \"a\"\n", "asset"},
                                   {"version = 1\n[[real]]\nalbedo = [1, 1, 1]\n", "plane"}}) {
    const auto scene = read(text);
    ASSERT_FALSE(scene) << text;
    EXPECT_EQ(scene.error().code, ErrorCode::kInvalid);
    EXPECT_NE(scene.error().where.find("scene.toml"), std::string::npos);
    EXPECT_NE(scene.error().detail.find(word), std::string::npos) << scene.error().detail;
  }
}

TEST_F(SceneFile, DamagedAndAbsentFilesAreErrors) {
  const auto damaged = read("version = 1\n[[object]\n");
  ASSERT_FALSE(damaged);
  EXPECT_EQ(damaged.error().code, ErrorCode::kUnreadable);
  EXPECT_EQ(damaged.error().where, path().string() + ":2");
  const auto absent = read_scene(folder_.path() / "nowhere.toml");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::kNotFound);
  EXPECT_FALSE(write_scene(path() / "below" / "scene.toml", {})) << "below a regular file";
}

// ------------------------------------------------------------------------------------- placing

BakeSettings quick_bake() {
  return {2, 0, 64, 64, false};
}
const auto kNoProgress = [](const std::string&) { return std::function<void(double)>(); };

prt::Bounds world_bounds(const PreparedScene& scene) {
  const prt::Mesh mesh = world_mesh(scene, true);
  return prt::bounds_of(mesh);
}

TEST_F(SceneFile, RealMeshesStandWhereTheyArePlaced) {
  RealGeometry box;
  box.mesh = "builtin:box";
  box.position = {1, .25, -2};
  box.place_on_floor = true;
  box.fit_size_m = .8;
  const auto scene = prepare({{}, {box}}, quick_bake(), kNoProgress);
  ASSERT_TRUE(scene) << scene.error().detail;
  const prt::Bounds b = prt::bounds_of(scene->real_mesh);
  EXPECT_NEAR(b.low.y, .25f, 1e-6f);
  EXPECT_NEAR(b.high.y, 1.05f, 1e-6f);
  EXPECT_NEAR(b.centre().x, 1, 1e-6f);
  EXPECT_NEAR(b.centre().z, -2, 1e-6f);
  box.mesh = "";
  EXPECT_EQ(prepare({{}, {box}}, quick_bake(), kNoProgress).error().code, ErrorCode::kInvalid);
}

// Every mesh whose own z points up needs a rotation: it must stand on the floor, not in it.
TEST(WorldFromMesh, ATurnedObjectOfAGivenSizeTouchesItsFloor) {
  prt::Mesh cone;  // a tip at +z, a base off the origin
  cone.positions = {{1, 1, 5}, {0, 0, 2}, {2, 0, 2}, {0, 2, 2}, {2, 2, 2}};
  const auto lowest = [&](const Placement& p, const glm::dvec3& up) {
    const glm::dmat4 place = world_from_mesh(p, cone, up);
    double least = HUGE_VAL;
    for (const glm::vec3& v : cone.positions)
      least = std::min(least, glm::dot(glm::dvec3(place * glm::dvec4(v, 1)) - p.position, up));
    return least;
  };
  Placement p;
  p.place_on_floor = true;
  p.fit_size_m = .6;
  p.position = {.3, .25, -1};
  const glm::dvec3 up(0, 1, 0), slope = glm::normalize(glm::dvec3(.2, 1, .1));
  for (const glm::dquat& turned :
       {glm::dquat(1, 0, 0, 0), glm::angleAxis(-kPi / 2, glm::dvec3(1, 0, 0)),
        glm::angleAxis(2., glm::normalize(glm::dvec3(1, 2, -.5)))}) {
    p.rotation = turned;
    EXPECT_NEAR(lowest(p, up), 0, 1e-6);
    EXPECT_NEAR(lowest(p, slope), 0, 1e-6);
  }
  // z up: the tip is above the middle of the base.
  p.rotation = glm::angleAxis(-kPi / 2, glm::dvec3(1, 0, 0));
  const glm::dvec3 tip(world_from_mesh(p, cone) * glm::dvec4(1, 1, 5, 1));
  EXPECT_NEAR(tip.x, .3, 1e-6);
  EXPECT_NEAR(tip.y, .85, 1e-6);
  EXPECT_NEAR(tip.z, -1, 1e-6);
}

TEST_F(SceneFile, FlatOnAndHalfInTheFloorStandOnItAndBelowItDoesNot) {
  prt::Mesh decal;
  decal.positions = {{-.2f, 0, -.2f}, {-.2f, 0, .2f}, {.2f, 0, .2f}, {.2f, 0, -.2f}};
  decal.normals.assign(4, {0, 1, 0});
  decal.triangles = {{0, 1, 2}, {0, 2, 3}};
  const prt::Mesh box = prt::make_box({-.1f, -.2f, -.1f}, {.1f, .1f, .1f}, 1, {.5f, .5f, .5f});
  RealGeometry floor;
  floor.plane = RealPlane{};
  for (const auto& [mesh, height, stands] :
       {std::tuple(decal, 0., true), {box, 0., true}, {box, -.5, false}}) {
    test::write_obj(mesh, folder_.path() / "thing.obj");
    SceneObject o;
    o.name = "thing";
    o.asset = (folder_.path() / "thing.obj").string();
    o.position = {0, height, 0};
    const auto scene = prepare({{o}, {floor}}, quick_bake(), kNoProgress);
    ASSERT_TRUE(scene) << scene.error().detail;
    EXPECT_EQ(scene->objects[0].baked.receiver.has_value(), stands) << height;
  }
}

TEST_F(SceneFile, StandingObjectRestsOnItsPlaneAtItsSize) {
  for (const double height : {0., .75}) {
    SceneObject o;
    o.asset = o.name = "builtin:twist";
    o.place_on_floor = true;
    o.fit_size_m = .4;
    o.position = {.3, height, -.2};
    RealGeometry plane;
    plane.plane = RealPlane{{0, height, 0}, {0, 1, 0}};
    const auto scene = prepare({{o}, {plane}}, quick_bake(), kNoProgress);
    ASSERT_TRUE(scene) << scene.error().detail;
    const prt::Bounds b = world_bounds(*scene);
    const glm::vec3 size = b.high - b.low;
    EXPECT_NEAR(std::max({size.x, size.y, size.z}), .4, 1e-4);
    EXPECT_NEAR(b.low.y, height, 1e-5);
    EXPECT_NEAR(b.centre().x, .3, 1e-4);
    EXPECT_NEAR(b.centre().z, -.2, 1e-4);
  }
}

TEST_F(SceneFile, BakedFileStandsWhereItsAssetWould) {
  // An asset that floats .3 above its own origin and off it.
  const fs::path file = folder_.path() / "baked.glb";
  prt::Mesh mesh = prt::make_box({.1f, .3f, -.2f}, {.5f, .5f, .2f}, 2, {.5f, .5f, .5f});
  prt::BakeOptions options;
  options.bands = 2;
  options.rays = options.ground_rays = 64;
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, prt::bounds_of(mesh).low.y, 16), {}};
  const auto baked = prt::bake(mesh, options);
  ASSERT_TRUE(baked);
  ASSERT_TRUE(prt::write_baked(file, *baked));
  SceneObject o;
  o.name = "box";
  o.asset = file.string();
  o.place_on_floor = true;
  o.fit_size_m = .8;
  o.position = {1, 0, 2};
  RealGeometry floor;
  floor.plane = RealPlane{};
  const auto scene = prepare({{o}, {floor}}, quick_bake(), kNoProgress);
  ASSERT_TRUE(scene) << scene.error().detail;
  const prt::Bounds b = world_bounds(*scene);
  EXPECT_NEAR(b.low.y, 0, 1e-4) << "stands on the floor";
  EXPECT_NEAR(b.centre().x, 1, 1e-3);
  EXPECT_NEAR(b.centre().z, 2, 1e-3);
  const PreparedObject& object = scene->objects[0];
  ASSERT_TRUE(object.baked.receiver);
  const glm::dvec3 plane =
      object.world_from_bake * glm::dvec3(0, object.baked.receiver->grid.height, 0);
  EXPECT_NEAR(plane.y, 0, 1e-4) << "its shadow lies on the floor";
}

TEST_F(SceneFile, BakedFileKeepsItsScaleHoweverItIsTurned) {
  const fs::path file = folder_.path() / "baked.glb";
  prt::BakeOptions options;
  options.bands = 2;
  options.rays = options.ground_rays = 64;
  const auto baked =
      prt::bake(prt::make_box({-.2f, 0, -.2f}, {.2f, .4f, .2f}, 1, {.5f, .5f, .5f}), options);
  ASSERT_TRUE(baked);
  ASSERT_TRUE(prt::write_baked(file, *baked));
  SceneObject o;
  o.name = "box";
  o.asset = file.string();
  o.scale = 2;
  for (const glm::dquat& turn :
       {glm::dquat(1, 0, 0, 0), glm::dquat(0, 1, 0, 0), glm::dquat(.5, .5, .5, .5),
        glm::angleAxis(1.1, glm::dvec3(1, 0, 0))}) {
    o.rotation = turn;
    const auto scene =
        prepare({{o}, {}}, quick_bake(), kNoProgress);  // no plane: any attitude is allowed
    ASSERT_TRUE(scene) << scene.error().detail;
    const prt::Bounds b = prt::bounds_of(scene->objects[0].baked.mesh);
    EXPECT_NEAR(b.high.y - b.low.y, .8, 1e-5) << turn.w << ' ' << turn.x;
  }
}

// ------------------------------------------------------------------------- one bake per asset

/// A cache of its own, and how often something was baked into it.
class OneBake : public testing::Test {
 protected:
  OneBake() : before_(std::getenv("XDG_CACHE_HOME") ? std::getenv("XDG_CACHE_HOME") : "") {
    ::setenv("XDG_CACHE_HOME", folder_.path().c_str(), 1);
  }
  ~OneBake() override {
    if (before_.empty())
      ::unsetenv("XDG_CACHE_HOME");
    else
      ::setenv("XDG_CACHE_HOME", before_.c_str(), 1);
  }
  PreparedScene prepared(const Scene& scene) {
    BakeSettings settings = quick_bake();
    settings.cache = BakeCache::kUsed;
    settings.bounces = 1;
    auto out =
        prepare(scene, settings, [&](const std::string& name) -> std::function<void(double)> {
          return [this, name](double) { baked_.insert(name); };
        });
    EXPECT_TRUE(out) << out.error().detail;
    return out ? std::move(*out) : PreparedScene{};
  }
  static SceneObject twist() {
    SceneObject o;
    o.name = "twist";
    o.asset = "builtin:twist";
    return o;
  }
  static RealGeometry floor_of(Rgb albedo, const glm::dvec3& normal = {0, 1, 0}) {
    RealGeometry floor;
    floor.plane = RealPlane{{.1, .2, -.3}, normal};
    floor.albedo = albedo;
    return floor;
  }
  test::TempFolder folder_;
  std::set<std::string> baked_;

 private:
  std::string before_;
};

// Wherever it stands on its plane, however it is turned and how large it is.
TEST_F(OneBake, ServesEveryPlaceTurnSizeAndFloor) {
  SceneObject o = twist();
  o.place_on_floor = true;
  const RealGeometry floor = floor_of({.4f, .4f, .4f});
  o.position = {.1, .2, -.3};
  prepared({{o}, {floor}});
  ASSERT_EQ(baked_.size(), 1u);
  baked_.clear();
  std::vector<Scene> others;
  const auto changed = [&](const auto& change) {
    Scene scene{{o}, {floor}};
    change(scene);
    others.push_back(scene);
  };
  changed([](Scene& s) { s.objects[0].position.x += .01; });
  changed([](Scene& s) { s.objects[0].position = {-17.3, .2, 1e3}; });
  changed([](Scene& s) { s.objects[0].rotation = glm::angleAxis(.7, glm::dvec3(0, 1, 0)); });
  changed([](Scene& s) { s.objects[0].rotation = glm::dquat(0, 0, 1, 0); });
  changed([](Scene& s) { s.objects[0].fit_size_m *= 1.06; });
  changed([](Scene& s) { s.real[0].albedo = Rgb{.1f, .5f, .2f}; });
  changed([](Scene& s) { s.real[0].albedo.reset(); });
  changed([](Scene& s) { s.objects[0].spin_rpm = 5; });
  changed([](Scene& s) {  // the floor slopes, and the object stands upright on it
    s.real[0].plane->normal = glm::normalize(glm::dvec3(.2, 1, .1));
    s.objects[0].rotation = glm::rotation(glm::dvec3(0, 1, 0), s.real[0].plane->normal);
    s.objects[0].position = s.real[0].plane->point;
  });
  for (const Scene& scene : others) prepared(scene);
  EXPECT_TRUE(baked_.empty());
}

TEST_F(OneBake, ServesCopiesWhichShareItsMemory) {
  Scene scene{{}, {floor_of({.4f, .4f, .4f})}};
  for (int i = 0; i < 4; ++i) {
    SceneObject o = twist();
    o.name += std::to_string(i);
    o.place_on_floor = true;
    o.position = {.1 + i, .2, -.3};
    o.fit_size_m = .3 + .1 * i;
    scene.objects.push_back(o);
  }
  const PreparedScene out = prepared(scene);
  EXPECT_EQ(baked_.size(), 1u);
  ASSERT_EQ(out.objects.size(), 4u);
  const prt::BakedObject& first = out.objects[0].baked;
  for (const PreparedObject& o : out.objects) {
    EXPECT_TRUE(o.baked.transfer.values.shares(first.transfer.values));
    EXPECT_TRUE(o.baked.reflected.values.shares(first.reflected.values));
    EXPECT_TRUE(o.baked.ground_deficit.values.shares(first.ground_deficit.values));
    EXPECT_TRUE(o.baked.visibility.open.shares(first.visibility.open));
    EXPECT_EQ(o.baked.receiver->albedo, (Rgb{.4f, .4f, .4f}));
  }
}

// A mesh of more vertices than are lit is drawn in full, wherever it stands, and so is the truth's.
TEST_F(OneBake, AMeshOfManyVerticesIsLitAtFew) {
  const test::TempFolder folder;
  const prt::Mesh ball = prt::make_sphere({0, .2f, 0}, .2f, 5, {.7f, .7f, .7f});
  std::string obj;
  for (const glm::vec3& p : ball.positions) obj += fmt::format("v {} {} {}\n", p.x, p.y, p.z);
  for (const auto& t : ball.triangles)
    obj += fmt::format("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
  std::ofstream(folder.path() / "ball.obj") << obj;
  SceneObject o;
  o.asset = (folder.path() / "ball.obj").string();
  o.name = "ball";
  o.max_vertices = 2000;
  o.rotation = glm::angleAxis(.5, glm::normalize(glm::dvec3(1, .3, 0)));
  o.place_on_floor = true;
  o.position = {1, 0, 2};
  o.fit_size_m = .8;
  Scene scene{{o}, {}};
  scene.real.push_back(floor_of({.4f, .4f, .4f}, {0, 1, 0}));
  const PreparedScene out = prepared(scene);
  ASSERT_EQ(out.objects.size(), 1U);
  const prt::BakedObject& baked = out.objects[0].baked;
  ASSERT_TRUE(baked.fine);
  EXPECT_LT(baked.mesh.positions.size(), 4000U);
  EXPECT_EQ(baked.fine->mesh.triangles.size(), ball.triangles.size());
  const prt::Mesh world = world_mesh(out, true);
  EXPECT_EQ(world.triangles.size(), ball.triangles.size());
  const prt::Bounds b = bounds_of(world);
  EXPECT_NEAR(b.low.y, 0, 2e-3);
  EXPECT_NEAR(b.high.y, .8, 4e-3);
  EXPECT_NEAR(b.centre().x, 1, 2e-3);
  // Both forms are in one frame.
  const prt::Bounds coarse = bounds_of(baked.mesh), fine = bounds_of(baked.fine->mesh);
  EXPECT_NEAR(glm::length(coarse.centre() - fine.centre()), 0, .01);
}

// Every vertex stands where the scene file says, whatever its bake was made of.
TEST_F(OneBake, StandsWhereTheSceneSays) {
  const auto asset = load_asset("builtin:twist", {.7f, .7f, .7f}, .03f);
  ASSERT_TRUE(asset);
  const prt::Mesh* const mesh = &asset->mesh;
  const glm::dvec3 slope = glm::normalize(glm::dvec3(.2, 1, .1));
  for (const glm::dvec3& normal : {glm::dvec3(0, 1, 0), slope})
    for (const glm::dquat& rotation :
         {glm::dquat(1, 0, 0, 0), glm::angleAxis(2.2, glm::dvec3(0, 1, 0)),
          glm::angleAxis(.6, glm::normalize(glm::dvec3(1, .5, -.3))),
          glm::angleAxis(kPi, glm::dvec3(1, 0, 0))})
      for (const int how : {0, 1, 2, 3}) {  // 3: on something that stands on the plane
        SceneObject o = twist();
        o.rotation = rotation;
        o.place_on_floor = how == 0 || how == 3;
        o.fit_size_m = .37;
        o.scale = 1.7;
        const RealGeometry floor = floor_of({.4f, .4f, .4f}, normal);
        o.position = floor.plane->point + (how == 2 ? 3. : how == 3 ? .35 : 0.) * normal;
        Scene scene{{o}, {}};
        if (how != 2) scene.real.push_back(floor);
        const PreparedScene out = prepared(scene);
        const prt::Mesh world = world_mesh(out, true);
        const glm::dmat4 place = world_from_mesh(
            o, *mesh, how != 2 ? floor_normal(out.planes, o.position) : glm::dvec3(0, 1, 0));
        ASSERT_EQ(world.positions.size(), mesh->positions.size());
        double worst = 0;
        for (std::size_t i = 0; i < world.positions.size(); ++i)
          worst =
              std::max(worst, glm::distance(glm::dvec3(world.positions[i]),
                                            glm::dvec3(place * glm::dvec4(mesh->positions[i], 1))));
        EXPECT_LT(worst, 2e-4) << how << ' ' << rotation.w << ' ' << normal.x;
      }
}

TEST_F(SceneFile, TurntableTurnsAboutTheNormalAndClosesAfterOneTurn) {
  PreparedObject o;
  o.world_from_bake = {glm::angleAxis(.4, glm::dvec3(1, 0, 0)), {1, 2, 3}};
  o.spin_rpm = 10;
  const glm::dvec3 up = o.world_from_bake.rotation * glm::dvec3(0, 1, 0);
  for (const double t : {0., .7, 3., 6.}) {
    const Pose pose = o.pose_at(t);
    EXPECT_LT(glm::distance(pose.rotation * glm::dvec3(0, 1, 0), up), 1e-12);
    EXPECT_LT(glm::distance(pose.translation, glm::dvec3(1, 2, 3)), 1e-12);
  }
  EXPECT_LT(glm::distance(o.pose_at(6) * glm::dvec3(1, 0, 0), o.pose_at(0) * glm::dvec3(1, 0, 0)),
            1e-9);
  EXPECT_GT(glm::distance(o.pose_at(3) * glm::dvec3(1, 0, 0), o.pose_at(0) * glm::dvec3(1, 0, 0)),
            1.9);
}

// An object of an OBJ that is wound the other way would be drawn black; a real room faces inwards.
TEST(LoadAsset, AnObjectThatIsInsideOutIsTurnedRoundAndARealMeshIsNot) {
  const test::TempFolder folder;
  const std::string file = (folder.path() / "in.obj").string();
  std::ofstream(file) << "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
                         "f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n";
  const auto volume = [](const prt::Mesh& m) {
    double sum = 0;
    for (const auto& t : m.triangles)
      sum += glm::dot(glm::dvec3(m.positions[t[0]]),
                      glm::cross(glm::dvec3(m.positions[t[1]]), glm::dvec3(m.positions[t[2]])));
    return sum;
  };
  const auto object = load_asset(file, {.5f, .5f, .5f}, .5f),
             real = load_asset(file, {.5f, .5f, .5f}, 0);
  ASSERT_TRUE(object && real);
  EXPECT_NEAR(volume(object->mesh), 1, 1e-5);
  EXPECT_NEAR(volume(real->mesh), -1, 1e-5);
}

}  // namespace
}  // namespace penumbra::runtime
