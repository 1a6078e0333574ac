// Real things in front of what is virtual, by a depth camera or a mask.
#include "runtime/foreground/foreground_stage.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/foreground/internal/depth_splat.h"
#include "runtime/pipeline/pipeline.h"
#include "tests/support/gl.h"
#include "tests/support/hand_world.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

using test::DepthErrors;
using test::HandPicture;
using test::HandWorld;

calib::CameraModel pinhole(int width, int height, double focal_px) {
  return {calib::ProjectionKind::kPinhole, width, height, {focal_px, focal_px},
          {width / 2., height / 2.},       {}};
}

const calib::CameraModel kHandView = pinhole(640, 480, 560), kDepthCamera = pinhole(320, 240, 270);

Pose depth_pose() {
  Pose out = HandWorld::view();
  out.translation += out.rotation * glm::dvec3(.05, .01, 0);
  return out;
}

capture::CameraInfo camera_of(const std::string& name, capture::Role role,
                              const calib::CameraModel& model, const Pose& pose) {
  capture::CameraInfo out;
  out.name = name;
  out.role = role;
  out.projection = model;
  out.response = calib::Response::linear();
  out.world_from_camera = pose;
  return out;
}

capture::Frame frame_of(int camera, FramePixels pixels, const Pose& pose, double seconds = 0) {
  capture::Frame out;
  out.camera = camera;
  out.time = TimestampNs{static_cast<std::int64_t>(seconds * 1e9)};
  out.exposure = {Seconds(1), Gain(1)};
  out.world_from_camera = pose;
  out.pixels = std::make_shared<const FramePixels>(std::move(pixels));
  return out;
}

Image<Rgb> with_noise(Image<Rgb> picture, float sigma, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, sigma);
  for (Rgb& p : picture.pixels()) p += Rgb{normal(random), normal(random), normal(random)};
  return picture;
}

// How far an edge lies off, pixels: what is covered wrongly over the length of the true edge, of
// the whole picture and of its worst twentieth of cells.
struct EdgeError {
  double mean_px = 0, worst_px = 0;
};

template <class Cover>
EdgeError edge_error(const Image<float>& truth, const Cover& cover) {
  constexpr int kCell = 24;
  constexpr double kMinLength = 6;
  double all_wrong = 0, all_length = 0;
  std::vector<double> cells;
  for (int y0 = 1; y0 < truth.height() - 1; y0 += kCell)
    for (int x0 = 1; x0 < truth.width() - 1; x0 += kCell) {
      double wrong = 0, length = 0;
      for (int y = y0; y < std::min(y0 + kCell, truth.height() - 1); ++y)
        for (int x = x0; x < std::min(x0 + kCell, truth.width() - 1); ++x) {
          wrong += std::abs(double(cover(x, y)) - double(truth.at(x, y)));
          length += std::hypot(truth.at(x + 1, y) - truth.at(x - 1, y),
                               truth.at(x, y + 1) - truth.at(x, y - 1)) /
                    2;
        }
      all_wrong += wrong, all_length += length;
      if (length > kMinLength) cells.push_back(wrong / length);
    }
  std::ranges::sort(cells);
  return {all_wrong / all_length, cells[cells.size() * 19 / 20]};
}

struct Filmed {
  std::vector<capture::CameraInfo> cameras{
      camera_of("view", capture::Role::kView, kHandView, HandWorld::view()),
      camera_of("depth", capture::Role::kDepth, kDepthCamera, depth_pose())};
  HandPicture picture;
  capture::Frame view, depth;

  explicit Filmed(const HandWorld& world, std::uint32_t seed = 1, const DepthErrors& errors = {})
      : picture(film(world, kHandView, HandWorld::view())),
        view(frame_of(0, with_noise(picture.signal, .004f, seed), HandWorld::view())),
        depth(frame_of(1, film_depth(world, kDepthCamera, depth_pose(), errors, seed),
                       depth_pose())) {}
};

const prt::Plane kTable;
const Vignetting kNoVignetting;
const std::vector<shadows::BoundingSphere> kBall{{{0, .13, 0}, .13}};
const std::vector<shadows::BoundingSphere> kNearBall{{{0, .13, 0}, .6}};

float cover_in(const compositor::Foreground& f, int x, int y) {
  if (x < f.area.x0 || x >= f.area.x1 || y < f.area.y0 || y >= f.area.y1) return 0;
  return f.cover[f.index(x, y)].a;
}

