// Calibrations of other programs: that their cameras see here what they see there.
#include "calib/import/import_camera.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <iterator>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "calib/import/camera_presets.h"
#include "tests/fuzz/mutate.h"

namespace penumbra::calib {
namespace {

const std::filesystem::path kSeeds = PENUMBRA_SOURCE_DIR "/tests/fuzz/corpus/import";

std::string text_of(const char* seed) {
  std::ifstream in(kSeeds / seed);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

void expect_refusal(const std::string& text, const std::string& words) {
  const auto rig = parse_camera_import(text, "file");
  ASSERT_FALSE(rig) << words;
  const std::string line = rig.error().where + ": " + rig.error().detail;
  EXPECT_NE(line.find(words), std::string::npos) << line;
}

std::vector<cv::Point3d> points_ahead() {
  std::vector<cv::Point3d> out;
  for (double x = -.6; x <= .6; x += .15)
    for (double y = -.5; y <= .5; y += .125) out.emplace_back(x, y, 1 + .1 * x);
  return out;
}

// OpenCV's own projection, whose pixels count from the first one's centre.
void expect_same_pixels(const CameraModel& ours, const std::vector<double>& k,
                        const std::vector<double>& d) {
  const cv::Matx33d matrix(k[0], 0, k[2], 0, k[1], k[3], 0, 0, 1);
  const auto points = points_ahead();
  std::vector<cv::Point2d> pixels;
  if (ours.kind == ProjectionKind::kKannalaBrandt)
    cv::fisheye::projectPoints(points, pixels, cv::Vec3d(), cv::Vec3d(), matrix, d);
  else
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), matrix, d, pixels);
  int seen = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto px = pixel_from_direction(ours, {points[i].x, -points[i].y, -points[i].z});
    if (!px) continue;
    ++seen;
    EXPECT_NEAR(px->x, pixels[i].x + .5, 1e-6);
    EXPECT_NEAR(px->y, pixels[i].y + .5, 1e-6);
  }
  EXPECT_GT(seen, 40);
}

TEST(ImportCamera, TheIndexsCamerasLookForwardFromTheHead) {
  const auto rig = parse_camera_import(text_of("index.json"), "config.json");
  ASSERT_TRUE(rig) << rig.error().detail;
  EXPECT_EQ(rig->format, "Valve Index config");
  EXPECT_EQ(rig->body, "head");
  ASSERT_EQ(rig->cameras.size(), 2u);
  const ImportedCamera& left = rig->cameras[0];
  EXPECT_EQ(left.name, "left");
  EXPECT_EQ(left.eye, "left");
  EXPECT_EQ(left.camera.width, 960);
  expect_same_pixels(left.camera, {411.9, 412.3, 481.2, 476.5}, {.19, .03, -.12, .04});
  ASSERT_TRUE(left.body_from_camera);
  // The sensors' frame has x to the left and z forward; its origin is 2 cm before the eyes.
  const Pose& pose = *left.body_from_camera;
  EXPECT_NEAR(pose.translation.x, -.067, 1e-9);
  EXPECT_NEAR(pose.translation.y, -.031, 1e-9);
  EXPECT_NEAR(pose.translation.z, -.072, 1e-9);
  const glm::dvec3 view = pose.rotation * glm::dvec3(0, 0, -1),
                   up = pose.rotation * glm::dvec3(0, 1, 0);
  EXPECT_LT(view.z, -.999);
  EXPECT_NEAR(view.x, -.02, 1e-4) << "outwards";
  EXPECT_GT(up.y, .999);
}

