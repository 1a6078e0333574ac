#include "runtime/pipeline/runner.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/governor/governor_config.h"
#include "runtime/pipeline/light_estimation_stage.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <thread>

#include "runtime/pipeline/light_file.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/studio/studio_setup.h"
#include "shadows/shadows.h"
#include "tests/support/ball_pictures.h"
#include "tests/support/gl.h"

namespace penumbra::runtime {
namespace {

// A small studio with a coarse object, fast enough to start again and again.
struct Bench {
  std::shared_ptr<capture::FloorWorld> world;
  PreparedScene scene;
  capture::StudioOptions options;

  Bench() {
    world = *capture::FloorWorld::make(capture::make_room_environment(128, 64));
    prt::Mesh mesh = prt::make_sphere({0, .2f, 0}, .2f, 3, {.5f, .5f, .5f});
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 64;
    bake.bounces = 1;
    bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
    scene.objects.push_back({"sphere", *prt::bake(std::move(mesh), bake), {}, 0});
    options.environment_width = 128;
    options.environment_height = 64;
    options.view_width = 96;
    options.view_height = 64;
    options.view_focal_px = 80;
    options.view_fps = options.environment_fps = 200;
    options.view_frames = 24;
    options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
    options.sensor.response = calib::Response::srgb();
  }
};
Bench& bench() {
  static Bench b;
  return b;
}

struct Stages {
  StageTimes times;
  capture::Studio studio;
  Result<LightEstimationStage> light;
  Result<std::unique_ptr<CompositeStage>> compose;
  Stages()
      : studio(bench().world, bench().options),
        light(LightEstimationStage::create(studio.cameras(), {.bands = 4}, times)),
        compose(CompositeStage::create(studio.cameras(), bench().scene,
                                       compositor::Compositor::Surface::kOffscreen, times)) {}
};

TEST(Replay, SameInputGivesTheSameBytes) {
  std::vector<FramePixels> first;
  for (int run = 0; run < 2; ++run) {
    Stages s;
    PENUMBRA_NEED_GL(s.compose);
    std::size_t i = 0;
    const auto counts = run_replay(
        s.studio, *s.light, **s.compose,
        [&](const Output& out) {
          if (run == 0)
            first.push_back(*out.pixels);
          else
            EXPECT_TRUE(*out.pixels == first[i]);
          ++i;
          return true;
        },
        s.times);
    ASSERT_TRUE(counts) << counts.error().detail;
    EXPECT_EQ(counts->frames, 24u);
    EXPECT_EQ(i, 24u);
    EXPECT_EQ(counts->without_light, 0u)
        << "the environment's first frame comes before the first view frame";
  }
}

// The studio's view camera alone, with a mirror ball of half the picture's height before it.
class BallInView : public capture::FrameSource {
 public:
  BallInView() : studio_(bench().world, bench().options) {
    capture::CameraInfo view = studio_.cameras()[1];
    view.ball = {capture::Ball::OutlinePixels{{48, 32}, 16}, {}, 0};
    cameras_ = {view};
    const auto ball = *calib::MirrorBall::from_outline(view.projection, {48, 32}, 16);
    Image<Rgb> light(96, 64, {.3f, .3f, .3f});
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 96; ++x) {
        const auto ray = calib::direction_from_pixel(view.projection, {x + .5, y + .5});
        if (const auto d = test::reflected(ball, *ray))
          light.at(x, y) =
              bench().world->far_radiance(view.world_from_camera.rotation * *d) * (1 / 60.f);
      }
    picture_ = std::make_shared<const FramePixels>(std::move(light));
  }
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return 30; }
  Result<std::optional<capture::Frame>> next() override {
    if (given_ == 5) return std::nullopt;
    capture::Frame frame{0,
                         given_,
                         {33'000'000 * std::int64_t(given_)},
                         {Seconds(1), Gain(1)},
                         cameras_[0].world_from_camera,
                         picture_};
    ++given_;
    return frame;
  }

 private:
  capture::Studio studio_;
  std::vector<capture::CameraInfo> cameras_;
  std::shared_ptr<const FramePixels> picture_;
  std::uint64_t given_ = 0;
};