// Depth alone, as it falls into the view's picture.
EdgeError depth_alone(const Filmed& filmed) {
  Silhouettes out;
  DepthFront front;
  SplatRow scratch;
  out.reset(kHandView.width, kHandView.height);
  const auto rays = DepthRays::create(kDepthCamera);
  find_front(std::get<Image<Rgb16>>(*filmed.depth.pixels), .001f, *rays, depth_pose(), {&kTable, 1},
             front);
  splat_depth(front, *rays, {kHandView, nullptr, HandWorld::view(), 2}, scratch, out);
  return edge_error(filmed.picture.cover, [&](int x, int y) {
    return out.distance_m.at(x, y) < Silhouettes::kNothing ? 1.f : 0.f;
  });
}

struct HandCase {
  std::string name;
  HandWorld world;
  bool alike = false;  // hand and table
};

std::vector<HandCase> hand_cases() {
  std::vector<HandCase> out{{"skin", HandWorld::usual()},
                            {"dark_glove", HandWorld::usual()},
                            {"as_the_table", HandWorld::usual()}};
  out[1].world.skin = {.05f, .05f, .06f};
  out[2].world.skin = out[2].world.floor;
  out[2].alike = true;
  return out;
}

TEST(ForegroundEdge, IsWithinAPixelAndAHalfOfTheTruth) {
  for (const HandCase& c : hand_cases()) {
    for (const std::uint32_t seed : {1u, 2u}) {
      const Filmed filmed(c.world, seed);
      auto stage = ForegroundStage::create(filmed.cameras, {&kTable, 1});
      ASSERT_TRUE(stage) << stage.error().detail;
      ASSERT_TRUE(stage->add(filmed.depth));
      const auto found =
          stage->in_front_of(filmed.view, {kHandView, nullptr, nullptr, kNoVignetting}, kNearBall);
      ASSERT_NE(found, nullptr);
      const EdgeError naive = depth_alone(filmed);
      const EdgeError ours =
          edge_error(filmed.picture.cover, [&](int x, int y) { return cover_in(*found, x, y); });
      std::printf("%-12s depth alone %.2f px (worst cells %.2f), with the picture %.2f (%.2f)\n",
                  c.name.c_str(), naive.mean_px, naive.worst_px, ours.mean_px, ours.worst_px);
      EXPECT_LE(ours.mean_px, c.alike ? 1.25 : .5) << c.name;
      EXPECT_LT(ours.mean_px, (c.alike ? .8 : .3) * naive.mean_px) << c.name;
      if (!c.alike) {
        EXPECT_LE(ours.worst_px, 1.) << c.name;
      }
    }
  }
}

// ------------------------------------------------------------------------------ joined chain

constexpr int kViewCamera = 0, kDepth = 1;

// A ball on the table, behind the hand.
std::shared_ptr<const PreparedScene> ball_on_table() {
  static const auto scene = [] {
    auto out = std::make_shared<PreparedScene>();
    prt::Mesh mesh = prt::make_sphere({0, .13f, 0}, .13f, 4, {.2f, .5f, .3f});
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 128;
    bake.bounces = 0;  // what the floor sends to it the hand takes elsewhere than its sun
    bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 48), {.3f, .3f, .3f}};
    out->objects.push_back({"ball", *prt::bake(std::move(mesh), bake), {}, 0});
    out->planes.push_back(kTable);
    return out;
  }();
  return scene;
}

Result<Pipeline> pipeline_of(const std::vector<capture::CameraInfo>& cameras) {
  auto out = Pipeline::create(cameras, ball_on_table());
  if (out) out->set_light(*lighting::estimate_map(capture::make_sky_environment(128, 64, .8), {}));
  return out;
}

Image<Rgb> composited(Pipeline& pipeline, const capture::Frame& view) {
  auto out = pipeline.composite(view);
  EXPECT_TRUE(out) << out.error().detail;
  return std::get<Image<Rgb>>(out->pixels);
}

float apart(const Rgb& a, const Rgb& b) {
  return std::max({std::abs(a.r - b.r), std::abs(a.g - b.g), std::abs(a.b - b.b)});
}

// The hand before the ball: what its picture would be if the ball stood there. `behind`: the
// picture without the hand, with the ball.
Image<Rgb> hand_before(const Filmed& filmed, const Image<Rgb>& empty, const Image<Rgb>& behind) {
  Image<Rgb> out = filmed.picture.signal;
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] +=
        (behind.pixels()[i] - empty.pixels()[i]) * (1 - filmed.picture.cover.pixels()[i]);
  return out;
}

