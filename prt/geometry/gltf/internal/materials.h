// Materials of a glTF file, each read once when something asks for it.
// threads: as Document
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/geometry/gltf/internal/document.h"
#include "prt/geometry/material.h"

namespace penumbra::prt::gltf {

class Materials {
 public:
  /// `fallback`: the albedo of what has no material.
  Materials(Document& document, Rgb fallback) : document_(document), fallback_(fallback) {}

  /// The place in all() of a material of the file; of the fallback's without an index.
  /// errors: kInvalid (a texture that is not there), kNotFound, kUnreadable (its picture)
  Result<std::uint16_t> use(std::optional<std::size_t> index);
  const std::vector<Material>& all() const { return materials_; }
  std::vector<Material> take() && { return std::move(materials_); }

 private:
  Result<Material> read(const Json& json, const std::string& name);
  Result<void> read_metallic_roughness(const Json& json, const std::string& name, Material& out);
  Result<void> read_specular_glossiness(const Json& json, const std::string& name, Material& out);
  Result<void> read_maps(const Json& json, const std::string& name, Material& out);
  void read_extensions(const Json& json, const std::string& name, Material& out);
  void leave_out_maps(const Json& extension, const std::string& name);
  /// What `of[key]` names; an empty texture where it is absent.
  Result<Texture> texture(const Json& of, const char* key, const std::string& name);
  Result<std::shared_ptr<const TexturePicture>> picture(std::size_t image);

  Document& document_;
  Rgb fallback_;
  std::vector<Material> materials_;
  std::map<std::size_t, std::uint16_t> places_;  // of the file's materials
  std::optional<std::uint16_t> fallback_place_;
  std::map<std::size_t, std::shared_ptr<const TexturePicture>> pictures_;
};

/// Whether a material says no more than an albedo, as files of other formats do.
bool is_plain(const Material& material);

/// Whether one of its pictures lies in this set of texture coordinates.
bool asks_for(const Material& material, int set);

}  // namespace penumbra::prt::gltf
