// One sample a pixel and contours, against 256 samples and against four.
#include "compositor/layers/contour.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <random>

#include "compositor/projection.h"
#include "core/half.h"
#include "core/image.h"

namespace penumbra::compositor {
namespace {

constexpr int kWidth = 96, kHeight = 72;
using Pixel = std::array<float, 4>;
using Picture = Image<Pixel>;

struct Thing {
  prt::Mesh mesh;  // albedo is what is seen, by the triangle's first vertex
  bool fronts_only = true;
};
using Things = std::vector<Thing>;

prt::PinholeView view_from(const glm::dvec3& eye, const glm::dvec3& at = {0, 0, 0}) {
  prt::PinholeView view{kWidth, kHeight, {90, 90}, {kWidth / 2. + .3, kHeight / 2. - .2}, {}};
  view.world_from_camera = {glm::quatLookAt(glm::normalize(at - eye), glm::dvec3(0, 1, 0)), eye};
  return view;
}
std::vector<prt::PinholeView> views() {
  std::vector<prt::PinholeView> out;
  for (int i = 0; i < 6; ++i) {
    const double turn = .9 * i + .2, up = .25 * i - .4;
    out.push_back(view_from(glm::dvec3(3.1 * std::sin(turn) * std::cos(up), 3.1 * std::sin(up),
                                       3.1 * std::cos(turn) * std::cos(up)),
                            {.013 * i, -.021 * i, 0}));
  }
  return out;
}

// Mean of n x n samples a pixel, each of the nearest triangle there.
Picture drawn(const Things& things, const prt::PinholeView& view, int n) {
  const glm::dmat4 clip = clip_from_world_of(view);
  const int w = n * kWidth, h = n * kHeight;
  Image<double> nearness(w, h);  // 1/distance
  Image<Pixel> samples(w, h);
  for (const Thing& thing : things)
    for (const auto& t : thing.mesh.triangles) {
      glm::dvec3 p[3];
      for (int k = 0; k < 3; ++k) {
        const glm::dvec4 c = clip * glm::dvec4(thing.mesh.positions[t[std::size_t(k)]], 1);
        p[k] = {(c.x / c.w + 1) / 2 * w, (c.y / c.w + 1) / 2 * h, 1 / c.w};
      }
      const auto cross = [](const glm::dvec3& a, const glm::dvec3& b, double x, double y) {
        return (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
      };
      const double area = cross(p[0], p[1], p[2].x, p[2].y);
      if (area == 0 || (thing.fronts_only && area > 0)) continue;
      const Rgb& c = thing.mesh.albedo[t[0]];
      const Pixel seen = area > 0 ? Pixel{0, 0, 0, 1} : Pixel{c.r, c.g, c.b, 1};
      const auto [x0, x1] = std::minmax({p[0].x, p[1].x, p[2].x});
      const auto [y0, y1] = std::minmax({p[0].y, p[1].y, p[2].y});
      for (int y = std::max(0, int(y0)); y < std::min(h, int(y1) + 1); ++y)
        for (int x = std::max(0, int(x0)); x < std::min(w, int(x1) + 1); ++x) {
          double weight[3], at = 0;
          for (int k = 0; k < 3; ++k) {
            weight[k] = cross(p[(k + 1) % 3], p[(k + 2) % 3], x + .5, y + .5) / area;
            at += weight[k] * p[k].z;
          }
          if (std::min({weight[0], weight[1], weight[2]}) < 0 || at <= nearness.at(x, y)) continue;
          nearness.at(x, y) = at;
          samples.at(x, y) = seen;
        }
    }
  Picture out(kWidth, kHeight);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x)
      for (std::size_t c = 0; c < 4; ++c)
        out.at(x / n, y / n)[c] += samples.at(x, y)[c] / static_cast<float>(n * n);
  return out;
}

std::vector<ContourLine> lines_of(const Things& things, const prt::PinholeView& view) {
  std::vector<ContourLine> lines;
  for (const Thing& t : things)
    EXPECT_TRUE(Contour(t.mesh).find(t.mesh.positions, t.mesh.triangles, t.fronts_only,
                                     ViewProjection(view, nullptr), lines));
  return lines;
}

Layer layer_of(const Picture& picture, const Rect& rect = {0, 0, kWidth, kHeight}) {
  Layer out{rect, {}};
  for (int y = rect.y0; y < rect.y1; ++y)
    for (int x = rect.x0; x < rect.x1; ++x)
      for (const float v : picture.at(x, y)) out.halves.push_back(half_from_float(v));
  return out;
}

Picture picture_of(const Layer& layer) {
  Picture out(kWidth, kHeight);
  std::size_t i = 0;
  for (int y = layer.rect.y0; y < layer.rect.y1; ++y)
    for (int x = layer.rect.x0; x < layer.rect.x1; ++x)
      for (float& v : out.at(x, y)) v = float_from_half(layer.halves[i++]);
  return out;
}

Picture smoothed(const Things& things, const prt::PinholeView& view) {
  Layer layer = layer_of(drawn(things, view, 1));
  ContourSmoother smoother;
  EXPECT_TRUE(smoother.smooth(lines_of(things, view), layer));
  return picture_of(layer);
}

struct Errors {
  double one = 0, four = 0, contours = 0;  // RMS over the pixels that one sample does not get right
};
Errors errors(const Things& things, const std::vector<prt::PinholeView>& from = views()) {
  double one = 0, four = 0, contours = 0, count = 0;
  for (const prt::PinholeView& view : from) {
    const Picture truth = drawn(things, view, 16), plain = drawn(things, view, 1),
                  oversampled = drawn(things, view, 2), ours = smoothed(things, view);
    for (std::size_t i = 0; i < truth.area(); ++i) {
      const auto square = [&](const Picture& p) {
        double sum = 0;
        for (std::size_t c = 0; c < 4; ++c)
          sum += std::pow(p.pixels()[i][c] - truth.pixels()[i][c], 2) / 4;
        return sum;
      };
      one += square(plain), four += square(oversampled), contours += square(ours);
      count += square(plain) > 1e-4;
    }
  }
  std::printf("edges: RMS error %.3f of one sample, %.3f of four, %.3f of one with contours\n",
              std::sqrt(one / count), std::sqrt(four / count), std::sqrt(contours / count));
  return {std::sqrt(one / count), std::sqrt(four / count), std::sqrt(contours / count)};
}

prt::Mesh ball(const glm::vec3& centre, float radius, Rgb seen) {
  return prt::make_sphere(centre, radius, 3, seen);
}

TEST(ClosedMesh, EveryEdgeJoinsTwoTrianglesThatFaceOutwards) {
  const prt::Mesh box = prt::make_box({0, 0, 0}, {1, 1, 1}, 8, {.5f, .5f, .5f});
  EXPECT_TRUE(is_closed(box));
  prt::Mesh open = box;
  open.triangles.pop_back();
  EXPECT_FALSE(is_closed(open));
  prt::Mesh inside_out = box;
  for (auto& t : inside_out.triangles) std::swap(t[1], t[2]);
  EXPECT_FALSE(is_closed(inside_out)) << "its backs are what is seen";
}

TEST(Contour, EdgesOfABallAreBetterThanOfFourSamples) {
  const Errors e = errors({{ball({0, 0, 0}, .9f, {1, .6f, .3f})}});
  EXPECT_GT(e.one, .2);
  EXPECT_LT(e.contours, .7 * e.four);
  EXPECT_LT(e.contours, .05);
}

TEST(Contour, NearEdgesBeforeFarOnesToo) {
  const Errors e = errors({{ball({0, 0, 0}, .6f, {1, .2f, .1f})},
                           {ball({.5f, .3f, .7f}, .4f, {.1f, .8f, .2f})},
                           {ball({-.5f, .1f, -.6f}, .5f, {.1f, .2f, .9f})}});
  EXPECT_LT(e.contours, .8 * e.four);
  EXPECT_LT(e.contours, .06);
}

// Seen from the side a knot's contour folds back onto itself: several edges lie within one pixel.
TEST(Contour, FoldsCountOnce) {
  prt::Mesh knot = prt::make_knot(1.6f, 700, 60, {1, 1, 1});
  prt::transform(knot, glm::dmat4(1));
  for (glm::vec3& p : knot.positions) p.y -= .8f;
  const Errors e = errors({{knot}});
  EXPECT_LT(e.contours, .9 * e.four);
  EXPECT_LT(e.contours, .07);
}

TEST(Contour, CreasesOfABoxAreSmoothToo) {
  prt::Mesh box = prt::make_box({-.6f, -.5f, -.7f}, {.7f, .5f, .6f}, 3, {});
  for (std::size_t i = 0; i < box.positions.size(); ++i) {
    const glm::vec3 n = glm::abs(box.normals[i]);
    box.albedo[i] = {.2f + .8f * n.x, .2f + .8f * n.y, .2f + .8f * n.z};
  }
  const Errors e = errors({{box}});
  EXPECT_LT(e.contours, .7 * e.four);
  EXPECT_LT(e.contours, .06);
}

TEST(Contour, ASheetHasItsRimFromBothSides) {
  prt::Mesh sheet;
  sheet.positions = {{-.8f, -.5f, .1f}, {.9f, -.4f, 0}, {.8f, .6f, .2f}, {-.7f, .5f, 0}};
  sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
  sheet.albedo.assign(4, Rgb{.9f, .5f, .2f});
  for (const double z : {3., -3.}) {
    const auto lines = lines_of({{sheet, false}}, view_from({.4, .3, z}));
    EXPECT_EQ(lines.size(), 4u) << z;
    for (const ContourLine& l : lines) {
      // The left hand, y down: towards the middle.
      const glm::vec2 d = glm::vec2(l.to - l.from),
                      in = glm::vec2(kWidth / 2, kHeight / 2) - glm::vec2(l.from);
      EXPECT_LT(d.x * in.y - d.y * in.x, 0) << z;
    }
  }
  const Errors e =
      errors({{sheet, false}}, {view_from({.4, .3, 3}), view_from({-1.2, .8, -2.4}),
                                view_from({1.5, -.9, 2.2}), view_from({-.8, -.7, 2.8})});
  EXPECT_LT(e.contours, .7 * e.four);
}

TEST(Contour, SeesTheFrontsAloneAndNothingThatReachesBehindTheCamera) {
  const prt::Mesh box = prt::make_box({-1, -1, -1}, {1, 1, 1}, 1, {1, 1, 1});
  Contour contour(box);
  std::vector<ContourLine> lines;
  const auto find = [&](const glm::dvec3& eye, bool fronts_only) {
    lines.clear();
    return contour.find(box.positions, box.triangles, fronts_only,
                        ViewProjection(view_from(eye), nullptr), lines);
  };
  // Three sides; six edges between front and back, three creases from both of their sides.
  EXPECT_TRUE(find({3, 4, 5}, true));
  EXPECT_EQ(contour.seen().size(), 6u);
  EXPECT_EQ(lines.size(), 12u);
  EXPECT_TRUE(find({3, 4, 5}, false));
  EXPECT_EQ(contour.seen().size(), 12u);
  EXPECT_FALSE(find({0, 0, .5}, true));
}

TEST(Contour, DoesNotServePartsThatMayGoThroughEachOther) {
  const auto serves = [](const glm::vec3& at, Rgb albedo) {
    prt::Mesh both = ball({0, 0, 0}, .5f, {.8f, .8f, .8f});
    prt::append(both, ball(at, .5f, albedo));
    return Contour(both).serves();
  };
  EXPECT_FALSE(serves({.6f, .2f, 0}, {.1f, .1f, .1f}));
  EXPECT_TRUE(serves({.6f, .2f, 0}, {.8f, .8f, .8f})) << "of one colour little shows";
  EXPECT_TRUE(serves({1.1f, 0, 0}, {.1f, .1f, .1f})) << "beside each other";
  const prt::Mesh box = prt::make_box({-1, -1, -1}, {1, 1, 1}, 2, {1, 1, 1});
  EXPECT_TRUE(Contour(box).serves()) << "creases part nothing";
}

TEST(Contour, DoesNotServeFacettedMeshesOfManyTriangles) {
  const auto facetted = [](int subdivisions) {
    const prt::Mesh smooth = prt::make_sphere({0, 0, 0}, .5f, subdivisions, {1, 1, 1});
    prt::Mesh out;
    for (const auto& t : smooth.triangles) {
      const auto n = static_cast<std::uint32_t>(out.positions.size());
      for (const std::uint32_t v : t) out.positions.push_back(smooth.positions[v]);
      out.triangles.push_back({n, n + 1, n + 2});
    }
    out.albedo.assign(out.positions.size(), Rgb{1, 1, 1});
    return out;
  };
  EXPECT_TRUE(Contour(facetted(4)).serves());
  EXPECT_FALSE(Contour(facetted(6)).serves());
}

TEST(Contour, RodsBetweenSamplesAreNotLost) {
  const prt::PinholeView view = view_from({.4, .3, 3.1});
  const double pixel = 3.1 / 90;
  const auto smooths = [&](double width_px) {
    const auto half = static_cast<float>(.5 * width_px * pixel);
    prt::Mesh thing = ball({0, -.4f, 0}, .3f, {1, 1, 1});
    prt::append(thing, prt::make_box({-half, -.3f, -half}, {half, .9f, half}, 4, {1, 1, 1}));
    const Things things{{thing}};
    Layer layer = layer_of(drawn(things, view, 1));
    return ContourSmoother().smooth(lines_of(things, view), layer);
  };
  EXPECT_TRUE(smooths(3));
  EXPECT_FALSE(smooths(.3));
}

TEST(Contour, EdgesIntoTheDistanceBehindWhatIsNear) {
  prt::Mesh road;
  road.positions = {{-.4f, -.3f, 2.6f}, {.3f, -.3f, 2.6f}, {.3f, -.3f, -40}, {-.4f, -.3f, -40}};
  road.triangles = {{0, 1, 2}, {0, 2, 3}};
  road.albedo.assign(4, Rgb{.9f, .9f, .9f});
  std::vector<prt::PinholeView> along;
  for (int i = 0; i < 5; ++i) along.push_back(view_from({.08 * i - .1, .1 + .07 * i, 3.1}));
  const Errors e = errors({{road, false}, {ball({.1f, -.25f, -.5f}, .4f, {.1f, .6f, .9f})}}, along);
  EXPECT_LT(e.contours, .9 * e.four);
}

TEST(Contour, NothingIsWrittenBesideTheLayerAndNothingWithoutEdges) {
  const Things things{{ball({0, 0, 0}, .9f, {1, 1, 1})}};
  const prt::PinholeView view = view_from({.3, .2, 1.4});  // it fills more than the picture
  const Rect rect{20, 11, 77, 60};
  Layer whole = layer_of(drawn(things, view, 1)), part = layer_of(drawn(things, view, 1), rect);
  ContourSmoother smoother;
  const auto lines = lines_of(things, view);
  EXPECT_TRUE(smoother.smooth(lines, whole));
  EXPECT_TRUE(smoother.smooth(lines, part));
  const Picture a = picture_of(whole), b = picture_of(part);
  for (int y = rect.y0 + 1; y < rect.y1 - 1; ++y)
    for (int x = rect.x0 + 1; x < rect.x1 - 1; ++x) ASSERT_EQ(a.at(x, y), b.at(x, y));
  Layer even = layer_of(drawn(things, view, 1));
  const auto before = even.halves;
  EXPECT_TRUE(smoother.smooth({}, even));
  EXPECT_EQ(even.halves, before);
}

TEST(Contour, TrianglesWithoutAreaAndFarAsideGiveNoNan) {
  prt::Mesh mesh = ball({0, 0, 0}, .9f, {1, 1, 1});
  mesh.triangles.push_back({0, 0, 1});
  mesh.triangles.push_back({2, 2, 2});
  mesh.positions[5] = {4e7f, 1e6f, -3};  // further aside than pixels can be counted
  mesh.positions[9] = {0, -3e8f, -3};
  std::mt19937 random(3);
  std::uniform_real_distribution<float> unit(0, 1);
  for (const glm::dvec3& eye : {glm::dvec3(0, .1, .5), glm::dvec3(.9, 0, 0), glm::dvec3(0, 0, 2)})
    for (const glm::dvec3& at : {glm::dvec3(3, 0, .1), glm::dvec3(0, 0, -3)}) {
      std::vector<ContourLine> lines;
      Contour(mesh).find(mesh.positions, mesh.triangles, false,
                         ViewProjection(view_from(eye, at), nullptr), lines);
      Layer layer{{0, 0, kWidth, kHeight}, std::vector<std::uint16_t>(4 * kWidth * kHeight)};
      for (auto& half : layer.halves) half = half_from_float(unit(random) < .5f ? 0 : unit(random));
      ContourSmoother().smooth(lines, layer);
      for (const std::uint16_t half : layer.halves) {
        ASSERT_GE(float_from_half(half), 0);
        ASSERT_LE(float_from_half(half), 1);
      }
    }
}

}  // namespace
}  // namespace penumbra::compositor
