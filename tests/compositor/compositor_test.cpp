#include "compositor/composite/compositor.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "tests/support/offscreen_compositor.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using glm::dvec3;
using test::kSceneHeight, test::kSceneWidth;

class CompositorTest : public test::OffscreenCompositor {
 protected:
  View view(const ResponseTable* curve = nullptr, float signal = .5f) const {
    return {test::scene_camera(), curve, signal};
  }
  FramePixels composited(FramePixels frame, const View& v, CompositeStats* touched = nullptr) {
    const auto done = compositor_->composite(v, frame);
    EXPECT_TRUE(done) << done.error().detail;
    if (done && touched) *touched = *done;
    return frame;
  }
  Image<Rgb> composited_floats(const Image<Rgb>& frame, const View& v) {
    return std::get<Image<Rgb>>(composited(frame, v));
  }

  const ResponseTable curve8_ = test::srgb_curve(8), curve16_ = test::srgb_curve(16);
};

RadianceSh side_light() {
  return test::sloped_light(1, {.5, .6, .1}, 3);
}

// ------------------------------------------------------------------------------------- what is
// touched

/// Whether the sphere of test::baked_sphere at `at`, or the visible part of its shadow, can reach a
/// pixel.
bool can_reach(const View& v, int x, int y, const dvec3& at, const prt::BakedObject& object,
               const shadows::PlanarShadow& shadow) {
  const dvec3 centre = at + dvec3(0, .4, 0);
  const double pixel =
      1.5 * glm::length(centre - v.camera.world_from_camera.translation) / v.camera.focal_px.x;
  if (test::distance_to_ray(v.camera, x + .5, y + .5, centre) < .4 + pixel) return true;
  const auto foot = test::floor_hit(v.camera, x + .5, y + .5);
  if (!foot || shadow.empty()) return false;
  const glm::vec2 texel = object.receiver->grid.uv(glm::vec2(*foot - glm::dvec2(at.x, at.z))) *
                          float(object.receiver->grid.size);
  return texel.x > float(shadow.x0 - 1) && texel.x < float(shadow.x1 + 1) &&
         texel.y > float(shadow.y0 - 1) && texel.y < float(shadow.y1 + 1);
}

template <class Pixel>
void expect_rest_untouched(const Image<Pixel>& before, const Image<Pixel>& after,
                           const CompositeStats& touched, const View& v, const dvec3& at,
                           const prt::BakedObject& object, const shadows::PlanarShadow& shadow) {
  std::size_t changed = 0, outside = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      if (before.at(x, y) == after.at(x, y)) continue;
      ++changed;
      outside += !can_reach(v, x, y, at, object, shadow);
    }
  EXPECT_EQ(outside, 0U) << "pixels changed that neither the object nor its shadow reaches";
  EXPECT_LE(changed, touched.pixels);
  EXPECT_GT(changed, 1000U);
  EXPECT_DOUBLE_EQ(touched.fraction, double(touched.pixels) / (kSceneWidth * kSceneHeight));
}

TEST_F(CompositorTest, EveryPixelOutsideObjectAndShadowComesOutBitForBit) {
  const auto object = test::baked_sphere(true);
  const auto shadow = test::lit(object, side_light()).shadow;
  const int handle = test::add_lit(*compositor_, object, side_light());
  for (const dvec3& at : {dvec3(0), dvec3(.5, 0, -.4), dvec3(-.8, 0, .3)}) {
    compositor_->set_pose(handle, {{1, 0, 0, 0}, at});
    CompositeStats touched;
    const auto f8 = test::noise_frame<Rgb8>(1);
    const auto out8 = composited(f8, view(&curve8_), &touched);
    expect_rest_untouched(f8, std::get<Image<Rgb8>>(out8), touched, view(), at, object, shadow);
    const auto f16 = test::noise_frame<Rgb16>(2);
    const auto out16 = composited(f16, view(&curve16_), &touched);
    expect_rest_untouched(f16, std::get<Image<Rgb16>>(out16), touched, view(), at, object, shadow);
    const auto f32 = test::noise_frame<Rgb>(3);
    const auto out32 = composited(f32, view(), &touched);
    expect_rest_untouched(f32, std::get<Image<Rgb>>(out32), touched, view(), at, object, shadow);
  }
}

TEST_F(CompositorTest, TheCamerasFrameStaysWhereItIsNotTheResult) {
  const auto object = test::baked_sphere(true);
  test::add_lit(*compositor_, object, side_light());
  View with_effects = view(&curve8_);
  with_effects.effects.read_noise = .01f;
  const FramePixels f8 = test::noise_frame<Rgb8>(1), f16 = test::noise_frame<Rgb16>(2),
                    f32 = test::noise_frame<Rgb>(3);
  for (const auto& [given, v] : {std::pair{f8, view(&curve8_)}, std::pair{f8, with_effects},
                                 std::pair{f16, view(&curve16_)}, std::pair{f32, view()}}) {
    const FramePixels camera = given;
    FramePixels out = Image<Rgb8>(3, 3);  // whatever it was before
    ASSERT_TRUE(compositor_->composite(v, camera, out));
    EXPECT_EQ(camera, given);
    EXPECT_EQ(out, composited(given, v));
    EXPECT_NE(out, given);
  }
  const FramePixels wrong = Image<Rgb8>(3, 3);
  FramePixels out = f8;
  EXPECT_FALSE(compositor_->composite(view(&curve8_), wrong, out));
  EXPECT_EQ(out, f8);
}

