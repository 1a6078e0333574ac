#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <tuple>
#include <utility>

#include "prt/bake/internal/baked_surface.h"
#include "prt/bake/internal/model_reader.h"
#include "prt/geometry/gltf/gltf.h"

namespace penumbra::prt {

namespace {

using tinygltf::Value;

Value number_of(float v) {
  return Value(double{v});
}

Value colour_of(const Rgb& c) {
  return Value(Value::Array{number_of(c.r), number_of(c.g), number_of(c.b)});
}

int wrap_code(Texture::Wrap wrap) {
  if (wrap == Texture::Wrap::kClamp) return TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;
  return wrap == Texture::Wrap::kMirror ? TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT
                                        : TINYGLTF_TEXTURE_WRAP_REPEAT;
}

// The parts of a transform that scales, then turns, then moves: the only kind that files hold.
Value transform_of(const glm::mat3x2& m) {
  const float sx = std::hypot(m[0].x, m[0].y);
  const float angle = sx > 0 ? std::atan2(-m[0].y, m[0].x) : std::atan2(m[1].x, m[1].y);
  const float sy = std::sin(angle) * m[1].x + std::cos(angle) * m[1].y;
  return Value(Value::Object{{"offset", Value(Value::Array{number_of(m[2].x), number_of(m[2].y)})},
                             {"rotation", number_of(angle)},
                             {"scale", Value(Value::Array{number_of(sx), number_of(sy)})}});
}

// Materials as tinygltf has them, each picture and sampler once.
class MaterialWriter {
 public:
  explicit MaterialWriter(ModelWriter& writer) : writer_(writer), model_(writer.model()) {}

  void add(const Material& m) {
    tinygltf::Material out;
    out.name = m.name;
    auto& pbr = out.pbrMetallicRoughness;
    pbr.baseColorFactor = {m.base_colour.r, m.base_colour.g, m.base_colour.b, m.opacity};
    pbr.metallicFactor = m.metallic;
    pbr.roughnessFactor = m.roughness;
    set(m.base_colour_map, pbr.baseColorTexture);
    set(m.metallic_roughness_map, pbr.metallicRoughnessTexture);
    set(m.normal_map, out.normalTexture);
    out.normalTexture.scale = m.normal_scale;
    set(m.occlusion_map, out.occlusionTexture);
    out.occlusionTexture.strength = m.occlusion_strength;
    set(m.emission_map, out.emissiveTexture);
    add_emission(m, out);
    if (m.alpha == Material::Alpha::kMask) out.alphaMode = "MASK";
    if (m.alpha == Material::Alpha::kBlend) out.alphaMode = "BLEND";
    out.alphaCutoff = m.alpha_cutoff;
    out.doubleSided = m.double_sided;
    add_extensions(m, out);
    model_.materials.push_back(std::move(out));
  }

 private:
  // Its factor ends at 1: what is brighter is told by its strength.
  void add_emission(const Material& m, tinygltf::Material& out) {
    const float strength = std::max({1.f, m.emission.r, m.emission.g, m.emission.b});
    out.emissiveFactor = {double{m.emission.r} / strength, double{m.emission.g} / strength,
                          double{m.emission.b} / strength};
    if (strength > 1)
      extend(out.extensions, "KHR_materials_emissive_strength",
             {{"emissiveStrength", number_of(strength)}});
  }

  void add_extensions(const Material& m, tinygltf::Material& out) {
    if (m.unlit) extend(out.extensions, "KHR_materials_unlit", {});
    if (m.ior != 1.5f) extend(out.extensions, "KHR_materials_ior", {{"ior", number_of(m.ior)}});
    if (m.specular != 1 || m.specular_colour != Rgb{1, 1, 1})
      extend(out.extensions, "KHR_materials_specular",
             {{"specularFactor", number_of(m.specular)},
              {"specularColorFactor", colour_of(m.specular_colour)}});
    if (m.clearcoat != 0)
      extend(out.extensions, "KHR_materials_clearcoat",
             {{"clearcoatFactor", number_of(m.clearcoat)},
              {"clearcoatRoughnessFactor", number_of(m.clearcoat_roughness)}});
    if (m.transmission != 0)
      extend(out.extensions, "KHR_materials_transmission",
             {{"transmissionFactor", number_of(m.transmission)}});
  }

  void extend(tinygltf::ExtensionMap& extensions, const std::string& name, Value::Object values) {
    extensions[name] = Value(std::move(values));
    if (std::ranges::find(model_.extensionsUsed, name) == model_.extensionsUsed.end())
      model_.extensionsUsed.push_back(name);
  }

  template <class Info>
  void set(const Texture& t, Info& info) {
    if (!t) return;
    info.index = texture_of(t);
    info.texCoord = t.set;
    if (t.transform != glm::mat3x2{1, 0, 0, 1, 0, 0})
      extend(info.extensions, "KHR_texture_transform",
             transform_of(t.transform).template Get<Value::Object>());
  }

  int texture_of(const Texture& t) {
    const auto next = static_cast<int>(model_.textures.size());
    const auto [found, fresh] =
        textures_.try_emplace({t.picture.get(), t.wrap_s, t.wrap_t, t.nearest}, next);
    if (!fresh) return found->second;
    tinygltf::Texture out;
    out.source = image_of(*t.picture);
    if (t.wrap_s != Texture::Wrap::kRepeat || t.wrap_t != Texture::Wrap::kRepeat || t.nearest) {
      tinygltf::Sampler sampler;
      sampler.wrapS = wrap_code(t.wrap_s);
      sampler.wrapT = wrap_code(t.wrap_t);
      if (t.nearest) sampler.magFilter = TINYGLTF_TEXTURE_FILTER_NEAREST;
      out.sampler = static_cast<int>(model_.samplers.size());
      model_.samplers.push_back(sampler);
    }
    model_.textures.push_back(out);
    return next;
  }

