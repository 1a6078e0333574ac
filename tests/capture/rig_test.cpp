// Several cameras as one source: order, unplugging, closing; and the tables of rig.toml that name
// them.

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <functional>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/fake_camera.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

using test::FakeCamera;
using Clock = std::chrono::steady_clock;

std::atomic<int> opened;
std::atomic<std::uint64_t> frames_before_it_goes = ~std::uint64_t{0};
std::atomic<bool> can_be_opened = true;

Result<std::unique_ptr<CameraDevice>> open_fake(const CameraSettings& settings) {
  if (!can_be_opened) return fail(ErrorCode::kNotFound, settings.device, "no such camera");
  ++opened;
  test::FakeCameraBehaviour b;
  b.fps = 200, b.paced = true;
  b.gone_after =
      settings.device == "environment" ? frames_before_it_goes.load() : ~std::uint64_t{0};
  return std::make_unique<FakeCamera>(Image<Rgb>(32, 16, {40, 40, 40}), b);
}

std::vector<RigCamera> cameras() {
  std::vector<RigCamera> out(2);
  out[0].info.name = out[0].settings.device = "environment";
  out[0].info.projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 32, 16);
  out[1].info.name = out[1].settings.device = "view";
  out[1].info.role = Role::kView;
  out[1].info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 32, 16);
  for (RigCamera& c : out) {
    c.info.response = calib::Response::srgb();
    c.schedule = {{Seconds(.004), Gain(1)}};
    c.settings.fps = 200;
  }
  return out;
}

void write(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path) << text;
}

class RigOfFakes : public testing::Test {
 protected:
  void SetUp() override {
    opened = 0, frames_before_it_goes = ~std::uint64_t{0}, can_be_opened = true;
  }
};

TEST_F(RigOfFakes, HandsOnTheFramesOfAllCamerasWithTheirNumbers) {
  auto rig = Rig::open(cameras(), open_fake);
  ASSERT_TRUE(rig);
  EXPECT_TRUE((*rig)->is_live());
  EXPECT_EQ((*rig)->view_rate(), 200);
  int count[2] = {};
  while (count[0] < 10 || count[1] < 10) {
    auto frame = (*rig)->next();
    ASSERT_TRUE(frame && *frame);
    const auto camera = static_cast<std::size_t>((*frame)->camera);
    ASSERT_LT(camera, 2u);
    EXPECT_EQ((*frame)->exposure.time, Seconds(.004));
    ++count[camera];
  }
}

TEST_F(RigOfFakes, AnUnpluggedCameraIsBackWithinTwoSecondsAndTheOtherGoesOn) {
  frames_before_it_goes = 20;
  auto rig = Rig::open(cameras(), open_fake);
  ASSERT_TRUE(rig);
  const auto wait_for = [&](auto done) {
    const auto give_up = Clock::now() + std::chrono::seconds(10);
    while (!done() && Clock::now() < give_up) {
      auto frame = (*rig)->next();
      ASSERT_TRUE(frame && *frame);
    }
    EXPECT_TRUE(done());
  };
  can_be_opened = false;
  wait_for([&] {
    const CameraCounts c = (*rig)->counts()[0];
    return c.frames + c.overrun == 20;
  });
  const std::uint64_t view_before = (*rig)->counts()[1].frames;
  wait_for([&] { return (*rig)->counts()[1].frames > view_before + 40; });
  EXPECT_EQ((*rig)->counts()[0].reconnected, 0u);
  frames_before_it_goes = ~std::uint64_t{0};
  can_be_opened = true;
  const auto back = Clock::now();
  wait_for([&] { return (*rig)->counts()[0].frames > 25; });
  EXPECT_LT(Clock::now() - back, std::chrono::seconds(2));
  EXPECT_EQ((*rig)->counts()[0].reconnected, 1u);
}

