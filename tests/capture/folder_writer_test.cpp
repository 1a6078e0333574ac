#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <glm/gtc/quaternion.hpp>
#include <limits>
#include <string>
#include <vector>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

namespace fs = std::filesystem;

constexpr int kWrittenWidth = 16, kWrittenHeight = 8;

CameraInfo camera(const std::string& name, Role role, calib::ProjectionKind kind) {
  CameraInfo info;
  info.name = name;
  info.role = role;
  info.projection =
      calib::make_projection(kind, kWrittenWidth, kWrittenHeight).value_or(calib::CameraModel{});
  info.world_from_camera = {glm::normalize(glm::dquat(.9, .1, -.3, .2)), {.1, 1.6, -2.5}};
  return info;
}

template <class Pixel>
std::shared_ptr<const FramePixels> picture(const std::function<Pixel(int)>& colour) {
  Image<Pixel> image(kWrittenWidth, kWrittenHeight);
  int n = 0;
  for (Pixel& p : image.pixels()) p = colour(n++);
  return std::make_shared<const FramePixels>(std::move(image));
}

std::shared_ptr<const FramePixels> picture8(int seed) {
  return picture<Rgb8>([=](int n) {
    return Rgb8{static_cast<std::uint8_t>(n + seed), static_cast<std::uint8_t>(2 * n),
                static_cast<std::uint8_t>(seed)};
  });
}

std::vector<CameraInfo> three_cameras() {
  std::vector<CameraInfo> cameras{
      camera("view-left", Role::kView, calib::ProjectionKind::kPinhole),
      camera("environment", Role::kEnvironment, calib::ProjectionKind::kEquidistant),
      camera("probe", Role::kEnvironment, calib::ProjectionKind::kLatLong)};
  cameras[0].eye = "left";
  cameras[0].response = calib::Response::gamma(2.2);
  cameras[0].black_level = .0625;
  cameras[0].projection.principal_px = {7.25, 4.1};
  std::array<std::vector<float>, 3> decode{{{0, .2f, 1}, {0, .3f, 1}, {0, .4f, 1}}};
  cameras[1].response = calib::Response::from_table(decode).value_or(calib::Response::linear());
  cameras[1].noise = {12345, 2.5e-4};
  for (const int i : {0, 1})
    cameras[1].lenses.push_back(
        {8 * i, 0, *calib::make_projection(calib::ProjectionKind::kKannalaBrandt, 8, 8),
         glm::normalize(glm::dquat(.1, .2, .9, -.1 * i)), 1.6 + i});
  cameras[1].lenses[1].projection.distortion = {.01, -.002, 0, 1e-4};
  cameras[1].projection = cameras[1].lenses[0].projection;
  cameras[1].projection.width = kWrittenWidth;
  cameras[0].vignetting = {-.3, 1. / 7, 0};
  cameras[0].ball = Ball{{}, {.25, 1. / 3, -2}, .05};
  cameras[0].ball_reflectance = {.6f, .55f, .5f};
  return cameras;
}

/// Times that a double in seconds cannot hold, three pixel formats, a tie.
std::vector<Frame> frames_in_order() {
  const std::int64_t start = 1'700'000'000'123'456'789;
  const auto frame = [&](int camera, std::uint64_t sequence, std::int64_t time, double seconds,
                         double gain, std::shared_ptr<const FramePixels> pixels) {
    const double t = static_cast<double>(sequence);
    return Frame{camera,
                 sequence,
                 {start + time},
                 {Seconds(seconds), Gain(gain)},
                 {glm::normalize(glm::dquat(1, .1 * t, .2, .3)), {t / 3, -1. / 7, 2}},
                 std::move(pixels)};
  };
  const auto deep = picture<Rgb16>([](int n) {
    return Rgb16{static_cast<std::uint16_t>(500 * n), 65535, static_cast<std::uint16_t>(n)};
  });
  const auto linear = picture<Rgb>([](int n) {
    return Rgb{1e-5f * static_cast<float>(n), 3e4f, 1.f / 3};
  });
  std::vector<Frame> out = {
      frame(1, 0, 0, 1. / 3, 1, picture8(1)), frame(2, 0, 0, .01, 1.7, linear),
      frame(0, 0, 0, .02, 1, deep),           frame(1, 1, 1, .04, 1, picture8(2)),
      frame(0, 1, 16'666'667, .02, 4, deep),  frame(1, 2, 33'333'333, 1e-6, 1, picture8(3))};
  out[4].opacity = .4f;  // its pose is old
  return out;
}

