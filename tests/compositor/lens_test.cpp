#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "compositor/composite/compositor.h"
#include "compositor/pixels/receivers.h"
#include "compositor/view_lens.h"
#include "tests/support/gl.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using glm::dvec2;
using glm::dvec3;

struct NamedLens {
  std::string name;
  calib::CameraModel model;
};

calib::CameraModel lens_model(calib::ProjectionKind kind, double focal, std::vector<double> terms) {
  calib::CameraModel model{kind, 320, 240, {focal, focal * 1.01}, {162.3, 117.8}, {}};
  const auto made = calib::with_distortion(model, terms);
  EXPECT_TRUE(made);
  return made.value_or(model);
}

std::vector<NamedLens> lenses() {
  using Kind = calib::ProjectionKind;
  return {{"barrel", lens_model(Kind::kPinhole, 250, {-.21, .05, .002, -.001, 0})},
          {"pincushion", lens_model(Kind::kPinhole, 400, {.15, .02, -.001, .002, 0})},
          {"kb4", lens_model(Kind::kKannalaBrandt, 140, {-.02, .004, -.001, 0})},
          {"equidistant", lens_model(Kind::kEquidistant, 110, {})},
          {"double_sphere", lens_model(Kind::kDoubleSphere, 120, {-.2, .55})}};
}

class ThroughALens : public ::testing::TestWithParam<NamedLens> {
 protected:
  void SetUp() override {
    auto lens = ViewLens::create(GetParam().model, "camera");
    ASSERT_TRUE(lens) << lens.error().detail;
    ASSERT_NE(*lens, nullptr);
    lens_ = *lens;
  }
  const calib::CameraModel& model() const { return GetParam().model; }

  std::shared_ptr<const ViewLens> lens_;
};

TEST_P(ThroughALens, PointsComeWhereTheModelPutsThem) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> x(0, model().width), y(0, model().height), far(.1, 20);
  double worst = 0;
  for (int i = 0; i < 2000; ++i) {
    const dvec2 pixel(x(rng), y(rng));
    const auto ray = calib::direction_from_pixel(model(), pixel);
    if (!ray) continue;
    EXPECT_FALSE(lens_->is_beside(*ray));
    worst = std::max(worst, glm::distance(lens_->pixel(*ray * far(rng)), pixel));
  }
  EXPECT_LT(worst, .01);
}

TEST_P(ThroughALens, PointsBesideThePictureStayBesideIt) {
  std::mt19937 rng(6);
  std::normal_distribution<double> component;
  for (int i = 0; i < 5000; ++i) {
    const dvec3 p = glm::normalize(dvec3(component(rng), component(rng), component(rng)));
    if (calib::pixel_from_direction(model(), p)) continue;
    const dvec2 at = lens_->pixel(p);
    EXPECT_TRUE(std::isfinite(at.x) && std::isfinite(at.y));
    const bool within =
        at.x > .5 && at.y > .5 && at.x < model().width - .5 && at.y < model().height - .5;
    // The corners of a fisheye's frame show nothing, and so do points that fall there.
    if (!within) continue;
    EXPECT_FALSE(calib::direction_from_pixel(model(), at)) << at.x << ' ' << at.y;
  }
}

TEST_P(ThroughALens, ThePixelsThatSomethingReachesAreAllThere) {
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> place(-1.2, 1.2), size(.05, .8);
  const Pose camera = test::looking_at({.1, .8, 2}, {0, .2, 0});
  const prt::PinholeView view{model().width, model().height, model().focal_px, model().principal_px,
                              camera};
  const ViewProjection from_world(view, lens_.get());
  for (int i = 0; i < 200; ++i) {
    const dvec3 low(place(rng), place(rng), place(rng)),
        high = low + dvec3(size(rng), size(rng), size(rng));
    dvec3 corners[8];
    for (int k = 0; k < 8; ++k)
      corners[k] = {k & 1 ? high.x : low.x, k & 2 ? high.y : low.y, k & 4 ? high.z : low.z};
    const Rect rect = from_world.reach(corners);
    std::uniform_real_distribution<double> part(0, 1);
    for (int k = 0; k < 200; ++k) {
      const dvec3 p = glm::mix(low, high, dvec3(part(rng), part(rng), part(rng)));
      const auto at = calib::pixel_from_direction(model(), camera.inverse() * p);
      if (!at) continue;
      EXPECT_GE(at->x, rect.x0 - 1e-9);
      EXPECT_LE(at->x, rect.x1 + 1e-9);
      EXPECT_GE(at->y, rect.y0 - 1e-9);
      EXPECT_LE(at->y, rect.y1 + 1e-9);
    }
  }
}

