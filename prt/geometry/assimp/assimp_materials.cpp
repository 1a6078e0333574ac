#include "prt/geometry/internal/assimp_materials.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "prt/geometry/gltf/internal/picture.h"
#include "prt/geometry/internal/asset_files.h"
#include "prt/geometry/internal/assimp_scene.h"

namespace penumbra::prt {

namespace {

std::string picture_name(const aiMaterial& material) {
  aiString name;
  if (material.GetTexture(aiTextureType_BASE_COLOR, 0, &name) == AI_SUCCESS ||
      material.GetTexture(aiTextureType_DIFFUSE, 0, &name) == AI_SUCCESS)
    return name.C_Str();
  return "";
}

Texture::Wrap wrap_of(const aiMaterial& material, const char* key, unsigned type) {
  int mode = aiTextureMapMode_Wrap;
  if (material.Get(key, type, 0, mode) != AI_SUCCESS) return Texture::Wrap::kRepeat;
  if (mode == aiTextureMapMode_Clamp) return Texture::Wrap::kClamp;
  return mode == aiTextureMapMode_Mirror ? Texture::Wrap::kMirror : Texture::Wrap::kRepeat;
}

}  // namespace

std::uint16_t AssimpMaterials::use(const aiMesh& mesh) {
  const auto [found, fresh] = places_.try_emplace(mesh.mMaterialIndex);
  if (!fresh) return found->second;
  constexpr std::size_t kMost = std::numeric_limits<std::uint16_t>::max();
  const std::size_t place = std::min(materials_.size(), kMost);
  found->second = static_cast<std::uint16_t>(place);
  if (place < materials_.size()) return found->second;
  Material& out = materials_.emplace_back();
  out.base_colour = albedo_of(scene_, mesh, fallback_);
  if (mesh.mMaterialIndex >= scene_.mNumMaterials || !mesh.HasTextureCoords(0))
    return found->second;
  const aiMaterial& material = *scene_.mMaterials[mesh.mMaterialIndex];
  out.name = material.GetName().C_Str();
  const std::string name = picture_name(material);
  if (name.empty()) return found->second;
  out.base_colour_map.picture = picture(name);
  out.base_colour_map.wrap_s =
      wrap_of(material, _AI_MATKEY_MAPPINGMODE_U_BASE, aiTextureType_DIFFUSE);
  out.base_colour_map.wrap_t =
      wrap_of(material, _AI_MATKEY_MAPPINGMODE_V_BASE, aiTextureType_DIFFUSE);
  return found->second;
}

std::shared_ptr<const TexturePicture> AssimpMaterials::picture(const std::string& name) {
  const auto [found, fresh] = pictures_.try_emplace(name);
  if (!fresh) return found->second;
  auto read = read_picture(name);
  if (!read) {
    left_out_.push_back(read.error().detail);
    return nullptr;
  }
  read->name = name;
  return found->second = std::make_shared<const TexturePicture>(std::move(*read));
}

Result<TexturePicture> AssimpMaterials::read_picture(const std::string& name) const {
  const std::string whose = "a material's picture \"" + shown(name) + "\"";
  if (const aiTexture* embedded = scene_.GetEmbeddedTexture(name.c_str())) {
    if (embedded->mHeight != 0)  // which no exporter writes
      return fail(ErrorCode::kInvalid, path_.string(), whose + " is not compressed");
    const auto* bytes = reinterpret_cast<const unsigned char*>(embedded->pcData);
    return gltf::decode_picture({bytes, embedded->mWidth}, path_.string(), whose);
  }
  // Exporters on Windows write its separators.
  std::string relative = name;
  std::ranges::replace(relative, '\\', '/');
  PENUMBRA_ASSIGN(bytes, read_beside(path_, relative, "a material"));
  return gltf::decode_picture(bytes, path_.string(), whose);
}

}  // namespace penumbra::prt
