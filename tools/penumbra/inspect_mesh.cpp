#include "tools/penumbra/inspect_mesh.h"

#include <set>
#include <utility>

#include "prt/geometry/animation.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "runtime/pipeline/report.h"

namespace penumbra::tools {

namespace {

using nlohmann::json;

std::string kind_of(const prt::Material& m) {
  if (m.unlit) return "unlit";
  if (m.transmission > 0) return "transmissive";
  if (m.metallic > 0 && m.metallic_roughness_map) return "metal by a map";
  return m.metallic >= .5f ? "metal" : "dielectric";
}

std::string alpha_of(const prt::Material& m) {
  if (m.alpha == prt::Material::Alpha::kMask) return "mask";
  return m.alpha == prt::Material::Alpha::kBlend ? "blend" : "opaque";
}

std::vector<std::pair<std::string, const prt::Texture*>> maps_of(const prt::Material& m) {
  const std::pair<const char*, const prt::Texture*> all[] = {
      {"base colour", &m.base_colour_map},
      {"metallic-roughness", &m.metallic_roughness_map},
      {"normal", &m.normal_map},
      {"occlusion", &m.occlusion_map},
      {"emission", &m.emission_map}};
  std::vector<std::pair<std::string, const prt::Texture*>> out;
  for (const auto& [name, texture] : all)
    if (*texture) out.emplace_back(name, texture);
  return out;
}

json to_json(const prt::Material& m) {
  json maps = json::array();
  for (const auto& [name, texture] : maps_of(m)) maps.push_back(name);
  return {{"name", m.name},
          {"kind", kind_of(m)},
          {"base_colour", runtime::to_json(m.base_colour)},
          {"metallic", m.metallic},
          {"roughness", m.roughness},
          {"alpha", alpha_of(m)},
          {"emission", runtime::to_json(m.emission)},
          {"maps", maps}};
}

json textures_of(const prt::SurfaceMaterials& surface) {
  json out = json::array();
  std::set<const prt::TexturePicture*> known;
  for (const prt::Material& m : surface.materials)
    for (const auto& [name, texture] : maps_of(m)) {
      const prt::TexturePicture& p = *texture->picture;
      if (!known.insert(&p).second) continue;
      out.push_back({{"name", p.name},
                     {"format", p.mime},
                     {"width", p.codes.width()},
                     {"height", p.codes.height()}});
    }
  return out;
}

}  // namespace

Result<json> inspect_mesh(const std::string& file) {
  constexpr Rgb kGrey{.7f, .7f, .7f};
  PENUMBRA_ASSIGN(imported, prt::import_mesh(file, kGrey));
  const prt::Bounds b = bounds_of(imported.mesh);
  const glm::vec3 size = b.high - b.low;
  json out{{"kind", "mesh"},
           {"vertices", imported.mesh.positions.size()},
           {"triangles", imported.mesh.triangles.size()},
           {"degenerate_triangles", imported.degenerate_triangles},
           {"size_m", {size.x, size.y, size.z}},
           {"low_m", {b.low.x, b.low.y, b.low.z}},
           {"materials", json::array()},
           {"textures", json::array()},
           {"extensions", imported.extensions},
           {"left_out", imported.left_out},
           {"clips", json::array()}};
  if (const float unit = prt::likely_unit_m(imported.mesh); unit < 1)
    out["likely_unit"] = unit < .01f ? "millimetres" : "centimetres";
  if (imported.surface) {
    for (const prt::Material& m : imported.surface->materials)
      out["materials"].push_back(to_json(m));
    out["textures"] = textures_of(*imported.surface);
  }
  // What cannot be read as a character has no clips.
  if (const auto character = prt::import_character(file, kGrey))
    for (const prt::Clip& clip : character->clips)
      out["clips"].push_back({{"name", clip.name}, {"seconds", clip.seconds}});
  return out;
}

}  // namespace penumbra::tools
