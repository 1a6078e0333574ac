// Real things in front of what is virtual, by a depth camera or a mask.
#include "runtime/foreground/foreground_stage.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/threads/stage_times.h"
#include "runtime/foreground/internal/depth_splat.h"
#include "tests/support/hand_world.h"

namespace penumbra::runtime {
namespace {

using test::DepthErrors;
using test::HandPicture;
using test::HandWorld;

calib::CameraModel pinhole(int width, int height, double focal_px) {
  return {calib::ProjectionKind::kPinhole, width, height, {focal_px, focal_px},
          {width / 2., height / 2.},       {}};
}

const calib::CameraModel kView = pinhole(640, 480, 560), kDepthCamera = pinhole(320, 240, 270);

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
      camera_of("view", capture::Role::kView, kView, HandWorld::view()),
      camera_of("depth", capture::Role::kDepth, kDepthCamera, depth_pose())};
  HandPicture picture;
  capture::Frame view, depth;

  explicit Filmed(const HandWorld& world, std::uint32_t seed = 1, const DepthErrors& errors = {})
      : picture(film(world, kView, HandWorld::view())),
        view(frame_of(0, with_noise(picture.signal, .004f, seed), HandWorld::view())),
        depth(frame_of(1, film_depth(world, kDepthCamera, depth_pose(), errors, seed),
                       depth_pose())) {}
};

const prt::Plane kTable;

float cover_in(const compositor::Foreground& f, int x, int y) {
  if (x < f.area.x0 || x >= f.area.x1 || y < f.area.y0 || y >= f.area.y1) return 0;
  return f.cover[f.index(x, y)].a;
}

// Depth alone, as it falls into the view's picture.
EdgeError depth_alone(const Filmed& filmed) {
  Silhouettes out;
  DepthRows scratch;
  out.reset(kView.width, kView.height);
  const auto rays = DepthRays::create(kDepthCamera);
  splat_depth({std::get<Image<Rgb16>>(*filmed.depth.pixels), .001f, *rays, depth_pose()},
              {&kTable, 1}, {kView, nullptr, HandWorld::view()}, scratch, out);
  return edge_error(filmed.picture.cover, [&](int x, int y) {
    return out.distance_m.at(x, y) < Silhouettes::kNothing ? 1.f : 0.f;
  });
}

struct HandCase {
  std::string name;
  HandWorld world;
};

std::vector<HandCase> hand_cases() {
  std::vector<HandCase> out{{"skin", HandWorld::usual()},
                            {"dark_glove", HandWorld::usual()},
                            {"as_the_table", HandWorld::usual()}};
  out[1].world.skin = {.05f, .05f, .06f};
  out[2].world.skin = out[2].world.floor;
  return out;
}

TEST(ForegroundEdge, IsWithinAPixelAndAHalfOfTheTruth) {
  for (const HandCase& c : hand_cases()) {
    for (const std::uint32_t seed : {1u, 2u}) {
      const Filmed filmed(c.world, seed);
      auto stage = ForegroundStage::create(filmed.cameras, {&kTable, 1});
      ASSERT_TRUE(stage) << stage.error().detail;
      ASSERT_TRUE(stage->add(filmed.depth));
      const auto found = stage->in_front_of(filmed.view, kView, nullptr, nullptr);
      ASSERT_NE(found, nullptr);
      const EdgeError naive = depth_alone(filmed);
      const EdgeError ours =
          edge_error(filmed.picture.cover, [&](int x, int y) { return cover_in(*found, x, y); });
      if (const char* d = std::getenv("FG_DUMP")) {
        std::FILE* f = std::fopen(
            (std::string(d) + "/" + c.name + std::to_string(seed) + ".ppm").c_str(), "wb");
        std::fprintf(f, "P6 640 1440 255\n");
        const auto put = [&](float r, float g, float b) {
          for (float v : {r, g, b}) std::fputc(int(std::clamp(255 * v, 0.f, 255.f)), f);
        };
        for (int y = 0; y < 480; ++y)
          for (int x = 0; x < 640; ++x) {
            Rgb s2 = filmed.picture.signal.at(x, y);
            put(s2.r, s2.g, s2.b);
          }
        for (int y = 0; y < 480; ++y)
          for (int x = 0; x < 640; ++x) {
            float a = cover_in(*found, x, y);
            put(a, a, a);
          }
        for (int y = 0; y < 480; ++y)
          for (int x = 0; x < 640; ++x) {
            float a = cover_in(*found, x, y), t = filmed.picture.cover.at(x, y);
            put(.5f + .5f * (a - t), .5f, .5f - .5f * (a - t));
          }
        std::fclose(f);
      }
      std::printf("%-12s depth alone %.2f px (worst cells %.2f), with the picture %.2f (%.2f)\n",
                  c.name.c_str(), naive.mean_px, naive.worst_px, ours.mean_px, ours.worst_px);
      EXPECT_LE(ours.mean_px, 1.5) << c.name;
      EXPECT_LE(ours.worst_px, 1.5) << c.name;
    }
  }
}

}  // namespace
}  // namespace penumbra::runtime
