// A virtual ball of 20 cm on the floor and a real wall, with the rays that meet them.
#pragma once

#include <gtest/gtest.h>

#include <optional>

#include "prt/prt.h"
#include "runtime/scene/scene.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::test {

struct BallAndWall {
  runtime::PreparedScene scene;
  std::optional<prt::RayWorld> virtual_things, real_things;

  /// in: corners of the wall, counter-clockwise from its front
  BallAndWall(const std::array<glm::vec3, 4>& wall, const glm::vec3& normal, Rgb floor_albedo) {
    runtime::PreparedObject& ball = scene.objects.emplace_back();
    ball.baked.mesh = prt::make_sphere({0, .2f, 0}, .2f, 4, {1, 1, 1});
    ball.baked.receiver = prt::Receiver{prt::fit_ground_grid(ball.baked.mesh, 0, 64), floor_albedo};
    scene.real_mesh.positions.assign(wall.begin(), wall.end());
    scene.real_mesh.normals.assign(4, normal);
    scene.real_mesh.albedo.assign(4, {.5f, .5f, .5f});
    scene.real_mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    auto virtual_world = prt::RayWorld::create(), real_world = prt::RayWorld::create();
    EXPECT_TRUE(virtual_world && real_world);
    virtual_things.emplace(std::move(*virtual_world));
    real_things.emplace(std::move(*real_world));
    EXPECT_TRUE(virtual_things->add(ball.baked.mesh));
    EXPECT_TRUE(real_things->add(scene.real_mesh));
  }
  shadows::RayOccluders occluders() const { return {&*virtual_things, &*real_things, 1e-4f}; }
};

}  // namespace penumbra::test