// What the lens shows, from pictures of a sharper pinhole that turns to it: the frame's own
// undistorted twin.
Image<Rgb> twin_of(const calib::CameraModel& lens, const Pose& camera, auto&& picture_of) {
  constexpr int kFiner = 4, kSide = 900, kSamples = 4;
  Image<Rgb> out(lens.width, lens.height);
  Image<float> done(lens.width, lens.height, 0.f);
  // Looking at tiles of the frame, each within a small field of view.
  constexpr int kTile = 80;
  for (int ty = 0; ty < lens.height; ty += kTile)
    for (int tx = 0; tx < lens.width; tx += kTile) {
      const auto axis = calib::direction_from_pixel(lens, {tx + kTile / 2., ty + kTile / 2.});
      if (!axis) continue;
      prt::PinholeView view{kSide, kSide, double(kFiner) * lens.focal_px, dvec2(kSide / 2.),
                            camera};
      view.world_from_camera.rotation =
          camera.rotation * test::looking_at(dvec3(0), *axis).rotation;
      const Image<Rgb> picture = picture_of(view);
      const Pose turned = view.world_from_camera.inverse() * camera;
      for (int y = ty; y < std::min(ty + kTile, lens.height); ++y)
        for (int x = tx; x < std::min(tx + kTile, lens.width); ++x) {
          Rgb sum;
          int known = 0;
          for (int k = 0; k < kSamples * kSamples; ++k) {
            const auto ray = calib::direction_from_pixel(
                lens,
                {x + (k % kSamples + .5) / kSamples, y + (double(k / kSamples) + .5) / kSamples});
            if (!ray) continue;
            const dvec3 d = turned.rotation * *ray;
            const dvec2 at = view.principal_px + view.focal_px * dvec2(d.x, -d.y) / -d.z;
            if (!(d.z < 0 && at.x > 0 && at.y > 0 && at.x < kSide && at.y < kSide)) continue;
            sum += picture.at(static_cast<int>(at.x), static_cast<int>(at.y));
            ++known;
          }
          if (known < kSamples * kSamples) continue;
          out.at(x, y) = sum * (1.f / float(known));
          done.at(x, y) = 1;
        }
    }
  const auto missing = std::ranges::count(done.pixels(), 0.f);
  EXPECT_LT(double(missing) / double(done.area()), .35);
  for (std::size_t i = 0; i < out.area(); ++i)
    if (done.pixels()[i] == 0) out.pixels()[i] = {NAN, NAN, NAN};
  return out;
}