TEST_F(CompositorTest, WhatIsDrawnStaysWhateverIsDrawnNext) {
  const auto object = test::baked_sphere(true);
  const int handle = test::add_lit(*compositor_, object, side_light());
  shadows::ShadowMap source;
  source.cell_m = .1f;
  source.virtual_occlusion = Image<float>(12, 12, .5f);
  const ShadowMapOnPlane on_floor{&source, {.5f, .5f, .5f}, nullptr};
  compositor_->set_shadow_maps({&on_floor, 1});
  View with_effects = view(&curve8_);
  with_effects.effects.read_noise = .01f;
  for (const View& v : {view(&curve8_), with_effects}) {
    compositor_->set_pose(handle, {});
    const FramePixels frame = test::noise_frame<Rgb8>(1);
    CompositeStats touched;
    const FramePixels expected = composited(frame, v, &touched);
    FramePixels first = frame, second = frame;
    Drawn drawn, next;
    ASSERT_TRUE(compositor_->draw(v, first, drawn));
    // Elsewhere, in another light, without the light, and seen from the other side.
    compositor_->set_pose(handle, {{1, 0, 0, 0}, {.6, 0, .2}});
    const auto dim = test::lit(object, test::sloped_light(.3, {-.5, .6, .1}, 3));
    compositor_->set_light(handle, dim.relit, dim.shadow);
    compositor_->set_shadow_maps({});
    View other = v;
    other.camera = test::scene_camera({-1, 1.5, 2});
    ASSERT_TRUE(compositor_->draw(other, second, next));
    EXPECT_EQ(drawn.composite_into(first).pixels, touched.pixels);
    EXPECT_EQ(first, expected);
    next.composite_into(second);
    EXPECT_EQ(second, composited(frame, other));
    EXPECT_NE(second, expected);
    const auto bright = test::lit(object, side_light());
    compositor_->set_light(handle, bright.relit, bright.shadow);
    compositor_->set_shadow_maps({&on_floor, 1});
  }
  FramePixels wrong = Image<Rgb8>(3, 3);
  Drawn none;
  EXPECT_FALSE(compositor_->draw(view(&curve8_), wrong, none));
}

TEST_F(CompositorTest, NoVirtualObjectLeavesTheFrameBitForBit) {
  CompositeStats touched;
  const FramePixels f8 = test::noise_frame<Rgb8>(1), f32 = test::noise_frame<Rgb>(2);
  EXPECT_EQ(composited(f8, view(&curve8_), &touched), f8);
  EXPECT_EQ(touched.pixels, 0U);
  EXPECT_EQ(composited(f32, view()), f32);
}

TEST_F(CompositorTest, ObjectBehindTheCameraLeavesTheFrameBitForBit) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light(), {{1, 0, 0, 0}, {.6, 0, 9}});
  CompositeStats touched;
  const FramePixels frame = test::noise_frame<Rgb8>(1);
  EXPECT_EQ(composited(frame, view(&curve8_), &touched), frame);
  EXPECT_EQ(touched.pixels, 0U);
}

TEST_F(CompositorTest, ObjectBesideThePictureLeavesTheFrameBitForBit) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light(), {{1, 0, 0, 0}, {30, 0, -2}});
  const FramePixels frame = test::noise_frame<Rgb8>(1);
  EXPECT_EQ(composited(frame, view(&curve8_)), frame);
}

// ------------------------------------------------------------------------------------- object

TEST_F(CompositorTest, WhiteObjectUnderWhiteSkyShowsTheRadianceOfTheSky) {
  const Rgb sky{.9f, .5f, .2f};
  test::add_lit(*compositor_, test::baked_sphere(false), test::constant_light(sky, 3));
  const View v8 = view(&curve8_, .8f), v16 = view(&curve16_, .8f), v32 = view(nullptr, .8f);
  const auto f8 = std::get<Image<Rgb8>>(composited(Image<Rgb8>(kSceneWidth, kSceneHeight), v8));
  const auto f16 = std::get<Image<Rgb16>>(composited(Image<Rgb16>(kSceneWidth, kSceneHeight), v16));
  const auto f32 = composited_floats(Image<Rgb>(kSceneWidth, kSceneHeight), v32);
  int inside = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      if (test::distance_to_ray(v8.camera, x + .5, y + .5, {0, .4, 0}) > .36) continue;
      ++inside;
      for (int c = 0; c < 3; ++c) {
        const float expected = .8f * sky[c];
        ASSERT_NEAR(f32.at(x, y)[c] / expected, 1, .01) << x << ' ' << y;
        const std::uint16_t code16[3] = {f16.at(x, y).r, f16.at(x, y).g, f16.at(x, y).b};
        ASSERT_NEAR(curve16_.decode(c, code16[c]) / expected, 1, .01) << x << ' ' << y;
        const std::uint8_t code8[3] = {f8.at(x, y).r, f8.at(x, y).g, f8.at(x, y).b};
        ASSERT_NEAR(code8[c], curve8_.encode(c, expected), 1) << x << ' ' << y;
      }
    }
  EXPECT_GT(inside, 1000);
}

