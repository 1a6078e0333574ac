// What both importers ask of Assimp: files opened safely, materials read.
#pragma once

#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <filesystem>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/internal/limits.h"  // IWYU pragma: export

namespace penumbra::prt {

/// Triangles with smooth normals. The scene belongs to the importer. May throw what Assimp throws.
/// errors: kNotFound, kUnreadable, kInvalid (a kind that is not read)
Result<const aiScene*> open_scene(Assimp::Importer& importer, const std::filesystem::path& path);

Rgb clamped_albedo(Rgb albedo, Rgb fallback);
/// The mesh's material where the file has one of its own.
Rgb albedo_of(const aiScene& scene, const aiMesh& mesh, Rgb fallback);

}  // namespace penumbra::prt
