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
