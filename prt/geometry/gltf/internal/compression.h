// Compressed geometry: EXT_meshopt_compression and KHR_draco_mesh_compression.
// threads: reentrant
#pragma once

#include <array>
#include <map>

#include "prt/geometry/gltf/internal/accessors.h"
#include "prt/geometry/gltf/internal/document.h"

namespace penumbra::prt::gltf {

/// The bytes of a buffer view from the extension's object and its packed bytes.
/// errors: kInvalid (sizes, mode or filter that the extension does not have), kUnreadable (damaged)
Result<std::vector<unsigned char>> unpack_meshopt(const Json& extension, Bytes packed,
                                                  const std::string& whose,
                                                  const std::string& file);

struct DracoMesh {
  std::map<std::string, AccessorValues> attributes;  // by their glTF names
  std::vector<std::uint32_t> indices;                // three a triangle
};
/// A primitive's geometry from its extension's object.
/// errors: kInvalid (no buffer view, an attribute that is not there, sizes), kUnreadable (damaged)
Result<DracoMesh> unpack_draco(Document& document, const Json& primitive, const Json& extension,
                               const std::string& whose);

}  // namespace penumbra::prt::gltf
