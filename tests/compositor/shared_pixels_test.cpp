// Pixels that show several real surfaces: the camera saw the sum of their light, so that their
// shadows count by what each of them sends.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/support/offscreen_compositor.h"

namespace penumbra::compositor {
namespace {

using test::kSceneHeight, test::kSceneWidth;

class SharedPixels : public test::OffscreenCompositor {
 protected:
  /// What is left of a frame of 1.
  Image<Rgb> ratios() {
    View view;
    view.camera = test::scene_camera();
    FramePixels frame = Image<Rgb>(kSceneWidth, kSceneHeight, {1, 1, 1});
    EXPECT_TRUE(compositor_->composite(view, frame));
    return std::get<Image<Rgb>>(frame);
  }
};

TEST_F(SharedPixels, TwoWallsCountByTheirLight) {
  const int both = compositor_->add_occluder(test::walls(-1, {{-9, .1f}, {.1f, 9}}));
  const Rgb bright{4, 2, .25f}, dark{.25f, 2, 4};  // what they send
  std::vector<Rgb> ratio(4, {.2f, .2f, .2f}), weight(4, bright);
  ratio.resize(8, {1, 1, 1}), weight.resize(8, dark);
  compositor_->set_ratios(both, ratio);
  compositor_->set_weights(both, weight);
  const Image<Rgb> seen = ratios();
  int mixed = 0;
  for (const Rgb& s : seen.pixels()) {
    // Of four samples a pixel, so many see the first.
    const auto error_with = [&](int first) {
      float largest = 0;
      for (int c = 0; c < 3; ++c) {
        const float a = static_cast<float>(first) * bright[c],
                    b = static_cast<float>(4 - first) * dark[c];
        largest = std::max(largest, std::abs(s[c] - (.2f * a + b) / (a + b)));
      }
      return largest;
    };
    const int first = std::ranges::min(std::array{0, 1, 2, 3, 4}, {}, error_with);
    EXPECT_LT(error_with(first), .01f) << first << ": " << s.r << ' ' << s.g << ' ' << s.b;
    mixed += first > 0 && first < 4;
  }
  EXPECT_GT(mixed, 20) << "the edge runs through pixels";
}

// The floor's shadow beside the edge of a wall that nothing shades.
TEST_F(SharedPixels, AWallAndTheFloorBehindItCountByTheirLight) {
  test::add_lit(*compositor_, test::baked_sphere(true), test::sloped_light(1, {.9, .5, 0}, 3));
  compositor_->add_occluder(
      test::walls(30, {{-9, 9}}));  // behind the camera: edges as with real things
  const Image<Rgb> open = ratios();
  const int wall = compositor_->add_occluder(test::walls(1.2f, {{-9, -.24f}}));
  const auto with_weight = [&](float w) {
    compositor_->set_weights(wall, std::vector<Rgb>(4, {w, w, w}));
    return ratios();
  };
  const Image<Rgb> dim = with_weight(1e-3f), same = with_weight(1), bright = with_weight(1e3f);
  int mixed = 0;
  for (std::size_t i = 0; i < open.area(); ++i) {
    const float s = open.pixels()[i].g, a = dim.pixels()[i].g, b = same.pixels()[i].g,
                c = bright.pixels()[i].g;
    const int x = static_cast<int>(i) % kSceneWidth, y = static_cast<int>(i) / kSceneWidth;
    if (test::distance_to_ray(test::scene_camera(), x + .5, y + .5, {0, .4, 0}) < .43) continue;
    if (!(s < .97f) || std::abs(b - s) < .01f || std::abs(b - 1) < .01f) continue;
    // The mean of both where they send alike; only the floor or only the wall where one sends all.
    EXPECT_NEAR(a, s, .01f);
    EXPECT_NEAR(c, 1, .01f);
    EXPECT_TRUE(s < b && b < 1) << s << ' ' << b;
    ++mixed;
  }
  EXPECT_GT(mixed, 5);
}

// Behind the wall's edge real things leave half of the floor's light: it weighs half as much.
TEST_F(SharedPixels, WhatRealThingsShadeOfTheFloorWeighsLess) {
  const auto object = test::baked_sphere(true);
  const auto light = test::sloped_light(1, {.9, .5, 0}, 3);
  const int handle = test::add_lit(*compositor_, object, light);
  const test::Lit l = test::lit(object, light);
  compositor_->add_real_receiver(object.receiver->grid, {});
  const int wall = compositor_->add_occluder(test::walls(1.2f, {{-9, -.24f}}));
  // The object's ratio stays what it is: what it takes is as much less as real things leave.
  const auto with_real_shadow = [&](float left) {
    compositor_->set_light(handle, l.relit, l.shadow, {left, left, left});
    shadows::PlanarShadow real = l.shadow;
    std::ranges::fill(real.ratio.pixels(), Rgb{left, left, left});
    real.x0 = real.y0 = 0, real.x1 = real.y1 = real.ratio.width();
    compositor_->set_real_shadow(real);
  };
  with_real_shadow(.5f);
  compositor_->set_weights(wall, std::vector<Rgb>(4, {.5f, .5f, .5f}));
  const Image<Rgb> shaded = ratios();
  with_real_shadow(1);
  compositor_->set_weights(wall, std::vector<Rgb>(4, {1, 1, 1}));
  const Image<Rgb> open = ratios();
  compositor_->set_weights(wall, std::vector<Rgb>(4, {.5f, .5f, .5f}));
  const Image<Rgb> other = ratios();
  int different = 0;
  for (std::size_t i = 0; i < open.area(); ++i) {
    const int x = static_cast<int>(i) % kSceneWidth, y = static_cast<int>(i) / kSceneWidth;
    if (test::distance_to_ray(test::scene_camera(), x + .5, y + .5, {0, .4, 0}) < .43) continue;
    EXPECT_NEAR(shaded.pixels()[i].g, open.pixels()[i].g, .01f) << x << ' ' << y;
    different += std::abs(other.pixels()[i].g - open.pixels()[i].g) > .03f;
  }
  EXPECT_GT(different, 3);
}

// A lamp that is only in the picture adds light: more than 1.
TEST_F(SharedPixels, AddedLightCountsByTheLightThatIsThere) {
  const int both = compositor_->add_occluder(test::walls(-1, {{-9, .1f}, {.1f, 9}}));
  std::vector<Rgb> ratio(4, {3, 3, 3}), weight(4, {.5f, .5f, .5f});
  ratio.resize(8, {1, 1, 1}), weight.resize(8, {2, 2, 2});
  compositor_->set_ratios(both, ratio);
  compositor_->set_weights(both, weight);
  int mixed = 0;
  for (const Rgb& s : ratios().pixels()) {
    float nearest = 9;
    for (int first = 0; first <= 4; ++first) {
      const float a = .5f * static_cast<float>(first), b = 2.f * static_cast<float>(4 - first);
      nearest = std::min(nearest, std::abs(s.g - (3 * a + b) / (a + b)));
    }
    EXPECT_LT(nearest, .02f) << s.g;
    mixed += s.g > 1.1f && s.g < 2.9f;
  }
  EXPECT_GT(mixed, 20);
}

}  // namespace
}  // namespace penumbra::compositor
