// Every reader of outside bytes sees damaged files in every run: an error or a value, never a
// crash.
#include <gtest/gtest.h>

#include <cstring>

#include "capture/capture.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "prt/prt.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "tests/fuzz/mutate.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

namespace fs = std::filesystem;

class DamagedInput : public testing::Test {
 protected:
  fs::path path(const char* name) const { return folder_.path() / name; }

  // Writes damaged copies of `good` to `name` and reads each.
  void damage(const char* name, std::string_view good, int iterations, const auto& read) {
    std::vector<unsigned char> seed(good.size());
    std::memcpy(seed.data(), good.data(), good.size());
    int errors = 0;
    test::mutate_and_run(seed, iterations, 20260101, [&](std::span<const unsigned char> bytes) {
      ASSERT_TRUE(
          write_bytes(path(name), {reinterpret_cast<const char*>(bytes.data()), bytes.size()}));
      const auto result = read();
      if (result) return;
      ++errors;
      EXPECT_FALSE(result.error().where.empty());
      EXPECT_FALSE(result.error().detail.empty());
    });
    EXPECT_GT(errors, iterations / 20) << "the damage must be felt";
  }

 private:
  test::TempFolder folder_;
};

constexpr const char* kCapture = R"(version = 1
[[camera]]
name = "v"
role = "view"
width = 4
height = 2
projection = "pinhole"
focal_px = [3, 3]
response = "gamma:2.2"
black_level = 0.01
world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,1.5,0,1]
frames = "v.csv"
)";
constexpr const char* kList =
    "file,time_s,exposure_s,gain,tx,ty,tz,qx,qy,qz,qw\n"
    "a.png,0.0,0.01,1,0,0,0,0,0,0,1\na.png,0.033,0.01,1,0,0,0,0,0,0,1\n";
constexpr const char* kScene = R"(version = 1
[[object]]
name = "o"
asset = "builtin:knot"
albedo = [0.7, 0.7, 0.7]
position = [0, 0, 0]
rotation = [0, 0, 0, 1]
scale = 1.0
[[real]]
plane = { point = [0, 0, 0], normal = [0, 1, 0] }
albedo = [0.4, 0.4, 0.4]
)";
constexpr const char* kRig = R"(version = 1
[capture]
source = "studio"
fps = 30
width = 640
[light]
bands = 5
[http]
address = "127.0.0.1"
port = 0
)";

TEST_F(DamagedInput, CaptureManifestAndFrameList) {
  ASSERT_TRUE(codec::write_frame(path("a.png"), Image<Rgb8>(4, 2, {1, 2, 3})));
  ASSERT_TRUE(write_bytes(path("v.csv"), kList));
  const auto open = [&] { return capture::open_capture_folder(path("")); };
  damage("capture.toml", kCapture, 1500, open);
  ASSERT_TRUE(write_bytes(path("capture.toml"), kCapture));
  damage("v.csv", kList, 1500, open);
}

TEST_F(DamagedInput, SceneAndRig) {
  damage("scene.toml", kScene, 1500, [&] { return read_scene(path("scene.toml")); });
  damage("rig.toml", kRig, 1500, [&] { return service::read_rig_config(path("rig.toml")); });
}

TEST_F(DamagedInput, BakedObject) {
  prt::Mesh mesh = prt::make_box({0, 0, 0}, {1, 1, 1}, 1, {.5f, .5f, .5f});
  prt::BakeOptions options;
  options.bands = 2;
  options.rays = options.ground_rays = 64;
  options.visibility = true;
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 4), {}};
  const auto baked = prt::bake(std::move(mesh), options);
  ASSERT_TRUE(baked);
  ASSERT_TRUE(prt::write_baked(path("good.glb"), *baked));
  const auto bytes = read_bytes(path("good.glb"));
  ASSERT_TRUE(bytes);
  damage("bad.glb", {reinterpret_cast<const char*>(bytes->data()), bytes->size()}, 1500,
         [&] { return prt::read_baked(path("bad.glb")); });
}

}  // namespace
}  // namespace penumbra::runtime