TEST(Replay, MirrorBallInTheViewCamerasPictureIsAllTheLightThatItNeeds) {
  for (const bool live : {false, true}) {
    StageTimes times;
    BallInView source;
    auto light = *LightEstimationStage::create(source.cameras(), {.bands = 4}, times);
    auto compose = CompositeStage::create(source.cameras(), bench().scene,
                                          compositor::Compositor::Surface::kOffscreen, times);
    if (!compose && compose.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1 here: " << compose.error().detail;
    double touched = 0, mean = 0;
    const auto sink = [&](const Output& out) {
      touched += *out.pixels != *out.source.pixels;
      mean = luminance(out.light.mean_radiance);
      return true;
    };
    std::atomic<bool> stop = false;
    const auto counts = live ? run_live(source, light, **compose, sink, times, stop)
                             : run_replay(source, light, **compose, sink, times);
    ASSERT_TRUE(counts) << counts.error().detail;
    EXPECT_EQ(counts->processor.has_value(), live);
    if (live) {
      EXPECT_GT(counts->processor->pipeline_ms, 0);
      EXPECT_GT(counts->processor->cameras_ms, 0) << "the studio films";
      EXPECT_GE(counts->processor->drawing_ms, 0);
      EXPECT_GE(counts->processor->other_ms, 0);
    }
    if (live) continue;  // how many frames it takes in time is the machine's
    EXPECT_EQ(counts->frames, 5u);
    EXPECT_EQ(counts->without_light, 0u);
    EXPECT_EQ(touched, 5);
    EXPECT_NEAR(mean, 1, .1) << "the world's mean luminance is 60";
  }
}

// The room's lamps saturate the first, longest exposure: lit by it alone the first frames would be
// dimmer.
TEST(Replay, FirstFramesAreLitByAWholeBracket) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  ASSERT_GT(s.studio.schedule().size(), 1u);
  std::vector<double> brightness, times;
  const auto counts = run_replay(
      s.studio, *s.light, **s.compose,
      [&](const Output& out) {
        brightness.push_back(luminance(out.light.mean_radiance));
        times.push_back((out.source.time - TimestampNs{0}).count());
        return true;
      },
      s.times);
  ASSERT_TRUE(counts) << counts.error().detail;
  ASSERT_EQ(brightness.size(), 24u);
  EXPECT_TRUE(std::ranges::is_sorted(times));
  for (const double b : brightness) EXPECT_NEAR(b / brightness.back(), 1, .02);
  // Naive: what the first exposure says.
  Stages naive;
  auto frame = naive.studio.next();
  while (frame && *frame && !naive.light->takes((*frame)->camera)) frame = naive.studio.next();
  ASSERT_TRUE(frame && *frame);
  const auto alone = naive.light->process(**frame);
  ASSERT_TRUE(alone);
  EXPECT_FALSE(naive.light->ready());
  EXPECT_LT(luminance(alone->mean_radiance), .9 * brightness.back());
}

// A warm-up before the first frame must leave nothing in it.
TEST(Replay, AWarmStageDrawsTheSameFrames) {
  std::vector<FramePixels> cold;
  for (const bool warm : {false, true}) {
    Stages s;
    PENUMBRA_NEED_GL(s.compose);
    if (warm) (*s.compose)->warm_up();
    std::size_t i = 0;
    const auto counts = run_replay(
        s.studio, *s.light, **s.compose,
        [&](const Output& out) {
          if (!warm)
            cold.push_back(*out.pixels);
          else
            EXPECT_TRUE(*out.pixels == cold[i]) << i;
          return ++i < 4;
        },
        s.times);
    ASSERT_TRUE(counts) << counts.error().detail;
  }
}

TEST(Replay, SinkStopsTheRun) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  int seen = 0;
  const auto counts = run_replay(
      s.studio, *s.light, **s.compose, [&](const Output&) { return ++seen < 5; }, s.times);
  ASSERT_TRUE(counts);
  EXPECT_EQ(counts->frames, 5u);
}

TEST(Live, EveryFrameIsHandedOutOrCountedAsDropped) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  const std::atomic<bool> stop = false;
  const auto counts = run_live(
      s.studio, *s.light, **s.compose, [](const Output&) { return true; }, s.times, stop);
  ASSERT_TRUE(counts) << counts.error().detail;
  EXPECT_GT(counts->frames, 0u);
  EXPECT_EQ(counts->frames + counts->overtaken.view, 24u);
  // How old motion and light are in what is handed out: of frames that were lit.
  int ages = 0;
  for (const auto& [name, p] : s.times.summary()) {
    if (name != "capture to picture" && name != "light to picture") continue;
    ++ages;
    EXPECT_EQ(p.count, counts->frames - counts->without_light) << name;
    EXPECT_GT(p.p50_ms, 0) << name;
    EXPECT_LT(p.p50_ms, 60'000) << name << ": another clock";
  }
  EXPECT_EQ(ages, counts->frames > counts->without_light ? 2 : 0);
}

