// What a surface is made of, as glTF 2.0 says it: colours, metal, roughness, pictures of them.
// threads: plain values; pictures are shared and never changed
#pragma once

#include <array>
#include <cstdint>
#include <glm/mat3x2.hpp>
#include <glm/vec2.hpp>
#include <glm/vec4.hpp>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Rgba8 {
  std::uint8_t r = 0, g = 0, b = 0, a = 255;
  friend bool operator==(const Rgba8&, const Rgba8&) = default;
};

/// A picture of an asset, once for all that sample it.
struct TexturePicture {
  std::string name;                // as the asset calls it, or its file
  std::string mime;                // of `encoded`: image/png or image/jpeg
  std::vector<std::uint8_t> file;  // as it stood in the asset, for files that carry it on
  Image<Rgba8> codes;              // first row above
};

/// How a material samples a picture.
struct Texture {
  enum class Wrap : std::uint8_t { kRepeat, kMirror, kClamp };

  std::shared_ptr<const TexturePicture> picture{};  // null: no picture, which counts as white
  Wrap wrap_s = Wrap::kRepeat, wrap_t = Wrap::kRepeat;
  bool nearest = false;  // magnified without interpolation
  int set = 0;           // of texture coordinates, 0 or 1
  // Place in the picture = transform * (u, v, 1); (0, 0) is its upper left corner
  glm::mat3x2 transform{1, 0, 0, 1, 0, 0};

  explicit operator bool() const { return picture != nullptr; }
};

/// glTF 2.0's metallic-roughness model and the extensions named below. Colours are linear,
/// Rec. 709.
struct Material {
  enum class Alpha : std::uint8_t { kOpaque, kMask, kBlend };

  std::string name{};
  Rgb base_colour{1, 1, 1};          // 0..1: diffuse albedo, or the reflectance of metal at normal
  float opacity = 1;                 // 0..1
  Texture base_colour_map{};         // sRGB codes; its alpha times `opacity`
  float metallic = 0;                // 0..1
  float roughness = 1;               // 0..1, squared the GGX width
  Texture metallic_roughness_map{};  // linear codes: green roughness, blue metallic
  Texture normal_map{};              // linear codes, tangent space, y up
  float normal_scale = 1;
  Texture occlusion_map{};  // linear codes: red
  float occlusion_strength = 1;
  Rgb emission{0, 0, 0};   // radiance in the scene's unit where white paper in the light sends 1
  Texture emission_map{};  // sRGB codes
  Alpha alpha = Alpha::kOpaque;
  float alpha_cutoff = .5f;
  bool double_sided = false;
  bool unlit = false;             // KHR_materials_unlit: base colour is what it sends
  float ior = 1.5f;               // KHR_materials_ior
  float specular = 1;             // KHR_materials_specular
  Rgb specular_colour{1, 1, 1};   // "
  float clearcoat = 0;            // KHR_materials_clearcoat
  float clearcoat_roughness = 0;  // "
  float transmission = 0;         // KHR_materials_transmission; drawn as a stated approximation
};

/// The texel of a picture of `size` that a place along an axis lies in; a place that is not finite
/// counts as 0.
int texel_at(float place, int size, Texture::Wrap wrap);

/// Linear values of sRGB's codes.
const std::array<float, 256>& linear_of_srgb();

/// What a mesh's vertices have beyond place, normal and albedo. Each vertex is of one material, and
/// so are the three of a triangle.
struct SurfaceMaterials {
  std::vector<Material> materials;
  std::vector<std::uint16_t> material;                // of each vertex
  std::array<std::vector<glm::vec2>, 2> coordinates;  // v down; empty where no material asks
  std::vector<Rgb> tint;  // vertex colours, times the base colour; empty without any
  // Unit, in the mesh's frame, w the sign of the bitangent; empty without normal maps
  std::vector<glm::vec4> tangents;

  /// For vertices that prt::subdivide adds: each lies in the middle of two earlier ones.
  void extend(std::span<const std::array<std::uint32_t, 2>> middles);
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