TEST_F(RigOfFakes, AViewCameraTakesADarkerFrameWhenItIsAsked) {
  std::vector<RigCamera> both = cameras();
  both[0].schedule.push_back({Seconds(.001), Gain(1)});
  auto rig = Rig::open(both, open_fake);
  ASSERT_TRUE(rig);
  EXPECT_FALSE((*rig)->take_darker(0, .125)) << "it has a bracket of its own";
  EXPECT_TRUE((*rig)->take_darker(1, .125));
  const auto give_up = Clock::now() + std::chrono::seconds(10);
  std::optional<Frame> darker;
  while (!darker && Clock::now() < give_up) {
    auto frame = (*rig)->next();
    ASSERT_TRUE(frame && *frame);
    if ((*frame)->for_light) darker = **frame;
  }
  ASSERT_TRUE(darker);
  EXPECT_EQ(darker->camera, 1);
  EXPECT_DOUBLE_EQ(darker->exposure.time.count(), .004 / 8);
}

TEST_F(RigOfFakes, OtherExposuresAreTakenWhenTheyAreAskedFor) {
  std::vector<RigCamera> both = cameras();
  both[1].schedule.clear();
  auto rig = Rig::open(both, open_fake);
  ASSERT_TRUE(rig);
  const auto refused = (*rig)->set_exposures(1, {{Seconds(.001), Gain(1)}});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, both[1].info.name);
  const auto wait_for = [&](Seconds time) {
    const auto give_up = Clock::now() + std::chrono::seconds(10);
    while (Clock::now() < give_up) {
      const auto frame = (*rig)->next();
      if (frame && *frame && (*frame)->camera == 0 && (*frame)->exposure.time == time) return true;
    }
    return false;
  };
  EXPECT_TRUE(wait_for(Seconds(.004)));
  ASSERT_TRUE((*rig)->set_exposures(0, {{Seconds(.001), Gain(1)}}));
  EXPECT_TRUE(wait_for(Seconds(.001)));
  EXPECT_EQ((*rig)->counts()[0].exposures.size(), 1u);
  ASSERT_TRUE((*rig)->set_exposures(0, {}));
  EXPECT_TRUE(wait_for(Seconds(.004))) << "as at first";
}

// A slow program loses frames in the rig's own queue: without a count nobody would know.
TEST_F(RigOfFakes, CountsWhatComesWhileTheQueueIsFull) {
  auto rig = Rig::open(cameras(), open_fake);
  ASSERT_TRUE(rig);
  const auto give_up = Clock::now() + std::chrono::seconds(10);
  const auto overrun = [&](std::size_t camera) { return (*rig)->counts()[camera].overrun; };
  while ((overrun(0) < 5 || overrun(1) < 5) && Clock::now() < give_up)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  EXPECT_GE(overrun(0), 5u);
  EXPECT_GE(overrun(1), 5u);
  const std::vector<CameraCounts> counts = (*rig)->counts();
  EXPECT_LE(counts[0].frames + counts[1].frames, 10u)
      << "more than the queue holds and two in hand";
  EXPECT_EQ(counts[0].lost + counts[1].lost, 0u) << "the cameras delivered all";
}

std::atomic<int> asked_width;

Result<std::unique_ptr<CameraDevice>> open_stereo(const CameraSettings& settings) {
  ++opened;
  asked_width = settings.width;
  Image<Rgb> both(settings.width, settings.height, {20, 20, 20});
  for (int y = 0; y < both.height(); ++y)
    for (int x = both.width() / 2; x < both.width(); ++x) both.at(x, y) = {90, 90, 90};
  test::FakeCameraBehaviour b;
  b.fps = 60, b.paced = true;
  return std::make_unique<FakeCamera>(both, b);
}