TEST(ImportCamera, TheIndexsCamerasMayHaveTheirZForwardOrBack) {
  const auto back = parse_camera_import(text_of("index.json"), "config.json");
  // The same camera by the axes of OpenCV: z forward, y down.
  const auto forward = parse_camera_import(
      replaced(text_of("index.json"), "[-0.02, 0.0, -0.9998]", "[0.02, 0.0, 0.9998]"), "config");
  ASSERT_TRUE(back && forward) << forward.error().detail;
  const glm::dquat a = back->cameras[0].body_from_camera->rotation,
                   b = forward->cameras[0].body_from_camera->rotation;
  EXPECT_NEAR(std::abs(glm::dot(a, b)), 1, 1e-12);
  expect_refusal(replaced(replaced(text_of("index.json"), "[-0.02, 0.0, -0.9998]", "[0, 1, 0]"),
                          "[-0.9998, 0.0, 0.02]", "[-1, 0, 0]"),
                 "does not look forward");
}

TEST(ImportCamera, KalibrsCamerasStandByTheFirst) {
  const auto rig = parse_camera_import(text_of("camchain.yaml"), "camchain.yaml");
  ASSERT_TRUE(rig) << rig.error().where << rig.error().detail;
  EXPECT_EQ(rig->format, "Kalibr camchain");
  EXPECT_EQ(rig->body, "first camera");
  ASSERT_EQ(rig->cameras.size(), 2u);
  expect_same_pixels(rig->cameras[0].camera, {458.6, 457.3, 367.2, 248.4},
                     {-.28, .07, .0002, .00002});
  const CameraModel& ds = rig->cameras[1].camera;
  EXPECT_EQ(ds.kind, ProjectionKind::kDoubleSphere);
  EXPECT_EQ(ds.distortion[0], -.21);
  EXPECT_EQ(ds.distortion[1], .58);
  EXPECT_EQ(ds.focal_px, glm::dvec2(157.2, 157.1));
  EXPECT_EQ(ds.principal_px, glm::dvec2(254.7, 256.8));
  // A point before the first camera, through the file's matrix and through ours.
  const glm::dvec3 cv0(.2, .1, 2);
  const glm::dvec3 cv1(.99999 * .2 + .004 * 2 - .11, .1 + .001, -.004 * .2 + .99999 * 2 + .0005);
  const glm::dvec3 ours0(cv0.x, -cv0.y, -cv0.z);
  const glm::dvec3 ours1 = rig->cameras[1].body_from_camera->inverse() * ours0;
  EXPECT_NEAR(glm::length(ours1 - glm::dvec3(cv1.x, -cv1.y, -cv1.z)), 0, 1e-4);
  EXPECT_EQ(*rig->cameras[0].body_from_camera, Pose{});
}

TEST(ImportCamera, KalibrsCamerasStandByTheImuWhereTheFileHasIt) {
  const std::string text =
      "cam0: {camera_model: pinhole, intrinsics: [380, 381, 320, 240], distortion_model: "
      "equidistant, distortion_coeffs: [0.01, -0.02, 0.003, 0.0], resolution: [640, 480],\n"
      "  T_cam_imu: [[0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]]}\n";
  const auto rig = parse_camera_import(text, "camchain.yaml");
  ASSERT_TRUE(rig) << rig.error().where << rig.error().detail;
  EXPECT_EQ(rig->body, "imu");
  expect_same_pixels(rig->cameras[0].camera, {380, 381, 320, 240}, {.01, -.02, .003, 0});
  // The IMU's x is the camera's view, its z is up.
  const glm::dvec3 seen = rig->cameras[0].body_from_camera->inverse() * glm::dvec3(2, 0, 0);
  EXPECT_NEAR(glm::length(seen - glm::dvec3(.1, -.2, -2.3)), 0, 1e-9);
  expect_refusal(replaced(text, "pinhole", "omni"), "is omni");
  expect_refusal(replaced(text, "equidistant", "fov"), "is fov");
  expect_refusal(replaced(text, "[0, -1, 0, 0.1]", "[0, -2, 0, 0.1]"), "is not a rotation");
}

