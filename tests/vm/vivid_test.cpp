// V4L2 capture against the kernel's vivid driver, in the guest of guest.sh: its test picture is
// known, so every format can be held against plain RGB. Outside the guest there is no such device
// and the tests are skipped.
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <cmath>
#include <cstdlib>
#include <ctime>

#include "capture/capture.h"
#include "capture/device/internal/v4l2_node.h"
#include "capture/raw_formats.h"
#include "core/threads/stage_times.h"

namespace penumbra::capture {
namespace {

constexpr const char* kVividDevice = "/dev/video0";

class Vivid : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::getenv("PENUMBRA_GUEST")) GTEST_SKIP() << "runs in the guest of tests/vm alone";
  }
};

CameraSettings settings(const std::string& format = "", int width = 640, int height = 360) {
  CameraSettings out;
  out.device = kVividDevice, out.format = format, out.width = width, out.height = height;
  return out;
}

struct Picture : CameraFrame {
  FramePixels pixels;
};
Result<Picture> first_frame(CameraDevice& camera) {
  auto frame = camera.wait(Seconds(20), Seconds(20));
  if (!frame) return std::unexpected(frame.error());
  if (!*frame) return fail(ErrorCode::kUnavailable, kVividDevice, "no frame in twenty seconds");
  auto pixels = camera.pixels();
  if (!pixels) return std::unexpected(pixels.error());
  return Picture{**frame, std::move(*pixels)};
}

Image<Rgb8> as_8_bit(const FramePixels& pixels) {
  if (const auto* codes = std::get_if<Image<Rgb8>>(&pixels)) return *codes;
  const auto& wide = std::get<Image<Rgb16>>(pixels);
  Image<Rgb8> out(wide.width(), wide.height());
  for (std::size_t i = 0; i < wide.area(); ++i) {
    const Rgb16& p = wide.pixels()[i];
    out.pixels()[i] = {static_cast<std::uint8_t>(p.r >> 8), static_cast<std::uint8_t>(p.g >> 8),
                       static_cast<std::uint8_t>(p.b >> 8)};
  }
  return out;
}

// Mean colour of the middle of each of the eight bars, below the driver's text.
std::vector<Rgb> bars(const Image<Rgb8>& picture) {
  std::vector<Rgb> out;
  for (int bar = 0; bar < 8; ++bar) {
    Rgb sum;
    int count = 0;
    for (int y = picture.height() * 7 / 10; y < picture.height() * 9 / 10; y += 2)
      for (int x = 0; x < 8; ++x) {
        const Rgb8& p = picture.at((2 * bar + 1) * picture.width() / 16 + x - 4, y);
        sum += {float(p.r), float(p.g), float(p.b)};
        ++count;
      }
    out.push_back(sum * (1 / static_cast<float>(count)));
  }
  return out;
}

TEST_F(Vivid, IsListedWithItsModesAndWhatItCannotDo) {
  const CameraList list = list_cameras();
  ASSERT_FALSE(list.cameras.empty());
  const CameraListing& vivid = list.cameras[0];
  EXPECT_EQ(vivid.device, kVividDevice);
  EXPECT_EQ(vivid.driver, "vivid");
  EXPECT_FALSE(vivid.exposure_s) << "vivid has no exposure";
  EXPECT_TRUE(vivid.gain);
  int readable = 0, rated = 0;
  for (const CameraMode& m : vivid.modes) readable += m.readable, rated += m.max_fps > 0;
  EXPECT_GT(readable, 20);
  EXPECT_EQ(rated, std::ssize(vivid.modes));
}

