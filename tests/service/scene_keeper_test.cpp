#include "service/scene/scene_keeper.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <vector>

#include "capture/capture.h"
#include "service/scene/scene_control.h"
#include "service/scene/scene_reload.h"
#include "tests/support/gl.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

runtime::SceneObject box(const std::string& name, double x) {
  runtime::SceneObject out;
  out.name = name;
  out.asset = "builtin:box";
  out.place_on_floor = true;
  out.fit_size_m = .2;
  out.position = {x, 0, 0};
  return out;
}

std::vector<capture::CameraInfo> view_camera() {
  capture::StudioOptions options;
  options.view_width = 64;
  options.view_height = 48;
  auto cameras =
      capture::Studio(*capture::FloorWorld::make(capture::make_room_environment(64, 32)), options)
          .cameras();
  std::erase_if(cameras, [](const auto& c) { return c.role != capture::Role::kView; });
  return cameras;
}

// A pipeline, a keeper and what clients do to them. Scenes are taken up at once, as by a run.
struct Running {
  test::TempFolder folder;
  Result<Pipeline> pipeline = Pipeline::create(view_camera(), runtime::Scene{});
  capture::Frame frame;
  SceneControl control;
  runtime::Scene shown;
  std::vector<std::vector<std::string>> handed_over;
  std::unique_ptr<SceneKeeper> keeper;

  Running() {
    ::setenv("XDG_CACHE_HOME", folder.path().c_str(), 1);
    if (!pipeline) return;
    frame.pixels = std::make_shared<const FramePixels>(Image<Rgb8>(64, 48));
    runtime::BakeSettings settings = runtime::BakeSettings::coarse();
    settings.rays = settings.ground_rays = 64;
    settings.max_edge_fraction = .2f;
    settings.bounces = 1;
    keeper = std::make_unique<SceneKeeper>(
        settings, [](const std::string&) { return [](double) {}; },
        [this](const runtime::Scene& scene, runtime::PreparedScene prepared) -> Result<void> {
          std::vector<std::string> names;
          for (const auto& o : scene.objects) names.push_back(o.name);
          handed_over.push_back(names);
          shown = scene;
          PENUMBRA_TRY(pipeline->change_scene(std::move(prepared)));
          (void)pipeline->composite(frame);
          return {};
        },
        [this](const std::string& object) { control.forget(object); });
    control.attach(&*pipeline, keeper.get());
  }
  ~Running() { keeper.reset(); }
  void start(const runtime::Scene& scene) {
    control.set_scene(scene);
    keeper->want(scene);
    settle();
  }
  void settle() const {
    while (keeper->is_busy()) ::usleep(5'000);
  }
  std::optional<runtime::ObjectState> state(const std::string& name) const {
    return control.state_of(name);
  }
};

runtime::Scene on_a_floor(std::vector<runtime::SceneObject> objects) {
  runtime::Scene out;
  out.objects = std::move(objects);
  out.real.emplace_back();
  out.real[0].plane = runtime::RealPlane{};
  return out;
}

TEST(SceneKeeper, WhatIsAddedLeavesTheOthersInThePictureAndWhereTheyAre) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({box("a", 0), box("b", .5)}));
  ASSERT_EQ(r.handed_over.front(), std::vector<std::string>{"a"}) << "one by one at the start";
  ASSERT_TRUE(r.control.change("b", {.position_m = glm::dvec3{.7, 0, .1}, .turn_deg = 30}));
  r.handed_over.clear();
  auto ball = box("ball", -.5);
  ball.asset = "builtin:ball";
  ASSERT_TRUE(r.control.add(ball));
  EXPECT_EQ(r.control.awaited(), std::vector<std::string>{"ball"});
  r.settle();
  EXPECT_TRUE(r.control.awaited().empty());
  ASSERT_FALSE(r.handed_over.empty());
  for (const auto& names : r.handed_over)
    EXPECT_EQ(names, (std::vector<std::string>{"a", "b", "ball"}));
  EXPECT_NEAR(r.state("b")->place.position_m.x, .7, 1e-9);
  EXPECT_NEAR(r.state("b")->place.turn_rad, glm::radians(30.), 1e-9);
}

TEST(SceneKeeper, AnObjectThatComesAgainUnderTheSameNameIsAnother) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({box("a", 0)}));
  ASSERT_TRUE(r.control.change("a", {.position_m = glm::dvec3{.7, 0, 0}}));
  ASSERT_TRUE(r.control.remove("a"));
  ASSERT_TRUE(r.control.add(box("a", -.3)));
  r.settle();
  ASSERT_TRUE(r.state("a"));
  EXPECT_TRUE(r.state("a")->visible);
  EXPECT_NEAR(r.state("a")->place.position_m.x, -.3, 1e-9);
}

TEST(SceneKeeper, AnObjectThatCannotBeBakedIsToldAndLeavesTheOthersAlone) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({box("a", 0)}));
  auto broken = box("broken", .5);
  broken.asset = (r.folder.path() / "missing.glb").string();
  ASSERT_TRUE(r.control.add(broken));
  r.settle();
  EXPECT_TRUE(r.keeper->faults().contains("broken"));
  EXPECT_TRUE(r.state("a"));
  ASSERT_TRUE(r.control.add(box("b", .5)));
  r.settle();
  EXPECT_TRUE(r.state("b")) << "later ones come";
  ASSERT_TRUE(r.control.add(box("broken", -.5))) << "mended under its name";
  r.settle();
  EXPECT_TRUE(r.state("broken"));
  EXPECT_FALSE(r.keeper->faults().contains("broken"));
  EXPECT_TRUE(*r.keeper->first_outcome()) << "of the first scene alone";
  broken.name = "never";
  ASSERT_TRUE(r.control.add(broken));
  r.settle();
  ASSERT_TRUE(r.keeper->faults().contains("never"));
  EXPECT_TRUE(r.control.remove("never")) << "an alert must end once somebody has read it";
  EXPECT_TRUE(r.keeper->faults().empty());
  EXPECT_FALSE(r.control.remove("never"));
}

