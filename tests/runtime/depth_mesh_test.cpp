#include "runtime/scene/depth_mesh.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "capture/capture.h"
#include "codec/codec.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

const prt::PinholeView kView{
    160, 120, {140, 140}, {80, 60}, capture::look_at({0, 1.5, 1.5}, {0, 0, 0})};

// Depth of the floor y = 0 along the axis.
Image<float> floor_depth() {
  Image<float> out(kView.width, kView.height);
  for (int y = 0; y < kView.height; ++y)
    for (int x = 0; x < kView.width; ++x) {
      const dvec3 d = kView.world_from_camera.rotation *
                      dvec3((x + .5 - kView.principal_px.x) / kView.focal_px.x,
                            -(y + .5 - kView.principal_px.y) / kView.focal_px.y, -1);
      out.at(x, y) = static_cast<float>(-kView.world_from_camera.translation.y / d.y);
    }
  return out;
}

TEST(DepthMesh, FloorLiesWhereItWasSeenAndFacesTheCamera) {
  const auto mesh = mesh_from_depth(floor_depth(), kView, {.4f, .4f, .4f});
  ASSERT_TRUE(mesh) << mesh.error().detail;
  EXPECT_EQ(mesh->positions.size(), 160u * 120u);
  EXPECT_EQ(mesh->triangles.size(), 2u * 159u * 119u);
  for (const glm::vec3& p : mesh->positions) ASSERT_NEAR(p.y, 0, 1e-4);
  for (const glm::vec3& n : mesh->normals) ASSERT_GT(n.y, .999f);
}

TEST(DepthMesh, JumpsAndHolesAreNoSurface) {
  Image<float> depth = floor_depth();
  // A board half way to the floor, and nothing known on the left.
  for (int y = 40; y < 80; ++y)
    for (int x = 60; x < 100; ++x) depth.at(x, y) *= .5f;
  constexpr float kUnknown[] = {0, -1, std::numeric_limits<float>::quiet_NaN(),
                                std::numeric_limits<float>::infinity()};
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 20; ++x) depth.at(x, y) = kUnknown[x % 4];
  const auto mesh = mesh_from_depth(depth, kView, {.4f, .4f, .4f});
  ASSERT_TRUE(mesh);
  for (const glm::vec3& p : mesh->positions) ASSERT_TRUE(std::isfinite(p.x + p.y + p.z));
  for (const auto& t : mesh->triangles) {
    float low = 1e9f, high = -1e9f;
    for (const std::uint32_t v : t) {
      low = std::min(low, mesh->positions[v].y);
      high = std::max(high, mesh->positions[v].y);
    }
    // Naive: all neighbours joined would hang walls between board and floor.
    ASSERT_LT(high - low, .2f);
  }
}

TEST(DepthMesh, LargePicturesAreThinnedOut) {
  prt::PinholeView view = kView;
  view.width = 2000, view.height = 1500, view.principal_px = {1000, 750},
  view.focal_px = {1700, 1700};
  const auto mesh = mesh_from_depth(Image<float>(2000, 1500, 2.f), view, {.4f, .4f, .4f});
  ASSERT_TRUE(mesh);
  EXPECT_LE(mesh->positions.size(), std::size_t(kDepthVertices) * kDepthVertices);
}

TEST(DepthMesh, WhatIsNoDepthIsAnError) {
  const auto nothing = mesh_from_depth(Image<float>(160, 120), kView, {});
  ASSERT_FALSE(nothing);
  EXPECT_EQ(nothing.error().code, ErrorCode::kUndetermined);
  EXPECT_FALSE(mesh_from_depth(Image<float>(10, 10, 1.f), kView, {}));
  const test::TempFolder folder;
  ASSERT_TRUE(codec::write_frame(folder.path() / "eight.png", Image<Rgb8>(160, 120, {9, 9, 9})));
  const auto no_camera =
      read_depth_mesh(folder.path() / "eight.png", folder.path() / "no.toml", {});
  ASSERT_FALSE(no_camera);
  EXPECT_NE(no_camera.error().where.find("no.toml"), std::string::npos);
}

}  // namespace
}  // namespace penumbra::runtime
