// Exposure labels: right for every delay, and refused where the picture says otherwise.
#include "capture/device/internal/bracketed_camera.h"
#include "calib/calib.h"
#include "capture/capture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "core/conventions.h"
#include "tests/support/fake_camera.h"

namespace penumbra::capture {
namespace {

using test::FakeCamera;
using test::FakeCameraBehaviour;

const std::vector<Exposure> kSchedule = {
    {Seconds(.016), Gain(1)}, {Seconds(.004), Gain(1)}, {Seconds(.001), Gain(1)}};

Image<Rgb> scene() {
  Image<Rgb> room = make_room_environment(384, 192);
  double sum = 0;
  for (const Rgb& p : room.pixels()) sum += luminance(p);
  const auto scale = static_cast<float>(20 / (sum / static_cast<double>(room.area())));
  for (Rgb& p : room.pixels()) p = p * scale;
  return room;
}

CameraInfo info() {
  CameraInfo out;
  out.name = "environment";
  out.projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 384, 192);
  out.response = calib::Response::srgb();
  return out;
}

struct Outcome {
  int good = 0, wrong = 0;
  double worst_slip = 0;  // natural logarithm of label over truth, of good frames
  std::uint64_t last_wrong = 0, first_good = 0;
  CameraCounts counts;
  std::vector<Frame> frames;
};

Outcome run_camera(const FakeCameraBehaviour& behaviour, int frames, std::optional<int> delay = {},
                   const std::vector<Exposure>& schedule = kSchedule) {
  auto fake = std::make_unique<FakeCamera>(scene(), behaviour);
  FakeCamera& camera = *fake;
  BracketedCamera bracketed(info(), schedule, delay);
  EXPECT_TRUE(bracketed.connect(std::move(fake)));
  Outcome out;
  for (int i = 0; i < frames; ++i) {
    auto frame = bracketed.next(Seconds(.1));
    if (!frame) break;
    if (!*frame) continue;
    if (out.good++ == 0) out.first_good = camera.sensor_frame();
    const double slip = std::abs(std::log((*frame)->exposure.product() / camera.shown().product()));
    if (slip > .2)
      ++out.wrong, out.last_wrong = camera.sensor_frame();
    else
      out.worst_slip = std::max(out.worst_slip, slip);
    out.frames.push_back(**frame);
  }
  out.counts = bracketed.counts();
  return out;
}

// Drivers stamp a frame when it begins; with its transfer it may arrive more than a period later.
TEST(FrameCounter, CountsRequestsFromTheFrameThatArrivedLast) {
  for (const double latency : {.2, .99, 1.5}) {  // periods
    FrameCounter counter;
    const auto at = [](double periods) { return TimestampNs{} + Seconds(periods / 30); };
    for (int i = 0; i < 40; ++i) {
      const double jitter = .05 * (i % 3);
      EXPECT_EQ(counter.count(static_cast<std::uint64_t>(i), at(i), at(i + latency + jitter)),
                static_cast<std::uint64_t>(i));
      if (i < 10) continue;
      EXPECT_EQ(counter.at(at(i + latency + jitter + .1)), static_cast<std::uint64_t>(i))
          << latency;
      EXPECT_EQ(counter.at(at(i + latency + 2.5)), static_cast<std::uint64_t>(i) + 2) << latency;
      EXPECT_GT(counter.fresh().count() * 30, latency + .2);
      EXPECT_LT(counter.fresh().count() * 30, latency + .8);
    }
    EXPECT_EQ(counter.lost(), 0u);
  }
}

class Delay : public testing::TestWithParam<int> {};
TEST_P(Delay, IsMeasuredAndEveryLabelIsRight) {
  FakeCameraBehaviour b;
  b.delay = GetParam();
  const Outcome r = run_camera(b, 100);
  EXPECT_GT(r.good, 75);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_EQ(r.counts.rejected, 0u);
  ASSERT_TRUE(r.counts.delay_frames);
  // Delays that differ by a whole turn of the schedule are the same.
  EXPECT_EQ(*r.counts.delay_frames % 3, GetParam() % 3);
}
INSTANTIATE_TEST_SUITE_P(Frames, Delay, testing::Values(1, 2, 3, 5));

// Sensors that say in each frame's metadata what was applied, as through libcamera.
TEST(ExposureLabels, FramesThatTellTheirExposureNeedNoDelayAndAreCheckedAllTheSame) {
  FakeCameraBehaviour b;
  b.delay_at = [](std::uint64_t frame) { return 1 + static_cast<int>(frame / 7 % 4); };
  b.tells = [](Exposure applied) { return applied; };
  const Outcome honest = run_camera(b, 100);
  EXPECT_EQ(honest.good, 100);
  EXPECT_EQ(honest.wrong, 0);
  b.tells = [n = 0](Exposure applied) mutable {
    return ++n % 17 ? applied : Exposure{4 * applied.time, applied.gain};
  };
  const Outcome lying = run_camera(b, 170);
  EXPECT_EQ(lying.wrong, 0);
  EXPECT_GE(lying.counts.rejected, 9u);
}

TEST(ExposureLabels, ASlipOfOneFrameIsRefused) {
  FakeCameraBehaviour b;
  b.slips = [](std::uint64_t frame) { return frame > 40 && frame % 17 == 0; };
  const Outcome r = run_camera(b, 200);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_GE(r.counts.rejected, 9u);
  EXPECT_LE(r.counts.rejected, 10u);
  // Without the check as many labels are wrong.
  int naive = 0;
  for (std::uint64_t frame = 41; frame <= 200; ++frame) naive += frame % 17 == 0;
  EXPECT_EQ(static_cast<int>(r.counts.rejected), naive);
}

TEST(ExposureLabels, AnotherDelayFromNowOnIsFoundWithinThirtyFrames) {
  FakeCameraBehaviour b;
  b.delay_at = [](std::uint64_t frame) { return frame < 60 ? 1 : 3; };
  const Outcome r = run_camera(b, 160);
  EXPECT_EQ(r.wrong, 0);
  ASSERT_TRUE(r.counts.delay_frames);
  EXPECT_EQ(*r.counts.delay_frames, 3);
  EXPECT_LE(r.counts.rejected, 30u);
  EXPECT_GT(r.good, 110);
}

TEST(ExposureLabels, FramesThatNeverCameAndWereNotCountedAreFoundByTheirTime) {
  FakeCameraBehaviour b;
  b.delay = 3;
  b.lost = [](std::uint64_t frame) { return frame % 5 == 0; };
  const Outcome r = run_camera(b, 200);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_NEAR(double(r.counts.lost), 50, 3);
  EXPECT_GT(r.good, 120);
}

TEST(ExposureLabels, ACameraThatIgnoresExposureIsNamed) {
  FakeCameraBehaviour b;
  b.ignores_controls = [](std::uint64_t) { return true; };
  const Outcome r = run_camera(b, 100);
  EXPECT_EQ(r.good, 0);
  EXPECT_TRUE(r.counts.ignores_controls);
}

TEST(ExposureLabels, ACameraThatFollowsAgainIsBelievedAgain) {
  FakeCameraBehaviour b;
  b.ignores_controls = [](std::uint64_t frame) { return frame > 60 && frame <= 100; };
  EXPECT_TRUE(run_camera(b, 100).counts.ignores_controls);
  const Outcome r = run_camera(b, 200);
  EXPECT_FALSE(r.counts.ignores_controls);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_GT(r.good, 110);
}

TEST(ExposureLabels, AChangeOfLightIsNoSlip) {
  FakeCameraBehaviour b;
  b.light = [](double t) { return t < 2 ? 1. : 1.8; };
  const Outcome r = run_camera(b, 150);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_LE(r.counts.rejected, 2u);
  // Even one that looks like a slip is believed when it stays.
  b.light = [](double t) { return t < 2 ? 1. : .25; };
  const Outcome quarter = run_camera(b, 200);
  EXPECT_EQ(quarter.wrong, 0);
  EXPECT_LE(quarter.counts.rejected, 25u);
  EXPECT_GT(quarter.good, 140);
}

// A lamp on 100 Hz mains under a camera at 30 frames a second and exposures much shorter than a
// period.
TEST(ExposureLabels, FlickerOfTheMainsGoesIntoTheGain) {
  FakeCameraBehaviour b;
  b.light = [](double t) { return 1 + .1 * std::sin(2 * kPi * 100 * t + .3); };
  b.fps = 29.3;
  const Outcome r = run_camera(b, 300);
  EXPECT_EQ(r.counts.rejected, 0u);
  // RMS of the change from frame to frame, of the radiance that the frames of one exposure give.
  const auto flicker = [&](bool with_gain) {
    BrightnessMeter meter(info());
    std::optional<Brightness> first;
    std::vector<double> ratios;
    for (std::size_t i = 60; i < r.frames.size(); ++i) {
      const Frame& f = r.frames[i];
      if (std::abs(f.exposure.time.count() - .004) > 1e-9) continue;
      Brightness seen = meter.measure(*f.pixels);
      for (float& v : seen.blocks)
        v /= static_cast<float>(with_gain ? f.exposure.product() : f.exposure.time.count());
      if (!first) first = seen;
      std::vector<double> blocks;
      for (std::size_t k = 0; k < seen.blocks.size(); ++k)
        if (seen.blocks[k] > 0 && first->blocks[k] > 0)
          blocks.push_back(seen.blocks[k] / first->blocks[k]);
      std::ranges::nth_element(blocks, blocks.begin() + std::ssize(blocks) / 2);
      ratios.push_back(blocks[blocks.size() / 2]);
    }
    double squares = 0;
    for (std::size_t i = 1; i < ratios.size(); ++i)
      squares += std::pow(ratios[i] / ratios[i - 1] - 1, 2);
    return std::sqrt(squares / static_cast<double>(ratios.size() - 1));
  };
  EXPECT_GT(flicker(false), .05);
  EXPECT_LT(flicker(true), .005);
}

// A camera whose times are not what it says: each by itself could be true, but their pictures tell
// the ratios.
TEST(ExposureLabels, RatiosThatTheCameraGetsWrongAreFoundFromOverlaps) {
  FakeCameraBehaviour b;
  b.really = [](Exposure asked) {
    const double factor = asked.time.count() > .01 ? 1 : asked.time.count() > .002 ? .9 : 1.1;
    return Exposure{asked.time * factor, asked.gain};
  };
  const Outcome r = run_camera(b, 150);
  EXPECT_EQ(r.counts.rejected, 0u);
  std::map<double, double> told_over_asked;
  for (std::size_t i = 100; i < r.frames.size(); ++i) {
    const Exposure& told = r.frames[i].exposure;
    told_over_asked[told.time.count()] = told.gain.value();
  }
  ASSERT_EQ(told_over_asked.size(), 3u);
  const double longest = told_over_asked[.016];  // one scale for all is the camera's own
  EXPECT_NEAR(told_over_asked[.004] / longest, .9, .01);
  EXPECT_NEAR(told_over_asked[.001] / longest, 1.1, .012);
}

// Other exposures are asked for while it films, and then the first ones again: what was asked for
// before is still on its way, up to ten frames.
TEST_P(Delay, OtherExposuresThatAreAskedForComeWithTheirLabels) {
  const std::vector<Exposure> one{{Seconds(.008), Gain(1)}},
      four{{Seconds(.03), Gain(1)},
           {Seconds(.01), Gain(1)},
           {Seconds(.002), Gain(1)},
           {Seconds(.0005), Gain(1)}},
      other{{Seconds(.0012), Gain(1)}};
  const std::pair<std::vector<Exposure>, std::vector<Exposure>> changes[] = {
      {kSchedule, one}, {kSchedule, four}, {one, other}, {one, kSchedule}};
  for (const auto& [before, after] : changes) {
    FakeCameraBehaviour b;
    b.delay = GetParam();
    auto fake = std::make_unique<FakeCamera>(scene(), b);
    FakeCamera& camera = *fake;
    BracketedCamera bracketed(info(), before, {});
    ASSERT_TRUE(bracketed.connect(std::move(fake)));
    int wrong = 0;
    const auto film = [&](int frames) {
      std::map<double, int> times;
      for (int i = 0; i < frames; ++i) {
        const auto frame = bracketed.next(Seconds(.1));
        if (!frame || !*frame) continue;
        wrong += (*frame)->exposure.time != camera.shown().time;
        if (i >= frames - 24) ++times[(*frame)->exposure.time.count()];
      }
      return times;
    };
    EXPECT_EQ(film(70).size(), before.size());
    bracketed.set_exposures(after);
    const auto taken = film(70);
    EXPECT_EQ(taken.size(), after.size());
    for (const Exposure& e : after) EXPECT_TRUE(taken.contains(e.time.count()));
    bracketed.set_exposures({});
    EXPECT_EQ(film(70).size(), before.size());
    EXPECT_EQ(wrong, 0) << before.size() << " to " << after.size();
    EXPECT_EQ(bracketed.counts().exposures.size(), before.size());
  }
}

TEST(BracketedCamera, ExposuresThatNobodyGaveAreNotSet) {
  BracketedCamera as_it_stands(info(), {}, {});
  EXPECT_FALSE(as_it_stands.sets_exposures());
  EXPECT_TRUE(BracketedCamera(info(), {}, {}, .01).sets_exposures()) << "chosen from the light";
}

// Asked for while it is unplugged, they are there when it is back.
TEST(BracketedCamera, ExposuresAreAskedForWhenTheCameraIsBack) {
  FakeCameraBehaviour b;
  b.gone_after = 20;
  BracketedCamera bracketed(info(), {{Seconds(.004), Gain(1)}}, {});
  ASSERT_TRUE(bracketed.connect(std::make_unique<FakeCamera>(scene(), b)));
  while (bracketed.connected()) (void)bracketed.next(Seconds(.1));
  bracketed.set_exposures({{Seconds(.001), Gain(1)}});
  auto again = std::make_unique<FakeCamera>(scene(), FakeCameraBehaviour{});
  FakeCamera& camera = *again;
  ASSERT_TRUE(bracketed.connect(std::move(again)));
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(bracketed.next(Seconds(.1)));
  EXPECT_EQ(camera.shown().time, Seconds(.001));
}

TEST(BracketedCamera, DamagedFramesAreCountedAndNeverShown) {
  FakeCameraBehaviour b;
  b.damaged = [](std::uint64_t frame) { return frame % 7 == 0; };
  const Outcome r = run_camera(b, 140);
  EXPECT_EQ(r.wrong, 0);
  EXPECT_GE(r.counts.damaged, 20u);
  EXPECT_GT(r.good, 90);
}

TEST(BracketedCamera, OneExposureNeedsNoMeasuring) {
  const Outcome r = run_camera({}, 20, {}, {{Seconds(.004), Gain(1)}});
  EXPECT_EQ(r.good, 20);
}

// A camera of one exposure that is asked for a darker frame after `asked_after` frames.
struct Darker {
  int shown_dark = 0;  // of those for the view: a flash of darkness
  int shown = 0;
  std::vector<Frame> for_light;
  std::vector<Exposure> truth;  // of those
  bool can_still = true;        // afterwards
};
Darker ask_for_darker(FakeCameraBehaviour behaviour, double factor = 1. / 8,
                      double exposure_s = .004, const Image<Rgb>& world = scene()) {
  constexpr int kFrames = 80, kAskedAfter = 10;
  auto fake = std::make_unique<FakeCamera>(world, behaviour);
  FakeCamera& camera = *fake;
  BracketedCamera bracketed(info(), {{Seconds(exposure_s), Gain(1)}}, {});
  EXPECT_TRUE(bracketed.connect(std::move(fake)));
  EXPECT_TRUE(bracketed.can_take_darker());
  Darker out;
  std::map<std::uint64_t, Exposure> really;  // by sensor frame
  for (int i = 0; i < kFrames; ++i) {
    if (i == kAskedAfter) bracketed.take_darker(factor);
    const auto frame = bracketed.next(Seconds(.1));
    really[camera.sensor_frame()] = camera.shown();
    if (!frame || !*frame) continue;
    const auto number = std::lround(((*frame)->time - TimestampNs{}).count() * behaviour.fps);
    const Exposure& truth = really.at(static_cast<std::uint64_t>(number));
    if ((*frame)->for_light) {
      out.for_light.push_back(**frame);
      out.truth.push_back(truth);
    } else {
      ++out.shown;
      out.shown_dark += truth.time < Seconds(.9 * exposure_s);
    }
  }
  EXPECT_EQ(bracketed.counts().frames, std::uint64_t(out.shown) + out.for_light.size());
  out.can_still = bracketed.can_take_darker();
  return out;
}

class DarkerFrames : public testing::TestWithParam<int> {};
TEST_P(DarkerFrames, OneComesBesideTheOthersWhateverTheDelay) {
  for (const double exposure_s : {.004, .1}) {  // of which the second overexposes
    FakeCameraBehaviour b;
    b.delay = GetParam();
    const Darker d = ask_for_darker(b, 1. / 8, exposure_s);
    ASSERT_EQ(d.for_light.size(), 1u) << exposure_s;
    EXPECT_DOUBLE_EQ(d.for_light[0].exposure.time.count(), exposure_s / 8);
    EXPECT_DOUBLE_EQ(d.truth[0].time.count(), exposure_s / 8);
    EXPECT_EQ(d.shown_dark, 0);
    EXPECT_GE(d.shown, 77) << "the view misses no more than that one";
  }
}
INSTANTIATE_TEST_SUITE_P(Frames, DarkerFrames, testing::Values(1, 2, 3, 5));

TEST(DarkerFrame, NoneComesOfACameraThatDoesNotFollow) {
  FakeCameraBehaviour b;
  b.ignores_controls = [](std::uint64_t) { return true; };
  const Darker d = ask_for_darker(b);
  EXPECT_TRUE(d.for_light.empty());
  EXPECT_EQ(d.shown, 80);
  // After the third time it is believed.
  auto fake = std::make_unique<FakeCamera>(scene(), b);
  BracketedCamera bracketed(info(), {{Seconds(.004), Gain(1)}}, {});
  ASSERT_TRUE(bracketed.connect(std::move(fake)));
  for (int i = 0; i < 60; ++i) {
    if (i % 15 == 0) bracketed.take_darker(1. / 8);
    EXPECT_TRUE(bracketed.next(Seconds(.1)));
  }
  EXPECT_FALSE(bracketed.can_take_darker());
}

// The frame at an eighth looks like the others: no pixel of either is below white.
TEST(DarkerFrame, AWhitePictureIsAskedForDarkerStill) {
  const Darker d = ask_for_darker({}, 1. / 8, 2., Image<Rgb>(384, 192, {20, 20, 20}));
  ASSERT_EQ(d.for_light.size(), 1u);
  EXPECT_DOUBLE_EQ(d.for_light[0].exposure.time.count(), 2. / 64);
  EXPECT_DOUBLE_EQ(d.truth[0].time.count(), 2. / 64);
}

// A hand before the camera for two frames.
TEST(DarkerFrame, APartThatIsCoveredIsNoExposure) {
  FakeCameraBehaviour b;
  b.ignores_controls = [](std::uint64_t) { return true; };
  b.covers = [](std::uint64_t frame, Image<Rgb>& picture) {
    if (frame != 13 && frame != 14) return;
    for (int y = 0; y < picture.height(); ++y)
      for (int x = 0; x < picture.width() * 2 / 5; ++x) picture.at(x, y) = {.5f, .4f, .3f};
  };
  const Darker d = ask_for_darker(b);
  EXPECT_TRUE(d.for_light.empty());
  EXPECT_EQ(d.shown, 80);
}

// The request that ends it is refused twice: the camera must not stay dark.
TEST(DarkerFrame, ARefusedRequestIsMadeAgain) {
  FakeCameraBehaviour b;
  b.refuses = [](int request) { return request == 2 || request == 3; };
  const Darker d = ask_for_darker(b);
  EXPECT_LE(d.shown_dark, 1);
  EXPECT_GE(d.shown, 75);
  b.refuses = [](int request) { return request >= 1; };  // none after the first
  EXPECT_EQ(ask_for_darker(b).shown, 80);
}

// A lamp that is switched off while a darker frame is awaited darkens every frame.
TEST(DarkerFrame, ALampThatGoesOutIsNoExposure) {
  FakeCameraBehaviour b;
  b.ignores_controls = [](std::uint64_t) { return true; };
  b.light = [](double s) { return s > 13 / 30. ? .2 : 1; };
  const Darker d = ask_for_darker(b);
  EXPECT_TRUE(d.for_light.empty());
  EXPECT_GE(d.shown, 77);
}

TEST(DarkerFrame, FramesThatTellTheirExposureAreBelieved) {
  FakeCameraBehaviour b;
  b.tells = [](Exposure e) { return e; };
  b.light = [](double s) { return s > 11 / 30. ? 5 : 1; };  // as much brighter as it is darker
  const Darker d = ask_for_darker(b, 1. / 5);
  ASSERT_EQ(d.for_light.size(), 1u);
  EXPECT_DOUBLE_EQ(d.truth[0].time.count(), .004 / 5);
}

TEST(DarkerFrame, ABracketIsNotAskedForOne) {
  BracketedCamera bracketed(info(), kSchedule, {});
  EXPECT_FALSE(bracketed.can_take_darker());
}

}  // namespace
}  // namespace penumbra::capture