// What real things leave of a light counts for every shadow, also in rows that the light's own does
// not reach.
TEST_F(CompositorTest, LightThatRealThingsTakeCountsEverywhereOnThePlane) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  compositor_->add_plane({0, 0, 0}, {0, 1, 0});
  const Image<Rgb> white(kSceneWidth, kSceneHeight, {1, 1, 1});
  const auto open = composited_floats(white, view(nullptr, 1));
  // A map with nothing in it beside the object, and half of the light lacking for ten metres
  // around.
  constexpr float kFraction = .5f;
  shadows::ShadowMap own, real;
  own.world_from_map = {{1, 0, 0, 0}, {.5, 0, -.5}};
  own.cell_m = .01f;
  own.virtual_occlusion = own.real_occlusion = Image<float>(9, 9);
  for (float& m : own.real_occlusion.pixels()) m = 1;
  real.world_from_map = {{1, 0, 0, 0}, {-10, 0, -10}};
  real.cell_m = 2.5f;
  real.virtual_occlusion = Image<float>(9, 9, 1.f);
  const ShadowMapOnPlane source{&own, {kFraction, kFraction, kFraction}, &real};
  compositor_->set_shadow_maps({&source, 1});
  const auto dim = composited_floats(white, view(nullptr, 1));
  int judged = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const bool floor = test::distance_to_ray(view().camera, x + .5, y + .5, {0, .4, 0}) > .45;
      const float p = open.at(x, y).g;
      if (!floor || p == 1 || p < .6f) continue;
      ++judged;
      ASSERT_NEAR(dim.at(x, y).g, 1 - (1 - p) / (1 - kFraction), 2e-3) << x << ' ' << y;
    }
  EXPECT_GT(judged, 500);
}

TEST_F(CompositorTest, TwoDrawInTurnAndOneOutlivesTheOther) {
  const FramePixels black = Image<Rgb>(kSceneWidth, kSceneHeight);
  const auto white_sphere = [](Compositor& c) {
    test::add_lit(c, test::baked_sphere(false), test::constant_light({1, 1, 1}, 3));
  };
  white_sphere(*compositor_);
  const FramePixels alone = composited(black, view());
  ASSERT_NE(alone, black);
  auto other = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen);
  ASSERT_TRUE(other);
  white_sphere(**other);
  EXPECT_EQ(composited(black, view()), alone);
  std::swap(*other, compositor_);
  EXPECT_EQ(composited(black, view()), alone);
  other->reset();
  EXPECT_EQ(composited(black, view()), alone) << "after the other took the context with it";
}

TEST_F(CompositorTest, SilhouetteIsWhereThePinholePutsIt) {
  test::add_lit(*compositor_, test::baked_sphere(false), test::constant_light({1, 1, 1}, 3),
                {{1, 0, 0, 0}, {.2, .1, -.3}});
  const auto out = composited_floats(Image<Rgb>(kSceneWidth, kSceneHeight), view(nullptr, 1));
  double seen = 0, expected = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const double d = test::distance_to_ray(view().camera, x + .5, y + .5, {.2, .5, -.3});
      seen += double(out.at(x, y).g), expected += d < .4;
      if (d < .36) {
        ASSERT_NEAR(out.at(x, y).g, 1, .01);
      }
      if (d > .43) {
        ASSERT_EQ(out.at(x, y).g, 0);
      }
    }
  EXPECT_NEAR(seen / expected, 1, .02) << "coverage of the rim";
}

TEST_F(CompositorTest, NewLightReplacesTheOld) {
  const auto object = test::baked_sphere(true);
  const int handle = test::add_lit(*compositor_, object, side_light());
  const Image<Rgb> frame = test::noise_frame<Rgb>(5);
  const auto first = composited_floats(frame, view());
  const auto other = test::lit(object, test::constant_light({.2f, .3f, .9f}, 3));
  compositor_->set_light(handle, other.relit, other.shadow);
  const auto second = composited_floats(frame, view());
  EXPECT_NE(second, first);
  const auto back = test::lit(object, side_light());
  compositor_->set_light(handle, back.relit, back.shadow);
  EXPECT_EQ(composited_floats(frame, view()), first);
}

// ------------------------------------------------------------------------------------- shadow

/// Bilinear ratio at a point of the floor, as the receiver's grid defines it.
Rgb ratio_at(const prt::GroundGrid& grid, const shadows::PlanarShadow& shadow,
             const glm::dvec2& p) {
  const glm::vec2 at =
      glm::clamp(grid.uv(glm::vec2(p)) * float(grid.size) - .5f, 0.f, float(grid.size - 1));
  const int x = std::min(int(at.x), grid.size - 2), y = std::min(int(at.y), grid.size - 2);
  const float fx = at.x - float(x), fy = at.y - float(y);
  const auto s = [&](int i, int j) { return shadow.ratio.at(x + i, y + j); };
  return (1 - fy) * ((1 - fx) * s(0, 0) + fx * s(1, 0)) + fy * ((1 - fx) * s(0, 1) + fx * s(1, 1));
}