TEST(ImportCamera, BasaltsCamerasStandByTheImu) {
  const auto rig = parse_camera_import(text_of("basalt.json"), "calibration.json");
  ASSERT_TRUE(rig) << rig.error().where << rig.error().detail;
  EXPECT_EQ(rig->format, "Basalt calibration");
  EXPECT_EQ(rig->body, "imu");
  ASSERT_EQ(rig->cameras.size(), 2u);
  expect_same_pixels(rig->cameras[0].camera, {380.8, 380.9, 510.2, 514.3},
                     {.0101, -.01, .009, -.003});
  expect_same_pixels(rig->cameras[1].camera, {269, 269.1, 324.3, 245.2},
                     {-.1, .02, .001, -.002, .003});
  // A quarter turn about z: the camera's x is the IMU's y.
  const glm::dvec3 right = rig->cameras[0].body_from_camera->rotation * glm::dvec3(1, 0, 0);
  EXPECT_NEAR(right.y, 1, 1e-6);
  // One camera that cannot be had leaves the others.
  for (const auto& [from, to, why, which] :
       {std::array{"\"k5\": 0.0", "\"k5\": 0.1", "has k5", "cam1"},
        std::array{"\"kb4\"", "\"eucm\"", "is eucm", "cam0"}}) {
    const auto rest = parse_camera_import(replaced(text_of("basalt.json"), from, to), "b.json");
    ASSERT_TRUE(rest) << rest.error().detail;
    EXPECT_EQ(rest->cameras.size(), 1u);
    ASSERT_EQ(rest->unknown.size(), 1u);
    EXPECT_EQ(rest->unknown[0].name, which);
    EXPECT_NE(rest->unknown[0].error.detail.find(why), std::string::npos)
        << rest->unknown[0].error.detail;
  }
}

// t_imu = t_camera + offset, in both.
TEST(ImportCamera, TheClockOfTheImuIsKept) {
  const auto basalt =
      parse_camera_import(replaced(text_of("basalt.json"), "\"value0\": {",
                                   "\"value0\": {\"cam_time_offset_ns\": -5000000,"),
                          "basalt.json");
  ASSERT_TRUE(basalt) << basalt.error().where << basalt.error().detail;
  ASSERT_TRUE(basalt->cameras[0].clock_offset);
  EXPECT_NEAR(basalt->cameras[0].clock_offset->count(), -.005, 1e-12);
  const auto kalibr = parse_camera_import(
      "cam0:\n  camera_model: pinhole\n  intrinsics: [400, 401, 320, 240]\n"
      "  distortion_model: none\n  resolution: [640, 480]\n  timeshift_cam_imu: 0.0123\n"
      "  T_cam_imu:\n  - [1, 0, 0, 0]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n",
      "camchain.yaml");
  ASSERT_TRUE(kalibr) << kalibr.error().where << kalibr.error().detail;
  EXPECT_EQ(kalibr->cameras[0].clock_offset->count(), .0123);
}

TEST(ImportCamera, APrintedMessageOfRosIsKnownAndSmallerPicturesAreRefused) {
  const std::string one =
      "width: 640\nheight: 480\ndistortion_model: plumb_bob\nD: [0.1, -0.2, 0.001, 0.002, 0.05]\n"
      "K: [500, 0, 319.5, 0, 501, 239.5, 0, 0, 1]\nbinning_x: 0\nbinning_y: 0\n"
      "roi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n";
  for (const std::string& text : {one, replaced(replaced(one, "D:", "d:"), "K:", "k:")}) {
    const auto rig = parse_camera_import(text, "info.yaml");
    ASSERT_TRUE(rig) << rig.error().where << rig.error().detail;
    EXPECT_EQ(rig->format, "ROS camera_info");
    EXPECT_EQ(rig->cameras[0].camera.width, 640);
    EXPECT_EQ(rig->cameras[0].camera.focal_px, glm::dvec2(500, 501));
  }
  expect_refusal(replaced(one, "binning_x: 0", "binning_x: 2"), "binning_x");
  expect_refusal(replaced(one, "x_offset: 0", "x_offset: 8"), "roi");
  expect_refusal(replaced(one, "  width: 0", "  width: 320"), "roi");
  const std::string whole =
      replaced(replaced(one, "  height: 0", "  height: 480"), "  width: 0", "  width: 640");
  EXPECT_TRUE(parse_camera_import(whole, "info.yaml")) << "all of the picture";
}

