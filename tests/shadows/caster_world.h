// Meshes that cast shadows on each other, of which the first is lit.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::shadows::test {

/// A level sheet of n x n squares about the origin.
inline prt::Mesh sheet(std::uint32_t n, float half_m = 1) {
  prt::Mesh m;
  for (std::uint32_t y = 0; y <= n; ++y)
    for (std::uint32_t x = 0; x <= n; ++x) {
      m.positions.emplace_back(half_m * (2 * float(x) / float(n) - 1), 0,
                               half_m * (2 * float(y) / float(n) - 1));
      m.normals.emplace_back(0, 1, 0);
      if (x == n || y == n) continue;
      const std::uint32_t i = y * (n + 1) + x;
      m.triangles.push_back({i, i + n + 1, i + 1});
      m.triangles.push_back({i + 1, i + n + 1, i + n + 2});
    }
  return m;
}

struct CasterWorld {
  std::vector<prt::Mesh> meshes;  // the first is the one that is lit
  prt::Mesh points;               // its vertices alone: nobody shares
  std::vector<SilhouetteMesh> silhouettes;
  std::vector<Caster> casters;
  prt::RayWorld rays = *prt::RayWorld::create();
  SilhouetteMesh none;
  float near_m;

  CasterWorld(std::vector<prt::Mesh> all, float near)
      : meshes(std::move(all)), points(meshes[0]), near_m(near) {
    points.triangles.clear();
    silhouettes.reserve(meshes.size());
    for (const prt::Mesh& m : meshes) {
      silhouettes.emplace_back(m);
      casters.push_back({&m, &silhouettes.back(), {}});
      EXPECT_TRUE(rays.add(m));
    }
  }
  std::vector<float> light(const lighting::DistantLight& source, const Caster& object,
                           const prt::RayWorld* occluders, int samples = 4) const {
    std::vector<float> out(meshes[0].positions.size());
    trace_direct_light({occluders, nullptr, near_m}, {casters, {}, near_m}, object, nullptr, source,
                       samples, out);
    return out;
  }
};

}  // namespace penumbra::shadows::test
