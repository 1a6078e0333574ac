// The materials of a baked object in its file, as any viewer of glTF shows them.
// threads: reentrant
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/bake/internal/model_writer.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

/// Materials, pictures and what vertices have for them, into the model and `attributes`. Without a
/// surface: one material that is neither metal nor glossy, as glTF's own default is metal.
void add_surface(const SurfaceMaterials* surface, ModelWriter& writer,
                 std::map<std::string, int>& attributes);

/// Adds one primitive for each material that triangles have, all with `attributes`.
void add_primitives(const Mesh& mesh, const SurfaceMaterials* surface, ModelWriter& writer,
                    const std::map<std::string, int>& attributes);

/// What a file has beside the mesh that was read from it; null where it was baked without
/// materials.
/// in:     `bytes`: the whole file
/// errors: kUnreadable, and what gltf::read_materials returns
Result<std::shared_ptr<const SurfaceMaterials>> read_surface(const tinygltf::Model& model,
                                                             std::vector<unsigned char> bytes,
                                                             const std::filesystem::path& path,
                                                             const Mesh& mesh);

}  // namespace penumbra::prt