TEST_F(CompositorTest, FloorIsMultipliedByTheShadowRatioOfItsPlace) {
  const auto object = test::baked_sphere(true);
  const dvec3 at(.3, 0, -.2);
  const Pose pose{glm::angleAxis(.7, dvec3(0, 1, 0)), at};
  test::add_lit(*compositor_, object, side_light(), pose);
  const auto shadow = test::lit(object, side_light()).shadow;
  const Image<Rgb> frame = test::noise_frame<Rgb>(6);
  const View v = view();
  const auto out = composited_floats(frame, v);
  int shaded = 0;
  float deepest = 1;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const auto foot = test::floor_hit(v.camera, x + .5, y + .5);
      if (!foot || test::distance_to_ray(v.camera, x + .5, y + .5, at + dvec3(0, .4, 0)) < .43)
        continue;
      const dvec3 in_bake = pose.inverse() * dvec3(foot->x, 0, foot->y);
      const glm::vec2 uv = object.receiver->grid.uv({in_bake.x, in_bake.z});
      const bool in_grid = std::max(std::abs(2 * uv.x - 1), std::abs(2 * uv.y - 1)) < 1;
      const Rgb s =
          in_grid ? ratio_at(object.receiver->grid, shadow, {in_bake.x, in_bake.z}) : Rgb{1, 1, 1};
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(out.at(x, y)[c], frame.at(x, y)[c] * s[c], .005 * frame.at(x, y)[c])
            << x << ' ' << y << " s " << s[c];
      shaded += s.g < .98f;
      deepest = std::min(deepest, s.g);
    }
  EXPECT_GT(shaded, 300);
  EXPECT_LT(deepest, .6f);
}

// Real things leave half of the floor's light, and 60 % of it to the object: what that takes is
// held against the half. A real shadow alone changes nothing, it is in the picture.
TEST_F(CompositorTest, WhatAnObjectTakesIsOfWhatRealThingsLeave) {
  const auto object = test::baked_sphere(true);
  const int handle = test::add_lit(*compositor_, object, side_light());
  const test::Lit l = test::lit(object, side_light());
  compositor_->set_light(handle, l.relit, l.shadow, {.6f, .6f, .6f});
  compositor_->add_real_receiver(object.receiver->grid, {});
  shadows::PlanarShadow half = l.shadow;
  std::ranges::fill(half.ratio.pixels(), Rgb{.5f, .5f, .5f});
  half.x0 = half.y0 = 0, half.x1 = half.y1 = half.ratio.width();
  compositor_->set_real_shadow(half);
  const Image<Rgb> frame = test::noise_frame<Rgb>(7);
  const View v = view();
  const auto out = composited_floats(frame, v);
  int shaded = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const auto foot = test::floor_hit(v.camera, x + .5, y + .5);
      if (!foot || test::distance_to_ray(v.camera, x + .5, y + .5, dvec3(0, .4, 0)) < .43) continue;
      const glm::vec2 uv = object.receiver->grid.uv(glm::vec2(*foot));
      if (std::max(std::abs(2 * uv.x - 1), std::abs(2 * uv.y - 1)) > .95) continue;
      const Rgb s = ratio_at(object.receiver->grid, l.shadow, *foot);
      for (int c = 0; c < 3; ++c) {
        const float expected = std::max(0.f, 1 - .6f * (1 - s[c]) / .5f);
        ASSERT_NEAR(out.at(x, y)[c], frame.at(x, y)[c] * expected, .01 * frame.at(x, y)[c])
            << x << ' ' << y << " s " << s[c];
      }
      shaded += s.g < .9f;
    }
  EXPECT_GT(shaded, 200);
}

TEST_F(CompositorTest, CoincidentObjectsMultiplyTheirRatiosAndStayInTheBounds) {
  const auto object = test::baked_sphere(true);
  const Image<Rgb> white(kSceneWidth, kSceneHeight, {1, 1, 1});
  test::add_lit(*compositor_, object, side_light());
  const auto one = composited_floats(white, view());
  test::add_lit(*compositor_, object, side_light());
  const auto two = composited_floats(white, view());
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      if (test::distance_to_ray(view().camera, x + .5, y + .5, {0, .4, 0}) < .43) continue;
      const float s = one.at(x, y).g, both = two.at(x, y).g, deficit = 1 - s;
      ASSERT_NEAR(both, s * s, 1e-4f) << x << ' ' << y;
      ASSERT_GE(1 - both, deficit - 1e-5f);
      ASSERT_LE(1 - both, std::min(1.f, 2 * deficit) + 1e-5f);
    }
}

// ------------------------------------------------------------------------------------- occluders

/// From x0 on to the right.
prt::Mesh wall(float z, float x0) {
  return test::walls(z, {{x0, 9}});
}

/// Equal but for the last digit: a pixel that nothing hides is multiplied by 1 - 0.
bool same(const Rgb& a, const Rgb& b) {
  for (int c = 0; c < 3; ++c)
    if (!(std::abs(a[c] - b[c]) <= 1e-6f)) return false;
  return true;
}

TEST_F(CompositorTest, RealGeometryInFrontHidesObjectAndShadow) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  compositor_->add_occluder(wall(1.8f, -9));
  const FramePixels frame = test::noise_frame<Rgb8>(7);
  EXPECT_EQ(composited(frame, view(&curve8_)), frame);
}

// Behind the camera: real geometry that hides nothing, with which edges are drawn as they are with
// other real geometry.
prt::Mesh wall_out_of_visibility() {
  return wall(30, -9);
}

TEST_F(CompositorTest, RealGeometryBehindHidesNothing) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  const Image<Rgb> frame = test::noise_frame<Rgb>(7);
  compositor_->add_occluder(wall_out_of_visibility());
  const auto without = composited_floats(frame, view());
  compositor_->add_occluder(wall(-30, -90));
  const auto with = composited_floats(frame, view());
  for (std::size_t i = 0; i < frame.area(); ++i)
    ASSERT_TRUE(same(with.pixels()[i], without.pixels()[i])) << i;
}