struct Chain {
  Filmed filmed;
  Image<Rgb> empty, behind;  // without the hand; with the ball
  std::optional<Pipeline> pipeline;

  explicit Chain(const HandWorld& world = HandWorld::usual()) : filmed(world) {
    HandWorld table = world;
    table.rods.clear();
    empty = film(table, kHandView, HandWorld::view()).signal;
    auto made = pipeline_of(filmed.cameras);
    if (!made) return;
    pipeline.emplace(std::move(*made));
    behind = composited(*pipeline, frame_of(kViewCamera, empty, HandWorld::view()));
  }
  // In all pixels that the ball, or its shadow, would change, and that the hand covers in part.
  double edge_error(const Image<Rgb>& picture) const {
    const Image<Rgb> truth = hand_before(filmed, empty, behind);
    return mean_where(picture, truth, [&](std::size_t i) {
      const float cover = filmed.picture.cover.pixels()[i];
      return cover > 0 && cover < 1;
    });
  }
  double inner_error(const Image<Rgb>& picture) const {
    const Image<Rgb> truth = hand_before(filmed, empty, behind);
    return mean_where(picture, truth,
                      [&](std::size_t i) { return filmed.picture.cover.pixels()[i] == 1; });
  }

 private:
  template <class Counts>
  double mean_where(const Image<Rgb>& a, const Image<Rgb>& b, const Counts& counts) const {
    double sum = 0;
    int pixels = 0;
    for (std::size_t i = 0; i < a.area(); ++i) {
      if (!counts(i) || apart(behind.pixels()[i], empty.pixels()[i]) < .05f) continue;
      sum += double(apart(a.pixels()[i], b.pixels()[i]));
      ++pixels;
    }
    EXPECT_GT(pixels, 100);
    return sum / pixels;
  }
};

#define NEED_CHAIN(chain) \
  if (!(chain).pipeline) GTEST_SKIP() << "no OpenGL ES 3.1 here"

TEST(HandInFront, LooksAsIfTheBallStoodBehindIt) {
  Chain chain;
  NEED_CHAIN(chain);
  const Image<Rgb> naive = composited(*chain.pipeline, chain.filmed.view);
  ASSERT_TRUE(chain.pipeline->add_foreground(chain.filmed.depth));
  const Image<Rgb> ours = composited(*chain.pipeline, chain.filmed.view);
  std::printf("edge: naive %.4f, ours %.4f; inside: naive %.4f, ours %.4f\n",
              chain.edge_error(naive), chain.edge_error(ours), chain.inner_error(naive),
              chain.inner_error(ours));
  EXPECT_LT(chain.edge_error(ours), .45 * chain.edge_error(naive));
  EXPECT_LT(chain.inner_error(ours), .006);  // the noise of the camera
  // The camera's own pixels stay where nothing virtual is to be seen.
  const Image<Rgb>& camera = std::get<Image<Rgb>>(*chain.filmed.view.pixels);
  int same = 0, covered = 0;
  for (std::size_t i = 0; i < ours.area(); ++i) {
    if (chain.filmed.picture.cover.pixels()[i] < 1) continue;
    ++covered;
    same += ours.pixels()[i] == camera.pixels()[i];
  }
  EXPECT_GT(same, .97 * covered);
}

TEST(HandInFront, BehindTheBallItHidesNothingOfIt) {
  HandWorld world = HandWorld::usual();
  for (test::Rod& rod : world.rods)
    rod.from += glm::dvec3(-.05, -.32, -.47), rod.to += glm::dvec3(-.05, -.32, -.47);
  Chain chain(world);
  NEED_CHAIN(chain);
  const Image<Rgb> naive = composited(*chain.pipeline, chain.filmed.view);
  ASSERT_TRUE(chain.pipeline->add_foreground(chain.filmed.depth));
  const Image<Rgb> ours = composited(*chain.pipeline, chain.filmed.view);
  int before_hand = 0;
  for (std::size_t i = 0; i < ours.area(); ++i) {
    const bool ball = apart(chain.behind.pixels()[i], chain.empty.pixels()[i]) > .05f;
    if (!ball || chain.filmed.picture.cover.pixels()[i] < 1) continue;
    ++before_hand;
    EXPECT_LT(apart(ours.pixels()[i], naive.pixels()[i]), 3e-3f);  // at the rim of the ball
  }
  EXPECT_GT(before_hand, 100);
}

