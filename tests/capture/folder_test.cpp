#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "capture/capture.h"
#include "codec/codec.h"
#include "codec/log/log_jpeg2000.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

namespace fs = std::filesystem;

constexpr int kFolderWidth = 16, kFolderHeight = 8;

void write_text(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

const std::string kManifest = R"(version = 1
[[camera]]
name = "environment"
role = "environment"
width = 16
height = 8
projection = "latlong"
response = "srgb"
black_level = 0.0
world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,1.5,0,1]
frames = "environment.csv"
)";
const std::string kList =
    "file,time_s,exposure_s,gain\n"
    "environment/0.png,0.0,0.01,1\n"
    "environment/1.png,0.033333333,0.02,2\n";

/// A good folder by hand, which each test then spoils.
class HandMade {
 public:
  HandMade() {
    fs::create_directories(path() / "environment");
    for (const char* name : {"0.png", "1.png"}) {
      const auto written = codec::write_frame(path() / "environment" / name,
                                              Image<Rgb8>(kFolderWidth, kFolderHeight, {1, 2, 3}));
      EXPECT_TRUE(written.has_value());
    }
    write_text(path() / "capture.toml", kManifest);
    write_text(path() / "environment.csv", kList);
  }
  const fs::path& path() const { return folder_.path(); }

 private:
  test::TempFolder folder_;
};

void expect_error(const fs::path& folder, ErrorCode code, const std::string& where,
                  const std::string& detail) {
  const auto source = open_capture_folder(folder);
  ASSERT_FALSE(source.has_value()) << "expected: " << where << ": " << detail;
  EXPECT_EQ(source.error().code, code) << source.error().where << ": " << source.error().detail;
  EXPECT_NE(source.error().where.find(where), std::string::npos)
      << source.error().where << ": " << source.error().detail << ", expected " << where;
  EXPECT_NE(source.error().detail.find(detail), std::string::npos)
      << source.error().detail << ", expected " << detail;
}

TEST(CaptureFolder, ReadsAHandMadeFolder) {
  const HandMade made;
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  ASSERT_EQ((*source)->cameras().size(), 1U);
  const CameraInfo& camera = (*source)->cameras()[0];
  EXPECT_EQ(camera.name, "environment");
  EXPECT_EQ(camera.role, Role::kEnvironment);
  EXPECT_EQ(camera.response.describe(), "srgb");
  EXPECT_EQ(camera.world_from_camera.translation, glm::dvec3(0, 1.5, 0));
  const auto first = (*source)->next();
  ASSERT_TRUE(first && *first);
  EXPECT_EQ((*first)->time.value, 0);
  const auto second = (*source)->next();
  ASSERT_TRUE(second && *second);
  EXPECT_EQ((*second)->time.value, 33'333'333);
  EXPECT_EQ((*second)->sequence, 1U);
  EXPECT_DOUBLE_EQ((*second)->exposure.product(), .04);
  EXPECT_EQ((*second)->world_from_camera, camera.world_from_camera);
  EXPECT_EQ(std::get<Image<Rgb8>>(*(*second)->pixels).at(3, 4), (Rgb8{1, 2, 3}));
  const auto end = (*source)->next();
  ASSERT_TRUE(end.has_value());
  EXPECT_FALSE(end->has_value());
}

TEST(CaptureFolder, ReadsIntrinsicsAndNoise) {
  const HandMade made;
  write_text(made.path() / "capture.toml",
             replaced(kManifest, "projection = \"latlong\"",
                      "projection = \"equidistant\"\nfocal_px = [4, 5.5]\nprincipal_px = [8, 4]\n"
                      "distortion = [0, 0.0]\nfull_well_electrons = 9000\nread_noise = 1e-3"));
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  const CameraInfo& camera = (*source)->cameras()[0];
  EXPECT_EQ(camera.projection.focal_px, glm::dvec2(4, 5.5));
  EXPECT_EQ(camera.projection.principal_px, glm::dvec2(8, 4));
  EXPECT_EQ(camera.noise.full_well_electrons, 9000);
  EXPECT_EQ(camera.noise.read_noise, 1e-3);
}