// Squared differences to a still of sixteen samples, over some views.
double error_to_still(Compositor& video, Compositor& still, const View& like) {
  double sum = 0;
  for (int i = 0; i < 8; ++i) {
    View v = like;
    v.camera = test::scene_camera({.3 + .02 * i, 1.3 - .013 * i, 2.6});
    FramePixels got = Image<Rgb>(kSceneWidth, kSceneHeight), truth = got;
    EXPECT_TRUE(video.composite(v, got));
    EXPECT_TRUE(still.composite(v, truth));
    for (std::size_t k = 0; k < kSceneWidth * kSceneHeight; ++k)
      sum += std::pow(
          std::get<Image<Rgb>>(got).pixels()[k].g - std::get<Image<Rgb>>(truth).pixels()[k].g, 2);
  }
  return sum;
}

// Stills take sixteen samples a pixel; video takes four with real geometry and one without.
TEST_F(CompositorTest, EdgesOfOneSampleAreNoWorseThanOfFour) {
  auto still = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4);
  ASSERT_TRUE(still) << still.error().detail;
  for (Compositor* c : {compositor_.get(), still->get()})
    test::add_lit(*c, test::baked_sphere(false), test::sloped_light(1, {0, .3, 0}, 3));
  const double one = error_to_still(*compositor_, **still, view());
  compositor_->add_occluder(wall_out_of_visibility());
  const double four = error_to_still(*compositor_, **still, view());
  EXPECT_GT(one, 0);
  EXPECT_LT(one, .7 * four);
}

// Where two things go through each other is an edge that neither has by itself.
TEST_F(CompositorTest, WhereObjectsMeetIsNoStaircase) {
  auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4);
  ASSERT_TRUE(made) << made.error().detail;
  const auto light = test::sloped_light(1, {0, .3, 0}, 3);
  const dvec3 centres[] = {{0, .4, 0}, {.35, .4, 0}};
  for (Compositor* c : {compositor_.get(), made->get()}) {
    test::add_lit(*c, test::baked_sphere(false, {.9f, .9f, .9f}), light);
    test::add_lit(*c, test::baked_sphere(false, {.1f, .1f, .1f}), light,
                  {{1, 0, 0, 0}, {.35, 0, 0}});
  }
  const Image<Rgb> black(kSceneWidth, kSceneHeight);
  double sum = 0, edge = 0;
  for (int i = 0; i < 8; ++i) {
    View v = view();
    v.camera = test::scene_camera({.3 + .02 * i, 1.3 - .013 * i, 2.6});
    FramePixels truth = black;
    ASSERT_TRUE((*made)->composite(v, truth));
    const auto got = composited_floats(black, v);
    for (int y = 0; y < kSceneHeight; ++y)
      for (int x = 0; x < kSceneWidth; ++x) {
        const auto inside = [&](const dvec3& c) {
          return test::distance_to_ray(v.camera, x + .5, y + .5, c) < .36;
        };
        if (!inside(centres[0]) || !inside(centres[1])) continue;
        const double error = got.at(x, y).g - std::get<Image<Rgb>>(truth).at(x, y).g;
        sum += error * error;
        edge += std::abs(error) > .01;
      }
  }
  EXPECT_GT(edge, 20);
  EXPECT_LT(std::sqrt(sum / edge), .12) << "one sample a pixel: .145";
}

TEST_F(CompositorTest, FloorHidesNothingThatRestsOnIt) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  const Image<Rgb> frame = test::noise_frame<Rgb>(9);
  const auto without = composited_floats(frame, view());
  compositor_->add_plane({0, 0, 0}, {0, 1, 0});
  const auto with = composited_floats(frame, view());
  int changed = 0;
  for (std::size_t i = 0; i < frame.area(); ++i)
    changed += !same(with.pixels()[i], without.pixels()[i]);
  EXPECT_LE(changed, 5) << "samples at the point of contact alone";
}

TEST_F(CompositorTest, FloorHidesWhatIsBuried) {
  Pose buried;
  buried.translation = {0, -.85, -.5};
  test::add_lit(*compositor_, test::baked_sphere(false), side_light(), buried);
  const Image<Rgb> frame = test::noise_frame<Rgb>(9);
  EXPECT_NE(composited_floats(frame, view()), frame) << "seen through a floor that nobody told of";
  compositor_->add_plane({0, 0, 0}, {0, 1, 0});
  EXPECT_EQ(composited_floats(frame, view()), frame);
}

TEST_F(CompositorTest, WallThatEndsHalfWayHidesItsSideOnly) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  const Image<Rgb> frame = test::noise_frame<Rgb>(8);
  compositor_->add_occluder(wall_out_of_visibility());
  const auto without = composited_floats(frame, view());
  const double edge = .2, z = 1.8;
  compositor_->add_occluder(wall(float(z), float(edge)));
  const auto with = composited_floats(frame, view());
  int hidden = 0, kept = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const dvec3 o = view().camera.world_from_camera.translation,
                  d = test::pixel_ray(view().camera, x + .5, y + .5);
      const double at_wall = o.x + d.x * (z - o.z) / d.z, pixel = .01;
      if (at_wall > edge + pixel) {
        ASSERT_EQ(with.at(x, y), frame.at(x, y)) << x << ' ' << y;
      }
      if (at_wall < edge - pixel) {
        ASSERT_TRUE(same(with.at(x, y), without.at(x, y))) << x << ' ' << y;
      }
      hidden += at_wall > edge && without.at(x, y) != frame.at(x, y);
      kept += at_wall < edge && without.at(x, y) != frame.at(x, y);
    }
  EXPECT_GT(hidden, 300);
  EXPECT_GT(kept, 300);
}