TEST(HandInFront, WhatIsOldTellsNothing) {
  Chain chain;
  NEED_CHAIN(chain);
  const Image<Rgb> naive = composited(*chain.pipeline, chain.filmed.view);
  capture::Frame view = chain.filmed.view;
  ASSERT_TRUE(chain.pipeline->add_foreground(chain.filmed.depth));
  view.time = TimestampNs{260'000'000};
  EXPECT_TRUE(composited(*chain.pipeline, view) == naive);
  view.time = TimestampNs{240'000'000};
  EXPECT_FALSE(composited(*chain.pipeline, view) == naive);
}

TEST(HandInFront, AMaskHidesAllThatIsVirtual) {
  Chain chain;
  NEED_CHAIN(chain);
  std::vector<capture::CameraInfo> cameras = chain.filmed.cameras;
  cameras[kDepth].role = capture::Role::kMask;
  auto made = pipeline_of(cameras);
  ASSERT_TRUE(made);
  const Image<Rgb> naive = composited(*made, chain.filmed.view);
  Image<Rgb8> mask(kDepthCamera.width, kDepthCamera.height, Rgb8{});
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      float sum = 0;
      for (int k = 0; k < 4; ++k)
        sum += chain.filmed.picture.cover.at(2 * x + k % 2, 2 * y + k / 2);
      const auto code = static_cast<std::uint8_t>(255 * sum / 4 + .5f);
      mask.at(x, y) = {code, code, code};
    }
  ASSERT_TRUE(made->add_foreground(frame_of(kDepth, mask, HandWorld::view())));
  const Image<Rgb> ours = composited(*made, chain.filmed.view);
  EXPECT_LT(chain.edge_error(ours), .45 * chain.edge_error(naive));
  EXPECT_LT(chain.inner_error(ours), .006);
}

// Both cameras through fisheyes, and a depth camera of another size than the view.
TEST(HandInFront, ThroughALensItIsWhereItIs) {
  const auto fisheye = [](int width, int height, double focal) {
    const calib::CameraModel plain{calib::ProjectionKind::kKannalaBrandt,
                                   width,
                                   height,
                                   {focal, focal},
                                   {width / 2., height / 2.},
                                   {}};
    return *calib::with_distortion(plain, std::vector<double>{-.02, .004, -.001, 0});
  };
  const calib::CameraModel view = fisheye(640, 480, 420), depth = fisheye(320, 240, 210);
  const HandWorld world = HandWorld::usual();
  const HandPicture picture = film(world, view, HandWorld::view(), 3);
  const std::vector<capture::CameraInfo> cameras{
      camera_of("view", capture::Role::kView, view, HandWorld::view()),
      camera_of("depth", capture::Role::kDepth, depth, depth_pose())};
  auto stage = ForegroundStage::create(cameras, {&kTable, 1});
  const auto lens = compositor::ViewLens::create(view, "view");
  ASSERT_TRUE(stage && lens);
  ASSERT_TRUE(
      stage->add(frame_of(kDepth, film_depth(world, depth, depth_pose(), {}, 3), depth_pose())));
  const auto found = stage->in_front_of(
      frame_of(kViewCamera, with_noise(picture.signal, .004f, 3), HandWorld::view()),
      {view, lens->get(), nullptr, kNoVignetting}, kNearBall);
  ASSERT_NE(found, nullptr);
  const EdgeError ours =
      edge_error(picture.cover, [&](int x, int y) { return cover_in(*found, x, y); });
  EXPECT_LE(ours.mean_px, .6);
  EXPECT_LE(ours.worst_px, 1.5);
}

// What stands behind all objects is no thing in front, though no plane of the scene.
TEST(HandInFront, AWallBehindLeavesTheEdgeSoft) {
  HandWorld world = HandWorld::usual();
  world.wall = true;
  const Filmed filmed(world);
  auto stage = ForegroundStage::create(filmed.cameras, {&kTable, 1});
  ASSERT_TRUE(stage);
  ASSERT_TRUE(stage->add(filmed.depth));
  const auto found =
      stage->in_front_of(filmed.view, {kHandView, nullptr, nullptr, kNoVignetting}, kBall);
  ASSERT_NE(found, nullptr);
  const EdgeError ours =
      edge_error(filmed.picture.cover, [&](int x, int y) { return cover_in(*found, x, y); });
  EXPECT_LE(ours.mean_px, .6);
  EXPECT_LE(ours.worst_px, 1.2);
}

