#include "prt/geometry/local_material.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace penumbra::prt {

namespace {

// The texel that stands for one beside the picture.
int wrapped_texel(int i, int size, Texture::Wrap wrap) {
  if (wrap == Texture::Wrap::kClamp) return std::clamp(i, 0, size - 1);
  const int turns = i >= 0 ? i / size : (i + 1) / size - 1, inside = i - turns * size;
  return wrap == Texture::Wrap::kMirror && turns % 2 != 0 ? size - 1 - inside : inside;
}

glm::vec4 texel(const Texture& t, int x, int y, bool srgb) {
  const Image<Rgba8>& codes = t.picture->codes;
  const Rgba8 c = codes.at(wrapped_texel(x, codes.width(), t.wrap_s),
                           wrapped_texel(y, codes.height(), t.wrap_t));
  constexpr float kUnit = 1.f / 255;
  const float alpha = kUnit * static_cast<float>(c.a);
  if (!srgb)
    return {kUnit * static_cast<float>(c.r), kUnit * static_cast<float>(c.g),
            kUnit * static_cast<float>(c.b), alpha};
  const auto& linear = linear_of_srgb();
  return {linear[c.r], linear[c.g], linear[c.b], alpha};
}

// Values of a triangle's corners at a place of it.
class TriangleValues {
 public:
  TriangleValues(const SurfaceMaterials& surface, const TrianglePlace& place)
      : surface_(surface), place_(place), first_weight_(1 - place.u - place.v) {}

  template <class Value>
  Value mix(const std::vector<Value>& values) const {
    const auto& [a, b, c] = place_.corners;
    return first_weight_ * values[a] + place_.u * values[b] + place_.v * values[c];
  }
  glm::vec4 picture(const Texture& texture, bool srgb) const {
    if (!texture) return glm::vec4(1);
    // Where only the first set is there, it stands for both.
    const auto& second = surface_.coordinates[1];
    const auto& set = texture.set == 1 && !second.empty() ? second : surface_.coordinates[0];
    return sample(texture, set.empty() ? glm::vec2(0) : mix(set), srgb);
  }

 private:
  const SurfaceMaterials& surface_;
  const TrianglePlace& place_;
  float first_weight_;
};

glm::vec3 leaning_normal(const Material& m, const SurfaceMaterials& surface,
                         const TriangleValues& corners, const glm::vec3& plain) {
  if (!m.normal_map || surface.tangents.empty()) return plain;
  glm::vec3 lean = 2.f * glm::vec3(corners.picture(m.normal_map, false)) - 1.f;
  lean.x *= m.normal_scale, lean.y *= m.normal_scale;
  const glm::vec4 along = corners.mix(surface.tangents);
  const float length = glm::length(glm::vec3(along));
  if (!(length > 1e-6f)) return plain;
  const glm::vec3 x = glm::vec3(along) / length, y = glm::cross(plain, x) * along.w;
  const glm::vec3 out = lean.x * x + lean.y * y + lean.z * plain;
  return glm::dot(out, out) > 1e-12f ? glm::normalize(out) : plain;
}

}  // namespace

glm::vec4 sample(const Texture& texture, const glm::vec2& coordinates, bool srgb) {
  if (!texture) return glm::vec4(1);
  constexpr float kFarthest = 1e6f;  // texels, which an int holds
  const Image<Rgba8>& codes = texture.picture->codes;
  const glm::vec2 size(codes.width(), codes.height());
  glm::vec2 p = texture.transform * glm::vec3(coordinates, 1) * size;
  for (int i = 0; i < 2; ++i)
    p[i] = std::isfinite(p[i]) ? std::clamp(p[i], -kFarthest, kFarthest) : 0;
  if (texture.nearest)
    return texel(texture, static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
                 srgb);
  p -= .5f;
  const glm::vec2 low = glm::floor(p), f = p - low;
  const int x = static_cast<int>(low.x), y = static_cast<int>(low.y);
  return (1 - f.y) *
             ((1 - f.x) * texel(texture, x, y, srgb) + f.x * texel(texture, x + 1, y, srgb)) +
         f.y * ((1 - f.x) * texel(texture, x, y + 1, srgb) +
                f.x * texel(texture, x + 1, y + 1, srgb));
}