// ------------------------------------------------------------------------------------- codes,
// errors

TEST_F(CompositorTest, FloatEightAndSixteenBitFramesAgree) {
  test::add_lit(*compositor_, test::baked_sphere(true, {.8f, .4f, .3f}), side_light());
  const auto f8 = test::noise_frame<Rgb8>(9);
  Image<Rgb16> f16(kSceneWidth, kSceneHeight);
  Image<Rgb> f32(kSceneWidth, kSceneHeight);
  for (std::size_t i = 0; i < f8.area(); ++i) {
    const Rgb8 p = f8.pixels()[i];
    f16.pixels()[i] = {std::uint16_t(257 * p.r), std::uint16_t(257 * p.g),
                       std::uint16_t(257 * p.b)};
    f32.pixels()[i] = {curve8_.decode(0, p.r), curve8_.decode(1, p.g), curve8_.decode(2, p.b)};
  }
  const auto out8 = std::get<Image<Rgb8>>(composited(f8, view(&curve8_)));
  const auto out16 = std::get<Image<Rgb16>>(composited(f16, view(&curve16_)));
  const auto out32 = composited_floats(f32, view());
  for (std::size_t i = 0; i < f8.area(); ++i) {
    const Rgb linear = out32.pixels()[i];
    const Rgb8 a = out8.pixels()[i];
    const Rgb16 b = out16.pixels()[i];
    ASSERT_NEAR(a.r, curve8_.encode(0, linear.r), 1) << i;
    ASSERT_NEAR(a.g, curve8_.encode(1, linear.g), 1) << i;
    ASSERT_NEAR(a.b, curve8_.encode(2, linear.b), 1) << i;
    ASSERT_NEAR(b.r, curve16_.encode(0, linear.r), 4) << i;
    ASSERT_NEAR(b.g, curve16_.encode(1, linear.g), 4) << i;
    ASSERT_NEAR(b.b, curve16_.encode(2, linear.b), 4) << i;
  }
}

TEST_F(CompositorTest, WrongSizeAndMissingCurveAreRefusedAndTheFrameIsLeftAlone) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  const auto refused = [&](FramePixels frame, const ResponseTable* curve) {
    const FramePixels before = frame;
    const auto done = compositor_->composite(view(curve), frame);
    EXPECT_EQ(frame, before);
    return !done && done.error().code == ErrorCode::kInvalid;
  };
  EXPECT_TRUE(refused(Image<Rgb8>(kSceneWidth, kSceneHeight + 1), &curve8_));
  EXPECT_TRUE(refused(Image<Rgb8>(), &curve8_));
  EXPECT_TRUE(refused(test::noise_frame<Rgb8>(1), nullptr));
  EXPECT_TRUE(refused(test::noise_frame<Rgb16>(1), nullptr));
  EXPECT_TRUE(refused(test::noise_frame<Rgb8>(1), &curve16_));
  EXPECT_TRUE(refused(test::noise_frame<Rgb16>(1), &curve8_));
  EXPECT_FALSE(Compositor::create(0, 5, Compositor::Surface::kOffscreen));
}

// ------------------------------------------------------------------------------------- repetition

TEST_F(CompositorTest, StaticViewGivesTheSameBytesEveryTime) {
  test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  compositor_->add_occluder(wall(1.8f, .2f));
  const FramePixels a = test::noise_frame<Rgb8>(10), b = test::noise_frame<Rgb8>(11);
  const auto first_a = composited(a, view(&curve8_)), first_b = composited(b, view(&curve8_));
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(composited(a, view(&curve8_)), first_a) << i;
    EXPECT_EQ(composited(b, view(&curve8_)), first_b) << i;
  }
}

TEST_F(CompositorTest, ThereAndBackGivesTheSameBytes) {
  const int handle = test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  compositor_->add_occluder(wall(1.8f, .2f));
  const FramePixels frame = test::noise_frame<Rgb8>(12);
  const auto first = composited(frame, view(&curve8_));
  compositor_->set_pose(handle, {{1, 0, 0, 0}, {-.7, 0, .2}});
  EXPECT_NE(composited(frame, view(&curve8_)), first) << "the object moved";
  compositor_->set_pose(handle, {});
  EXPECT_EQ(composited(frame, view(&curve8_)), first);
  View moved = view(&curve8_);
  moved.camera = test::scene_camera({-.4, 1, 2.2});
  EXPECT_NE(composited(frame, moved), first) << "the camera moved";
  EXPECT_EQ(composited(frame, view(&curve8_)), first);
  EXPECT_NE(composited(frame, view(&curve8_, .1f)), first) << "the exposure changed";
  EXPECT_EQ(composited(frame, view(&curve8_)), first);
  compositor_->set_pose(handle, {{1, 0, 0, 0}, {.6, 0, 9}});
  EXPECT_EQ(composited(frame, view(&curve8_)), frame)
      << "behind the camera: nothing of before remains";
}

