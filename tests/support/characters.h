// Characters for tests.
#pragma once

#include "prt/prt.h"

namespace penumbra::test {

/// A mesh as a character that one bone holds; no clips.
inline prt::Character one_bone(const prt::Mesh& mesh) {
  prt::Character c;
  c.positions = mesh.positions;
  c.normals = mesh.normals;
  c.albedo = mesh.albedo;
  c.triangles = mesh.triangles;
  c.nodes.push_back({"root", -1, {}});
  c.bones.push_back({0, glm::mat4(1)});
  c.influences.assign(mesh.positions.size(), {{0}, {1}});
  return c;
}

/// The same with the clip "Rest", which is one pose.
inline prt::Character resting(const prt::Mesh& mesh) {
  prt::Character c = one_bone(mesh);
  c.clips.push_back({"Rest", 0, {}, {}});
  return c;
}

}  // namespace penumbra::test
