// The primitives of a glTF mesh as triangles with all that their vertices have.
// threads: as Document
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/geometry/gltf/internal/document.h"
#include "prt/geometry/gltf/internal/materials.h"

namespace penumbra::prt::gltf {

/// In the mesh's own frame. Lists other than positions and normals are empty where the file has
/// none, or as long as those.
struct Primitive {
  std::vector<glm::vec3> positions, normals;
  std::vector<glm::vec4> tangents;
  std::array<std::vector<glm::vec2>, 2> coordinates;
  std::vector<Rgb> tint;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::uint16_t material = 0;  // in Materials::all()
  std::string name;            // for messages
};

/// Of one mesh, without those that have no triangles. Normals are made where they are absent, and
/// tangents where a normal map asks for them.
/// errors: kInvalid (accessors, indices), kNonFinite (a position), what Materials::use returns
Result<std::vector<Primitive>> read_primitives(Document& document, std::size_t mesh,
                                               Materials& materials);

}  // namespace penumbra::prt::gltf