// Sensors of a few pixels and light that is no number: no edge is found, and nothing goes wrong.
TEST(HandInFront, OddPicturesDoNoHarm) {
  for (const auto& [width, height, focal] :
       {std::tuple(8, 8, 8.), {1, 1, 1.}, {1, 40, 30.}, {16, 12, 14.}}) {
    std::vector<capture::CameraInfo> cameras = Filmed(HandWorld::usual()).cameras;
    cameras[kDepth].projection = pinhole(width, height, focal);
    auto stage = ForegroundStage::create(cameras, {});
    if (!stage) {  // a pixel that sees all around
      EXPECT_EQ(stage.error().where, "depth");
      continue;
    }
    const Image<Rgb16> flat(width, height, Rgb16{600, 600, 600});
    ASSERT_TRUE(stage->add(frame_of(kDepth, flat, HandWorld::view())));
    Image<Rgb> bright(kHandView.width, kHandView.height, {.4f, .4f, .4f});
    for (int i = 0; i < 480; i += 7)
      bright.at(i, i) = {std::numeric_limits<float>::infinity(), std::nanf(""), -1};
    const auto found = stage->in_front_of(frame_of(kViewCamera, bright, HandWorld::view()),
                                          {kHandView, nullptr, nullptr, kNoVignetting}, kNearBall);
    if (!found) continue;
    for (const glm::vec4& c : found->cover) {
      ASSERT_TRUE(std::isfinite(c.r + c.g + c.b));
      ASSERT_TRUE(c.a >= 0 && c.a <= 1);
    }
    EXPECT_LT(stage->surface_near(kNearBall, TimestampNs{}).triangles.size(), 1000u);
  }
}

// The table is as noisy as the hand: it must not be taken for something in front.
TEST(HandInFront, NoisyDepthOfTheTableHidesNoShadow) {
  HandWorld table = HandWorld::usual();
  table.rods.clear();
  DepthErrors noisy;
  noisy.axial_m = .004;
  const Filmed filmed(table, 5, noisy);
  auto stage = ForegroundStage::create(filmed.cameras, {&kTable, 1});
  ASSERT_TRUE(stage);
  ASSERT_TRUE(stage->add(filmed.depth));
  const auto found =
      stage->in_front_of(filmed.view, {kHandView, nullptr, nullptr, kNoVignetting}, kNearBall);
  int covered = 0;
  for (int y = 0; found && y < kHandView.height; ++y)
    for (int x = 0; x < kHandView.width; ++x) covered += cover_in(*found, x, y) > 0;
  EXPECT_LT(covered, .0005 * kHandView.width * kHandView.height);
}

// Segmentation is never quite black, and says nothing against depth.
TEST(HandInFront, AFaintMaskLeavesWhatDepthKnows) {
  const Filmed filmed(HandWorld::usual());
  std::vector<capture::CameraInfo> cameras = filmed.cameras;
  cameras.push_back(camera_of("mask", capture::Role::kMask, pinhole(64, 48, 56), {}));
  auto stage = ForegroundStage::create(cameras, {&kTable, 1});
  ASSERT_TRUE(stage);
  ASSERT_TRUE(stage->add(filmed.depth));
  const auto find = [&] {
    return stage->in_front_of(filmed.view, {kHandView, nullptr, nullptr, kNoVignetting}, kNearBall);
  };
  const auto alone = find();
  ASSERT_NE(alone, nullptr);
  ASSERT_TRUE(stage->add(frame_of(2, Image<Rgb8>(64, 48, Rgb8{1, 1, 1}), {})));
  const auto both = find();
  ASSERT_NE(both, nullptr);
  double covered = 0, left = 0, outside = 0;
  for (int y = 0; y < kHandView.height; ++y)
    for (int x = 0; x < kHandView.width; ++x) {
      const float now = cover_in(*both, x, y), before = cover_in(*alone, x, y);
      covered += before == 1 ? 1 : 0;
      (before == 1 ? left : outside) += std::abs(double(now) - double(before));
      ASSERT_TRUE(std::isfinite(both->distance_m[both->index(x, y)]));
    }
  // Blocks of colours lie elsewhere in a larger area.
  EXPECT_LT(left, .01 * covered);
  EXPECT_LT(outside, .01 * (kHandView.width * kHandView.height - covered));
}

