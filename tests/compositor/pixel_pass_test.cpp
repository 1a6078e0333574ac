// The two fractions of a frame against what each pixel is to become, looked up one by one.
#include "compositor/pixels/pixel_pass.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <glm/gtc/quaternion.hpp>

#include "compositor/pixels/layered_rows.h"
#include "core/half.h"

namespace penumbra::compositor {
namespace {

constexpr int kPassWidth = 48, kPassHeight = 32;

// Colour premultiplied, and coverage: none, some, all. Halves hold the values exactly.
std::array<float, 4> layer_value(int x, int y) {
  const int k = (x + 2 * y) % 3;
  if (k == 0) return {0, 0, 0, 0};
  return k == 1 ? std::array{.25f, .125f, .0625f, .5f} : std::array{.5f, .375f, .25f, 1.f};
}

Layer layer(const Rect& rect) {
  Layer out{rect, {}};
  for (int y = rect.y0; y < rect.y1; ++y)
    for (int x = rect.x0; x < rect.x1; ++x) {
      const auto value = layer_value(x, y);
      for (const float v : value) out.halves.push_back(half_from_float(v));
      out.weights.insert(out.weights.end(), 4, half_from_float(value[3]));  // as the plane
    }
  return out;
}

bool holds(const Rect& r, int x, int y) {
  return x >= r.x0 && x < r.x1 && y >= r.y0 && y < r.y1;
}

// From above, askew, onto a shadow that lies in the picture whole.
View view_of(const Pose& world_from_camera) {
  View view;
  view.camera = {
      kPassWidth, kPassHeight, {40, 40}, {kPassWidth / 2., kPassHeight / 2.}, world_from_camera};
  return view;
}
Receivers shadow_below(const View& view, Rect& area) {
  prt::GroundGrid grid;
  grid.size = 32;
  grid.half_extent = 1;
  shadows::PlanarShadow shadow{Image<Rgb>(32, 32, Rgb{1, 1, 1}), 6, 8, 26, 25};
  for (int y = shadow.y0; y < shadow.y1; ++y)
    for (int x = shadow.x0; x < shadow.x1; ++x) shadow.ratio.at(x, y) = {.5f, .75f, .25f};
  Receivers out(2);
  const int receiver = out.add(grid);
  out.set_pose(receiver, {});
  out.set_shadow(receiver, shadow);
  area = out.prepare(view);
  return out;
}

struct Expected {
  Image<Rgb> frame;
  std::size_t written = 0;
};
// Row by row in one piece.
Expected expected(const Image<Rgb>& frame, const Layered& in) {
  Expected out{frame};
  for (int y = 0; y < kPassHeight; ++y) {
    std::vector<float> s[3];
    for (auto& v : s) v.assign(kPassWidth, 1.f);
    in.receivers.load_row(y, {0, y, kPassWidth, y + 1}, s[0].data(), s[1].data(), s[2].data());
    for (int x = 0; x < kPassWidth; ++x) {
      const std::array<float, 4> none{};
      const auto object = holds(in.objects.rect, x, y) ? layer_value(x, y) : none,
                 hidden = holds(in.hidden.rect, x, y) ? layer_value(x, y) : none;
      bool touched = object[3] != 0;
      for (std::size_t c = 0; c < 3; ++c) {
        const float ratio =
            1 + (1 - hidden[3]) * (s[c][static_cast<std::size_t>(x)] - 1) - hidden[c];
        touched |= ratio != 1;
        float& p = out.frame.at(x, y)[static_cast<int>(c)];
        p = object[c] + (1 - object[3]) * ratio * p;
      }
      out.written += touched;
    }
  }
  return out;
}

TEST(PixelPass, TwoSharesAreTheWholeFrameAndMeetNowhere) {
  const View view =
      view_of({glm::angleAxis(.2, glm::dvec3(0, 1, 0)) * glm::angleAxis(-1.4, glm::dvec3(1, 0, 0)),
               {.1, 1.6, .3}});
  Rect area;
  const Receivers receivers = shadow_below(view, area);
  ASSERT_FALSE(area.empty());
  Image<Rgb> picture(kPassWidth, kPassHeight);
  for (int y = 0; y < kPassHeight; ++y)
    for (int x = 0; x < kPassWidth; ++x)
      picture.at(x, y) = {.01f * static_cast<float>(x), .02f * static_cast<float>(y), .5f};
  const Rect objects[] = {{20, 10, 31, 21},
                          {0, 5, 9, 30},
                          {40, 0, kPassWidth, 12},
                          {3, 28, 45, kPassHeight},
                          {0, 12, 0, 20},
                          {kPassWidth, 3, kPassWidth, 9},
                          {},
                          {0, 0, kPassWidth, kPassHeight}};
  for (const Rect& rect : objects)
    for (const Rect& behind : {Rect{}, Rect{12, 6, 37, 25}}) {
      const Layer drawn = layer(rect), hidden = layer(behind);
      const Layered in{drawn, hidden, receivers, united(united(rect, area), behind),
                       view.vignetting};
      const Expected wanted = expected(picture, in);
      ASSERT_GT(wanted.written, 100u);
      for (const bool objects_first : {false, true}) {
        FramePixels frame = picture;
        const FrameRegion first = objects_first ? FrameRegion::kObjects : FrameRegion::kBeside,
                          second = objects_first ? FrameRegion::kBeside : FrameRegion::kObjects;
        std::size_t written = composite_fraction(first, view, frame, in);
        written += composite_fraction(second, view, frame, in);
        EXPECT_EQ(written, wanted.written) << rect.x0 << ' ' << rect.x1 << ' ' << objects_first;
        const auto& is = std::get<Image<Rgb>>(frame);
        for (int y = 0; y < kPassHeight; ++y)
          for (int x = 0; x < kPassWidth; ++x)
            for (int c = 0; c < 3; ++c)
              ASSERT_NEAR(is.at(x, y)[c], wanted.frame.at(x, y)[c], 1e-6)
                  << x << ' ' << y << ", objects from " << rect.x0 << ' ' << rect.y0;
      }
    }
}

}  // namespace
}  // namespace penumbra::compositor
