// Pictures of base colours in files that Assimp reads.
// threads: one thread at a time
#pragma once

#include <assimp/scene.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/material.h"

namespace penumbra::prt {

class AssimpMaterials {
 public:
  /// `fallback`: the albedo of what has no material.
  AssimpMaterials(const aiScene& scene, std::filesystem::path path, Rgb fallback)
      : scene_(scene), path_(std::move(path)), fallback_(fallback) {}

  /// The place in all() of a mesh's material: an albedo, and its picture where it can be read.
  std::uint16_t use(const aiMesh& mesh);
  const std::vector<Material>& all() const { return materials_; }
  std::vector<Material> take() && { return std::move(materials_); }
  /// Pictures that are not read, a line each.
  const std::vector<std::string>& left_out() const { return left_out_; }

 private:
  std::shared_ptr<const TexturePicture> picture(const std::string& name);
  Result<TexturePicture> read_picture(const std::string& name) const;

  const aiScene& scene_;
  std::filesystem::path path_;
  Rgb fallback_;
  std::vector<Material> materials_;
  std::map<unsigned, std::uint16_t> places_;  // of the file's materials
  std::map<std::string, std::shared_ptr<const TexturePicture>> pictures_;
  std::vector<std::string> left_out_;
};

}  // namespace penumbra::prt
