// The key `pose` of a camera's table.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "capture/recording/camera_table.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

using testing::HasSubstr;

class PoseKey : public testing::Test {
 protected:
  Result<CameraInfo> read(const std::string& frame) const {
    std::ofstream(folder_.path() / "poses.toml")
        << "version = 1\n"
        << frame
        << "[[camera]]\nname = \"webcam\"\n"
           "world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 1,2,3,1]\n";
    const std::filesystem::path path = folder_.path() / "rig.toml";
    const auto table = parse_toml_text(
        "name = \"webcam\"\nrole = \"view\"\nwidth = 64\nheight = 48\n"
        "projection = \"pinhole\"\npose = \"poses.toml\"\n",
        path);
    return read_camera_info(TomlKeys(path, *table));
  }
  test::TempFolder folder_;
};

TEST_F(PoseKey, TakesPosesInTheWorld) {
  for (const char* frame :
       {"", "[rig]\nframe = \"board\"\n", "[rig]\nframe = \"first camera\"\n"}) {
    const auto camera = read(frame);
    ASSERT_TRUE(camera) << camera.error().detail;
    EXPECT_EQ(camera->world_from_camera.translation, glm::dvec3(1, 2, 3));
  }
}

TEST_F(PoseKey, RefusesPosesOnABodyByName) {
  const auto camera = read("[rig]\nframe = \"tracked body\"\ntracker_offset_s = 0.03\n");
  ASSERT_FALSE(camera);
  EXPECT_THAT(camera.error().detail, HasSubstr("pose: poses.toml has poses on a tracked body"));
}

}  // namespace
}  // namespace penumbra::capture