TEST(ImportCamera, FourTermsMayBeAFisheyesAndThatIsSaid) {
  const auto rig = parse_camera_import(
      R"({"image_width": 1280, "image_height": 720, "K": [900, 0, 639.5, 0, 901, 359.5, 0, 0, 1],
          "D": [0.05, -0.12, 0.001, -0.0008]})",
      "four.json");
  ASSERT_TRUE(rig) << rig.error().detail;
  ASSERT_EQ(rig->notes.size(), 1u);
  EXPECT_NE(rig->notes[0].find("fisheye_model"), std::string::npos);
}

TEST(ImportCamera, OpenCvsYamlXmlAndJsonAreOneCamera) {
  const auto yaml = parse_camera_import(text_of("opencv.yml"), "camera.yml");
  const auto xml = parse_camera_import(text_of("opencv.xml"), "camera.xml");
  const auto json = parse_camera_import(
      R"({"image_width": 1280, "image_height": 720,
          "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
                            "data": [900, 0, 639.5, 0, 901, 359.5, 0, 0, 1]},
          "distortion_coefficients": {"type_id": "opencv-matrix", "rows": 5, "cols": 1, "dt": "d",
                                      "data": [0.05, -0.12, 0.001, -0.0008, 0.06]}})",
      "camera.json");
  ASSERT_TRUE(yaml) << yaml.error().where << yaml.error().detail;
  ASSERT_TRUE(xml) << xml.error().where << xml.error().detail;
  ASSERT_TRUE(json) << json.error().where << json.error().detail;
  EXPECT_EQ(yaml->format, "OpenCV FileStorage");
  EXPECT_EQ(yaml->body, "");
  expect_same_pixels(yaml->cameras[0].camera, {900, 901, 639.5, 359.5},
                     {.05, -.12, .001, -.0008, .06});
  EXPECT_EQ(yaml->cameras[0].camera, xml->cameras[0].camera);
  EXPECT_EQ(yaml->cameras[0].camera, json->cameras[0].camera);
}

TEST(ImportCamera, OpenCvsFisheyesAndPairsAreKnown) {
  const std::string fisheye =
      replaced(replaced(text_of("opencv.yml"), "fisheye_model: 0", "fisheye_model: 1"),
               "[ 0.05, -0.12, 0.001, -0.0008, 0.06 ]", "[ 0.05, -0.012, 0.001, -0.0008 ]");
  const auto one = parse_camera_import(fisheye, "camera.yml");
  ASSERT_TRUE(one) << one.error().where << one.error().detail;
  expect_same_pixels(one->cameras[0].camera, {900, 901, 639.5, 359.5}, {.05, -.012, .001, -.0008});
  const auto pair = parse_camera_import(
      "imageSize: [640, 480]\nM1: [500, 0, 319.5, 0, 500, 239.5, 0, 0, 1]\nD1: [0.1, 0, 0, 0]\n"
      "M2: [501, 0, 318, 0, 501, 240, 0, 0, 1]\nD2: [0.1, 0, 0, 0]\n"
      "R: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nT: [-0.063, 0, 0]\n",
      "pair.yml");
  ASSERT_TRUE(pair) << pair.error().where << pair.error().detail;
  ASSERT_EQ(pair->cameras.size(), 2u);
  EXPECT_EQ(pair->cameras[1].eye, "right");
  EXPECT_NEAR(pair->cameras[1].body_from_camera->translation.x, .063, 1e-12);
}