void expect_same(const Frame& a, const Frame& b) {
  EXPECT_EQ(a.camera, b.camera);
  EXPECT_EQ(a.sequence, b.sequence);
  EXPECT_EQ(a.time.value, b.time.value);
  EXPECT_EQ(a.exposure.time.count(), b.exposure.time.count());
  EXPECT_EQ(a.exposure.gain.value(), b.exposure.gain.value());
  EXPECT_EQ(a.world_from_camera, b.world_from_camera);
  EXPECT_EQ(a.opacity, b.opacity);
  EXPECT_TRUE(*a.pixels == *b.pixels);
}

void write_all(const fs::path& folder, const std::vector<Frame>& frames) {
  auto writer = CaptureFolderWriter::create(folder, three_cameras());
  ASSERT_TRUE(writer.has_value()) << writer.error().detail;
  for (const Frame& frame : frames) {
    const auto written = writer->write(frame);
    ASSERT_TRUE(written.has_value()) << written.error().where << ": " << written.error().detail;
  }
  EXPECT_FALSE(fs::exists(folder / "capture.toml"));
  const auto finished = writer->finish();
  ASSERT_TRUE(finished.has_value()) << finished.error().detail;
}

TEST(CaptureFolderWriter, FramesReadBackIdentically) {
  const test::TempFolder temp;
  const fs::path folder = temp.path() / "deep" / "capture";
  // Written camera by camera: reading merges them in order of time, the environment first.
  std::vector<Frame> by_camera = frames_in_order();
  std::ranges::stable_sort(by_camera, {}, &Frame::camera);
  write_all(folder, by_camera);
  const auto source = open_capture_folder(folder);
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  for (const Frame& expected : frames_in_order()) {
    const auto frame = (*source)->next();
    ASSERT_TRUE(frame.has_value()) << frame.error().where << ": " << frame.error().detail;
    ASSERT_TRUE(frame->has_value());
    expect_same(**frame, expected);
  }
  const auto end = (*source)->next();
  ASSERT_TRUE(end.has_value());
  EXPECT_FALSE(end->has_value());
}

TEST(CaptureFolderWriter, CamerasReadBackIdentically) {
  const test::TempFolder temp;
  write_all(temp.path(), frames_in_order());
  const auto source = open_capture_folder(temp.path());
  ASSERT_TRUE(source.has_value()) << source.error().where << ": " << source.error().detail;
  const auto expected = three_cameras();
  const auto& found = (*source)->cameras();
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_EQ(found[i].name, expected[i].name);
    EXPECT_EQ(found[i].role, expected[i].role);
    EXPECT_EQ(found[i].eye, expected[i].eye);
    EXPECT_EQ(found[i].black_level, expected[i].black_level);
    EXPECT_EQ(found[i].noise.full_well_electrons, expected[i].noise.full_well_electrons);
    EXPECT_EQ(found[i].noise.read_noise, expected[i].noise.read_noise);
    EXPECT_EQ(found[i].response.describe(), expected[i].response.describe());
    for (int c = 0; c < 3; ++c)
      EXPECT_EQ(found[i].response.decode_table(8, c), expected[i].response.decode_table(8, c));
    const auto &p = found[i].projection, &q = expected[i].projection;
    EXPECT_EQ(p.kind, q.kind);
    EXPECT_EQ(p.focal_px, q.focal_px);
    EXPECT_EQ(p.principal_px, q.principal_px);
    EXPECT_EQ(found[i].vignetting, expected[i].vignetting);
    ASSERT_EQ(found[i].lenses.size(), expected[i].lenses.size());
    for (std::size_t k = 0; k < found[i].lenses.size(); ++k) {
      const Lens &a = found[i].lenses[k], &b = expected[i].lenses[k];
      EXPECT_EQ(a.x_px, b.x_px);
      EXPECT_EQ(a.projection.width, b.projection.width);
      EXPECT_EQ(a.projection.focal_px, b.projection.focal_px);
      EXPECT_EQ(a.projection.distortion, b.projection.distortion);
      EXPECT_NEAR(a.half_field_of_view_rad, b.half_field_of_view_rad, 1e-14);
      EXPECT_NEAR(std::abs(glm::dot(a.camera_from_lens, b.camera_from_lens)), 1, 1e-14);
    }
    ASSERT_EQ(found[i].ball.has_value(), expected[i].ball.has_value());
    if (found[i].ball) {
      EXPECT_EQ(found[i].ball->centre_m, expected[i].ball->centre_m);
      EXPECT_EQ(found[i].ball->radius_m, expected[i].ball->radius_m);
      EXPECT_EQ(found[i].ball_reflectance, expected[i].ball_reflectance);
    }
    const glm::dmat4 m = found[i].world_from_camera.matrix(),
                     n = expected[i].world_from_camera.matrix();
    for (int k = 0; k < 4; ++k) EXPECT_LT(glm::length(m[k] - n[k]), 1e-14);
  }
}