TEST_F(RigOfFakes, OneDeviceShowsBothEyesSideBySide) {
  std::vector<RigCamera> eyes = cameras();
  for (RigCamera& c : eyes) {
    c.info.role = Role::kView;
    c.info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 32, 16);
    c.settings.device = "stereo";
  }
  eyes[0].half = StereoHalf::kRight;  // in whatever order
  eyes[1].half = StereoHalf::kLeft;
  eyes[1].info.world_from_camera.translation = {-.064, 0, 0};
  auto rig = Rig::open(eyes, open_stereo);
  ASSERT_TRUE(rig);
  EXPECT_EQ(opened, 1);
  EXPECT_EQ(asked_width, 64);
  ASSERT_EQ((*rig)->cameras().size(), 2u);
  TimestampNs time[2];
  double mean[2] = {};
  for (int k = 0; k < 20; ++k) {
    const auto frame = (*rig)->next();
    ASSERT_TRUE(frame && *frame);
    const auto camera = static_cast<std::size_t>((*frame)->camera);
    EXPECT_EQ(camera, static_cast<std::size_t>(k % 2)) << "each moment gives both";
    time[camera] = (*frame)->time;
    EXPECT_EQ((*frame)->world_from_camera.translation.x, camera == 1 ? -.064 : 0);
    EXPECT_EQ(width(*(*frame)->pixels), 32);
    EXPECT_EQ(height(*(*frame)->pixels), 16);
    const auto& codes = std::get<Image<Rgb8>>(*(*frame)->pixels);
    double sum = 0;
    for (const Rgb8& c : codes.pixels()) sum += c.g;
    mean[camera] = sum / double(codes.area());
    if (camera == 1) EXPECT_EQ(time[0], time[1]);
  }
  EXPECT_GT(mean[0], 1.5 * mean[1]) << "the right half is the bright one";
  const auto counts = (*rig)->counts();
  ASSERT_EQ(counts.size(), 2u);
  EXPECT_EQ(counts[0].arrived, counts[1].arrived);
  EXPECT_TRUE((*rig)->take_darker(1, .125)) << "the device's, for both";
}

std::vector<RigCamera> two_halves() {
  std::vector<RigCamera> eyes = cameras();
  eyes[0].info = eyes[1].info;
  eyes[0].info.name = "other";
  eyes[0].settings.device = eyes[1].settings.device = "stereo";
  eyes[0].half = StereoHalf::kLeft, eyes[1].half = StereoHalf::kRight;
  return eyes;
}

TEST_F(RigOfFakes, AFullQueueLosesBothEyesOrNone) {
  auto rig = Rig::open(two_halves(), open_stereo);
  ASSERT_TRUE(rig);
  for (int round = 0; round < 5; ++round) {
    for (int k = 0; k < 5; ++k) {
      const auto left = (*rig)->next();
      std::this_thread::sleep_for(std::chrono::milliseconds(100));  // the queue is full but for one
      const auto right = (*rig)->next();
      ASSERT_TRUE(left && *left && right && *right);
      EXPECT_EQ((*left)->camera, 0);
      EXPECT_EQ((*right)->camera, 1);
      EXPECT_EQ((*left)->time, (*right)->time);
    }
  }
  const auto counts = (*rig)->counts();
  EXPECT_GT(counts[0].overrun, 0u);
  EXPECT_EQ(counts[0].overrun, counts[1].overrun);
}

TEST_F(RigOfFakes, WhatIsNotTwoHalvesIsRefused) {
  const auto refused = [](const std::function<void(std::vector<RigCamera>&)>& spoil) {
    std::vector<RigCamera> eyes = two_halves();
    spoil(eyes);
    const auto rig = Rig::open(eyes, open_stereo);
    return !rig && rig.error().code == ErrorCode::kInvalid;
  };
  EXPECT_TRUE(refused([](auto& eyes) { eyes[1].half = StereoHalf::kLeft; }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes[0].half.reset(); }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes[1].half.reset(); }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes.push_back(eyes[1]); }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes[1].info.projection.width = 30; }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes[1].info.role = Role::kEnvironment; }));
  EXPECT_TRUE(refused([](auto& eyes) { eyes[0].light_error = .01; }));
}

TEST_F(RigOfFakes, AHalfMayBeAlone) {
  std::vector<RigCamera> one = {cameras()[1]};
  one[0].half = StereoHalf::kLeft;
  auto rig = Rig::open(one, open_stereo);
  ASSERT_TRUE(rig);
  EXPECT_EQ(asked_width, 64);
  const auto frame = (*rig)->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_EQ(width(*(*frame)->pixels), 32);
}

