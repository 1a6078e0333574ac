#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

using testing::HasSubstr;

const std::string kCamera =
    "[[camera]]\nname = \"left\"\nworld_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 1,2,3,1]\n"
    "position_sigma_mm = [0.4, 0.3, 0.7]\n";

std::string refusal(const std::string& text) {
  const auto file = parse_pose_file(text, "poses.toml");
  return file ? "" : file.error().where + ": " + file.error().detail;
}

TEST(PoseFile, TellsABodyFromTheWorld) {
  const auto frame = [](const std::string& rig) {
    return parse_pose_file("version = 1\n" + rig + kCamera, "poses.toml")->poses_in;
  };
  EXPECT_EQ(frame(""), PosesIn::kWorld);  // written by hand
  EXPECT_EQ(frame("[rig]\nframe = \"board\"\n"), PosesIn::kWorld);
  EXPECT_EQ(frame("[rig]\nframe = \"first camera\"\n"), PosesIn::kFirstCamera);
  EXPECT_EQ(frame("[rig]\nframe = \"tracked body\"\nrms_px = 0.2\n"), PosesIn::kTrackedBody);
}

TEST(PoseFile, ReadsEachCameraAndTheTrackersOffset) {
  const auto file = parse_pose_file(
      "version = 1\n[rig]\nframe = \"tracked body\"\ntracker_offset_s = -0.012\n" + kCamera,
      "poses.toml");
  ASSERT_TRUE(file);
  ASSERT_EQ(file->cameras.size(), 1u);
  EXPECT_EQ(file->cameras[0].name, "left");
  EXPECT_EQ(file->cameras[0].pose.translation, glm::dvec3(1, 2, 3));
  EXPECT_EQ(file->tracker_offset, Seconds(-.012));
}

TEST(PoseFile, RefusesWhatItCannotTake) {
  EXPECT_EQ(refusal("version = 1\n" + kCamera), "");
  EXPECT_THAT(refusal(kCamera), HasSubstr("version"));
  EXPECT_THAT(refusal("version = 1\n[rig]\nframe = \"head\"\n" + kCamera),
              HasSubstr("poses.toml:3: frame: \"head\" is none of"));
  EXPECT_THAT(refusal("version = 1\n[rig]\ntracker_offset_s = 1e9\n" + kCamera),
              HasSubstr("an hour"));
  EXPECT_THAT(refusal("version = 1\n" + kCamera + kCamera), HasSubstr("twice"));
  EXPECT_THAT(refusal("version = 1\n[[camera]]\nname = \"a\"\nworld_from_camera = "
                      "[2,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n"),
              HasSubstr("not orthonormal"));
  EXPECT_THAT(refusal("version = 1\n[[camera]]\nname = \"a\"\nworld_from_camera = "
                      "[-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n"),
              HasSubstr("mirrors"));
  EXPECT_THAT(refusal("version = 1\nrig = 3\n" + kCamera), HasSubstr("[rig]"));
}

}  // namespace
}  // namespace penumbra::calib