TEST_F(Vivid, EveryFormatShowsTheBarsThatPlainRgbShows) {
  auto plain = open_camera(settings("RGB3"));
  ASSERT_TRUE(plain) << plain.error().detail;
  auto frame = first_frame(**plain);
  ASSERT_TRUE(frame) << frame.error().detail;
  const std::vector<Rgb> expected = bars(as_8_bit(frame->pixels));
  plain->reset();
  float contrast = 0;
  for (const Rgb& c : expected)
    contrast = std::max(contrast, std::max({c.r, c.g, c.b}) - std::min({c.r, c.g, c.b}));
  ASSERT_GT(contrast, 100) << "these are no colour bars";
  int formats = 0;
  for (const char* name : {"BGR3", "YUYV", "UYVY", "YVYU", "NV12", "NV21", "YU12", "RGGB",
                           "GRBG", "GBRG", "BA81", "RG10", "BA10", "GB10", "BG10", "RG12",
                           "BA12", "GB12", "BG12", "RG16", "GR16", "GB16", "BYR2"}) {
    auto camera = open_camera(settings(name));
    ASSERT_TRUE(camera) << name << ": " << camera.error().detail;
    auto other = first_frame(**camera);
    ASSERT_TRUE(other) << name << ": " << other.error().detail;
    const std::vector<Rgb> seen = bars(as_8_bit(other->pixels));
    for (std::size_t bar = 0; bar < 8; ++bar)
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(seen[bar][c], expected[bar][c], 4)
            << name << " bar " << bar << " channel " << c;
    ++formats;
  }
  EXPECT_EQ(formats, 23);
}

TEST_F(Vivid, BothEyesSideBySideAreTwoCamerasOfOneDevice) {
  std::vector<RigCamera> eyes(2);
  for (RigCamera& eye : eyes) {
    eye.info.role = Role::kView;
    eye.info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 320, 360);
    eye.info.response = calib::Response::srgb();
    eye.settings = settings("RGB3");
  }
  eyes[0].info.name = "left", eyes[0].half = StereoHalf::kLeft;
  eyes[1].info.name = "right", eyes[1].half = StereoHalf::kRight;
  auto rig = Rig::open(eyes);
  ASSERT_TRUE(rig) << rig.error().where << " " << rig.error().detail;
  Image<Rgb8> both(640, 360);
  TimestampNs left_time;
  for (int camera = 0; camera < 2; ++camera) {
    const auto frame = (*rig)->next();
    ASSERT_TRUE(frame && *frame);
    ASSERT_EQ((*frame)->camera, camera);
    if (camera == 0)
      left_time = (*frame)->time;
    else
      EXPECT_EQ((*frame)->time, left_time);
    const auto half = as_8_bit(*(*frame)->pixels);
    ASSERT_EQ(half.width(), 320);
    for (int y = 0; y < 360; ++y)
      std::ranges::copy(half.row(y), both.row(y).begin() + 320 * camera);
  }
  rig->reset();
  auto whole = open_camera(settings("RGB3"));
  ASSERT_TRUE(whole) << whole.error().detail;
  const auto picture = first_frame(**whole);
  ASSERT_TRUE(picture);
  const std::vector<Rgb> seen = bars(both), expected = bars(as_8_bit(picture->pixels));
  for (std::size_t bar = 0; bar < 8; ++bar)
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(seen[bar][c], expected[bar][c], 2) << bar;
}

TEST_F(Vivid, FramesCarryTheDriversNumbersAndRisingMonotonicTimes) {
  auto camera = open_camera(settings("YUYV"));
  ASSERT_TRUE(camera) << camera.error().detail;
  std::optional<Picture> before;
  for (int i = 0; i < 20; ++i) {
    auto frame = first_frame(**camera);
    ASSERT_TRUE(frame);
    if (before) {
      EXPECT_GT(frame->sequence, before->sequence);
      const double apart = (frame->time - before->time).count();
      EXPECT_GT(apart, .001);
      EXPECT_LT(apart, 2);
    }
    before = std::move(*frame);
  }
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  EXPECT_LT(
      std::abs(static_cast<double>(now.tv_sec) - static_cast<double>(before->time.value) * 1e-9),
      5);
}

