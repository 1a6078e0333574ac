// Where the meshes of a glTF file stand.
// threads: as Document
#pragma once

#include <cstddef>
#include <glm/mat4x4.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/geometry/gltf/internal/document.h"

namespace penumbra::prt::gltf {

/// More meshes than this, instances counted, no file may place.
inline constexpr std::size_t kMaxPlaced = 100'000;

struct PlacedMesh {
  std::size_t mesh = 0;
  glm::dmat4 world_from_mesh{1};
  std::string name;  // of its node, for messages
};

/// Of a node's instances (EXT_mesh_gpu_instancing) within it; one where it has none.
/// errors: kInvalid
Result<std::vector<glm::dmat4>> instance_matrices(Document& document, const Json& node,
                                                  const std::string& name);

/// Of the file's scene, or of all roots where it has none, in the order of a walk from the roots;
/// EXT_mesh_gpu_instancing gives one for each instance.
/// errors: kInvalid (a node that is its own ancestor or has two parents; damaged transforms)
Result<std::vector<PlacedMesh>> placed_meshes(Document& document);

}  // namespace penumbra::prt::gltf