// A mask's thin parts, hair and glass, hide as much as it says, however far from its solid ones.
TEST(HandInFront, AThinMaskHidesInPart) {
  std::vector<capture::CameraInfo> cameras = Filmed(HandWorld::usual()).cameras;
  cameras[kDepth].role = capture::Role::kMask;
  auto stage = ForegroundStage::create(cameras, {});
  ASSERT_TRUE(stage);
  Image<Rgb8> mask(kDepthCamera.width, kDepthCamera.height, Rgb8{102, 102, 102});
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) mask.at(x, y) = {255, 255, 255};
  ASSERT_TRUE(stage->add(frame_of(kDepth, mask, {})));
  const Image<Rgb> grey(kHandView.width, kHandView.height, {.3f, .3f, .3f});
  const auto found = stage->in_front_of(frame_of(kViewCamera, grey, {}),
                                        {kHandView, nullptr, nullptr, kNoVignetting}, kNearBall);
  ASSERT_NE(found, nullptr);
  EXPECT_EQ(cover_in(*found, 20, 20), 1);
  for (const int x : {100, 300, 600}) {
    EXPECT_NEAR(cover_in(*found, x, 400), .4f, .002f) << x;
    EXPECT_EQ(found->distance_m[found->index(x, 400)], 0) << x;
  }
}

TEST(HandInFront, AViewFrameOfAnotherSizeIsRefused) {
  Chain chain;
  NEED_CHAIN(chain);
  ASSERT_TRUE(chain.pipeline->add_foreground(chain.filmed.depth));
  const auto refused = chain.pipeline->composite(
      frame_of(kViewCamera, Image<Rgb>(320, 240, {.3f, .3f, .3f}), HandWorld::view()));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, "frame");
  EXPECT_EQ(refused.error().detail, "has 320x240 pixels instead of 640x480");
}

TEST(HandInFront, BadInputIsNamed) {
  std::vector<capture::CameraInfo> cameras = Filmed(HandWorld::usual()).cameras;
  auto stage = ForegroundStage::create(cameras, {});
  ASSERT_TRUE(stage);
  const auto refused = [&](const capture::Frame& frame) {
    const auto added = stage->add(frame);
    return added ? std::string("taken") : added.error().where + " " + added.error().detail;
  };
  EXPECT_EQ(refused(frame_of(kDepth, Image<Rgb8>(320, 240, Rgb8{}), {})),
            "depth has depth that is not of 16 bits");
  EXPECT_EQ(refused(frame_of(kDepth, Image<Rgb16>(240, 320, Rgb16{}), {})),
            "depth has a frame of 240x320 pixels instead of 320x240");
  EXPECT_EQ(refused(frame_of(kViewCamera, Image<Rgb16>(320, 240, Rgb16{}), {})),
            "frame belongs to no depth camera and no mask");
  // No depth at all is no failure.
  EXPECT_EQ(refused(frame_of(kDepth, Image<Rgb16>(320, 240, Rgb16{}), {})), "taken");
  cameras[kDepth].projection = *calib::make_projection(calib::ProjectionKind::kEquidistant, 64, 64);
  const auto wide = ForegroundStage::create(cameras, {});
  ASSERT_FALSE(wide);
  EXPECT_EQ(wide.error().where, "depth");
}

// ------------------------------------------------------------------------------ its shadow

constexpr double kSunRadius = .05;  // radians

// Grey all around and a sun behind the hand, as the ball sees it.
lighting::LightEstimate sun_behind_hand(const glm::dvec3& towards) {
  constexpr int kWidth = 512, kHeight = 256;
  Image<Rgb> map(kWidth, kHeight, {.3f, .3f, .3f});
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      if (glm::dot(latlong_direction(x + .5, y + .5, kWidth, kHeight), towards) >
          std::cos(kSunRadius))
        map.at(x, y) = {120, 115, 100};
  return *lighting::estimate_map(map, {});
}

// The fraction of the sun that the hand leaves.
double sun_left(const HandWorld& world, const glm::dvec3& at, const glm::dvec3& towards) {
  constexpr int kSamples = 64;
  const glm::dvec3 u = glm::normalize(glm::cross(towards, glm::dvec3(1, 0, 0))),
                   v = glm::cross(towards, u);
  int seen = 0;
  for (int k = 0; k < kSamples; ++k) {
    const double r = kSunRadius * std::sqrt((k + .5) / kSamples), turn = 2.399963 * k;
    seen +=
        !world.hand(at, glm::normalize(towards + r * (std::cos(turn) * u + std::sin(turn) * v)));
  }
  return double(seen) / kSamples;
}