// The hand-made camera, 16 x 8, with two lenses side by side; `change` replaces a part of the text.
std::string with_lenses(const std::string& from = "", const std::string& to = "") {
  const std::string text =
      replaced(kManifest, "projection = \"latlong\"\n", "") +
      "\n[[camera.lens]]\ncrop_px = [0, 0, 8, 8]\nprojection = \"equidistant\"\nfov_deg = 200\n"
      "\n[[camera.lens]]\ncrop_px = [8, 0, 8, 8]\nprojection = \"kb4\"\nfocal_px = [3, 3]\n"
      "distortion = [0.01]\nfov_deg = 190\n"
      "camera_from_lens = [-1,0,0,0, 0,1,0,0, 0,0,-1,0, 0,0,0,1]\n";
  return from.empty() ? text : replaced(text, from, to);
}

TEST(CaptureFolder, ReadsLenses) {
  const HandMade made;
  write_text(made.path() / "capture.toml", with_lenses());
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  const CameraInfo& camera = (*source)->cameras()[0];
  ASSERT_EQ(camera.lenses.size(), 2u);
  EXPECT_EQ(camera.projection.width, 16);
  EXPECT_EQ(camera.lenses[1].x_px, 8);
  EXPECT_EQ(camera.lenses[1].projection.width, 8);
  EXPECT_EQ(camera.lenses[1].projection.distortion[0], .01);
  EXPECT_NEAR(camera.lenses[1].half_field_of_view_rad, 95 * kPi / 180, 1e-12);
  EXPECT_NEAR(std::abs(camera.lenses[1].camera_from_lens.y), 1, 1e-12);
}

TEST(CaptureFolder, RefusesBadLensesAndBalls) {
  const HandMade made;
  const auto expect_refused = [&](const std::string& text, const std::string& detail) {
    write_text(made.path() / "capture.toml", text);
    const auto source = open_capture_folder(made.path());
    ASSERT_FALSE(source.has_value()) << detail;
    EXPECT_EQ(source.error().code, ErrorCode::kInvalid);
    EXPECT_NE(source.error().where.find(".toml:"), std::string::npos);
    EXPECT_NE(source.error().detail.find(detail), std::string::npos) << source.error().detail;
  };
  expect_refused(with_lenses("[8, 0, 8, 8]", "[9, 0, 8, 8]"),
                 "crop_px: is not x, y, width, height");
  expect_refused(with_lenses("[8, 0, 8, 8]", "[8, 0, 7.5, 8]"),
                 "crop_px: is not x, y, width, height");
  expect_refused(with_lenses("fov_deg = 190", "fov_deg = 0"), "fov_deg: is not above 0");
  expect_refused(with_lenses("fov_deg = 190", ""), "fov_deg: is missing");
  expect_refused(with_lenses("\"kb4\"", "\"latlong\""), "projection");
  expect_refused(with_lenses("fov_deg = 190", "fov_deg = 190\nname = \"x\""), "unknown key");
  expect_refused(with_lenses("height = 8", "height = 8\nprojection = \"latlong\""),
                 "projection: belongs into each [[camera.lens]]");
  expect_refused(with_lenses("height = 8", "height = 8\nfocal_px = [3, 3]"),
                 "focal_px: belongs into each [[camera.lens]]");
  expect_refused(with_lenses("role = \"environment\"", "role = \"view\""),
                 "lens: belongs to environment cameras");
  const auto ball = [](const std::string& keys) {
    return replaced(replaced(kManifest, "\"latlong\"", "\"pinhole\""), "role = \"environment\"",
                    "role = \"view\"") +
           "\n[camera.ball]\n" + keys;
  };
  expect_refused(ball(""), "either outline_px, or centre_m");
  expect_refused(ball("outline_px = [4, 4, 2]\ncentre_m = [0, 0, 0]"), "either outline_px");
  expect_refused(ball("outline_px = [4, 4]"), "outline_px: has 2 numbers instead of 3");
  expect_refused(ball("outline_px = [4, 4, -2]"), "outline_px: has a radius that is not positive");
  expect_refused(ball("outline_px = [4, 4, 1e9]"), "outline_px: the mirror ball cannot be found");
  expect_refused(ball("outline_px = [8, 4, 0.5]"), "pixels large");
  expect_refused(ball("outline_px = [4, 4, 2]\nradius_m = 1"), "radius_m: belongs to centre_m");
  expect_refused(ball("centre_m = [0, 0, 0]"), "radius_m: is missing");
  expect_refused(ball("centre_m = [0, 0, 0]\nradius_m = 0"), "radius_m: is not positive");
  expect_refused(ball("centre_m = [0, 0, 0]\nradius_m = 1\nreflectance = [1, 1, 1.1]"),
                 "reflectance: has a number that is not");
  write_text(made.path() / "self.toml",
             replaced(kManifest, "projection = \"latlong\"", "intrinsics = \"self.toml\""));
  expect_refused(replaced(kManifest, "projection = \"latlong\"", "intrinsics = \"self.toml\""),
                 "has a projection of its own");
  expect_refused(std::string(kManifest) + "\n[camera.ball]\noutline_px = [4, 4, 2]",
                 "ball: belongs to view cameras");
}