// One sample a pixel, four and back: how a view looks is not a matter of what was drawn before it.
TEST_F(CompositorTest, HowManySamplesIsDecidedByTheViewAlone) {
  const int handle = test::add_lit(*compositor_, test::baked_sphere(true), side_light());
  compositor_->add_plane({0, 0, 0}, {0, 1, 0});
  const FramePixels frame = test::noise_frame<Rgb8>(12);
  const auto first = composited(frame, view(&curve8_));
  compositor_->set_pose(handle, {{1, 0, 0, 0}, {0, -.3, 0}});
  const auto buried = composited(frame, view(&curve8_));
  View far = view(&curve8_);
  far.camera = test::scene_camera({3, 6, 30});
  for (int i = 0; i < 2; ++i) {
    compositor_->set_pose(handle, {});
    EXPECT_EQ(composited(frame, view(&curve8_)), first) << i;
    EXPECT_NE(composited(frame, far), frame) << i;
    EXPECT_EQ(composited(frame, view(&curve8_)), first) << i;
    compositor_->set_pose(handle, {{1, 0, 0, 0}, {0, -.3, 0}});
    EXPECT_EQ(composited(frame, view(&curve8_)), buried) << i;
  }
  // Another object, out of visibility, moves what is kept of the first.
  const int other = compositor_->add_object(test::baked_sphere(false));
  compositor_->set_pose(other, {{1, 0, 0, 0}, {0, 0, 40}});
  compositor_->set_pose(handle, {});
  EXPECT_EQ(composited(frame, view(&curve8_)), first);
}

prt::BakedObject baked(const prt::Mesh& mesh) {
  prt::BakeOptions options;
  options.bands = 3, options.bounces = 0, options.rays = 64;
  auto object = prt::bake(mesh, options);
  EXPECT_TRUE(object);
  return object ? std::move(*object) : prt::BakedObject{};
}

// Three balls of which now one, now another changes: what is drawn in part is what another
// compositor draws that comes to the same place at once.
TEST_F(CompositorTest, WhatChangesBesideWhatRestsIsDrawnAsIfAllWere) {
  struct Ball {
    Pose pose;
    RadianceSh light;
    bool visible = true;
  };
  const auto sphere = baked(prt::make_sphere({0, .15f, 0}, .15f, 3, {.9f, .9f, .9f}));
  const RadianceSh bright = side_light(), dim = test::sloped_light(.3, {-.5, .6, .1}, 3);
  const auto at = [](double x, double y) { return Pose{{1, 0, 0, 0}, {x, y, 0}}; };
  const auto set = [&](Compositor& c, int handle, const Ball& ball) {
    c.set_pose(handle, ball.pose);
    c.show(handle, ball.visible);
    const auto lit = test::lit(sphere, ball.light);
    c.set_light(handle, lit.relit, lit.shadow);
  };
  const Image<Rgb> frame = test::noise_frame<Rgb>(14);
  for (const bool with_floor : {false, true}) {
    SetUp();
    std::vector<Ball> balls{{at(-.8, 0), bright}, {at(0, 0), bright}, {at(.8, 0), bright}};
    for (const Ball& ball : balls) set(*compositor_, compositor_->add_object(sphere), ball);
    if (with_floor) compositor_->add_plane({0, 0, 0}, {0, 1, 0});
    const double floor = with_floor ? -.05 : 0;  // deep enough for four samples a pixel
    composited_floats(frame, view());
    const auto expect_as_new = [&](const char* what) {
      auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen);
      ASSERT_TRUE(made);
      for (const Ball& ball : balls) set(**made, (*made)->add_object(sphere), ball);
      if (with_floor) (*made)->add_plane({0, 0, 0}, {0, 1, 0});
      Image<Rgb> expected(1, 1);
      {
        FramePixels all = frame;
        ASSERT_TRUE((*made)->composite(view(), all));
        expected = std::get<Image<Rgb>>(all);
      }
      for (std::size_t k = 0; k < balls.size(); ++k) set(*compositor_, int(k), balls[k]);
      const Image<Rgb> ours = composited_floats(frame, view());
      float worst = 0;
      for (std::size_t i = 0; i < ours.area(); ++i)
        for (int c = 0; c < 3; ++c)
          worst = std::max(worst, std::abs(ours.pixels()[i][c] - expected.pixels()[i][c]));
      EXPECT_LT(worst, 2e-3) << what << (with_floor ? ", on a floor" : "");
    };
    balls[0].pose = at(-.8, floor);
    expect_as_new("all at the height of the floor");
    for (int i = 1; i < 8; ++i) {
      balls[2].pose = at(.8 - .05 * i, floor);
      expect_as_new("one glides");
    }
    balls[0].light = dim;
    expect_as_new("another darkens");
    balls[0].pose = at(-.5, floor), balls[0].light = bright;
    expect_as_new("it goes on and is bright again");
    balls[2].visible = false;
    expect_as_new("one goes");
    balls[2].visible = true, balls[2].pose = at(.1, floor);
    expect_as_new("and comes back behind another");
    balls[1].pose = at(9, 0);
    expect_as_new("one leaves the picture");
    balls[1].pose = at(9.5, 0);
    expect_as_new("and moves there");
    balls[1].pose = at(-1.2, floor);
    expect_as_new("and is cut by the picture's edge");
  }
}