TEST(CaptureFolderWriter, RefusesAFolderThatHoldsACapture) {
  const test::TempFolder temp;
  write_all(temp.path(), frames_in_order());
  const auto again = CaptureFolderWriter::create(temp.path(), three_cameras());
  ASSERT_FALSE(again.has_value());
  EXPECT_EQ(again.error().code, ErrorCode::kUnwritable);
  EXPECT_EQ(again.error().detail, "already holds a capture: remove it, or choose another folder");
}

TEST(CaptureFolderWriter, AnUnfinishedFolderIsNoCapture) {
  const test::TempFolder temp;
  {
    auto writer = CaptureFolderWriter::create(temp.path(), three_cameras());
    ASSERT_TRUE(writer.has_value());
    ASSERT_TRUE(writer->write(frames_in_order()[0]).has_value());
  }
  const auto source = open_capture_folder(temp.path());
  ASSERT_FALSE(source.has_value());
  EXPECT_EQ(source.error().code, ErrorCode::kNotFound);
}

TEST(CaptureFolderWriter, RefusesBadCameras) {
  const test::TempFolder temp;
  const auto refused = [&](const std::vector<CameraInfo>& cameras) {
    const auto writer = CaptureFolderWriter::create(temp.path(), cameras);
    return !writer && writer.error().code == ErrorCode::kInvalid;
  };
  EXPECT_TRUE(refused({}));
  const CameraInfo good = three_cameras()[0];
  EXPECT_TRUE(refused({good, good}));
  for (const char* name : {"", "..", "a/b", "a b", "\"", "a\nb"}) {
    CameraInfo bad = good;
    bad.name = name;
    EXPECT_TRUE(refused({bad})) << name;
  }
  EXPECT_TRUE(temp.empty());
}

TEST(CaptureFolderWriter, RefusesBadFramesAndWritesNothing) {
  const test::TempFolder temp;
  auto writer = CaptureFolderWriter::create(temp.path(), three_cameras());
  ASSERT_TRUE(writer.has_value());
  const Frame good = frames_in_order()[3];
  const auto refused = [&](const std::function<void(Frame&)>& spoil, const std::string& reason) {
    Frame bad = good;
    spoil(bad);
    const auto written = writer->write(bad);
    ASSERT_FALSE(written.has_value()) << reason;
    EXPECT_EQ(written.error().code, ErrorCode::kInvalid);
    EXPECT_NE(written.error().detail.find(reason), std::string::npos) << written.error().detail;
  };
  refused([](Frame& f) { f.camera = 3; }, "no camera 3");
  refused([](Frame& f) { f.camera = -1; }, "no camera -1");
  refused([](Frame& f) { f.pixels = nullptr; }, "has no pixels");
  refused([](Frame& f) { f.pixels = std::make_shared<const FramePixels>(Image<Rgb8>(3, 2)); },
          "has 3x2 pixels instead of 16x8");
  for (const double t : {0., -1., std::nan(""), std::numeric_limits<double>::infinity()})
    refused([t](Frame& f) { f.exposure.time = Seconds(t); }, "exposure_s");
  refused([](Frame& f) { f.exposure.gain = Gain(0); }, "gain");
  refused([](Frame& f) { f.world_from_camera.translation.x = std::nan(""); }, "tx");
  EXPECT_TRUE(fs::is_empty(temp.path() / "environment"));
  ASSERT_TRUE(writer->write(good).has_value());
  refused([](Frame& f) { f.time.value -= 1; }, "before the previous frame's");
}

TEST(CaptureFolderWriter, NegativeAndHugeTimesReadBackExactly) {
  const test::TempFolder temp;
  auto frames = frames_in_order();
  frames.resize(1);
  for (const std::int64_t ns : {-1'000'000'001LL, -1LL, 8'999'999'999'999'999'999LL}) {
    frames[0].time = {ns};
    const fs::path folder = temp.path() / std::to_string(ns);
    write_all(folder, frames);
    const auto source = open_capture_folder(folder);
    ASSERT_TRUE(source.has_value());
    const auto frame = (*source)->next();
    ASSERT_TRUE(frame && *frame);
    EXPECT_EQ((*frame)->time.value, ns);
  }
}

}  // namespace
}  // namespace penumbra::capture
