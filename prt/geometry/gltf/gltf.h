// glTF 2.0 files with their materials.
// threads: reentrant
#pragma once

#include <filesystem>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt::gltf {

/// By its name's ending.
bool is_gltf(const std::filesystem::path& path);

/// What import_mesh does with .gltf and .glb.
/// errors: as import_mesh
Result<Import> import_file(const std::filesystem::path& path, Rgb default_albedo);

/// The same from memory; `path` stands in errors, and what the file names lies beside it.
Result<Import> import_bytes(std::vector<unsigned char> bytes, const std::filesystem::path& path,
                            Rgb default_albedo);

/// All materials of a file, in its order, with their pictures.
/// errors: kUnreadable, kInvalid, kNotFound
Result<std::vector<Material>> read_materials(std::vector<unsigned char> bytes,
                                             const std::filesystem::path& path);

/// The file as Assimp reads it for its clips: checked, and without what Assimp does not know. A
/// binary file stays one.
/// errors: as import_file
Result<std::vector<unsigned char>> clip_file_bytes(const std::filesystem::path& path);

}  // namespace penumbra::prt::gltf
#pragma GCC visibility pop
