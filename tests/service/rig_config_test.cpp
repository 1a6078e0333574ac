#include "service/rig_config.h"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/temp_folder.h"

namespace penumbra::service {

namespace {

class RigConfigFile : public testing::Test {
 protected:
  std::filesystem::path path() const { return folder_.path() / "rig.toml"; }
  Result<RigConfig> read(const std::string& text) {
    std::ofstream(path(), std::ios::binary) << text;
    return read_rig_config(path());
  }
  void expect_invalid(const std::string& text, int line, const std::string& word) {
    const auto config = read(text);
    ASSERT_FALSE(config) << text;
    EXPECT_EQ(config.error().code, ErrorCode::kInvalid) << config.error().detail;
    EXPECT_EQ(config.error().where, path().string() + ":" + std::to_string(line))
        << config.error().detail;
    EXPECT_NE(config.error().detail.find(word), std::string::npos) << config.error().detail;
  }
  test::TempFolder folder_;
};

const std::string kStudio = "version = 1\n[capture]\nsource = \"studio\"\n";

TEST_F(RigConfigFile, StudioNeedsOneLineAndHasSafeDefaults) {
  const auto c = read(kStudio);
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(c->source, "studio");
  EXPECT_EQ(c->address, "127.0.0.1");
  EXPECT_EQ(c->bands, RigConfig{}.bands);
  EXPECT_FALSE(c->scene || c->environment || c->asset);
}

TEST_F(RigConfigFile, EveryKeyIsRead) {
  const auto c =
      read(kStudio +
           "environment = \"sky.hdr\"\nasset = \"builtin:knot\"\nreal_mesh = \"box.obj\"\n"
           "fps = 59.94\nwidth = 320\nheight = 180\n[scene]\nfile = \"/abs/scene.toml\"\n"
           "[light]\nbands = 3\nstale_after_s = 0.25\n[http]\naddress = \"::1\"\nport = 0\n");
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(c->real_mesh, (folder_.path() / "box.obj").string())
      << "paths are meant from the file's folder";
  EXPECT_EQ(c->environment, (folder_.path() / "sky.hdr").string());
  EXPECT_EQ(c->asset, "builtin:knot");
  EXPECT_EQ(c->scene, "/abs/scene.toml");
  EXPECT_DOUBLE_EQ(c->fps, 59.94);
  EXPECT_EQ(c->width, 320);
  EXPECT_EQ(c->height, 180);
  EXPECT_EQ(c->bands, 3);
  EXPECT_DOUBLE_EQ(c->stale_after_s, .25);
  EXPECT_EQ(c->address, "::1");
  EXPECT_EQ(c->port, 0);
}

TEST_F(RigConfigFile, UnknownKeysAreNamedWithFileAndLine) {
  expect_invalid(kStudio + "colour = 3\n", 4, "colour");
  expect_invalid("version = 1\nlights = 1\n[capture]\nsource = \"studio\"\n", 2, "lights");
  expect_invalid(kStudio + "[scene]\npath = \"a\"\n", 5, "path");
  expect_invalid(kStudio + "[light]\nband = 3\n", 5, "band");
  expect_invalid(kStudio + "[http]\nhost = \"a\"\n", 5, "host");
}

TEST_F(RigConfigFile, BadValuesAreNamedWithFileAndLine) {
  for (const auto& [line, word] : {std::pair{"fps = 0", "fps"},
                                   {"fps = -1", "fps"},
                                   {"fps = nan", "fps"},
                                   {"fps = inf", "fps"},
                                   {"fps = \"30\"", "fps"},
                                   {"width = 0", "width"},
                                   {"width = 63", "width"},
                                   {"width = 1e9", "width"},
                                   {"height = 100000", "height"},
                                   {"environment = 3", "environment"}})
    expect_invalid(kStudio + line + "\n", 4, word);
  for (const auto& [line, word] : {std::pair{"[light]\nbands = 0", "bands"},
                                   {"[light]\nbands = 10", "bands"},
                                   {"[light]\nbands = 2.5", "bands"},
                                   {"[light]\nstale_after_s = 0", "stale_after_s"},
                                   {"[http]\nport = -1", "port"},
                                   {"[http]\nport = 65536", "port"},
                                   {"[http]\nport = \"80\"", "port"}})
    expect_invalid(kStudio + line + "\n", 5, word);
  expect_invalid("version = 1\ncapture = 3\n", 2, "capture");
  expect_invalid("version = 3\n[capture]\nsource = \"studio\"\n", 1, "version");
}

TEST_F(RigConfigFile, AddressesThatAreNotLoopbackAreRefused) {
  for (const char* address :
       {"0.0.0.0", "192.168.1.10", "::", "example.com", "", "128.0.0.1", "127.0.0.1.example.com",
        "127.example.com", "localhost.example.com", "::ffff:192.168.1.10"})
    expect_invalid(kStudio + "[http]\naddress = \"" + address + "\"\n", 5, "loopback");
  for (const char* address : {"127.0.0.1", "127.1.2.3", "localhost", "::1"})
    EXPECT_TRUE(read(kStudio + "[http]\nport = 0\naddress = \"" + address + "\"\n")) << address;
  expect_invalid(kStudio + "[http]\naddress = \"127.0.0.1\"\n", 5, "port");
}

TEST_F(RigConfigFile, WithATokenOthersMayCome) {
  const std::string token = (folder_.path() / "token").string();
  const std::string text = kStudio + "[http]\naddress = \"0.0.0.0\"\nport = 0\n";
  expect_invalid(text, 5, "token_file");
  EXPECT_FALSE(read(text + "token_file = \"token\"\n")) << "not there";
  for (const char* bad :
       {"", "short", "with spaces in it all over", "\x01\x02\x03 and so on and on"}) {
    std::ofstream(token) << bad;
    expect_invalid(text + "token_file = \"token\"\n", 7, "token");
  }
  std::ofstream(token) << "0123456789abcdefXYZ-_\n";
  const auto c = read(text + "token_file = \"token\"\norigins = [\"https://a.example\"]\n");
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(c->token, "0123456789abcdefXYZ-_");
  EXPECT_EQ(c->origins, std::vector<std::string>{"https://a.example"});
  expect_invalid(kStudio + "[http]\norigins = [\"a.example\"]\n", 5, "origin");
  expect_invalid(kStudio + "[http]\norigins = \"https://a.example\"\n", 5, "list");
}

TEST_F(RigConfigFile, SocketPageAndRecordingsAreBesideTheFile) {
  const auto usual = read(kStudio);
  ASSERT_TRUE(usual);
  EXPECT_FALSE(usual->port) << "no TCP without being asked";
  EXPECT_FALSE(usual->socket || usual->light_page);
  EXPECT_EQ(usual->recordings, folder_.path() / "recordings");
  const auto c = read(kStudio +
                      "[http]\nsocket = \"a.sock\"\n[output]\nlight_page = \"\"\n"
                      "recordings = \"/tmp/out\"\n");
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(*c->socket, folder_.path() / "a.sock");
  EXPECT_EQ(*c->light_page, "") << "none";
  EXPECT_EQ(c->recordings, "/tmp/out");
}

TEST_F(RigConfigFile, KeysOfTheStudioAreRefusedBesideAnotherSource) {
  for (const std::string source : {"cameras", "rec", "rec.mkv"})
    for (const std::string line :
         {"environment = \"sky.hdr\"", "asset = \"builtin:knot\"", "real_mesh = \"builtin:box\"",
          "fps = 30", "width = 640", "height = 480"})
      expect_invalid("version = 1\n[capture]\nsource = \"" + source + "\"\n" + line +
                         "\n[scene]\nfile = \"scene.toml\"\n",
                     4, line.substr(0, line.find(' ')) + ": belongs to source = \"studio\"");
}

TEST_F(RigConfigFile, CaptureFolderNeedsAScene) {
  const auto c = read("version = 1\n[capture]\nsource = \"recording\"\n");
  ASSERT_FALSE(c);
  EXPECT_EQ(c.error().code, ErrorCode::kInvalid);
  EXPECT_NE(c.error().detail.find("scene"), std::string::npos);
  const auto placed =
      read("version = 1\n[capture]\nsource = \"recording\"\n[scene]\nfile = \"scene.toml\"\n");
  ASSERT_TRUE(placed) << placed.error().detail;
  EXPECT_EQ(placed->source, (folder_.path() / "recording").string());
}

const std::string kCameras =
    "version = 1\n[capture]\nsource = \"cameras\"\n[scene]\nfile = \"scene.toml\"\n";
std::string camera(const std::string& name, const std::string& role, const std::string& device) {
  return "[[camera]]\nname = \"" + name + "\"\nrole = \"" + role + "\"\ndevice = \"" + device +
         "\"\nwidth = 64\nheight = 32\nprojection = \"latlong\"\nresponse = \"srgb\"\n";
}

TEST_F(RigConfigFile, CamerasAreAnEnvironmentAndAView) {
  const auto c = read(kCameras + camera("sky", "environment", "/dev/video0") +
                      camera("eye", "view", "/dev/video1"));
  ASSERT_TRUE(c) << c.error().where << ": " << c.error().detail;
  ASSERT_EQ(c->cameras.size(), 2u);
  EXPECT_EQ(c->cameras[1].settings.device, "/dev/video1");
  const std::string sky = camera("sky", "environment", "/dev/video0");
  for (const auto& [text, word] : std::initializer_list<std::pair<std::string, const char*>>{
           {kCameras, "environment"},
           {kCameras + sky, "view"},
           {kCameras + sky + camera("eye", "view", "/dev/video0"), "twice"},
           {kCameras + sky + camera("sky", "view", "/dev/video1"), "twice"},
           {kStudio + sky, "cameras"}}) {
    const auto bad = read(text);
    ASSERT_FALSE(bad) << text;
    EXPECT_NE(bad.error().detail.find(word), std::string::npos) << bad.error().detail;
  }
  const auto no_scene = read("version = 1\n[capture]\nsource = \"cameras\"\n" + sky);
  ASSERT_FALSE(no_scene);
  EXPECT_NE(no_scene.error().detail.find("scene"), std::string::npos);
}

TEST_F(RigConfigFile, MissingAndDamagedFilesAreErrors) {
  const auto absent = read_rig_config(folder_.path() / "nowhere.toml");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::kNotFound);
  for (const char* text : {"", "version = 1\n", "version = 1\n[capture]\n"}) {
    const auto c = read(text);
    ASSERT_FALSE(c) << text;
    EXPECT_EQ(c.error().code, ErrorCode::kInvalid);
  }
  const auto damaged = read("version = 1\n[capture\n");
  ASSERT_FALSE(damaged);
  EXPECT_EQ(damaged.error().code, ErrorCode::kUnreadable);
}

}  // namespace
}  // namespace penumbra::service
