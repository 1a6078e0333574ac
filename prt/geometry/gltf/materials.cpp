#include "prt/geometry/gltf/internal/materials.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string_view>
#include <utility>

#include "prt/geometry/gltf/internal/picture.h"

namespace penumbra::prt::gltf {

namespace {

constexpr float kMaxRadiance = 1e6f;  // brighter emission leaves the range of half floats
constexpr float kAnyOffset = 1e6f;    // of texture coordinates

// Up to four numbers of a list, those that it lacks from `fallback`.
std::array<float, 4> numbers(const Json& of, const char* key, std::array<float, 4> fallback,
                             float low, float high) {
  const Json* list = member(of, key);
  if (!list || !list->is_array()) return fallback;
  for (std::size_t k = 0; k < std::min<std::size_t>(4, list->size()); ++k)
    if (const Json& v = (*list)[k]; v.is_number() && std::isfinite(v.get<double>()))
      fallback[k] = static_cast<float>(std::clamp<double>(v.get<double>(), low, high));
  return fallback;
}

Rgb colour(const Json& of, const char* key, Rgb fallback, float high = 1) {
  const auto n = numbers(of, key, {fallback.r, fallback.g, fallback.b, 1}, 0, high);
  return {n[0], n[1], n[2]};
}

bool flag(const Json& of, const char* key) {
  const Json* found = member(of, key);
  return found && found->is_boolean() && found->get<bool>();
}

Texture::Wrap wrap(std::uint64_t code) {  // OpenGL's numbers
  if (code == 33071) return Texture::Wrap::kClamp;
  return code == 33648 ? Texture::Wrap::kMirror : Texture::Wrap::kRepeat;
}

// KHR_texture_transform: scaled, then turned counter-clockwise as the picture shows it, whose v
// points down, then moved. The matrix in the extension's text turns the other way, its words and
// all its examples this way.
glm::mat3x2 transform_of(const Json& extension) {
  const auto offset = numbers(extension, "offset", {0, 0, 0, 0}, -kAnyOffset, kAnyOffset);
  const auto scale = numbers(extension, "scale", {1, 1, 1, 1}, -kAnyOffset, kAnyOffset);
  const float angle = number(extension, "rotation", 0, -kAnyOffset, kAnyOffset);
  const float c = std::cos(angle), s = std::sin(angle);
  return {c * scale[0], -s * scale[0], s * scale[1], c * scale[1], offset[0], offset[1]};
}

std::string name_of(const Json& json) {
  const Json* name = member(json, "name");
  return name && name->is_string() ? name->get<std::string>() : "";
}

}  // namespace

bool is_plain(const Material& m) {
  const bool maps = m.base_colour_map || m.metallic_roughness_map || m.normal_map ||
                    m.occlusion_map || m.emission_map;
  return !maps && m.metallic == 0 && m.roughness == 1 && m.emission == Rgb{} &&
         m.alpha == Material::Alpha::kOpaque && !m.double_sided && !m.unlit && m.ior == 1.5f &&
         m.specular == 1 && m.specular_colour == Rgb{1, 1, 1} && m.clearcoat == 0 &&
         m.transmission == 0;
}

bool asks_for(const Material& m, int set) {
  const Texture* const maps[] = {&m.base_colour_map, &m.metallic_roughness_map, &m.normal_map,
                                 &m.occlusion_map, &m.emission_map};
  return std::ranges::any_of(maps, [&](const Texture* t) { return *t && t->set == set; });
}

Result<std::uint16_t> Materials::use(std::optional<std::size_t> index) {
  if (!index && fallback_place_) return *fallback_place_;
  if (index)
    if (const auto known = places_.find(*index); known != places_.end()) return known->second;
  if (materials_.size() > std::numeric_limits<std::uint16_t>::max())
    return document_.invalid("has more than 65536 materials");
  const auto place = static_cast<std::uint16_t>(materials_.size());
  if (index) {
    const Json& json = document_.at("materials", *index);
    PENUMBRA_ASSIGN(material, read(json, called("material", *index, json)));
    materials_.push_back(std::move(material));
    places_[*index] = place;
  } else {
    materials_.emplace_back().base_colour = fallback_;
    fallback_place_ = place;
  }
  return place;
}

Result<Material> Materials::read(const Json& json, const std::string& name) {
  Material out;
  out.name = name_of(json);
  PENUMBRA_TRY(read_metallic_roughness(json, name, out));
  if (!member(json, "pbrMetallicRoughness"))
    PENUMBRA_TRY(read_specular_glossiness(json, name, out));
  PENUMBRA_TRY(read_maps(json, name, out));
  if (const Json* mode = member(json, "alphaMode"); mode && mode->is_string()) {
    const auto& text = mode->get_ref<const std::string&>();
    if (text == "MASK") out.alpha = Material::Alpha::kMask;
    if (text == "BLEND") out.alpha = Material::Alpha::kBlend;
  }
  out.alpha_cutoff = number(json, "alphaCutoff", .5f, 0, 2);
  out.double_sided = flag(json, "doubleSided");
  read_extensions(json, name, out);
  return out;
}

Result<void> Materials::read_metallic_roughness(const Json& json, const std::string& name,
                                                Material& out) {
  static const Json kAbsent = Json::object();
  const Json* found = member(json, "pbrMetallicRoughness");
  const Json& pbr = found ? *found : kAbsent;
  const auto base = numbers(pbr, "baseColorFactor", {1, 1, 1, 1}, 0, 1);
  out.base_colour = {base[0], base[1], base[2]};
  out.opacity = base[3];
  out.metallic = number(pbr, "metallicFactor", 1, 0, 1);
  out.roughness = number(pbr, "roughnessFactor", 1, 0, 1);
  PENUMBRA_ASSIGN(base_map, texture(pbr, "baseColorTexture", name));
  PENUMBRA_ASSIGN(metal_map, texture(pbr, "metallicRoughnessTexture", name));
  out.base_colour_map = base_map;
  out.metallic_roughness_map = metal_map;
  return {};
}

// An archived extension that older assets still have: its diffuse part is kept.
Result<void> Materials::read_specular_glossiness(const Json& json, const std::string& name,
                                                 Material& out) {
  const Json* found = extension(json, "KHR_materials_pbrSpecularGlossiness");
  if (!found) return {};
  const auto diffuse = numbers(*found, "diffuseFactor", {1, 1, 1, 1}, 0, 1);
  out.base_colour = {diffuse[0], diffuse[1], diffuse[2]};
  out.opacity = diffuse[3];
  out.metallic = 0;
  out.roughness = 1 - number(*found, "glossinessFactor", 1, 0, 1);
  PENUMBRA_ASSIGN(map, texture(*found, "diffuseTexture", name));
  out.base_colour_map = map;
  document_.leave_out(name +
                      ": specular-glossiness is approximated by its diffuse colour and glossiness");
  return {};
}

Result<void> Materials::read_maps(const Json& json, const std::string& name, Material& out) {
  PENUMBRA_ASSIGN(normal, texture(json, "normalTexture", name));
  PENUMBRA_ASSIGN(occlusion, texture(json, "occlusionTexture", name));
  PENUMBRA_ASSIGN(emission, texture(json, "emissiveTexture", name));
  out.normal_map = normal;
  if (normal) out.normal_scale = number(*member(json, "normalTexture"), "scale", 1, -100, 100);
  out.occlusion_map = occlusion;
  if (occlusion)
    out.occlusion_strength = number(*member(json, "occlusionTexture"), "strength", 1, 0, 1);
  out.emission_map = emission;
  out.emission = colour(json, "emissiveFactor", {0, 0, 0});
  return {};
}

void Materials::read_extensions(const Json& json, const std::string& name, Material& out) {
  if (const Json* e = extension(json, "KHR_materials_emissive_strength"))
    out.emission = out.emission * number(*e, "emissiveStrength", 1, 0, kMaxRadiance);
  out.unlit = extension(json, "KHR_materials_unlit") != nullptr;
  if (const Json* e = extension(json, "KHR_materials_ior")) {
    const float ior = number(*e, "ior", 1.5f, 0, 10);
    out.ior = ior == 0 ? 0 : std::max(ior, 1.f);  // 0 asks for no Fresnel fall-off
  }
  if (const Json* e = extension(json, "KHR_materials_specular")) {
    out.specular = number(*e, "specularFactor", 1, 0, 1);
    out.specular_colour = colour(*e, "specularColorFactor", {1, 1, 1}, 100);
    leave_out_maps(*e, name);
  }
  if (const Json* e = extension(json, "KHR_materials_clearcoat")) {
    out.clearcoat = number(*e, "clearcoatFactor", 0, 0, 1);
    out.clearcoat_roughness = number(*e, "clearcoatRoughnessFactor", 0, 0, 1);
    leave_out_maps(*e, name);
  }
  if (const Json* e = extension(json, "KHR_materials_transmission")) {
    out.transmission = number(*e, "transmissionFactor", 0, 0, 1);
    leave_out_maps(*e, name);
    if (out.transmission > 0)
      document_.leave_out(name + ": transmission is approximated, without refraction");
  }
}

void Materials::leave_out_maps(const Json& of, const std::string& name) {
  for (const auto& [key, value] : of.items())
    if (key.ends_with("Texture"))
      document_.leave_out(fmt::format("{}: its {} is left out", name, key));
}

Result<Texture> Materials::texture(const Json& of, const char* key, const std::string& name) {
  const Json* info = member(of, key);
  if (!info) return Texture{};
  const std::string whose = fmt::format("{}: its {}", name, key);
  PENUMBRA_ASSIGN(index, document_.reference(*info, "index", "textures", whose));
  if (!index) return document_.invalid(whose + " names no texture");
  const Json& json = document_.at("textures", *index);
  PENUMBRA_ASSIGN(image, document_.reference(json, "source", "images", whose));
  if (!image) {
    for (const char* other : {"KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif"})
      if (extension(json, other))
        return document_.invalid(
            fmt::format("{} has its picture by {} alone: save it as PNG or JPEG", whose, other));
    return document_.invalid(whose + " has no picture");
  }
  Texture out;
  const Json* transform = extension(*info, "KHR_texture_transform");
  if (transform) out.transform = transform_of(*transform);
  auto set = whole(*info, "texCoord", 0);
  if (transform && set) set = whole(*transform, "texCoord", *set);
  if (!set || *set > 1) {
    document_.leave_out(whose + " is left out: it asks for a third set of texture coordinates");
    return Texture{};
  }
  out.set = static_cast<int>(*set);
  PENUMBRA_ASSIGN(sampler, document_.reference(json, "sampler", "samplers", whose));
  if (sampler) {
    const Json& s = document_.at("samplers", *sampler);
    out.wrap_s = wrap(whole(s, "wrapS", 10497).value_or(10497));
    out.wrap_t = wrap(whole(s, "wrapT", 10497).value_or(10497));
    out.nearest = whole(s, "magFilter", 9729).value_or(9729) == 9728;
  }
  PENUMBRA_ASSIGN(pixels, picture(*image));
  out.picture = pixels;
  return out;
}

Result<std::shared_ptr<const TexturePicture>> Materials::picture(std::size_t image) {
  if (const auto known = pictures_.find(image); known != pictures_.end()) return known->second;
  const Json& json = document_.at("images", image);
  const std::string whose = called("image", image, json);
  std::string name = name_of(json);
  std::vector<unsigned char> held;
  Bytes bytes;
  if (const Json* uri = member(json, "uri"); uri && uri->is_string()) {
    const auto& text = uri->get_ref<const std::string&>();
    PENUMBRA_ASSIGN(read, document_.resource(text, whose));
    held = std::move(read);
    bytes = held;
    if (name.empty() && !text.starts_with("data:")) name = text;
  } else {
    PENUMBRA_ASSIGN(view, document_.reference(json, "bufferView", "bufferViews", whose));
    if (!view) return document_.invalid(whose + " has neither a URI nor a buffer view");
    PENUMBRA_ASSIGN(read, document_.view(*view));
    bytes = read.bytes;
  }
  PENUMBRA_ASSIGN(decoded, decode_picture(bytes, document_.file(), whose));
  decoded.name = std::move(name);
  return pictures_[image] = std::make_shared<const TexturePicture>(std::move(decoded));
}

}  // namespace penumbra::prt::gltf