TEST(HandInFront, ThrowsItsShadowOnTheBall) {
  Chain chain;
  NEED_CHAIN(chain);
  constexpr double kRadius = .13;
  const glm::dvec3 centre(0, kRadius, 0),
      towards = glm::normalize(glm::dvec3(.02, .40, .27) - glm::dvec3(0, .17, .12));
  const lighting::LightEstimate light = sun_behind_hand(towards);
  ASSERT_EQ(light.lights.size(), 1u);
  lighting::LightEstimate shade = light;
  shade.lights.clear();
  chain.pipeline->set_light(shade);
  const Image<Rgb> ambient = composited(*chain.pipeline, chain.filmed.view);
  chain.pipeline->set_light(light);
  const Image<Rgb> lit = composited(*chain.pipeline, chain.filmed.view);
  ASSERT_TRUE(chain.pipeline->add_foreground(chain.filmed.depth));
  const Image<Rgb> ours = composited(*chain.pipeline, chain.filmed.view);
  const HandWorld world = HandWorld::usual();
  const Pose pose = HandWorld::view();
  double naive_error = 0, our_error = 0, taken = 0;
  int pixels = 0;
  for (int y = 2; y < kHandView.height - 2; ++y)
    for (int x = 2; x < kHandView.width - 2; ++x) {
      const glm::dvec3 ray =
          pose.rotation * glm::normalize(*calib::direction_from_pixel(kHandView, {x + .5, y + .5}));
      const auto ball =
          test::hit({centre, centre + glm::dvec3(0, 1e-9, 0), kRadius}, pose.translation, ray);
      if (!ball || glm::dot(ball->normal, -ray) < .3) continue;  // the rim is a mixture
      bool free = true;
      for (int k = 0; k < 25; ++k)
        free &= chain.filmed.picture.cover.at(x + k % 5 - 2, y + k / 5 - 2) == 0;
      if (!free) continue;
      const double left =
          sun_left(world, pose.translation + (ball->distance - 1e-6) * ray, towards);
      const Rgb truth =
          ambient.at(x, y) + (lit.at(x, y) - ambient.at(x, y)) * static_cast<float>(left);
      naive_error += double(apart(lit.at(x, y), truth));
      our_error += double(apart(ours.at(x, y), truth));
      taken += 1 - left;
      ++pixels;
    }
  std::printf("%d pixels, %.0f %% of their sun taken: error %.4f without, %.4f with its shadow\n",
              pixels, 100 * taken / pixels, naive_error / pixels, our_error / pixels);
  EXPECT_GT(taken, .1 * pixels);
  EXPECT_LT(our_error, .3 * naive_error);
  // Once it is gone, so is its shadow.
  capture::Frame later = chain.filmed.view;
  later.time = TimestampNs{400'000'000};
  const Image<Rgb> gone = composited(*chain.pipeline, later);
  double left_over = 0;
  for (std::size_t i = 0; i < gone.area(); ++i)
    left_over = std::max(left_over, double(apart(gone.pixels()[i], lit.pixels()[i])));
  EXPECT_LT(left_over, 1e-3);
}

// ------------------------------------------------------------------------------ runs

// The studio's room with a hand before the view camera.
struct FilmedRun : capture::FrameSource {
  std::vector<capture::CameraInfo> infos;
  std::vector<capture::Frame> frames;
  std::size_t next_frame = 0;

  const std::vector<capture::CameraInfo>& cameras() const override { return infos; }
  double view_rate() const override { return 30; }
  Result<std::optional<capture::Frame>> next() override {
    if (next_frame == frames.size()) return std::nullopt;
    return frames[next_frame++];
  }
};

FramePixels codes_of(const Image<Rgb>& signal) {
  Image<Rgb8> out(signal.width(), signal.height(), Rgb8{});
  for (std::size_t i = 0; i < signal.area(); ++i)
    for (int c = 0; c < 3; ++c)
      (&out.pixels()[i].r)[c] =
          static_cast<std::uint8_t>(255 * std::clamp(signal.pixels()[i][c], 0.f, 1.f) + .5f);
  return out;
}

FilmedRun filmed_run() {
  FilmedRun out;
  const calib::CameraModel view = pinhole(160, 120, 140), depth = pinhole(80, 60, 68);
  const Image<Rgb> sky = capture::make_sky_environment(64, 32, .8);
  out.infos = {camera_of("sky", capture::Role::kEnvironment,
                         *calib::make_projection(calib::ProjectionKind::kLatLong, 64, 32), {}),
               camera_of("view", capture::Role::kView, view, HandWorld::view()),
               camera_of("depth", capture::Role::kDepth, depth, depth_pose())};
  for (int i = 0; i < 6; ++i) {
    HandWorld world = HandWorld::usual();
    for (test::Rod& rod : world.rods) rod.from.x += .01 * i, rod.to.x += .01 * i;
    const double time = i / 30.;
    Image<Rgb> dim = sky;
    for (Rgb& p : dim.pixels()) p = p * .02f;
    out.frames.push_back(frame_of(0, codes_of(dim), {}, time));
    out.frames.push_back(
        frame_of(2, film_depth(world, depth, depth_pose(), {}, 1), depth_pose(), time));
    out.frames.push_back(frame_of(1, codes_of(film(world, view, HandWorld::view(), 2).signal),
                                  HandWorld::view(), time));
    for (std::size_t k = out.frames.size() - 3; k < out.frames.size(); ++k)
      out.frames[k].sequence = static_cast<std::uint64_t>(i);
  }
  return out;
}

