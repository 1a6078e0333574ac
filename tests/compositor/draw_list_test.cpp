#include "compositor/layers/draw_list.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>

namespace penumbra::compositor {
namespace {

using DrawTriangle = DrawList::DrawTriangle;
constexpr float kTolerance = 1.5e-3f;

struct Hit {
  float distance;
  glm::vec3 weights;
  DrawTriangle triangle;
};

// Brute force: the nearest of all triangles that have the point's projection, or nearly, inside.
Hit nearest(const prt::Mesh& mesh, std::span<const DrawTriangle> triangles, const glm::vec3& p) {
  Hit best{HUGE_VALF, {}, {}};
  for (const DrawTriangle& t : triangles) {
    const glm::vec3 &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
    const glm::vec3 n = glm::cross(b - a, c - a), m = n / glm::dot(n, n);
    glm::vec3 w(glm::dot(glm::cross(b - p, c - p), m), glm::dot(glm::cross(c - p, a - p), m), 0);
    w.z = 1 - w.x - w.y;
    w = glm::max(w, 0.f);
    w /= w.x + w.y + w.z;
    const float d = glm::distance(p, w.x * a + w.y * b + w.z * c);
    if (d < best.distance) best = {d, w, t};
  }
  return best;
}

struct Worst {
  float moved = 0, colour = 0;
};
Worst worst_of(const prt::Mesh& mesh, std::span<const DrawTriangle> triangles,
               const std::vector<Rgb>& colours) {
  Worst worst;  // of every thirteenth vertex, they have no order that 13 could follow
  for (std::size_t i = 0; i < mesh.positions.size(); i += 13) {
    const Hit h = nearest(mesh, triangles, mesh.positions[i]);
    worst.moved = std::max(worst.moved, h.distance);
    const float shown = h.weights.x * colours[h.triangle[0]].g +
                        h.weights.y * colours[h.triangle[1]].g +
                        h.weights.z * colours[h.triangle[2]].g;
    worst.colour = std::max(worst.colour, std::abs(shown - colours[i].g));
  }
  return worst;
}

bool closed(std::span<const DrawTriangle> triangles) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (const DrawTriangle& t : triangles)
    for (std::size_t i = 0; i < 3; ++i) ++edges[{t[i], t[(i + 1) % 3]}];
  return std::ranges::all_of(edges, [&](const auto& e) {
    return e.second == 1 && edges.contains({e.first.second, e.first.first});
  });
}

// Edges of 1.8 hundredths of the radius: six times fewer triangles have the same form to a
// thousandth.
const prt::Mesh& ball() {
  static const prt::Mesh mesh = prt::make_sphere({0, 0, 0}, 1, 6, {.5f, .5f, .5f});
  return mesh;
}
std::vector<Rgb> coloured(const prt::Mesh& mesh, const auto& value_at) {
  std::vector<Rgb> out;
  for (const glm::vec3& p : mesh.positions) {
    const float v = value_at(p);
    out.push_back({v, v, v});
  }
  return out;
}

TEST(DrawList, EvenColoursNeedFewTrianglesOfTheSameForm) {
  DrawList list(ball(), kTolerance);
  const auto colours = coloured(ball(), [](const glm::vec3&) { return 1.f; });
  const auto chosen = list.select(colours);
  EXPECT_LT(chosen.size(), list.all().size() / 4);
  EXPECT_TRUE(closed(chosen));
  EXPECT_LT(worst_of(ball(), chosen, colours).moved, 2 * kTolerance);
}

TEST(DrawList, ShadowEdgeKeepsTheTrianglesThatItNeeds) {
  const auto edge = [](const glm::vec3& p) { return p.x + .3f * p.y < .1f ? .2f : 1.f; };
  const auto smooth = [](const glm::vec3& p) { return 1 + .3f * p.z; };
  const auto colours = coloured(ball(), [&](const glm::vec3& p) { return edge(p) * smooth(p); });
  DrawList list(ball(), kTolerance);
  const auto by_form = list.select(coloured(ball(), smooth));
  const std::vector<DrawTriangle> blind(by_form.begin(), by_form.end());
  const auto chosen = list.select(colours);
  EXPECT_LT(chosen.size(), list.all().size() / 2);
  EXPECT_TRUE(closed(chosen));
  EXPECT_LT(worst_of(ball(), chosen, colours).colour, .03f);
  EXPECT_GT(worst_of(ball(), blind, colours).colour, .3f) << "what form alone would choose";
}

TEST(DrawList, LightThatReturnsBringsTheSameTriangles) {
  DrawList list(ball(), kTolerance);
  const auto even = coloured(ball(), [](const glm::vec3&) { return 1.f; });
  const auto busy = coloured(ball(), [](const glm::vec3& p) { return p.x < 0 ? 0.f : 1.f; });
  const auto first = list.select(even);
  const std::vector<DrawTriangle> before(first.begin(), first.end());
  list.select(busy);
  EXPECT_TRUE(std::ranges::equal(before, list.select(even)));
}

TEST(DrawList, CreasesAndBordersStay) {
  const prt::Mesh box = prt::make_box({0, 0, 0}, {1, 1, 1}, 8, {.5f, .5f, .5f});
  DrawList list(box, kTolerance);
  EXPECT_TRUE(list.closed());
  const auto colours = coloured(box, [](const glm::vec3&) { return 1.f; });
  const auto chosen = list.select(colours);
  EXPECT_LT(chosen.size(), list.all().size());
  EXPECT_LT(worst_of(box, chosen, colours).moved, 1e-5f);
  prt::Mesh open = box;
  open.triangles.pop_back();
  EXPECT_FALSE(DrawList(open, kTolerance).closed());
  prt::Mesh inside_out = box;
  for (DrawTriangle& t : inside_out.triangles) std::swap(t[1], t[2]);
  EXPECT_FALSE(DrawList(inside_out, kTolerance).closed()) << "its backs are what is seen";
}

// A flat sheet that bends: what is flat in one form is not in another.
TEST(DrawList, EveryFormKeepsItsForm) {
  constexpr int kSide = 24;
  prt::Mesh flat;
  for (int y = 0; y <= kSide; ++y)
    for (int x = 0; x <= kSide; ++x)
      flat.positions.push_back({2.f * x / kSide - 1, 0, 2.f * y / kSide - 1});
  flat.normals.assign(flat.positions.size(), {0, 1, 0});
  for (std::uint32_t y = 0; y < kSide; ++y)
    for (std::uint32_t x = 0; x < kSide; ++x) {
      const std::uint32_t a = y * (kSide + 1) + x, b = a + kSide + 1;
      flat.triangles.insert(flat.triangles.end(), {{a, b, a + 1}, {a + 1, b, b + 1}});
    }
  prt::Mesh bent = flat;  // along a crease at x = 0
  for (glm::vec3& p : bent.positions) p.y = .5f * std::max(0.f, p.x);
  const auto colours = coloured(flat, [](const glm::vec3&) { return 1.f; });
  DrawList alone(flat, kTolerance), both(flat, kTolerance, std::span(&bent, 1));
  const auto naive = alone.select(colours);
  EXPECT_GT(worst_of(bent, naive, colours).moved, .01f);
  const auto chosen = both.select(colours);
  EXPECT_LT(chosen.size(), flat.triangles.size() / 3);
  EXPECT_LT(worst_of(bent, chosen, colours).moved, 2 * kTolerance);
}

TEST(DrawList, NoLightAtAllAndOneTriangle) {
  prt::Mesh one;
  one.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  one.triangles = {{0, 1, 2}};
  DrawList list(one, kTolerance);
  EXPECT_FALSE(list.closed());
  EXPECT_EQ(list.select(std::vector<Rgb>(3)).size(), 1u);
}

}  // namespace
}  // namespace penumbra::compositor