TEST(CaptureFolder, TimesInAnyDecimalFormAreNanoseconds) {
  const HandMade made;
  const std::vector<std::pair<std::string, std::int64_t>> times{
      {"-.5", -500'000'000}, {"0", 0},
      {"1e-3", 1'000'000},   {"0.0333333335", 33'333'334},
      {"2.", 2'000'000'000}, {"1700000000.123456789", 1'700'000'000'123'456'789}};
  std::string list = "file,time_s,exposure_s,gain\r\n";
  for (const auto& [text, ns] : times) list += "environment/0.png, " + text + ", 1, 1\r\n";
  write_text(made.path() / "environment.csv", list);
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  for (const auto& [text, ns] : times) {
    const auto frame = (*source)->next();
    ASSERT_TRUE(frame && *frame);
    EXPECT_EQ((*frame)->time.value, ns) << text;
  }
}

TEST(CaptureFolder, RefusesABadManifestNamingFileLineAndKey) {
  struct Case {
    std::string from, to, line, detail;
  };
  const HandMade made;
  for (const Case& c : std::vector<Case>{
           {"version = 1", "version = 2", ":1", "version: is not 1"},
           {"version = 1", "# none", ":", "version: is missing"},
           {"version = 1", "version = 1\ncolour = 3", ":2", "unknown key \"colour\""},
           {"black_level = 0.0", "blacklevel = 0.0", ":9", "unknown key \"blacklevel\""},
           {"[[camera]]", "[camera]", ":", "tables [[camera]]"},
           {"name = \"environment\"\n", "", ":2", "name: is missing"},
           {"name = \"environment\"", "name = \"\"", ":3", "name: is empty"},
           {"name = \"environment\"", "name = 3", ":3", "name: is not text"},
           {"role = \"environment\"", "role = \"light\"", ":4", "role: \"light\""},
           {"role = \"environment\"", "role = \"view\"\neye = \"third\"", ":5", "eye: \"third\""},
           {"role = \"environment\"", "role = \"depth\"", ":8", "response: means nothing"},
           {"role = \"environment\"", "role = \"mask\"", ":8", "response: means nothing"},
           {"black_level = 0.0", "depth_unit_m = 0.001", ":9", "depth_unit_m: belongs to"},
           {"role = \"environment\"", "role = \"depth\"\ndepth_unit_m = 2", ":9", "response"},
           {"width = 16", "width = 0", ":5", "width: is not a whole number"},
           {"width = 16", "width = 16.5", ":5", "width: is not a whole number"},
           {"height = 8", "height = 100000", ":6", "height: is not a whole number"},
           {"projection = \"latlong\"", "projection = \"fishy\"", ":7", "which are latlong"},
           {"projection = \"latlong\"", "projection = \"vertical-cross\"", ":7", "3 x 4 squares"},
           {"projection = \"latlong\"", "projection = \"latlong\"\nfocal_px = [1, 1]", ":8",
            "focal_px: the projection latlong has none"},
           {"projection = \"latlong\"", "projection = \"pinhole\"\nfocal_px = [1]", ":8",
            "focal_px: has 1 numbers instead of 2"},
           {"projection = \"latlong\"", "projection = \"pinhole\"\nfocal_px = [0, 5]", ":8",
            "focal_px: is not positive"},
           {"projection = \"latlong\"", "projection = \"pinhole\"\nfocal_px = [nan, 5]", ":8",
            "focal_px: is not a finite number"},
           {"projection = \"latlong\"", "projection = \"equidistant\"\ndistortion = [0.1]", ":8",
            "distortion: has 1 distortion coefficients instead of at most 0"},
           {"projection = \"latlong\"", "projection = \"kb4\"\ndistortion = [-9]", ":8",
            "not monotone"},
           {"response = \"srgb\"", "response = \"gamma:x\"", ":8", "response: \"gamma:x\""},
           {"response = \"srgb\"\n", "", ":2", "response: is missing"},
           {"black_level = 0.0", "black_level = 1.0", ":9", "black_level: is not within 0..1"},
           {"black_level = 0.0", "vignetting = [-1, 0]", ":9", "vignetting: has 2 numbers"},
           {"black_level = 0.0", "vignetting = [0, 0, 0]", ":9",
            "vignetting: the projection latlong has none"},
           {"projection = \"latlong\"", "projection = \"pinhole\"\nvignetting = [-1.5, 0, 0]", ":8",
            "vignetting: leaves less"},
           {"black_level = 0.0", "full_well_electrons = 0", ":9",
            "full_well_electrons: is not positive"},
           {"black_level = 0.0", "read_noise = -1", ":9", "read_noise: is not within"},
           {"0,1.5,0,1]", "0,1.5,0]", ":10", "world_from_camera: has 15 numbers"},
           {"0,1.5,0,1]", "0,1.5,0,2]", ":10", "last row"},
           {"0,1.5,0,1]", "0,inf,0,1]", ":10", "not a finite number"},
           {"[1,0,0,0,", "[1.1,0,0,0,", ":10", "not a rigid transform: its axes"},
           {"[1,0,0,0,", "[-1,0,0,0,", ":10", "not a rigid transform: it mirrors"},
           {"frames = \"environment.csv\"", "frames = \"../x.csv\"", ":11", "not a path inside"},
           {"frames = \"environment.csv\"", "frames = \"/x.csv\"", ":11", "not a path inside"},
           {"frames = \"environment.csv\"\n", "", ":2", "frames: is missing"},
       }) {
    write_text(made.path() / "capture.toml", replaced(kManifest, c.from, c.to));
    expect_error(made.path(), ErrorCode::kInvalid, "capture.toml" + c.line, c.detail);
  }
  write_text(made.path() / "capture.toml", kManifest + kManifest.substr(kManifest.find("[[")));
  expect_error(made.path(), ErrorCode::kInvalid, "capture.toml:13", "used twice");
  write_text(made.path() / "capture.toml", "version = = 1\n");
  expect_error(made.path(), ErrorCode::kUnreadable, "capture.toml:1", "");
}

TEST(CaptureFolder, RefusesABadListNamingFileAndLine) {
  struct Case {
    std::string from, to, line, detail;
  };
  const HandMade made;
  for (const Case& c : std::vector<Case>{
           {"file,time_s", "name,time_s", ":1", "header is"},
           {"gain\n", "gain,tx\n", ":1", "header is"},
           {"0.01,1\n", "0.01\n", ":2", "3 fields instead of 4"},
           {"0.01,1\n", "0.01,1,2\n", ":2", "5 fields instead of 4"},
           {"0.01,1\n", "0,1\n", ":2", "exposure_s is \"0\""},
           {"0.01,1\n", "-0.01,1\n", ":2", "exposure_s is \"-0.01\""},
           {"0.01,1\n", "nan,1\n", ":2", "exposure_s is \"nan\""},
           {"0.01,1\n", "inf,1\n", ":2", "exposure_s is \"inf\""},
           {"0.01,1\n", "0.01s,1\n", ":2", "exposure_s is \"0.01s\""},
           {"0.01,1\n", ",1\n", ":2", "exposure_s is \"\""},
           {"0.01,1\n", "0.01,0\n", ":2", "gain is \"0\""},
           {"0.01,1\n", "0.01,nan\n", ":2", "gain is \"nan\""},
           {"0.png,0.0,", "0.png,nan,", ":2", "time_s is \"nan\""},
           {"0.png,0.0,", "0.png,1e12,", ":2", "time_s is \"1e12\""},
           {"0.png,0.0,", "0.png,0.5,", ":3", "time_s 0.033333333 is before"},
           {"environment/0.png", "../0.png", ":2", "not a path inside"},
           {"environment/0.png", "environment/../../0.png", ":2", "not a path inside"},
           {"environment/0.png", "/tmp/0.png", ":2", "not a path inside"},
           {"environment/0.png", "", ":2", "not a path inside"},
       }) {
    write_text(made.path() / "environment.csv", replaced(kList, c.from, c.to));
    expect_error(made.path(), ErrorCode::kInvalid, "environment.csv" + c.line, c.detail);
  }
  write_text(made.path() / "environment.csv", "");
  expect_error(made.path(), ErrorCode::kInvalid, "environment.csv:1", "header is missing");
  write_text(made.path() / "environment.csv", "file,time_s,exposure_s,gain\n");
  expect_error(made.path(), ErrorCode::kInvalid, "capture.toml", "no camera has a frame");
}

TEST(CaptureFolder, RefusesABadPose) {
  const HandMade made;
  const std::string header = "file,time_s,exposure_s,gain,tx,ty,tz,qx,qy,qz,qw\n";
  write_text(made.path() / "environment.csv", header + "environment/0.png,0,1,1,0,0,nan,0,0,0,1\n");
  expect_error(made.path(), ErrorCode::kInvalid, "environment.csv:2", "tz is \"nan\"");
  write_text(made.path() / "environment.csv", header + "environment/0.png,0,1,1,0,0,0,0,0,0,2\n");
  expect_error(made.path(), ErrorCode::kInvalid, "environment.csv:2", "has length 2");
  write_text(made.path() / "environment.csv", header + "environment/0.png,0,1,1\n");
  expect_error(made.path(), ErrorCode::kInvalid, "environment.csv:2", "4 fields instead of 11");
  write_text(made.path() / "environment.csv",
             replaced(header, "qw", "qw,opacity") + "environment/0.png,0,1,1,0,0,0,0,0,0,1,1.5\n");
  expect_error(made.path(), ErrorCode::kInvalid, "environment.csv:2", "not within 0..1");
}

TEST(CaptureFolder, APoseThatIsOldSaysHowMuchOfWhatIsVirtualShows) {
  const HandMade made;
  write_text(made.path() / "environment.csv",
             "file,time_s,exposure_s,gain,tx,ty,tz,qx,qy,qz,qw,opacity\n"
             "environment/0.png,0,1,1,0,0,0,0,0,0,1,0.25\n");
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source) << source.error().detail;
  const auto first = (*source)->next();
  ASSERT_TRUE(first && *first);
  EXPECT_EQ((*first)->opacity, .25f);
}

TEST(CaptureFolder, RefusesMissingFiles) {
  const test::TempFolder empty;
  expect_error(empty.path(), ErrorCode::kNotFound, "capture.toml", "no such file");
  expect_error(empty.path() / "nowhere", ErrorCode::kNotFound, "capture.toml", "no such file");
  const HandMade made;
  fs::remove(made.path() / "environment" / "1.png");
  expect_error(made.path(), ErrorCode::kNotFound, "environment.csv:3",
               "environment/1.png does not exist");
  fs::remove(made.path() / "environment.csv");
  expect_error(made.path(), ErrorCode::kNotFound, "environment.csv", "no such file");
  write_text(made.path() / "environment.csv",
             "file,time_s,exposure_s,gain\nenvironment/0.png,0,1,1\n");
  write_text(made.path() / "capture.toml", replaced(kManifest, "\"srgb\"", "\"curve.toml\""));
  expect_error(made.path(), ErrorCode::kNotFound, "curve.toml", "neither a response nor a file");
  write_text(made.path() / "curve.toml", "version = 1\ndecode = [1, 0]\n");
  expect_error(made.path(), ErrorCode::kInvalid, "curve.toml:2", "not monotone");
}

TEST(CaptureFolder, APictureOfTheWrongSizeIsOneErrorAndTheNextOneFollows) {
  const HandMade made;
  ASSERT_TRUE(codec::write_frame(made.path() / "environment" / "0.png", Image<Rgb8>(6, 5)));
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value());
  const auto bad = (*source)->next();
  ASSERT_FALSE(bad.has_value());
  EXPECT_EQ(bad.error().code, ErrorCode::kInvalid);
  EXPECT_NE(bad.error().where.find("environment/0.png"), std::string::npos);
  EXPECT_EQ(bad.error().detail, "has 6x5 pixels instead of 16x8");
  const auto good = (*source)->next();
  ASSERT_TRUE(good.has_value());
  EXPECT_TRUE(good->has_value());
}