  int image_of(const TexturePicture& picture) {
    const auto next = static_cast<int>(model_.images.size());
    const auto [found, fresh] = images_.try_emplace(&picture, next);
    if (!fresh) return found->second;
    tinygltf::Image out;
    out.name = picture.name;
    out.mimeType = picture.mime;
    out.bufferView = writer_.add_view(picture.file.data(), picture.file.size(), 0);
    model_.images.push_back(out);
    return next;
  }

  ModelWriter& writer_;
  tinygltf::Model& model_;
  std::map<const TexturePicture*, int> images_;
  std::map<std::tuple<const TexturePicture*, Texture::Wrap, Texture::Wrap, bool>, int> textures_;
};

// True where a list is absent, or there is one for each vertex.
template <class T>
bool read_optional(const tinygltf::Model& m, const std::string& name, int type,
                   std::size_t vertices, std::vector<T>& out) {
  const auto& p = m.meshes[0].primitives[0];
  if (!p.attributes.contains(name)) return true;
  constexpr std::size_t kFloats = sizeof(T) / sizeof(float);
  return read_attribute(m, p, name, type, out) && out.size() == vertices &&
         finite({reinterpret_cast<const float*>(out.data()), vertices * kFloats});
}

// The vertices' materials from the triangles of the primitives, which follow each other in the
// mesh.
// Nothing where one names no material of the file or a vertex has two.
std::optional<std::vector<std::uint16_t>> materials_of_vertices(const tinygltf::Model& m,
                                                                const Mesh& mesh,
                                                                std::size_t materials) {
  constexpr int kNone = -1;
  std::vector<int> found(mesh.positions.size(), kNone);
  auto triangle = mesh.triangles.begin();
  for (const auto& p : m.meshes[0].primitives) {
    if (p.material < 0 || static_cast<std::size_t>(p.material) >= materials || p.material > 65535)
      return std::nullopt;
    const std::size_t count = m.accessors[static_cast<std::size_t>(p.indices)].count / 3;
    for (std::size_t k = 0; k < count; ++k, ++triangle)
      for (const std::uint32_t i : *triangle) {
        if (found[i] != kNone && found[i] != p.material) return std::nullopt;
        found[i] = p.material;
      }
  }
  std::vector<std::uint16_t> out;
  for (const int material : found) out.push_back(static_cast<std::uint16_t>(std::max(material, 0)));
  return out;
}

}  // namespace

void add_surface(const SurfaceMaterials* surface, ModelWriter& writer,
                 std::map<std::string, int>& attributes) {
  MaterialWriter materials(writer);
  if (!surface) return materials.add(Material{});
  for (const Material& m : surface->materials) materials.add(m);
  for (std::size_t set = 0; set < 2; ++set)
    if (!surface->coordinates[set].empty())
      attributes[set == 0 ? "TEXCOORD_0" : "TEXCOORD_1"] =
          writer.add_vertices(surface->coordinates[set], TINYGLTF_TYPE_VEC2);
  if (!surface->tangents.empty())
    attributes["TANGENT"] = writer.add_vertices(surface->tangents, TINYGLTF_TYPE_VEC4);
  if (!surface->tint.empty())
    attributes["COLOR_0"] = writer.add_vertices(surface->tint, TINYGLTF_TYPE_VEC3);
}

void add_primitives(const Mesh& mesh, const SurfaceMaterials* surface, ModelWriter& writer,
                    const std::map<std::string, int>& attributes) {
  std::map<int, std::vector<std::array<std::uint32_t, 3>>> by_material;
  for (const auto& t : mesh.triangles)
    by_material[surface ? surface->material[t[0]] : 0].push_back(t);
  if (by_material.empty()) by_material[0];
  auto& primitives = writer.model().meshes.emplace_back().primitives;
  for (const auto& [material, triangles] : by_material) {
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    primitive.attributes = attributes;
    primitive.material = material;
    primitive.indices = writer.add(triangles.data(), triangles.size() * 12, triangles.size() * 3,
                                   TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR,
                                   TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER);
    primitives.push_back(std::move(primitive));
  }
}

Result<std::shared_ptr<const SurfaceMaterials>> read_surface(const tinygltf::Model& m,
                                                             std::vector<unsigned char> bytes,
                                                             const std::filesystem::path& path,
                                                             const Mesh& mesh) {
  if (!m.meshes[0].primitives[0].attributes.contains("_ALBEDO")) return nullptr;
  SurfaceMaterials out;
  PENUMBRA_ASSIGN(materials, gltf::read_materials(std::move(bytes), path));
  out.materials = std::move(materials);
  const std::size_t n = mesh.positions.size();
  auto material = materials_of_vertices(m, mesh, out.materials.size());
  if (!material || !read_optional(m, "TEXCOORD_0", TINYGLTF_TYPE_VEC2, n, out.coordinates[0]) ||
      !read_optional(m, "TEXCOORD_1", TINYGLTF_TYPE_VEC2, n, out.coordinates[1]) ||
      !read_optional(m, "TANGENT", TINYGLTF_TYPE_VEC4, n, out.tangents) ||
      !read_optional(m, "COLOR_0", TINYGLTF_TYPE_VEC3, n, out.tint))
    return fail(ErrorCode::kUnreadable, path.string(), "has damaged materials");
  out.material = std::move(*material);
  return std::make_shared<const SurfaceMaterials>(std::move(out));
}

}  // namespace penumbra::prt