TEST(ImportCamera, RossCameraInfoIsKnown) {
  const auto rig = parse_camera_import(text_of("ros.yaml"), "camera_info.yaml");
  ASSERT_TRUE(rig) << rig.error().where << rig.error().detail;
  EXPECT_EQ(rig->format, "ROS camera_info");
  EXPECT_EQ(rig->cameras[0].name, "narrow_stereo");
  expect_same_pixels(rig->cameras[0].camera, {438.78, 437.35, 305.59, 243.74},
                     {-.36, .11, .0011, -.00047, 0});
  expect_refusal(replaced(text_of("ros.yaml"), "plumb_bob", "thin_prism"), "is thin_prism");
}

TEST(ImportCamera, WhatCannotBeReadIsRefusedByName) {
  expect_refusal("", "is empty");
  expect_refusal("a: 1\n", "is no calibration of");
  expect_refusal("{\"a\": ", "is no JSON at byte");
  expect_refusal("a: [1, 2", "file:");
  expect_refusal("<opencv_storage><a>", "ends too early");
  expect_refusal("<other/>", "does not begin with opencv_storage");
  expect_refusal(replaced(text_of("opencv.yml"), "image_width", "width"),
                 "image_width and image_height: are missing");
  expect_refusal(replaced(text_of("opencv.yml"), "9.0e+02", ".nan"), "finite numbers");
  expect_refusal(replaced(text_of("opencv.yml"), "9.0e+02", "-900"), "focal length");
  expect_refusal(replaced(text_of("opencv.yml"), "9.0e+02, 0.", "9.0e+02, 3."), "fx 0 cx");
  expect_refusal(replaced(text_of("opencv.yml"), "image_width: 1280", "image_width: 1e9"),
                 "within 1..32768");
  std::string deep;
  for (int i = 0; i < 300; ++i) deep += "[";
  expect_refusal("a: " + deep, "");
  // Aliases of aliases: a few lines that would be millions of values.
  std::string many = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n";
  for (int i = 1; i < 9; ++i) {
    many += "a" + std::to_string(i) + ": &a" + std::to_string(i) + " [";
    for (int j = 0; j < 10; ++j) many += (j ? ", *a" : "*a") + std::to_string(i - 1);
    many += "]\n";
  }
  expect_refusal(many, "too many values");
}

TEST(ImportCamera, DamagedFilesAreRefusedOrRead) {
  for (const char* seed :
       {"index.json", "camchain.yaml", "basalt.json", "opencv.yml", "opencv.xml", "ros.yaml"}) {
    const std::string text = text_of(seed);
    int read = 0;
    test::mutate_and_run({reinterpret_cast<const unsigned char*>(text.data()), text.size()}, 300,
                         20261127, [&](std::span<const unsigned char> bytes) {
                           const auto rig = parse_camera_import(
                               {reinterpret_cast<const char*>(bytes.data()), bytes.size()}, seed);
                           if (!rig) return;
                           ++read;
                           for (const ImportedCamera& one : rig->cameras)
                             EXPECT_GT(one.camera.focal_px.x * one.camera.focal_px.y, 0);
                         });
    EXPECT_LT(read, 300) << seed;
  }
}

TEST(CameraPresets, TheIndexIsKnownByItsUsbName) {
  const auto index = find_camera_preset("3D Camera: eTronVideo");
  ASSERT_TRUE(index);
  EXPECT_EQ(index->headset, "Valve Index");
  EXPECT_EQ(index->width, 1920);
  EXPECT_TRUE(index->side_by_side);
  EXPECT_EQ(
      advice(*index),
      "  as in a Valve Index: two cameras of width = 960 and height = 960, half = \"left\" and "
      "\"right\", format = \"YUYV\", fps = 54\n"
      "  its lenses and poses: penumbra calibrate import FILE, of "
      "config/lighthouse/SERIAL/config.json in Steam's folder\n");
  EXPECT_FALSE(find_camera_preset("Integrated Camera"));
}

}  // namespace
}  // namespace penumbra::calib
