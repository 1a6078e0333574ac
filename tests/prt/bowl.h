// A bowl whose light is known in closed form.
#pragma once

#include <glm/geometric.hpp>
#include <vector>

#include "prt/prt.h"

namespace penumbra::test {

struct Bowl {
  prt::Mesh mesh;
  double fraction = 0;                  // of the sphere's area
  std::vector<double> vertex_fraction;  // of the bowl's area
};

/// The inside of a unit sphere below `cut`. Between any two patches of a sphere's inside
/// the form factor is area/(4 pi), so the ragged rim does no harm.
inline Bowl make_bowl(float cut, float albedo) {
  const prt::Mesh sphere = prt::make_sphere({0, 0, 0}, 1, 4, {albedo, albedo, albedo});
  Bowl bowl;
  std::vector<int> place(sphere.positions.size(), -1);
  double whole = 0, kept = 0;
  for (const auto& t : sphere.triangles) {
    const glm::vec3 a = sphere.positions[t[0]], b = sphere.positions[t[1]],
                    c = sphere.positions[t[2]];
    const double area = .5 * glm::length(glm::cross(b - a, c - a));
    whole += area;
    if ((a.y + b.y + c.y) / 3 > cut) continue;
    kept += area;
    for (const auto i : t)
      if (place[i] < 0) {
        place[i] = static_cast<int>(bowl.mesh.positions.size());
        bowl.mesh.positions.push_back(sphere.positions[i]);
        bowl.mesh.normals.push_back(-sphere.normals[i]);
        bowl.mesh.albedo.push_back(sphere.albedo[i]);
        bowl.vertex_fraction.push_back(0);
      }
    const auto at = [&](int i) {
      return static_cast<std::uint32_t>(place[t[static_cast<std::size_t>(i)]]);
    };
    bowl.mesh.triangles.push_back({at(0), at(2), at(1)});
    for (int i = 0; i < 3; ++i) bowl.vertex_fraction[at(i)] += area / 3;
  }
  bowl.fraction = kept / whole;
  for (double& part : bowl.vertex_fraction) part /= kept;
  return bowl;
}

}  // namespace penumbra::test
