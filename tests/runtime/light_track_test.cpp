#include "runtime/pipeline/light_track.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/threads/stage_times.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "tests/support/irradiance.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

struct FilmedRoom {
  std::shared_ptr<capture::FloorWorld> world =
      *capture::FloorWorld::make(capture::make_room_environment(256, 128));
  capture::StudioOptions options;

  FilmedRoom() {
    options.environment_width = 256;
    options.environment_height = 128;
    options.view_width = 32;
    options.view_height = 24;
    options.view_focal_px = 30;
    options.view_frames = 12;
    options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
    options.sensor.response = calib::Response::srgb();
  }
};

std::string order_of(capture::FrameSource& source) {
  std::string out;
  while (auto frame = *source.next())
    out += source.cameras()[static_cast<std::size_t>(frame->camera)].name[0];
  return out;
}

TEST(LightTrackSource, MapsComeBehindTheFramesThatTheyAreMeasuredFrom) {
  const FilmedRoom room;
  capture::Studio studio(room.world, room.options);
  const auto plain = order_of(studio);
  for (const KeptLight keep : {KeptLight::kBoth, KeptLight::kTrack}) {
    capture::Studio again(room.world, room.options);
    auto tracked = *with_light_track(again, keep);
    const std::string order = order_of(*tracked);
    std::string expected;  // no map before the bracket is whole
    int exposures = 0;
    for (const char c : plain) {
      if (c == 'v' || keep == KeptLight::kBoth) expected += c;
      if (c == 'e' && ++exposures >= static_cast<int>(again.schedule().size())) expected += 'l';
    }
    EXPECT_EQ(order, expected);
    EXPECT_GT(std::ranges::count(order, 'l'), 5);
    const capture::CameraInfo& track = tracked->cameras().back();
    EXPECT_TRUE(track.gives_maps);
    EXPECT_EQ(track.projection.height, 128);
  }
}

// Finer maps are averaged, not sampled: all light stays, also of what is smaller than a pixel.
TEST(LightTrackSource, HalvedMapsKeepTheirLight) {
  const FilmedRoom room;
  const auto map_of = [&](int rows) {
    capture::Studio studio(room.world, room.options);
    auto tracked = *with_light_track(studio, KeptLight::kTrack, rows);
    EXPECT_EQ(tracked->cameras().back().projection.height, rows);
    for (;;)
      if (auto frame = *tracked->next(); frame->map) return *frame->map;
  };
  const Environment fine = map_of(128), coarse = map_of(32);
  EXPECT_EQ(coarse.radiance.height(), 32);
  // What is left is how the cosine varies within a pixel of 5.6 degrees.
  EXPECT_LT(test::irradiance_error(coarse.radiance, fine.radiance), .01);
}

// Whatever the cameras resolve: a fisheye of 275 pixels has 862 rows.
TEST(LightTrackSource, NoMapHasMoreRowsThanAskedFor) {
  FilmedRoom room;
  for (const int height : {64, 86, 90, 102, 128}) {
    room.options.environment_width = 2 * height, room.options.environment_height = height;
    for (const int most : {16, 50, 64}) {
      capture::Studio studio(room.world, room.options);
      auto tracked = *with_light_track(studio, KeptLight::kTrack, most);
      const int rows = tracked->cameras().back().projection.height;
      EXPECT_LE(rows, most) << height;
      EXPECT_GE(2 * rows + 4, std::min(most, height)) << height;
      EXPECT_EQ(rows % 2, 0) << height;
      for (;;)
        if (auto frame = *tracked->next(); frame->map) {
          EXPECT_EQ(frame->map->radiance.height(), rows) << height;
          break;
        }
    }
  }
}

TEST(LightTrackSource, ATrackBesideCamerasIsNoOneLight) {
  const FilmedRoom room;
  capture::Studio studio(room.world, room.options);
  auto both = *with_light_track(studio, KeptLight::kBoth);
  StageTimes times;
  EXPECT_FALSE(LightEstimationStage::create(both->cameras(), {.bands = 3}, times));
  EXPECT_FALSE(with_light_track(*both, KeptLight::kTrack));
}

