// Vertices that look around for those beside them.
#include "prt/transfer/vertex_samples.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <glm/geometric.hpp>
#include <set>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

using Around = std::set<std::uint32_t>;

// By vertex itself and those that fraction a triangle with it.
std::vector<Around> neighbours_of(const Mesh& mesh) {
  std::vector<Around> out(mesh.positions.size());
  for (std::uint32_t i = 0; i < out.size(); ++i) out[i].insert(i);
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t a : t) out[a].insert(t.begin(), t.end());
  return out;
}

TEST(VertexSamples, ThreeAreAtOrBesideEachVertex) {
  for (const Mesh& mesh :
       {make_knot(.5f, 60, 16, {.5f, .5f, .5f}), make_sphere({0, 0, 0}, 1, 3, {.5f, .5f, .5f}),
        make_box({-1, -1, -1}, {1, 1, 1}, 4, {.5f, .5f, .5f})}) {
    const VertexSamples samples(mesh);
    const std::vector<Around> near = neighbours_of(mesh);
    ASSERT_TRUE(std::ranges::is_sorted(samples.vertices()));
    const Around all(samples.vertices().begin(), samples.vertices().end());
    EXPECT_LT(all.size(), near.size() * 7 / 10) << "half of them do";
    for (std::uint32_t i = 0; i < near.size(); ++i) {
      EXPECT_EQ(samples.is_sample(i), all.contains(i));
      const auto there = std::ranges::count_if(near[i], [&](auto k) { return all.contains(k); });
      EXPECT_GE(there, 3) << i;
      Around named;
      for (const std::uint32_t place : samples.around(i)) {
        if (place == samples.vertices().size()) continue;
        EXPECT_TRUE(near[i].contains(samples.vertices()[place])) << i;
        EXPECT_TRUE(named.insert(place).second) << i << " names one twice";
      }
      EXPECT_EQ(named.size(), std::min<std::size_t>(static_cast<std::size_t>(there), 4)) << i;
      if (samples.is_sample(i)) {
        EXPECT_EQ(samples.vertices()[samples.around(i)[0]], i) << "its own comes first";
      }
    }
  }
}

// What lies in a dent sees less than those around it do.
TEST(VertexSamples, WhatLooksAnotherWayLooksForItself) {
  Mesh mesh = make_sphere({0, 0, 0}, 1, 4, {.5f, .5f, .5f});
  std::size_t left_out = 0;
  for (const std::uint32_t dent : {0u, 100u, 500u}) {
    left_out += !VertexSamples(mesh).is_sample(dent);
    Mesh dented = mesh;
    dented.positions[dent] *= .5f;
    EXPECT_TRUE(VertexSamples(dented).is_sample(dent)) << "at the end of long edges";
    dented = mesh;
    dented.normals[dent] = glm::normalize(glm::cross(mesh.normals[dent], glm::vec3(.3f, .5f, .8f)));
    EXPECT_TRUE(VertexSamples(dented).is_sample(dent)) << "turned";
  }
  EXPECT_GT(left_out, 0u) << "others look for some of them as long as they are not";
}

// Nobody can look for a point that no triangle joins to others, nor for the corners of a triangle
// alone.
TEST(VertexSamples, WhatHasTooFewNeighboursLooksForItself) {
  Mesh mesh;
  mesh.positions.assign(5, glm::vec3(0));
  mesh.normals.assign(5, glm::vec3(0, 1, 0));
  mesh.triangles = {{1, 2, 3}};
  const VertexSamples samples(mesh);
  EXPECT_EQ(samples.vertices().size(), 5u);
  EXPECT_EQ(samples.around(0), (std::array<std::uint32_t, 4>{0, 5, 5, 5}));
  EXPECT_EQ(samples.around(2), (std::array<std::uint32_t, 4>{2, 1, 3, 5}));
}

}  // namespace
}  // namespace penumbra::prt