std::vector<FramePixels> replayed(capture::FrameSource& source) {
  std::vector<FramePixels> out;
  auto pipeline = Pipeline::create(source.cameras(), ball_on_table());
  if (!pipeline) return out;
  const auto ran = pipeline->replay(source, [&](const Output& o) {
    out.push_back(*o.pixels);
    return true;
  });
  EXPECT_TRUE(ran) << ran.error().where << " " << ran.error().detail;
  return out;
}

TEST(HandInFront, ARecordingKeepsItAndGivesTheSameBytes) {
  FilmedRun source = filmed_run();
  const std::vector<FramePixels> direct = replayed(source);
  if (direct.empty()) GTEST_SKIP() << "no OpenGL ES 3.1 here";
  FilmedRun without = filmed_run();
  std::erase_if(without.frames, [](const capture::Frame& f) { return f.camera == 2; });
  const std::vector<FramePixels> naive = replayed(without);
  ASSERT_EQ(direct.size(), 6u);
  for (std::size_t i = 0; i < direct.size(); ++i) EXPECT_FALSE(direct[i] == naive[i]) << i;

  const test::TempFolder folder;
  using capture::Coding;
  const std::vector<Coding> codings{Coding::kRgb8, Coding::kRgb8, Coding::kRgb16};
  const auto path = folder.path() / "hand.mkv";
  auto writer = capture::RecordingWriter::create(path, source.infos, codings, 30);
  ASSERT_TRUE(writer) << writer.error().detail;
  for (const capture::Frame& frame : source.frames) ASSERT_TRUE(writer->write(frame));
  ASSERT_TRUE(writer->finish());
  auto recording = capture::open_capture(path);
  ASSERT_TRUE(recording) << recording.error().where << recording.error().detail;
  EXPECT_EQ((*recording)->cameras()[2].role, capture::Role::kDepth);
  EXPECT_EQ(replayed(**recording), direct);
}

TEST(HandInFront, ALiveRunTakesTheNewestDepth) {
  FilmedRun source = filmed_run();
  auto pipeline = Pipeline::create(source.infos, ball_on_table());
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline);
  pipeline->set_light(*lighting::estimate_map(capture::make_sky_environment(64, 32, .8), {}));
  const std::atomic<bool> stop = false;
  FilmedRun without = filmed_run();
  std::erase_if(without.frames, [](const capture::Frame& f) { return f.camera == 2; });
  const std::vector<FramePixels> naive = replayed(without);
  int hidden = 0;
  const auto sink = [&](const Output& o) {
    hidden += o.light.valid && !(*o.pixels == naive[o.source.sequence]);
    return true;
  };
  const auto ran = pipeline->run_live(source, sink, stop);
  ASSERT_TRUE(ran) << ran.error().detail;
  EXPECT_GT(ran->frames, 0u);
  EXPECT_GT(hidden, 0);
}

TEST(HandInFront, DepthThatNewerOnesOvertakeIsCounted) {
  FilmedRun source = filmed_run();
  const auto first = std::ranges::find(source.frames, 2, &capture::Frame::camera);
  ASSERT_NE(first, source.frames.end());
  const capture::Frame depth = *first;
  source.frames.insert(first, 3, depth);  // before the first view frame
  auto pipeline = Pipeline::create(source.infos, ball_on_table());
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline);
  pipeline->set_light(*lighting::estimate_map(capture::make_sky_environment(64, 32, .8), {}));
  const std::atomic<bool> stop = false;
  std::uint64_t told = 0;
  const auto ran = pipeline->run_live(
      source,
      [&](const Output& o) {
        told = o.overtaken.foreground;
        return true;
      },
      stop);
  ASSERT_TRUE(ran) << ran.error().detail;
  EXPECT_GE(ran->overtaken.foreground, 3u);
  EXPECT_GE(told, 3u);
  EXPECT_LE(told, ran->overtaken.foreground);
}

}  // namespace
}  // namespace penumbra::runtime