// By an hour on and two back, as when a machine without a battery finds its time server.
TEST_F(Vivid, AClockThatJumpsMovesNoFrame) {
  RigCamera one;
  one.info.name = "view", one.info.role = Role::kView;
  one.info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 640, 360);
  one.info.response = calib::Response::srgb();
  one.settings = settings("RGB3");
  auto rig = Rig::open({one});
  ASSERT_TRUE(rig) << rig.error().where << " " << rig.error().detail;
  const auto turn_clock = [](std::time_t seconds) {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    now.tv_sec += seconds;
    ASSERT_EQ(clock_settime(CLOCK_REALTIME, &now), 0) << "the guest's user is no root";
  };
  struct ClockAtEnd {
    static std::int64_t now_ns(clockid_t clock) {
      timespec now{};
      clock_gettime(clock, &now);
      return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
    }
    std::int64_t apart_ns = now_ns(CLOCK_REALTIME) - now_ns(CLOCK_MONOTONIC);
    ~ClockAtEnd() {
      const std::int64_t ns = now_ns(CLOCK_MONOTONIC) + apart_ns;
      const timespec right{static_cast<std::time_t>(ns / 1'000'000'000),
                           static_cast<long>(ns % 1'000'000'000)};
      (void)clock_settime(CLOCK_REALTIME, &right);
    }
  };
  const ClockAtEnd restores;
  std::optional<TimestampNs> before;
  for (int i = 0; i < 24; ++i) {
    if (i == 8) turn_clock(3600);
    if (i == 16) turn_clock(-7200);
    const Stopwatch watch;
    const auto frame = (*rig)->next();
    ASSERT_TRUE(frame && *frame) << i;
    EXPECT_LT(watch.ms(), 5000) << i;
    if (before) {
      const double apart = ((*frame)->time - *before).count();
      EXPECT_GT(apart, 0) << i;
      EXPECT_LT(apart, 2) << i;
    }
    before = (*frame)->time;
  }
  EXPECT_EQ((*rig)->counts()[0].reconnected, 0u);
}

TEST_F(Vivid, WhatItDoesNotOfferIsRefusedInOneLine) {
  auto size = open_camera(settings("YUYV", 641, 361));
  ASSERT_FALSE(size);
  EXPECT_NE(size.error().detail.find("YUYV 641x361"), std::string::npos) << size.error().detail;
  auto format = open_camera(settings("H264"));
  ASSERT_FALSE(format);
  CameraSettings none;
  none.device = "/dev/video77";
  auto missing = open_camera(none);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  auto camera = open_camera(settings("YUYV"));
  ASSERT_TRUE(camera);
  EXPECT_FALSE((*camera)->request({Seconds(.01), Gain(1)})) << "it has no exposure";
  auto busy = open_camera(settings("YUYV"));
  ASSERT_FALSE(busy);
  EXPECT_EQ(busy.error().code, ErrorCode::kUnavailable);
}

// vivid's own control unplugs the driver from its nodes: what a pulled cable looks like.
TEST_F(Vivid, AnUnpluggedCameraIsAClosedOneAndNoHang) {
  auto camera = open_camera(settings("YUYV"));
  ASSERT_TRUE(camera);
  ASSERT_TRUE(first_frame(**camera));
  auto node = V4l2Node::open(kVividDevice);
  ASSERT_TRUE(node);
  std::uint32_t id = 0;
  v4l2_queryctrl query{};
  for (query.id = V4L2_CTRL_FLAG_NEXT_CTRL; node->call(VIDIOC_QUERYCTRL, &query) == 0;
       query.id |= V4L2_CTRL_FLAG_NEXT_CTRL)
    if (std::string(reinterpret_cast<const char*>(query.name)) == "Disconnect") id = query.id;
  if (id == 0) GTEST_SKIP() << "this vivid cannot be unplugged";
  ASSERT_EQ(node->set(id, 1), 0);
  Result<std::optional<CameraFrame>> frame = std::nullopt;
  for (int i = 0; i < 50 && frame; ++i) frame = (*camera)->wait(Seconds(.1), Seconds(1));
  ASSERT_FALSE(frame);
  EXPECT_EQ(frame.error().code, ErrorCode::kClosed);
}

}  // namespace
}  // namespace penumbra::capture
