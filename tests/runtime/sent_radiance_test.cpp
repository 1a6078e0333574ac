// What an object sends each way, against closed forms.
#include "runtime/shading/sent_radiance.h"

#include <gtest/gtest.h>

#include "core/conventions.h"
#include "prt/prt.h"

namespace penumbra::runtime {
namespace {

std::vector<float> relit_of(const prt::Mesh& mesh, auto irradiance_over_pi) {
  std::vector<float> out;
  for (int c = 0; c < 3; ++c)
    for (const glm::vec3& n : mesh.normals) out.push_back(irradiance_over_pi(n));
  return out;
}

// Int (a + b n.x) (n.d)+ / Int (n.d)+ over the sphere is a + 2/3 b d.x.
TEST(SentRadiance, OfABallLitFromOneSideIsTheClosedForm) {
  const prt::Mesh ball = prt::make_sphere({1, 2, 3}, .2f, 4, {.5f, .25f, 0});
  const SentRadiance sent(ball, vertex_areas(ball),
                          relit_of(ball, [](const glm::vec3& n) { return 3 + n.x; }));
  for (const glm::vec3& d : {glm::vec3(1, 0, 0), {-5, 0, 0}, {0, 1, 0}, {.6f, 0, .8f}}) {
    const float expected = 3 + 2 / 3.f * glm::normalize(d).x;
    const Rgb out = sent.towards(d);
    EXPECT_NEAR(out.r, .5f * expected, .02f) << d.x << ' ' << d.y << ' ' << d.z;
    EXPECT_NEAR(out.g, .25f * expected, .01f);
    EXPECT_EQ(out.b, 0);
  }
}

TEST(SentRadiance, AreasAreThoseOfTheSurface) {
  const prt::Mesh ball = prt::make_sphere({0, 0, 0}, .5f, 5, {1, 1, 1});
  float sum = 0;
  for (const float a : vertex_areas(ball)) sum += a;
  EXPECT_NEAR(sum, kPi, .01);
}

// A sheet has nothing that faces sideways: the answer stays finite and not negative.
TEST(SentRadiance, StaysFiniteBesideASheet) {
  prt::Mesh sheet;
  sheet.positions = {{0, 0, 0}, {1, 0, 0}, {0, 0, 1}};
  sheet.normals = {{0, 1, 0}, {0, 1, 0}, {0, 1, 0}};
  sheet.albedo.assign(3, {1, 1, 1});
  sheet.triangles = {{0, 2, 1}};
  const SentRadiance sent(sheet, vertex_areas(sheet),
                          relit_of(sheet, [](const glm::vec3&) { return 1.f; }));
  for (const glm::vec3& d : {glm::vec3(1, 0, 0), {0, -1, 0}, {0, 1, 0}}) {
    EXPECT_GE(sent.towards(d).g, 0);
    EXPECT_LE(sent.towards(d).g, 1.5f);
  }
}

}  // namespace
}  // namespace penumbra::runtime