LocalMaterial local_material(const Mesh& mesh, const SurfaceMaterials& surface,
                             const TrianglePlace& place) {
  const Material& m = surface.materials[surface.material[place.corners[0]]];
  const TriangleValues corners(surface, place);
  LocalMaterial out;
  const glm::vec4 map = corners.picture(m.base_colour_map, true);
  Rgb base = m.base_colour * Rgb{map.x, map.y, map.z};
  if (!surface.tint.empty()) base = base * corners.mix(surface.tint);
  if (m.alpha == Material::Alpha::kBlend) out.opacity = std::clamp(m.opacity * map.w, 0.f, 1.f);
  if (m.alpha == Material::Alpha::kMask) out.opacity = m.opacity * map.w < m.alpha_cutoff ? 0 : 1;
  const float side = place.front ? 1.f : -1.f;
  const glm::vec3 plain = glm::normalize(corners.mix(mesh.normals));
  out.plain = side * plain;
  out.unlit = m.unlit;
  if (m.unlit) {
    out.normal = out.plain;
    out.emission = base;
    return out;
  }
  const glm::vec4 rough_metal = corners.picture(m.metallic_roughness_map, false);
  const float metal = std::clamp(m.metallic * rough_metal.z, 0.f, 1.f);
  out.roughness = std::clamp(m.roughness * rough_metal.y, 0.f, 1.f);
  out.normal = side * leaning_normal(m, surface, corners, plain);
  const float ratio = (m.ior - 1) / (m.ior + 1);
  for (int c = 0; c < 3; ++c) {
    const float own = std::min(m.specular_colour[c] * ratio * ratio, 1.f) * m.specular;
    out.reflectance[c] = own + metal * (base[c] - own);
  }
  out.grazing_reflectance = m.specular + metal * (1 - m.specular);
  out.transmitted = std::clamp(m.transmission, 0.f, 1.f) * (1 - metal);
  out.diffuse = base * ((1 - metal) * (1 - std::clamp(m.transmission, 0.f, 1.f)));
  out.clearcoat = std::clamp(m.clearcoat, 0.f, 1.f);
  out.clearcoat_roughness = std::clamp(m.clearcoat_roughness, 0.f, 1.f);
  const glm::vec4 glow = corners.picture(m.emission_map, true);
  out.emission = m.emission * Rgb{glow.x, glow.y, glow.z};
  return out;
}

bool is_see_through(const Material& m) {
  return m.alpha != Material::Alpha::kOpaque || m.transmission > 0;
}

bool has_backs(const Material& m) {
  return m.double_sided || (m.alpha != Material::Alpha::kBlend && m.transmission <= 0);
}

Result<void> check_surface(const Mesh& mesh, const SurfaceMaterials& s) {
  const std::size_t count = mesh.positions.size();
  const auto fits = [&](const auto& values) { return values.empty() || values.size() == count; };
  if (s.material.size() != count || !fits(s.coordinates[0]) || !fits(s.coordinates[1]) ||
      !fits(s.tint) || !fits(s.tangents))
    return fail(ErrorCode::kInvalid, "surface", "has not one entry for each vertex of the mesh");
  for (const std::uint16_t m : s.material)
    if (m >= s.materials.size())
      return fail(ErrorCode::kInvalid, "surface",
                  fmt::format("names material {} of {}", m, s.materials.size()));
  for (const Material& m : s.materials)
    for (const Texture* t :
         {&m.base_colour_map, &m.metallic_roughness_map, &m.normal_map, &m.emission_map})
      if (*t && t->picture->codes.empty())
        return fail(ErrorCode::kInvalid, "material " + m.name, "has a picture without pixels");
  return {};
}

}  // namespace penumbra::prt