TEST(CaptureFolder, ADamagedPictureIsOneErrorNamingIt) {
  const HandMade made;
  write_text(made.path() / "environment" / "0.png", "not a picture");
  const auto source = open_capture_folder(made.path());
  ASSERT_TRUE(source.has_value());
  const auto bad = (*source)->next();
  ASSERT_FALSE(bad.has_value());
  EXPECT_EQ(bad.error().code, ErrorCode::kUnreadable);
  EXPECT_NE(bad.error().where.find("environment/0.png"), std::string::npos);
}

// The pixel at 1, 1 of a camera without a response whose frames are linear: `file` alone.
Rgb linear_pixel_of(const HandMade& made, const std::string& file) {
  write_text(made.path() / "environment.csv",
             "file,time_s,exposure_s,gain\nenvironment/" + file + ",0,1,1\n");
  write_text(made.path() / "capture.toml", replaced(kManifest, "response = \"srgb\"\n", ""));
  const auto source = open_capture_folder(made.path());
  EXPECT_TRUE(source) << source.error().where << ": " << source.error().detail;
  if (!source) return {};
  EXPECT_TRUE((*source)->cameras()[0].response.is_linear());
  const auto frame = (*source)->next();
  EXPECT_TRUE(frame && *frame);
  if (!frame || !*frame) return {};
  return std::get<Image<Rgb>>(*(*frame)->pixels).at(1, 1);
}

TEST(CaptureFolder, FloatFramesNeedNoResponse) {
  const HandMade made;
  ASSERT_TRUE(codec::write_hdr(made.path() / "environment" / "0.exr",
                               Image<Rgb>(kFolderWidth, kFolderHeight, {.5f, 1, 2}),
                               codec::Depth::kFloat));
  EXPECT_EQ(linear_pixel_of(made, "0.exr"), (Rgb{.5f, 1, 2}));
}

TEST(CaptureFolder, FramesThatWereEncodedAreLinearToo) {
  const HandMade made;
  const auto coded = codec::encode_log_jpeg2000_exactly(
      Image<Rgb>(kFolderWidth, kFolderHeight, {.5f, 1, 2}), {.deviation = .001});
  ASSERT_TRUE(coded) << coded.error().detail;
  ASSERT_TRUE(
      write_bytes(made.path() / "environment" / "0.jph",
                  {reinterpret_cast<const char*>(coded->bytes.data()), coded->bytes.size()}));
  const Rgb pixel = linear_pixel_of(made, "0.jph");
  EXPECT_NEAR(pixel.r, .5, .01);
  EXPECT_NEAR(pixel.b, 2, .01);
}

}  // namespace
}  // namespace penumbra::capture