TEST(SceneKeeper, FaultsAreKeptUpToABound) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({}));
  auto broken = box("", 0);
  broken.asset = (r.folder.path() / "missing.glb").string();
  for (std::size_t i = 0; i < SceneKeeper::kMaxFaults + 5; ++i) {
    broken.name = "broken" + std::to_string(i);
    ASSERT_TRUE(r.control.add(broken));
    r.settle();
  }
  const auto faults = r.keeper->faults();
  EXPECT_EQ(faults.size(), SceneKeeper::kMaxFaults);
  EXPECT_FALSE(faults.contains("broken4")) << "the oldest go";
  EXPECT_TRUE(faults.contains("broken5"));
  EXPECT_TRUE(faults.contains(broken.name));
}

// At the start the author of the scene wants to hear of it.
TEST(SceneKeeper, AFaultOfTheFirstSceneIsItsOutcome) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  auto broken = box("broken", 0);
  broken.asset = (r.folder.path() / "missing.glb").string();
  r.start(on_a_floor({broken, box("a", .5)}));
  ASSERT_TRUE(r.keeper->first_outcome());
  EXPECT_EQ(r.keeper->first_outcome()->error().code, ErrorCode::kNotFound);
}

// A file that changes more than places at once, beside what clients did.
TEST(SceneKeeper, AFileReadAnewKeepsWhatClientsAddedAndTookAway) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  const runtime::Scene file = on_a_floor({box("a", 0), box("b", .5), box("c", 1)});
  r.start(file);
  ASSERT_TRUE(r.control.remove("b"));
  ASSERT_TRUE(r.control.remove("c"));
  ASSERT_TRUE(r.control.add(box("c", -1)));  // a client's own
  r.settle();
  runtime::Scene edited = file;
  edited.objects[0].fit_size_m = .3;  // another bake, another place
  edited.objects[0].position.x = .2;
  edited.objects.push_back(box("d", -.5));
  r.control.follow_file(r.control.file(), edited, apply_scene(r.shown, file, edited, r.control));
  r.settle();
  EXPECT_NEAR(r.state("a")->place.position_m.x, .2, 1e-9) << "the file's new place counts";
  EXPECT_FALSE(r.state("b")) << "taken away by a client";
  EXPECT_NEAR(r.state("c")->place.position_m.x, -1, 1e-9) << "the client's own";
  EXPECT_TRUE(r.state("d"));
}

TEST(SceneKeeper, AnotherSceneIsFollowedByItsOwnFile) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({box("a", 0)}));
  const SceneFile first = r.control.file();
  ASSERT_TRUE(r.control.show_scene(on_a_floor({box("z", 0)}), "other.toml"));
  r.settle();
  EXPECT_EQ(r.pipeline->objects().size(), 1u);
  EXPECT_EQ(r.control.file().path, "other.toml");
  const runtime::Scene edited = on_a_floor({box("z", .3), box("y", -.3)});
  r.control.follow_file(first, edited, true);  // of the file before
  r.settle();
  EXPECT_FALSE(r.state("y"));
  const SceneFile now = r.control.file();
  r.control.follow_file(now, edited, apply_scene(r.shown, now.scene, edited, r.control));
  r.settle();
  EXPECT_TRUE(r.state("y"));
  EXPECT_NEAR(r.state("z")->place.position_m.x, .3, 1e-9);
}

// Put onto another plane by the file it stands there, with its contact shadow: it is not lifted.
TEST(SceneKeeper, AnObjectThatTheFilePutsOnAnotherPlaneStandsOnIt) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  runtime::Scene file = on_a_floor({box("a", 0)});
  file.real.emplace_back();
  file.real[1].plane = runtime::RealPlane{};
  file.real[1].plane->point.y = .3;
  r.start(file);
  runtime::Scene edited = file;
  edited.objects[0].position.y = .3;
  const SceneFile last = r.control.file();
  EXPECT_TRUE(apply_scene(r.shown, last.scene, edited, r.control));
  r.control.follow_file(last, edited, true);
  r.settle();
  ASSERT_TRUE(r.state("a"));
  EXPECT_NEAR(r.state("a")->height_m, 0, 1e-9);
  EXPECT_NEAR(r.state("a")->place.position_m.y, .3, 1e-9);
}

// Its bake ends after the file no longer has it.
TEST(SceneKeeper, AnObjectThatLeavesTheFileWhileItIsBakedDoesNotCome) {
  Running r;
  PENUMBRA_NEED_GL(r.pipeline);
  r.start(on_a_floor({box("a", 0)}));
  const auto read_anew = [&](const runtime::Scene& now) {
    const SceneFile last = r.control.file();
    r.control.follow_file(last, now, apply_scene(r.shown, last.scene, now, r.control));
  };
  auto slow = box("b", .5);
  slow.asset = "builtin:knot";
  read_anew(on_a_floor({box("a", 0), slow}));
  read_anew(on_a_floor({box("a", 0)}));
  r.settle();
  EXPECT_TRUE(r.state("a"));
  EXPECT_FALSE(r.state("b"));
}

}  // namespace
}  // namespace penumbra::service