TEST_P(ThroughALens, ObjectsAndShadowsAreThoseOfThePictureWithoutDistortion) {
  const Pose camera = test::looking_at({.2, 1.1, 1.7}, {0, .3, 0});
  PENUMBRA_NEED_GL(Compositor::create(8, 8, Compositor::Surface::kOffscreen));
  const prt::BakedObject sphere = test::baked_sphere(true);
  const RadianceSh light = test::constant_light({1, .8f, .6f}, 3);
  const auto composited = [&](View view, int oversampling) {
    auto compositor = Compositor::create(view.camera.width, view.camera.height,
                                         Compositor::Surface::kOffscreen, oversampling);
    EXPECT_TRUE(compositor);
    if (view.lens) (*compositor)->use_lens(*view.lens);
    (*compositor)->add_plane({0, 0, 0}, {0, 1, 0});
    test::add_lit(**compositor, sphere, light);
    // Half below the floor, which hides that half.
    test::add_lit(**compositor, sphere, light, {{1, 0, 0, 0}, {.9, -.4, -.2}});
    const FramePixels grey = Image<Rgb>(view.camera.width, view.camera.height, Rgb{.5f, .5f, .5f});
    FramePixels out;
    EXPECT_TRUE((*compositor)->composite(view, grey, out));
    return std::get<Image<Rgb>>(out);
  };
  const Image<Rgb> twin = twin_of(
      model(), camera, [&](const prt::PinholeView& view) { return composited(View{view}, 2); });
  for (const int oversampling : {2, 4}) {
    View view{{model().width, model().height, model().focal_px, model().principal_px, camera}};
    view.lens = lens_;
    const Image<Rgb> mine = composited(view, oversampling);
    double sum = 0, worst = 0;
    int counted = 0, changed = 0;
    for (int y = 0; y < model().height; ++y)
      for (int x = 0; x < model().width; ++x) {
        if (!std::isfinite(twin.at(x, y).g)) continue;
        const double off = std::abs(mine.at(x, y).g - twin.at(x, y).g);
        sum += off, worst = std::max(worst, off), ++counted;
        changed += std::abs(twin.at(x, y).g - .5f) > .01f;
      }
    std::printf("%s %d: worst %.3f mean %.2e of %d, %d changed\n", GetParam().name.c_str(),
                oversampling, worst, sum / counted, counted, changed);
    EXPECT_GT(changed, 2000);
    // A contour 0.3 pixels off would give pixels along it a third of their contrast.
    EXPECT_LT(worst, .12) << oversampling;
    EXPECT_LT(sum / counted, 4e-4) << oversampling;
  }
}

INSTANTIATE_TEST_SUITE_P(Lenses, ThroughALens, ::testing::ValuesIn(lenses()),
                         [](const auto& p) { return p.param.name; });

TEST(ViewLens, APinholeTakesNone) {
  const auto lens =
      ViewLens::create({calib::ProjectionKind::kPinhole, 64, 48, {60, 60}, {32, 24}, {}}, "camera");
  ASSERT_TRUE(lens);
  EXPECT_EQ(*lens, nullptr);
}

TEST(ViewLens, RefusesMapsAndPicturesThatFoldBack) {
  const auto map =
      ViewLens::create({calib::ProjectionKind::kLatLong, 64, 32, {0, 0}, {32, 16}, {}}, "camera");
  ASSERT_FALSE(map);
  EXPECT_THAT(map.error().detail, ::testing::HasSubstr("latlong"));
  // Folds back at r = .95, which is 43 degrees off the axis; the corners lie further out.
  calib::CameraModel folding{calib::ProjectionKind::kPinhole, 640, 480, {200, 200}, {320, 240}, {}};
  folding.distortion = {-.37, 0, 0, 0, 0};
  const auto folded = ViewLens::create(folding, "camera");
  ASSERT_FALSE(folded);
  EXPECT_EQ(folded.error().where, "camera");
  EXPECT_THAT(folded.error().detail, ::testing::HasSubstr("folds back"));
  // A fisheye of 60 degrees within the picture is a wrong term; one of 95 ends there.
  calib::CameraModel fisheye{
      calib::ProjectionKind::kKannalaBrandt, 640, 480, {200, 200}, {320, 240}, {-.3, 0, 0, 0}};
  const auto wrong = ViewLens::create(fisheye, "camera");
  ASSERT_FALSE(wrong);
  EXPECT_THAT(wrong.error().detail, ::testing::HasSubstr("folds back on itself 60 degrees"));
  fisheye.focal_px = {140, 140}, fisheye.distortion = {-.12, 0, 0, 0};
  EXPECT_TRUE(ViewLens::create(fisheye, "camera"));
}

}  // namespace
}  // namespace penumbra::compositor