TEST_F(RigOfFakes, ClosesAHundredTimesInMidStream) {
  for (int i = 0; i < 100; ++i) {
    auto rig = Rig::open(cameras(), open_fake);
    ASSERT_TRUE(rig);
    std::jthread reader([&] {
      while (true) {
        auto frame = (*rig)->next();
        if (!frame || !*frame) return;
      }
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(i % 7));
    (*rig)->close();
    reader.join();
  }
  EXPECT_EQ(opened, 200);
}

TEST_F(RigOfFakes, ACameraThatIsNotThereIsTheErrorOfOpening) {
  can_be_opened = false;
  auto rig = Rig::open(cameras(), open_fake);
  ASSERT_FALSE(rig);
  EXPECT_EQ(rig.error().where, "environment");
}

TEST(RigFile, NamesDeviceScheduleAndLens) {
  const test::TempFolder folder;
  write(folder.path() / "rig.toml", R"(
[[camera]]
name = "sky"
role = "environment"
device = "/dev/video2"
format = "MJPG"
fps = 60
width = 640
height = 480
projection = "equidistant"
response = "srgb"
exposures_s = [0.01, 0.002]
gains = [1, 2]
unit_gain = 16
delay_frames = 2
)");
  auto cameras = read_rig_cameras(folder.path() / "rig.toml");
  ASSERT_TRUE(cameras) << cameras.error().where << cameras.error().detail;
  ASSERT_EQ(cameras->size(), 1u);
  const RigCamera& c = cameras->front();
  EXPECT_EQ(c.settings.device, "/dev/video2");
  EXPECT_EQ(c.settings.format, "MJPG");
  EXPECT_EQ(c.settings.fps, 60);
  EXPECT_EQ(c.settings.unit_gain, 16);
  ASSERT_EQ(c.schedule.size(), 2u);
  EXPECT_EQ(c.schedule[1].time, Seconds(.002));
  EXPECT_EQ(c.schedule[1].gain.value(), 2);
  EXPECT_EQ(c.delay_frames, 2);
}

TEST(RigFile, ADepthCameraKeepsItsOwnExposure) {
  const test::TempFolder folder;
  const std::string camera =
      "[[camera]]\nname = \"depth\"\nrole = \"depth\"\nwidth = 64\nheight = 48\n"
      "projection = \"pinhole\"\nfocal_px = [60, 60]\ndevice = \"/dev/video0\"\n";
  write(folder.path() / "rig.toml", camera + "depth_unit_m = 0.0001\n");
  const auto cameras = read_rig_cameras(folder.path() / "rig.toml");
  ASSERT_TRUE(cameras) << cameras.error().where << cameras.error().detail;
  EXPECT_EQ(cameras->front().info.role, Role::kDepth);
  EXPECT_EQ(cameras->front().info.depth_unit_m, 1e-4);
  EXPECT_EQ(cameras->front().settings.format, "Z16");
  EXPECT_FALSE(cameras->front().settings.stop_automatics);
  write(folder.path() / "rig.toml", camera + "format = \"YUYV\"\n");
  const auto no_depth = read_rig_cameras(folder.path() / "rig.toml");
  ASSERT_FALSE(no_depth);
  EXPECT_NE((no_depth.error().where + no_depth.error().detail).find("format: is neither Z16"),
            std::string::npos);
  for (const std::string key : {"exposures_s", "gains", "light_error", "white_balance_k",
                                "unit_gain", "response", "black_level"}) {
    write(folder.path() / "rig.toml", camera + key + " = 1\n");
    const auto refused = read_rig_cameras(folder.path() / "rig.toml");
    ASSERT_FALSE(refused) << key;
    EXPECT_NE((refused.error().where + refused.error().detail)
                  .find(key + ": means nothing of a camera with role = \"depth\""),
              std::string::npos)
        << refused.error().where << " " << refused.error().detail;
  }
}

TEST(RigFile, ExposuresMayBeLeftToTheLight) {
  const test::TempFolder folder;
  const std::string camera =
      "[[camera]]\nname = \"a\"\nrole = \"environment\"\nwidth = 64\nheight = 48\n"
      "projection = \"equidistant\"\nresponse = \"srgb\"\ndevice = \"/dev/video0\"\n"
      "exposures_s = \"auto\"\n";
  for (const auto& [more, error] : {std::pair{"", .01}, {"light_error = 0.03\n", .03}}) {
    write(folder.path() / "rig.toml", camera + more);
    const auto cameras = read_rig_cameras(folder.path() / "rig.toml");
    ASSERT_TRUE(cameras) << cameras.error().where << cameras.error().detail;
    EXPECT_TRUE(cameras->front().schedule.empty());
    EXPECT_EQ(cameras->front().light_error, error);
  }
}

TEST(RigFile, TwoCamerasMayBeTheHalvesOfOneDevice) {
  const test::TempFolder folder;
  const auto camera = [](const std::string& name, const std::string& more) {
    return "[[camera]]\nname = \"" + name + "\"\nrole = \"view\"\neye = \"" + name +
           "\"\nheight = 48\nprojection = \"pinhole\"\nresponse = \"srgb\"\n"
           "device = \"/dev/video0\"\n" +
           more;
  };
  const std::string width = "width = 64\n", left = "half = \"left\"\n",
                    right = "half = \"right\"\n",
                    first = camera("left", width + left + "fps = 54\nexposures_s = [0.004]\n");
  write(folder.path() / "rig.toml", first + camera("right", width + right));
  const auto eyes = read_rig_cameras(folder.path() / "rig.toml");
  ASSERT_TRUE(eyes) << eyes.error().where << eyes.error().detail;
  EXPECT_EQ((*eyes)[0].half, StereoHalf::kLeft);
  EXPECT_EQ((*eyes)[1].half, StereoHalf::kRight);
  const auto refused = [&](const std::string& text, const std::string& reason) {
    write(folder.path() / "rig.toml", text);
    const auto read = read_rig_cameras(folder.path() / "rig.toml");
    ASSERT_FALSE(read) << reason;
    EXPECT_NE((read.error().where + read.error().detail).find(reason), std::string::npos)
        << read.error().where << " " << read.error().detail;
  };
  refused(first + camera("right", width), "is used twice");
  refused(first + camera("right", width + left), "half: is the same one");
  refused(first + camera("right", width + right + "fps = 30\n"),
          "fps: is told with the other half");
  refused(first + camera("right", "width = 60\n" + right), "differ from those of the other half");
  std::string environment = camera("right", width + right);
  environment.replace(environment.find("role = \"view\"\neye = \"right\""), 27,
                      "role = \"environment\"");
  refused(first + environment, "role: is another one");
  refused(camera("left", width + "half = \"top\"\n"), "neither \"left\" nor \"right\"");
  refused(camera("left", width + left + "exposures_s = \"auto\"\n"), "whole pictures");
}

TEST(RigFile, BadValuesNameTheirKeyAndLine) {
  const test::TempFolder folder;
  const std::string good =
      "[[camera]]\nname = \"a\"\nrole = \"view\"\nwidth = 64\nheight = 48\n"
      "projection = \"pinhole\"\nresponse = \"srgb\"\ndevice = \"/dev/video0\"\n";
  for (const auto& [line, key] : std::initializer_list<std::pair<const char*, const char*>>{
           {"exposures_s = [0.01, -1]", "exposures_s"},
           {"exposures_s = []", "exposures_s"},
           {"exposures_s = \"best\"", "exposures_s"},
           {"exposures_s = [0.01]\nlight_error = 0.1", "light_error"},
           {"exposures_s = \"auto\"\nlight_error = 0", "light_error"},
           {"exposures_s = \"auto\"\ngains = [1]", "gains"},
           {"exposures_s = [0.01]\ngains = [1, 2]", "gains"},
           {"fps = 0", "fps"},
           {"delay_frames = 0", "delay_frames"},
           {"unit_gain = -3", "unit_gain"},
           {"frames = \"a.csv\"", "frames"}}) {
    write(folder.path() / "rig.toml", good + line + "\n");
    auto cameras = read_rig_cameras(folder.path() / "rig.toml");
    ASSERT_FALSE(cameras) << line;
    EXPECT_NE((cameras.error().where + cameras.error().detail).find(key), std::string::npos)
        << cameras.error().where << " " << cameras.error().detail;
    EXPECT_NE(cameras.error().where.find("rig.toml:"), std::string::npos) << cameras.error().where;
  }
}

}  // namespace
}  // namespace penumbra::capture