TEST(Live, FramesThatComeLateAreTheSameAndInOrder) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  // Two pictures in turn; the next one always waits already, so that every frame ends beside the
  // begin of the next.
  capture::StudioOptions endless = bench().options;
  endless.view_fps = 2000;
  endless.view_frames = 1 << 30;
  endless.clip = 2;
  capture::Studio studio(bench().world, endless);
  struct Seen {
    capture::Frame frame;
    lighting::LightEstimate light;
    std::shared_ptr<const FramePixels> pixels;
  };
  std::vector<Seen> seen;
  std::atomic<bool> stop = false;
  const auto counts = run_live(
      studio, *s.light, **s.compose,
      [&](const Output& out) {
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
        if (out.light.valid) seen.push_back({out.source, out.light, out.pixels});
        return seen.size() < 40;
      },
      s.times, stop);
  ASSERT_TRUE(counts) << counts.error().detail;
  ASSERT_EQ(seen.size(), 40u);
  EXPECT_EQ(counts->frames - counts->without_light, 40u) << "what the sink did not want is none";
  Stages again;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (i > 0) {
      EXPECT_GT(seen[i].frame.time.value, seen[i - 1].frame.time.value);
    }
    const auto composited = (*again.compose)->process(seen[i].frame, seen[i].light);
    ASSERT_TRUE(composited);
    EXPECT_EQ(composited->pixels, *seen[i].pixels) << i;
  }
}

TEST(Live, LightsThatAFrameHasNoTimeForAreGivenUp) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  // Nobody has the twenty microseconds that a frame may take here.
  capture::StudioOptions hurried = bench().options;
  hurried.view_fps = 50'000;
  hurried.view_frames = 1 << 30;
  hurried.clip = 2;
  capture::Studio studio(bench().world, hurried);
  const auto governor_config =
      make_governor_config(bench().scene, {.max_error = .001}, CostSource::kFixed);
  ASSERT_TRUE(governor_config);
  s.light->set_governor(*governor_config);
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  bool traced = false, given_up = false;
  std::atomic<bool> stop = false;
  // For who lights other things by it the light keeps them.
  std::atomic<int> least_published = 64;
  std::atomic<bool> published_whole = true;
  LiveChanges changes;
  changes.on_light = [&](const LightEstimationStage& stage, const lighting::LightEstimate& light) {
    if (!stage.ready()) published_whole = false;
    least_published = std::min(least_published.load(), static_cast<int>(light.lights.size()));
  };
  const auto counts = run_live(
      studio, *s.light, **s.compose,
      [&](const Output& out) {
        traced |= out.light.plan && out.light.plan->lights > 0;
        given_up = out.light.plan && out.light.plan->time_limited && out.light.lights.empty();
        return !given_up && std::chrono::steady_clock::now() < end;
      },
      s.times, stop, changes);
  ASSERT_TRUE(counts) << counts.error().detail;
  EXPECT_TRUE(traced) << "the map needs distant lights";
  EXPECT_TRUE(given_up);
  EXPECT_GT(least_published, 0);
  EXPECT_TRUE(published_whole) << "the light of half a bracket is too dim";
}

TEST(Live, StopsAtAnyMomentAndJoinsItsThreads) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  for (int round = 0; round < 100; ++round) {
    capture::Studio studio(bench().world, [&] {
      capture::StudioOptions endless = bench().options;
      endless.view_frames = 1 << 30;
      endless.clip = 2;
      return endless;
    }());
    std::atomic<bool> stop = false;
    int seen = 0;
    const auto counts = run_live(
        studio, *s.light, **s.compose,
        [&](const Output&) {
          if (++seen > round % 4) stop = true;
          return true;
        },
        s.times, stop);
    ASSERT_TRUE(counts) << counts.error().detail;
  }
}

// A source that fails after some frames.
class FailingSource : public capture::FrameSource {
 public:
  explicit FailingSource(capture::FrameSource& source) : source_(source) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return source_.cameras(); }
  double view_rate() const override { return source_.view_rate(); }
  Result<std::optional<capture::Frame>> next() override {
    if (++count_ > 6) return fail(ErrorCode::kUnreadable, "camera", "pulled out");
    return source_.next();
  }

 protected:
  capture::FrameSource& inner() { return source_; }

 private:
  capture::FrameSource& source_;
  int count_ = 0;
};

