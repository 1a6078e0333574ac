// Every key that has another name now is refused with it, in the table that it belongs to.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <map>
#include <string>

#include "calib/camera/calibration_files.h"
#include "capture/recording/folder.h"
#include "core/io/renamed.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {

namespace {

class RenamedKeys : public testing::Test {
 protected:
  // The error of reading a text as a file of its kind; empty where it is read.
  std::string refusal(const std::string& name, const std::string& text) {
    const auto path = folder_.path() / name;
    std::ofstream(path, std::ios::binary) << text;
    const auto told = [](const auto& read) { return read ? "" : read.error().detail; };
    if (name == "rig.toml") return told(read_rig_config(path));
    if (name == "scene.toml") return told(runtime::read_scene(path));
    if (name == "capture.toml") return told(capture::open_capture_folder(folder_.path()));
    return told(calib::parse_noise_file(text, path));
  }
  test::TempFolder folder_;
};

TEST_F(RenamedKeys, AreRefusedWithTheNewNameEachInItsTable) {
  const std::string rig = "version = 1\n[capture]\nsource = \"studio\"\n",
                    object = "version = 1\n[[object]]\nasset = \"builtin:walker\"\n",
                    clip = object + "animation = \"Walk\"\n",
                    lens =
                        "version = 1\n[[camera]]\nname = \"e\"\nrole = \"environment\"\n"
                        "width = 16\nheight = 8\nresponse = \"srgb\"\nblack_level = 0.0\n"
                        "world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,1.5,0,1]\n"
                        "frames = \"e.csv\"\n[[camera.lens]]\ncrop_px = [0, 0, 8, 8]\n"
                        "projection = \"equidistant\"\n";
  struct OldFile {
    std::string name, text;
  };
  const std::map<std::string, OldFile, std::less<>> files{
      {"blend_share", {"scene.toml", clip + "blend = \"Wave\"\nblend_share = 0.5\n"}},
      {"live_ms", {"scene.toml", clip + "transfer = \"live\"\nlive_ms = 5\n"}},
      {"stand_size_m", {"scene.toml", object + "stand_size_m = 1\n"}},
      {"budget", {"rig.toml", rig + "[light]\nbudget = 0.05\n"}},
      {"discs", {"rig.toml", rig + "[light]\ndiscs = 4\n"}},
      {"prop", {"rig.toml", rig + "prop = \"builtin:box\"\n"}},
      {"field_deg", {"capture.toml", lens + "field_deg = 190\n"}},
      {"read_fraction",
       {"noise.toml",
        "version = 1\n[noise]\nfull_well_electrons = 9000\nread_fraction = 0.001\n"
        "black_level = 0\n"}},
  };
  for (const Renamed& key : kRenamedKeys) {
    const auto file = files.find(key.before);
    ASSERT_NE(file, files.end()) << key.before << " is not tried";
    EXPECT_THAT(refusal(file->second.name, file->second.text),
                testing::HasSubstr("\"" + std::string(key.before) + "\" is now \"" +
                                   std::string(key.now) + "\""));
  }
}

}  // namespace

}  // namespace penumbra::service
