// Rows of shadow ratios against what each pixel's ray meets, looked up one by one.
#include "compositor/pixels/receivers.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <optional>

namespace penumbra::compositor {
namespace {

constexpr int kReceiverWidth = 96, kReceiverHeight = 72;

prt::PinholeView view_of_receivers(const glm::dvec3& eye, const glm::dvec3& at) {
  prt::PinholeView view{
      kReceiverWidth, kReceiverHeight, {70, 70}, {kReceiverWidth / 2., kReceiverHeight / 2.}, {}};
  view.world_from_camera = {glm::quatLookAt(glm::normalize(at - eye), glm::dvec3(0, 1, 0)), eye};
  return view;
}

// From high up, slantwise, along the ground with the horizon in visibility, from within the shadow,
// and past it.
std::vector<prt::PinholeView> receiver_views() {
  return {view_of_receivers({.1, 3, .2}, {0, 0, .01}), view_of_receivers({1.5, 1.2, 2}, {0, 0, 0}),
          view_of_receivers({-2, .25, .4}, {3, .3, 0}),
          view_of_receivers({.2, .4, .1}, {.9, .1, -.6}),
          view_of_receivers({0, 1, 2}, {4, 1.2, -1})};
}

// Where the ray through a place of the picture meets y = height of a frame, in front of the camera.
std::optional<glm::dvec2> on_plane(const prt::PinholeView& v, const Pose& world_from_frame,
                                   double height, double px, double py) {
  const Pose frame_from_camera = world_from_frame.inverse() * v.world_from_camera;
  const glm::dvec3 o = frame_from_camera.translation;
  const glm::dvec3 d =
      frame_from_camera.rotation * glm::dvec3((px - v.principal_px.x) / v.focal_px.x,
                                              (v.principal_px.y - py) / v.focal_px.y, -1);
  const double t = (height - o.y) / d.y;
  if (!(t > 0) || !std::isfinite(t)) return {};
  return glm::dvec2(o.x + t * d.x, o.z + t * d.z);
}

double between_nodes(const Image<float>& nodes, double u, double v) {
  if (u < 0 || v < 0 || u >= nodes.width() - 1 || v >= nodes.height() - 1) return 0;
  const int i = static_cast<int>(u), j = static_cast<int>(v);
  const double fu = u - i, fv = v - j;
  return (1 - fv) * std::lerp(nodes.at(i, j), nodes.at(i + 1, j), fu) +
         fv * std::lerp(nodes.at(i, j + 1), nodes.at(i + 1, j + 1), fu);
}

// Every pixel of every view: expected(view, x, y), whole rows and narrow ones.
template <class Expected>
void expect_rows(Receivers& receivers, const Expected& expected) {
  int shaded = 0, spared = 0;
  for (const prt::PinholeView& view : receiver_views()) {
    const Rect area = receivers.prepare({view});
    for (int y = 0; y < kReceiverHeight; ++y) {
      const Rect narrow = receivers.reach_in_row(y);
      std::vector<float> r(kReceiverWidth, 1), g(kReceiverWidth, 1), b(kReceiverWidth, 1),
          residual[3];
      const bool any = receivers.load_row(y, area, r.data(), g.data(), b.data());
      for (auto& v : residual) v.assign(kReceiverWidth, 1);
      receivers.load_row(y, narrow, residual[0].data(), residual[1].data(), residual[2].data());
      // In two pieces, cut within a shadow or beside it.
      std::vector<float> left[3], right[3];
      for (auto* piece : {left, right})
        for (int c = 0; c < 3; ++c) piece[c].assign(kReceiverWidth, 1);
      const int cut = 20 + y % 50;
      receivers.load_row(y, {0, y, cut, y + 1}, left[0].data(), left[1].data(), left[2].data());
      receivers.load_row(y, {cut, y, kReceiverWidth, y + 1}, right[0].data(), right[1].data(),
                         right[2].data());
      for (int x = 0; x < kReceiverWidth; ++x) {
        const double wanted = expected(view, x, y);
        const bool inside = any && x >= area.x0 && x < area.x1;
        const float whole = inside ? r[static_cast<std::size_t>(x - area.x0)] : 1;
        const bool reached = x >= narrow.x0 && x < narrow.x1;
        const float part = reached ? residual[0][static_cast<std::size_t>(x - narrow.x0)] : 1;
        ASSERT_NEAR(whole, wanted, 4e-3) << x << ' ' << y;
        ASSERT_EQ(part, whole) << x << ' ' << y;
        ASSERT_EQ(x < cut ? left[0][static_cast<std::size_t>(x)]
                          : right[0][static_cast<std::size_t>(x - cut)],
                  whole)
            << x << ' ' << y << " cut at " << cut;
        shaded += wanted < .99;
        spared += !reached && inside;
      }
    }
  }
  EXPECT_GT(shaded, 500);
  EXPECT_GT(spared, 500);
}

const Pose kAskew{glm::angleAxis(.6, glm::dvec3(0, 1, 0)), {.15, .02, -.1}};

TEST(Receivers, RowsHoldWhatTheirPixelsMeet) {
  prt::GroundGrid grid;
  grid.size = 64;
  grid.half_extent = 4;
  shadows::PlanarShadow shadow{Image<Rgb>(64, 64, Rgb{1, 1, 1}), 14, 20, 44, 51};
  for (int y = shadow.y0; y < shadow.y1; ++y)
    for (int x = shadow.x0; x < shadow.x1; ++x) {
      const float s = .3f + .01f * static_cast<float>(x + y % 3);
      shadow.ratio.at(x, y) = {s, s, s};
    }
  Receivers receivers(2);
  const int index = receivers.add(grid);
  receivers.set_pose(index, kAskew);
  receivers.set_shadow(index, shadow);
  Image<float> missing(64, 64);
  for (std::size_t i = 0; i < missing.area(); ++i)
    missing.pixels()[i] = 1 - shadow.ratio.pixels()[i].r;
  expect_rows(receivers, [&](const prt::PinholeView& view, int x, int y) {
    const auto p = on_plane(view, kAskew, grid.height, x + .5, y + .5);
    if (!p) return 1.;
    const glm::vec2 texel = grid.uv(glm::vec2(*p)) * 64.f - .5f;
    return 1 - between_nodes(missing, texel.x, texel.y);
  });
}

TEST(Receivers, LightsToo) {
  shadows::ShadowMap source;
  source.world_from_map = kAskew;
  source.cell_m = .05f;
  source.virtual_occlusion = Image<float>(30, 18);
  for (int y = 1; y < 17; ++y)
    for (int x = 1; x < 29; ++x)
      source.virtual_occlusion.at(x, y) = .5f + .01f * static_cast<float>(x + y);
  const ShadowMapOnPlane on_plane_of_all{&source, {.6f, .6f, .6f}, nullptr};
  Receivers receivers(2);
  receivers.set_shadow_maps({&on_plane_of_all, 1});
  const auto expected = [&](const prt::PinholeView& view, int x, int y) {
    double sum = 0;
    for (const double dx : {.25, .75})
      for (const double dy : {.25, .75})
        if (const auto p = on_plane(view, kAskew, 0, x + dx, y + dy))
          sum += between_nodes(source.virtual_occlusion, p->x / .05, p->y / .05);
    return 1 - .6 * sum / 4;
  };
  expect_rows(receivers, expected);
  // Beside a real shadow of the same light that nothing virtual meets, elsewhere.
  shadows::ShadowMap real = source;
  real.world_from_map.translation += glm::dvec3(0, 0, 5);
  const ShadowMapOnPlane beside{&source, {.6f, .6f, .6f}, &real};
  receivers.set_shadow_maps({&beside, 1});
  expect_rows(receivers, expected);
}

}  // namespace
}  // namespace penumbra::compositor