TEST(Live, ErrorOfTheSourceReachesTheCaller) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  FailingSource source(s.studio);
  const std::atomic<bool> stop = false;
  const auto counts = run_live(
      source, *s.light, **s.compose, [](const Output&) { return true; }, s.times, stop);
  ASSERT_FALSE(counts);
  EXPECT_EQ(counts.error().where, "camera");
}

TEST(Live, ThrowingSinkEndsTheRunInsteadOfHangingIt) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  const std::atomic<bool> stop = false;
  EXPECT_THROW((void)run_live(
                   s.studio, *s.light, **s.compose,
                   [](const Output&) -> bool { throw std::runtime_error("full"); }, s.times, stop),
               std::runtime_error);
}

// Every third frame cannot be read.
class FlakySource : public FailingSource {
 public:
  using FailingSource::FailingSource;
  Result<std::optional<capture::Frame>> next() override {
    if (++calls_ % 3 == 0) return fail(ErrorCode::kUnreadable, "frame", "damaged");
    return inner().next();
  }

 private:
  int calls_ = 0;
};

TEST(Live, DamagedFramesAreCountedAndDoNotEndTheRun) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  FlakySource source(s.studio);
  const std::atomic<bool> stop = false;
  const auto counts = run_live(
      source, *s.light, **s.compose, [](const Output&) { return true; }, s.times, stop);
  ASSERT_TRUE(counts) << counts.error().detail;
  EXPECT_GT(counts->frames, 5u);
  EXPECT_GT(counts->unusable, 5u);
}

// One frame, then one that is due in an hour.
class GapSource : public FailingSource {
 public:
  using FailingSource::FailingSource;
  Result<std::optional<capture::Frame>> next() override {
    auto frame = FailingSource::next();
    if (frame && *frame && (*frame)->sequence > 0) (*frame)->time.value += 3'600'000'000'000;
    return frame;
  }
};

TEST(Live, StopDoesNotWaitForAFrameThatIsDueMuchLater) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  GapSource source(s.studio);
  std::atomic<bool> stop = false;
  const auto counts = run_live(
      source, *s.light, **s.compose,
      [&](const Output&) {
        stop = true;
        return true;
      },
      s.times, stop);
  EXPECT_TRUE(counts);
}

// A live source that gives one view frame and then waits for ever, as cameras do that were
// unplugged.
class SilentSource : public capture::FrameSource {
 public:
  explicit SilentSource(capture::Studio& studio) : studio_(studio) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return studio_.cameras(); }
  double view_rate() const override { return 30; }
  bool is_live() const override { return true; }
  Result<std::optional<capture::Frame>> next() override {
    while (!given_) {
      auto frame = studio_.next();
      given_ = cameras()[static_cast<std::size_t>((*frame)->camera)].role == capture::Role::kView;
      if (given_) return frame;
    }
    while (!closed_.wait(Seconds(60)) && !closed_.closed()) {
    }
    return std::nullopt;
  }
  void close() override { closed_.close(); }

 private:
  capture::Studio& studio_;
  bool given_ = false;
  Latest<int> closed_;
};

TEST(Live, StopReleasesASourceThatWaitsForACamera) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  SilentSource source(s.studio);
  std::atomic<bool> stop = false;
  const auto counts = run_live(
      source, *s.light, **s.compose, [&](const Output&) { return !(stop = true); }, s.times, stop);
  EXPECT_TRUE(counts);
}

TEST(Replay, DarkWorldIsAnErrorOnlyWhenNoLightEverCame) {
  Stages s;
  PENUMBRA_NEED_GL(s.compose);
  // Every environment frame is exposed so briefly that it is black.
  capture::StudioOptions dark = bench().options;
  dark.schedule = {{Seconds(1e-9), Gain(1)}};
  dark.sensor.noisy = false;
  capture::Studio studio(bench().world, dark);
  const auto counts = run_replay(
      studio, *s.light, **s.compose, [](const Output&) { return true; }, s.times);
  ASSERT_FALSE(counts);
  EXPECT_EQ(counts.error().code, ErrorCode::kUndetermined);
  EXPECT_NE(counts.error().detail.find("black"), std::string::npos);
}

}  // namespace
}  // namespace penumbra::runtime