// Whether edges of the object are those of four samples, which real geometry out of visibility
// brings.
bool has_four_samples(const prt::BakedObject& object, const Pose& pose, const View& v,
                      bool with_floor = false) {
  auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen);
  EXPECT_TRUE(made) << made.error().detail;
  Compositor& c = **made;
  test::add_lit(c, object, test::sloped_light(1, {0, .3, 0}, 3), pose);
  if (with_floor) c.add_plane({0, 0, 0}, {0, 1, 0});
  FramePixels plain = Image<Rgb>(kSceneWidth, kSceneHeight), four = plain;
  EXPECT_TRUE(c.composite(v, plain));
  EXPECT_NE(plain, (FramePixels(Image<Rgb>(kSceneWidth, kSceneHeight)))) << "in view";
  c.add_occluder(wall_out_of_visibility());
  EXPECT_TRUE(c.composite(v, four));
  return std::ranges::equal(std::get<Image<Rgb>>(plain).pixels(),
                            std::get<Image<Rgb>>(four).pixels(), same);
}

TEST_F(CompositorTest, FourSamplesWhereOneDoesNot) {
  const prt::Mesh sphere = prt::make_sphere({0, .4f, 0}, .4f, 3, {.9f, .9f, .9f});
  EXPECT_FALSE(has_four_samples(baked(sphere), {}, view())) << "what the others are compared to";
  prt::Mesh parts = sphere;
  prt::append(parts, prt::make_sphere({.4f, .4f, 0}, .3f, 3, {.1f, .1f, .1f}));
  EXPECT_TRUE(has_four_samples(baked(parts), {}, view())) << "parts go through each other";
  View far = view();
  far.camera = test::scene_camera({.4, 2, 6});
  EXPECT_FALSE(has_four_samples(baked(sphere), {}, far));
  const prt::Mesh fine = prt::make_sphere({0, .4f, 0}, .4f, 5, {.9f, .9f, .9f});
  EXPECT_TRUE(has_four_samples(baked(fine), {}, far)) << "triangles of a part of a pixel";
  const auto rod = [](float half) {
    return baked(prt::make_box({-half, 0, -half}, {half, 1.4f, half}, 4, {.9f, .9f, .9f}));
  };
  const Pose aslant{glm::angleAxis(.15, dvec3(0, 0, 1)), {0, 0, 0}};
  EXPECT_FALSE(has_four_samples(rod(.04f), aslant, view()));
  EXPECT_TRUE(has_four_samples(rod(.005f), aslant, view())) << "a rod between samples";
  View near = view();
  near.camera = test::scene_camera({.1, .7, 1.2});
  const auto slab = baked(prt::make_box({-.1f, .1f, -2}, {.1f, .2f, 2.5f}, 2, {.9f, .9f, .9f}));
  EXPECT_TRUE(has_four_samples(slab, {}, near)) << "it reaches behind the camera";
}

TEST_F(CompositorTest, FourSamplesWhereAFloorCutsWhatIsTurned) {
  const auto box = baked(prt::make_box({-.5f, -.1f, -.1f}, {.5f, .1f, .1f}, 4, {.9f, .9f, .9f}));
  const auto lying = [&](double turn, double height, const dvec3& axis = {0, 0, 1}) {
    const Pose pose{glm::angleAxis(turn, glm::normalize(axis)), {0, height, 0}};
    return has_four_samples(box, pose, view(), true);
  };
  EXPECT_FALSE(lying(0, .11));
  EXPECT_FALSE(lying(0, .0995)) << "half a pixel and less";
  EXPECT_TRUE(lying(0, .05));
  EXPECT_FALSE(lying(1.2, .51)) << "on its end it is half a metre high";
  EXPECT_TRUE(lying(1.2, .4));
  EXPECT_TRUE(lying(-1.2, .4));
  EXPECT_FALSE(lying(1.2, .475, {1, 1, 1}));
  EXPECT_TRUE(lying(1.2, .43, {1, 1, 1}));
}

TEST_F(CompositorTest, AnotherFormHasItsOwnContour) {
  auto still = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4);
  ASSERT_TRUE(still) << still.error().detail;
  const prt::BakedObject sphere = test::baked_sphere(false);
  const RadianceSh light = test::sloped_light(1, {0, .3, 0}, 3);
  prt::Mesh tall = sphere.mesh;
  for (glm::vec3& p : tall.positions) p = {.6f * p.x, 1.4f * p.y, .6f * p.z};
  const int video_handle = test::add_lit(*compositor_, sphere, light),
            still_handle = test::add_lit(**still, sphere, light);
  const double before = error_to_still(*compositor_, **still, view());
  compositor_->update_vertices(video_handle, tall);
  EXPECT_GT(error_to_still(*compositor_, **still, view()), 100 * before) << "of the other form";
  (*still)->update_vertices(still_handle, tall);
  EXPECT_LT(error_to_still(*compositor_, **still, view()), 1.5 * before);
}

// A face that a plane cuts off has an edge there that is none of the mesh.
TEST_F(CompositorTest, WhereAPlaneCutsIsNoStaircase) {
  auto still = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4);
  ASSERT_TRUE(still) << still.error().detail;
  const RadianceSh light = test::sloped_light(1, {0, .3, 0}, 3);
  const Pose sunk{{1, 0, 0, 0}, {0, -.3, 0}};
  for (Compositor* c : {compositor_.get(), still->get()}) {
    test::add_lit(*c, test::baked_sphere(false), light, sunk);
    c->add_plane({0, 0, 0}, {0, 1, 0});
  }
  const double sunk_error = error_to_still(*compositor_, **still, view());
  for (Compositor* c : {compositor_.get(), still->get()}) c->add_occluder(wall_out_of_visibility());
  EXPECT_NEAR(sunk_error, error_to_still(*compositor_, **still, view()), 1e-9 + .02 * sunk_error)
      << "of four samples";
}

}  // namespace
}  // namespace penumbra::compositor