TEST(LightTrackSource, ATrackOfATrackIsOneTrack) {
  const FilmedRoom room;
  for (const KeptLight keep : {KeptLight::kTrack, KeptLight::kBoth}) {
    capture::Studio studio(room.world, room.options);
    auto track = *with_light_track(studio, KeptLight::kTrack, 32);
    auto again = *with_light_track(*track, keep);
    ASSERT_EQ(again->cameras().size(), 2u);
    EXPECT_EQ(again->cameras()[1].projection.height, 32);
    EXPECT_EQ(order_of(*again).substr(0, 4), "vlvl");
  }
  // 172 x 86 pixels do not halve into even rows.
  FilmedRoom odd;
  odd.options.environment_width = 172, odd.options.environment_height = 86;
  for (const int rows : {86, 43}) {
    capture::Studio studio(odd.world, odd.options);
    auto track = *with_light_track(studio, KeptLight::kTrack, 86);
    auto again = *with_light_track(*track, KeptLight::kTrack, rows);
    const int promised = again->cameras().back().projection.height;
    for (;;)
      if (auto frame = *again->next(); frame->map) {
        EXPECT_EQ(frame->map->radiance.height(), promised) << rows;
        break;
      }
  }
}

TEST(LightTrackSource, AnEstimateFromTheRecordedTrackIsTheCameras) {
  const FilmedRoom room;
  const test::TempFolder folder;
  const auto path = folder.path() / "light.mkv";
  capture::Studio studio(room.world, room.options);
  StageTimes times;
  auto by_cameras = *LightEstimationStage::create(studio.cameras(), {.bands = 3}, times);
  lighting::LightEstimate from_cameras;
  {
    capture::Studio again(room.world, room.options);
    auto tracked = *with_light_track(again, KeptLight::kTrack);
    std::vector<capture::Coding> codings{capture::Coding::kRgb8, capture::Coding::kMap};
    auto writer = *capture::RecordingWriter::create(path, tracked->cameras(), codings, 30);
    while (auto frame = *tracked->next()) {
      const auto written = writer.write(*frame);
      ASSERT_TRUE(written) << written.error().detail;
    }
    ASSERT_TRUE(writer.finish());
    while (auto frame = *studio.next())
      if (by_cameras.takes(frame->camera)) {
        ASSERT_TRUE(by_cameras.process(*frame, from_cameras));
      }
  }
  auto replay = *capture::open_capture(path, capture::RecordedLight::kTrack);
  auto by_track = *LightEstimationStage::create(replay->cameras(), {.bands = 3}, times);
  lighting::LightEstimate from_track;
  while (auto frame = *replay->next())
    if (by_track.takes(frame->camera)) {
      ASSERT_TRUE(by_track.process(*frame, from_track));
    }
  EXPECT_TRUE(by_track.ready());
  EXPECT_EQ(from_track.time, from_cameras.time);
  ASSERT_EQ(from_track.lights.size(), from_cameras.lights.size());
  EXPECT_NEAR(from_track.coverage, from_cameras.coverage, 1e-3);
  for (int c = 0; c < 3; ++c) {
    const auto whole = double(from_cameras.light[0][c]);
    for (int n = 0; n < 9; ++n)
      EXPECT_NEAR(from_track.light[n][c], from_cameras.light[n][c], .01 * whole) << n << " " << c;
  }
}

TEST(LightTrackSource, RefusesWhatGivesNoLight) {
  const FilmedRoom room;
  capture::Studio studio(room.world, room.options);
  for (const int rows : {0, 15, 1025})
    EXPECT_FALSE(with_light_track(studio, KeptLight::kTrack, rows)) << rows;
  EXPECT_FALSE(kept_light("sun"));
  EXPECT_TRUE(kept_light("both"));
}

}  // namespace
}  // namespace penumbra::runtime
