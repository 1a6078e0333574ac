#include "compositor/layers/glossy.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <glm/mat4x4.hpp>
#include <numeric>
#include <string>
#include <string_view>

#include "compositor/layers/foreground_textures.h"
#include "compositor/layers/light_pieces.h"
#include "core/conventions.h"
#include "lighting/reflections/ggx.h"
#include "lighting/reflections/octahedral_map.h"

namespace penumbra::compositor {

namespace {

using lighting::ReflectionMap;

// Units 0 to 2 are those of other programs' pictures and of a lens.
constexpr int kFirstUnit = 3, kMaps = 5, kSurroundingsUnit = kFirstUnit + kMaps,
              kReflectedUnit = kSurroundingsUnit + 1, kFloorUnit = kReflectedUnit + 1,
              kMirroredUnit = kFloorUnit + 1, kPastObjectsUnit = kMirroredUnit + 1;
static_assert(kPastObjectsUnit < ForegroundTextures::kCoverUnit);

// What stays with a vertex, and what turns with the form.
struct VertexAttributes {
  glm::vec4 tangent, coordinates;
  glm::vec3 tint;
};
struct VertexDirections {
  glm::vec3 normal;
  glm::vec4 openness;
};

// Of the buffer that is bound, element by element.
template <class Element>
void glossy_attribute(GLuint location, int components, std::size_t offset) {
  glEnableVertexAttribArray(location);
  glVertexAttribPointer(location, components, GL_FLOAT, GL_FALSE, sizeof(Element),
                        reinterpret_cast<const void*>(offset));
}

std::vector<VertexAttributes> attributes_of(const prt::SurfaceMaterials& s, std::size_t count) {
  std::vector<VertexAttributes> out(count);
  for (std::size_t i = 0; i < count; ++i) {
    const glm::vec2 a = i < s.coordinates[0].size() ? s.coordinates[0][i] : glm::vec2(0),
                    b = i < s.coordinates[1].size() ? s.coordinates[1][i] : a;
    const Rgb tint = i < s.tint.size() ? s.tint[i] : Rgb{1, 1, 1};
    out[i] = {i < s.tangents.size() ? s.tangents[i] : glm::vec4(1, 0, 0, 1), glm::vec4(a, b),
              glm::vec3(tint.r, tint.g, tint.b)};
  }
  return out;
}

GLsizeiptr byte_count(const auto& v) {
  return static_cast<GLsizeiptr>(v.size() * sizeof(v[0]));
}

// Two bands of transfer of an open point from directions below the horizon, as (Y_0; along the
// normal's horizontal part, up), by the height of the normal. By sums over directions.
std::array<glm::vec3, 65> make_from_below() {
  constexpr int kSteps = 64;
  std::array<glm::vec3, 65> out{};
  for (std::size_t k = 0; k < out.size(); ++k) {
    const double up = static_cast<double>(k) / 32 - 1;
    const glm::dvec3 n(std::sqrt(std::max(0., 1 - up * up)), up, 0);
    glm::dvec3 sum(0);
    for (int i = 0; i < kSteps; ++i)
      for (int j = 0; j < 2 * kSteps; ++j) {
        const double y = -(i + .5) / kSteps, phi = kPi * (j + .5) / kSteps,
                     r = std::sqrt(1 - y * y);
        const glm::dvec3 d(r * std::cos(phi), y, r * std::sin(phi));
        sum += std::max(glm::dot(n, d), 0.) * glm::dvec3(1, d.x, d.y);
      }
    const double each = 2 * kPi / (2. * kSteps * kSteps) / kPi;
    out[k] = glm::vec3(sum * each * glm::dvec3(.282095, .488603, .488603));
  }
  return out;
}

glm::vec4 from_below(const glm::vec3& n) {
  static const std::array<glm::vec3, 65> table = make_from_below();
  const float at = 32 * (std::clamp(n.y, -1.f, 1.f) + 1);
  const auto k = std::min(static_cast<std::size_t>(at), table.size() - 2);
  const glm::vec3 one = glm::mix(table[k], table[k + 1], at - static_cast<float>(k));
  const float across = std::hypot(n.x, n.z), to_unit = across > 0 ? 1 / across : 0;
  return {one.x, one.y * n.x * to_unit, one.z, one.y * n.z * to_unit};
}

// Two bands of transfer of an open point, as (Y_0; x, y, z of Y_1): A_l Y / pi.
glm::vec4 open_point(const glm::vec3& n) {
  return {.282095f, .325735f * n};
}

// The same of what lets light in at a vertex: its transfer without what came by reflection, and
// what the floor takes, which a mirror shows.
std::vector<glm::vec4> openness_of(const prt::BakedObject& baked) {
  const prt::Transfer &all = baked.transfer, &reflected = baked.reflected;
  const auto holds = [](const prt::Transfer& t, std::size_t i) {
    return i < t.points && !t.values.empty() && t.bands >= 2;
  };
  std::vector<glm::vec4> out(baked.mesh.positions.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const glm::vec3 n = baked.mesh.normals[i];
    out[i] = open_point(n);
    if (!holds(all, i)) continue;
    const auto direct = [&](int k) {
      return all.value(0, k, i) - (holds(reflected, i) ? reflected.value(0, k, i) : 0);
    };
    out[i] = {direct(0), direct(3), direct(1), direct(2)};  // Y_1 goes y, z, x
    if (baked.receiver) out[i] += from_below(n);
  }
  return out;
}

// Harmonics of irradiance over pi, times the constants of the basis (core/conventions.h).
std::array<glm::vec3, 9> irradiance_polynomial(const RadianceSh& light) {
  constexpr float kBasis[] = {.282095f,  .488603f, .488603f,  .488603f, 1.092548f,
                              1.092548f, .315392f, 1.092548f, .546274f};
  constexpr float kCosine[] = {1, 2.f / 3, .25f};
  std::array<glm::vec3, 9> out{};
  for (int n = 0; n < std::min(9, light.size()); ++n) {
    const float k = kBasis[n] * kCosine[n == 0 ? 0 : n < 4 ? 1 : 2];
    out[static_cast<std::size_t>(n)] = k * glm::vec3(light[n].r, light[n].g, light[n].b);
  }
  return out;
}

GLenum wrap_of(prt::Texture::Wrap wrap) {
  switch (wrap) {
    case prt::Texture::Wrap::kRepeat:
      return GL_REPEAT;
    case prt::Texture::Wrap::kMirror:
      return GL_MIRRORED_REPEAT;
    case prt::Texture::Wrap::kClamp:
      break;
  }
  return GL_CLAMP_TO_EDGE;
}

// Most assets keep both in one, and a second look at it costs as much as the first.
bool is_one_picture(const prt::Texture& a, const prt::Texture& b) {
  return a && a.picture == b.picture && a.set == b.set && a.transform == b.transform &&
         a.wrap_s == b.wrap_s && a.wrap_t == b.wrap_t && a.nearest == b.nearest;
}

// A mean of two levels would be seen where the roughness is a hundredth of a step off one.
bool is_between_levels(float place) {
  return std::abs(place - std::round(place)) > .01f;
}

// The picture with a texel more on each side, so that it is read across its folds.
Image<Rgb> with_border(const Image<Rgb>& picture) {
  const int size = picture.width();
  Image<Rgb> out(size + 2, size + 2);
  for (int y = 0; y < size + 2; ++y) {
    const bool inside = y > 0 && y <= size;
    if (inside) std::ranges::copy(picture.row(y - 1), out.row(y).begin() + 1);
    for (int x = 0; x < size + 2; x += inside ? size + 1 : 1) {
      const glm::ivec2 from = lighting::octahedral_texel(x - 1, y - 1, size);
      out.at(x, y) = picture.at(from.x, from.y);
    }
  }
  return out;
}

GLint uniform(GLuint program, const char* name) {
  return glGetUniformLocation(program, name);
}
void set(GLuint program, const char* name, float v) {
  glUniform1f(uniform(program, name), v);
}
void set(GLuint program, const char* name, const Rgb& c) {
  glUniform3f(uniform(program, name), c.r, c.g, c.b);
}

}  // namespace

bool GlossyObject::is_blended(const Part& part) const {
  const prt::Material& m = surface->materials[part.material];
  return m.alpha != prt::Material::Alpha::kOpaque || m.transmission > 0;
}

bool GlossyObject::any(bool blended) const {
  return std::ranges::any_of(parts, [&](const Part& p) { return is_blended(p) == blended; });
}

std::vector<GlossyObject::Part> GlossyObject::parts_of(std::span<const Triangle> triangles) const {
  const auto material_of = [&](const Triangle& t) {
    return static_cast<std::size_t>(surface->material[t[0]]);
  };
  std::vector<Part> out;
  for (std::size_t i = 0; i < triangles.size();) {
    const std::size_t first = i;
    while (i < triangles.size() && material_of(triangles[i]) == material_of(triangles[first])) ++i;
    out.push_back({material_of(triangles[first]), static_cast<GLsizei>(3 * first),
                   static_cast<GLsizei>(3 * (i - first))});
  }
  return out;
}

GlossyFeatures Glossy::features_of(const GlossyObject& o, const GlossyObject::Part& part) const {
  const prt::Material& m = o.surface->materials[part.material];
  using enum GlossyFeatures::Feature;
  GlossyFeatures out;
  out.add(kBaseColourMap, bool(m.base_colour_map));
  out.add(kMask, m.alpha == prt::Material::Alpha::kMask);
  out.add(kBlend, o.is_blended(part));
  out.add(kAlpha, m.alpha == prt::Material::Alpha::kBlend);
  out.add(kDoubleSided, m.double_sided);
  out.add(kUnlit, m.unlit);
  if (m.unlit) return out;
  out.add(kMetallicRoughnessMap, bool(m.metallic_roughness_map));
  out.add(kNormalMap, bool(m.normal_map));
  out.add(kOcclusionMap, bool(m.occlusion_map));
  out.add(kOcclusionInRoughness, is_one_picture(m.metallic_roughness_map, m.occlusion_map));
  out.add(kEmissionMap, bool(m.emission_map));
  out.add(kClearcoat, m.clearcoat > 0);
  out.add(kLights, !surroundings_.lights.empty());
  if (shown_ && shown_->levels.size() > 1)
    out.add(kBetweenLevels,
            m.metallic_roughness_map || is_between_levels(shown_->place_of(m.roughness)) ||
                is_between_levels(shown_->place_of(m.clearcoat_roughness)) ||
                (lighting::has_long_lobe(m.roughness) &&
                 is_between_levels(shown_->place_of(lighting::kNarrowLobe * m.roughness))));
  out.add(kLongLobe, lighting::has_long_lobe(m.roughness));
  out.add(kFloor, !o.floor_codes.empty());
  out.add(kObjects, o.mirrored_size.x > 0 && mirrors_objects(m));
  return out;
}

Glossy::Glossy() {
  const auto* const renderer = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  in_software_ = renderer && std::string_view(renderer).find("pipe") != std::string_view::npos;
  const std::uint8_t white[4] = {255, 255, 255, 255};
  glBindTexture(GL_TEXTURE_2D, white_.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA8, 1, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, white);
  const Image<glm::vec2>& table = lighting::reflected_of_even_table();
  glBindTexture(GL_TEXTURE_2D, reflected_.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RG16F, table.width(), table.height());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, table.width(), table.height(), GL_RG, GL_FLOAT,
                  table.pixels().data());
  read_to_the_rim();
  lay_out_levels({});
}

void Glossy::upload(const prt::Texture& texture, bool srgb) {
  if (!texture) return;
  const auto [held, fresh] = pictures_.try_emplace({texture.picture.get(), srgb});
  if (!fresh) return;
  held->second.picture = texture.picture;
  const Image<prt::Rgba8>& codes = texture.picture->codes;
  glBindTexture(GL_TEXTURE_2D, held->second.texture.get());
  glTexStorage2D(GL_TEXTURE_2D, mip_levels(codes.width(), codes.height()),
                 srgb ? GL_SRGB8_ALPHA8 : GL_RGBA8, codes.width(), codes.height());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, codes.width(), codes.height(), GL_RGBA, GL_UNSIGNED_BYTE,
                  codes.pixels().data());
  glGenerateMipmap(GL_TEXTURE_2D);
}

GLuint Glossy::sampler_of(const prt::Texture& texture) {
  const auto key = static_cast<std::uint32_t>(texture.wrap_s) +
                   4 * static_cast<std::uint32_t>(texture.wrap_t) + (texture.nearest ? 16u : 0u);
  const auto [sampler, fresh] = samplers_.try_emplace(key);
  if (fresh) {
    const GLuint name = sampler->second.get();
    const auto parameter = [&](GLenum what, GLenum value) {
      glSamplerParameteri(name, what, static_cast<GLint>(value));
    };
    parameter(GL_TEXTURE_WRAP_S, wrap_of(texture.wrap_s));
    parameter(GL_TEXTURE_WRAP_T, wrap_of(texture.wrap_t));
    parameter(GL_TEXTURE_MAG_FILTER, texture.nearest ? GL_NEAREST : GL_LINEAR);
    // Without a GPU two levels take twice the time of one.
    parameter(GL_TEXTURE_MIN_FILTER,
              in_software_ ? GL_LINEAR_MIPMAP_NEAREST : GL_LINEAR_MIPMAP_LINEAR);
  }
  return sampler->second.get();
}

GlossyObject Glossy::add(const prt::BakedObject& baked, const prt::Mesh& drawn,
                         const DrawnVertices& vertices,
                         std::vector<GlossyObject::Triangle>& triangles) {
  GlossyObject o;
  o.own_vertices = baked.mesh.positions.size();
  if (baked.receiver) o.floor_grid = baked.receiver->grid;
  auto surface = std::make_shared<prt::SurfaceMaterials>(vertices.fine() ? *vertices.fine()->surface
                                                                         : *baked.surface);
  surface->extend(vertices.middles());
  o.surface = std::move(surface);
  std::vector<glm::vec4> openness = openness_of(baked);
  vertices.spread(openness);
  const auto material_of = [&](const GlossyObject::Triangle& t) {
    return static_cast<std::size_t>(o.surface->material[t[0]]);
  };
  std::ranges::stable_sort(triangles, {}, material_of);
  o.parts = o.parts_of(triangles);
  for (const GlossyObject::Part& part : o.parts) {
    const prt::Material& m = o.surface->materials[part.material];
    o.shows_backs |= m.double_sided || m.alpha != prt::Material::Alpha::kOpaque;
    upload(m.base_colour_map, true);
    upload(m.emission_map, true);
    for (const prt::Texture* map : {&m.metallic_roughness_map, &m.normal_map, &m.occlusion_map})
      upload(*map, false);
  }
  const std::vector<VertexAttributes> attributes =
      attributes_of(*o.surface, drawn.positions.size());
  glBindBuffer(GL_ARRAY_BUFFER, o.attributes.get());
  glBufferData(GL_ARRAY_BUFFER, byte_count(attributes), attributes.data(), GL_STATIC_DRAW);
  glossy_attribute<VertexAttributes>(5, 4, offsetof(VertexAttributes, tangent));
  glossy_attribute<VertexAttributes>(6, 4, offsetof(VertexAttributes, coordinates));
  glossy_attribute<VertexAttributes>(7, 3, offsetof(VertexAttributes, tint));
  std::vector<VertexDirections> directions;
  for (std::size_t i = 0; i < drawn.normals.size(); ++i)
    directions.push_back({drawn.normals[i], openness[i]});
  glBindBuffer(GL_ARRAY_BUFFER, o.directions.get());
  glBufferData(GL_ARRAY_BUFFER, byte_count(directions), directions.data(), GL_DYNAMIC_DRAW);
  glossy_attribute<VertexDirections>(4, 3, offsetof(VertexDirections, normal));
  glossy_attribute<VertexDirections>(9, 4, offsetof(VertexDirections, openness));
  glBindBuffer(GL_ARRAY_BUFFER, o.fractions.get());
  const std::vector<std::uint8_t> open(4 * drawn.positions.size(), 255);
  glBufferData(GL_ARRAY_BUFFER, byte_count(open), open.data(), GL_DYNAMIC_DRAW);
  glEnableVertexAttribArray(8);
  glVertexAttribPointer(8, 4, GL_UNSIGNED_BYTE, GL_TRUE, 0, nullptr);
  return o;
}

void Glossy::update_normals(GlossyObject& o, std::span<const glm::vec3> normals) {
  std::vector<VertexDirections> directions;
  directions.reserve(normals.size());
  for (const glm::vec3& n : normals) directions.push_back({n, open_point(n)});
  glBindBuffer(GL_ARRAY_BUFFER, o.directions.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, byte_count(directions), directions.data());
}

void Glossy::set_fractions(GlossyObject& o, std::span<const std::array<float, 4>> fractions,
                           const DrawnVertices& vertices) {
  std::vector<glm::vec4> all;
  all.reserve(o.surface->material.size());
  for (const auto& s : fractions) all.emplace_back(s[0], s[1], s[2], s[3]);
  all.resize(o.own_vertices, glm::vec4(1));
  vertices.spread(all);
  std::vector<std::array<std::uint8_t, 4>> codes(o.surface->material.size(), {255, 255, 255, 255});
  for (std::size_t i = 0; i < std::min(all.size(), codes.size()); ++i)
    for (int k = 0; k < 4; ++k)
      codes[i][static_cast<std::size_t>(k)] =
          static_cast<std::uint8_t>(std::lround(255 * std::clamp(all[i][k], 0.f, 1.f)));
  glBindBuffer(GL_ARRAY_BUFFER, o.fractions.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, byte_count(codes), codes.data());
}

// In rows, the largest first, each as high as its first.
void Glossy::lay_out_levels(std::span<const ReflectionMap::RoughnessLevel> levels) {
  std::vector<int> sizes;
  for (const auto& level : levels) sizes.push_back(level.picture.width());
  if (sizes == level_sizes_ && !sizes.empty()) return;
  level_sizes_ = sizes;
  level_corners_.clear();
  glm::ivec2 at(0), whole(1);
  int row_height = 0;
  for (const int size : sizes) {
    const int side = size + 2;
    if (row_height > 0 && at.x + side > 2 * (sizes.front() + 2)) at = {0, at.y + row_height};
    if (at.x == 0) row_height = side;
    level_corners_.push_back(at);
    at.x += side;
    whole = glm::max(whole, glm::ivec2(at.x, at.y + side));
  }
  tiles_.fill(glm::vec4(0));
  for (std::size_t i = 0; i < sizes.size(); ++i)
    tiles_[i] = glm::vec4(glm::vec2(level_corners_[i] + 1) / glm::vec2(whole),
                          glm::vec2(sizes[i]) / glm::vec2(whole));
  level_pictures_ = {};
  glBindTexture(GL_TEXTURE_2D, level_pictures_.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB16F, whole.x, whole.y);
  read_to_the_rim();
  const Rgb dark{};
  if (sizes.empty()) glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, 1, 1, GL_RGB, GL_FLOAT, &dark);
}

void Glossy::set_surroundings(const Surroundings& surroundings) {
  surroundings_ = surroundings;
  if (!surroundings.reflections || surroundings.reflections == shown_) return;
  shown_ = surroundings.reflections;
  const auto count = std::min(shown_->levels.size(), ReflectionMap::kMaxLevels);
  lay_out_levels(std::span(shown_->levels).first(count));
  glBindTexture(GL_TEXTURE_2D, level_pictures_.get());
  for (std::size_t i = 0; i < count; ++i) {
    const Image<Rgb> bordered = with_border(shown_->levels[i].picture);
    glTexSubImage2D(GL_TEXTURE_2D, 0, level_corners_[i].x, level_corners_[i].y, bordered.width(),
                    bordered.height(), GL_RGB, GL_FLOAT, bordered.pixels().data());
  }
}

bool Glossy::set_floor(GlossyObject& o, const Image<Rgb>& ratios) {
  std::vector<std::uint8_t> codes;
  codes.reserve(3 * ratios.area());
  for (const Rgb& s : ratios.pixels())
    for (int c = 0; c < 3; ++c)
      codes.push_back(static_cast<std::uint8_t>(std::lround(170 * std::clamp(s[c], 0.f, 1.5f))));
  if (codes == o.floor_codes) return false;
  glBindTexture(GL_TEXTURE_2D, o.floor.get());
  if (o.floor_codes.empty()) {
    glTexStorage2D(GL_TEXTURE_2D, mip_levels(kMirroredFloor, kMirroredFloor), GL_RGB8,
                   kMirroredFloor, kMirroredFloor);
    read_to_the_rim(GL_LINEAR_MIPMAP_LINEAR);
  }
  o.floor_codes = std::move(codes);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, kMirroredFloor, kMirroredFloor, GL_RGB, GL_UNSIGNED_BYTE,
                  o.floor_codes.data());
  glGenerateMipmap(GL_TEXTURE_2D);
  return true;
}

void Glossy::set_mirrored(GlossyObject& o, const MirroredPicture& picture) {
  const glm::ivec2 size(picture.light.width(), picture.light.height());
  const auto upload = [&](const GlTexture& to, const Image<Rgb>& from) {
    glBindTexture(GL_TEXTURE_2D, to.get());
    if (size != o.mirrored_size) {
      glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB16F, size.x, size.y, 0, GL_RGB, GL_FLOAT,
                   from.pixels().data());
      read_to_the_rim();
    } else {
      glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, size.x, size.y, GL_RGB, GL_FLOAT,
                      from.pixels().data());
    }
  };
  upload(o.mirrored, picture.light);
  upload(o.past_objects, picture.open);
  o.mirrored_size = size;
  o.mirrored_place = {picture.x0, picture.y0, picture.step};
}

void Glossy::set_mirrored_objects(GLuint program, const GlossyObject& o) const {
  if (o.mirrored_size.x == 0) return;
  glActiveTexture(GL_TEXTURE0 + kMirroredUnit);
  glBindTexture(GL_TEXTURE_2D, o.mirrored.get());
  glUniform1i(uniform(program, "objects"), kMirroredUnit);
  glActiveTexture(GL_TEXTURE0 + kPastObjectsUnit);
  glBindTexture(GL_TEXTURE_2D, o.past_objects.get());
  glUniform1i(uniform(program, "past_objects"), kPastObjectsUnit);
  const glm::vec2 texel =
      static_cast<float>(o.mirrored_place.z) * glm::vec2(o.mirrored_size);  // pixels of them all
  const glm::vec2 corner =
                      glm::vec2(canvas_.x0 - o.mirrored_place.x, canvas_.y0 - o.mirrored_place.y) /
                      texel,
                  each = 1.f / (texel * static_cast<float>(scale_));
  glUniform4f(uniform(program, "objects_place"), corner.x, corner.y, each.x, each.y);
}

void Glossy::set_mirrored_floor(GLuint program, const GlossyObject& o,
                                const Pose& world_from_floor) {
  if (o.floor_codes.empty()) return;
  glActiveTexture(GL_TEXTURE0 + kFloorUnit);
  glBindTexture(GL_TEXTURE_2D, o.floor.get());
  glUniform1i(uniform(program, "floor_ratio"), kFloorUnit);
  const glm::mat4 grid_from_world(world_from_floor.inverse().matrix());
  glUniformMatrix4fv(uniform(program, "grid_from_world"), 1, GL_FALSE,
                     glm::value_ptr(grid_from_world));
  const prt::GroundGrid& g = *o.floor_grid;
  glUniform4f(uniform(program, "grid"), g.centre.x, g.centre.y, g.half_extent, g.height);
}

void Glossy::bind(int unit, const prt::Texture& texture, bool srgb, GLuint program,
                  const char* name) {
  const auto at = static_cast<GLuint>(kFirstUnit + unit);
  glActiveTexture(GL_TEXTURE0 + at);
  if (texture) {
    glBindTexture(GL_TEXTURE_2D, pictures_.at({texture.picture.get(), srgb}).texture.get());
    glBindSampler(at, sampler_of(texture));
  } else {
    glBindTexture(GL_TEXTURE_2D, white_.get());
    glBindSampler(at, 0);
  }
  glUniform1i(uniform(program, name), static_cast<GLint>(at));
  const std::string index = "[" + std::to_string(unit) + "]";
  glUniformMatrix3x2fv(uniform(program, ("transforms" + index).c_str()), 1, GL_FALSE,
                       glm::value_ptr(texture.transform));
  glUniform1i(uniform(program, ("sets" + index).c_str()), texture.set);
}

void Glossy::set_material(const prt::Material& m, GLuint program) {
  const std::array<const prt::Texture*, kMaps> maps{&m.base_colour_map, &m.metallic_roughness_map,
                                                    &m.normal_map, &m.occlusion_map,
                                                    &m.emission_map};
  constexpr const char* kNames[] = {"base_colour_map", "metallic_roughness_map", "normal_map",
                                    "occlusion_map", "emission_map"};
  for (int i = 0; i < kMaps; ++i)
    bind(i, *maps[static_cast<std::size_t>(i)], i == 0 || i == 4, program, kNames[i]);
  const Rgb& c = m.base_colour;
  glUniform4f(uniform(program, "base_colour"), c.r, c.g, c.b, m.opacity);
  set(program, "metallic", m.metallic);
  set(program, "roughness", m.roughness);
  set(program, "normal_scale", m.normal_scale);
  set(program, "occlusion_strength", m.occlusion_strength);
  set(program, "alpha_cutoff", m.alpha_cutoff);
  set(program, "clearcoat", m.clearcoat);
  set(program, "clearcoat_roughness", m.clearcoat_roughness);
  set(program, "transmission", m.transmission);
  const auto level_of = [&](float roughness) {
    const float place = shown_ ? shown_->place_of(roughness) : 0;
    return is_between_levels(place) ? place : std::round(place);
  };
  set(program, "level", level_of(m.roughness));
  set(program, "long_level", level_of(lighting::kNarrowLobe * m.roughness));
  set(program, "clearcoat_level", level_of(m.clearcoat_roughness));
  set(program, "emission", m.emission);
  // Fresnel's reflectance at normal incidence, scaled and tinted by KHR_materials_specular.
  const float ratio = (m.ior - 1) / (m.ior + 1), normal = ratio * ratio;
  Rgb reflectance = m.specular_colour * normal;
  for (int k = 0; k < 3; ++k) reflectance[k] = std::min(reflectance[k], 1.f) * m.specular;
  set(program, "reflectance", reflectance);
  set(program, "grazing_reflectance", m.specular);
}

void Glossy::set_scene(GLuint program, const GlossyObject& o, const Placed& placed) const {
  const glm::mat4 world(placed.world_from_object.matrix());
  glUniformMatrix4fv(uniform(program, "world_from_object"), 1, GL_FALSE, glm::value_ptr(world));
  glUniform3f(uniform(program, "eye"), static_cast<float>(placed.eye.x),
              static_cast<float>(placed.eye.y), static_cast<float>(placed.eye.z));
  set(program, "emission_unit", surroundings_.emission_unit);
  glActiveTexture(GL_TEXTURE0 + kSurroundingsUnit);
  glBindTexture(GL_TEXTURE_2D, level_pictures_.get());
  glUniform1i(uniform(program, "surroundings"), kSurroundingsUnit);
  set_levels(program);
  glActiveTexture(GL_TEXTURE0 + kReflectedUnit);
  glBindTexture(GL_TEXTURE_2D, reflected_.get());
  glUniform1i(uniform(program, "reflected"), kReflectedUnit);
  glActiveTexture(GL_TEXTURE0);
  const auto polynomial = irradiance_polynomial(surroundings_.light);
  glUniform3fv(uniform(program, "irradiance_sh"), 9, glm::value_ptr(polynomial[0]));
  const std::size_t count = std::min(surroundings_.lights.size(), Surroundings::kMaxLights);
  std::array<glm::vec4, Surroundings::kMaxLights> places{};
  std::array<glm::vec3, Surroundings::kMaxLights> irradiances{};
  for (std::size_t i = 0; i < count; ++i) {
    const MirroredLight& light = surroundings_.lights[i];
    places[i] = glm::vec4(glm::vec3(light.direction),
                          static_cast<float>(std::sin(std::min(light.radius_rad, kPi / 2))));
    irradiances[i] = {light.irradiance.r, light.irradiance.g, light.irradiance.b};
  }
  constexpr double kSameLight = .99999;  // cosine: both follow it as it moves
  int edged = -1;
  for (std::size_t i = 0; i < count; ++i)
    if (glm::dot(o.edged_towards, surroundings_.lights[i].direction) > kSameLight)
      edged = static_cast<int>(i);
  glUniform1i(uniform(program, "edged_light"), edged);
  glUniform1i(uniform(program, "light_count"), static_cast<GLint>(count));
  glUniform4fv(uniform(program, "light_places"), Surroundings::kMaxLights,
               glm::value_ptr(places[0]));
  glUniform3fv(uniform(program, "light_irradiances"), Surroundings::kMaxLights,
               glm::value_ptr(irradiances[0]));
}

void Glossy::set_mirrored_lights(GLuint program, const prt::Material& m) const {
  const LightPieces pieces(surroundings_.lights, m);
  constexpr auto kMost = static_cast<GLsizei>(LightPieces::kMost);
  glUniform1i(uniform(program, "piece_count"), pieces.count);
  glUniform4fv(uniform(program, "piece_places"), kMost, glm::value_ptr(pieces.places[0]));
  glUniform3fv(uniform(program, "piece_irradiances"), kMost, glm::value_ptr(pieces.irradiances[0]));
  glUniform1iv(uniform(program, "piece_lights"), kMost, pieces.lights.data());
}

void Glossy::set_levels(GLuint program) const {
  constexpr auto kCount = static_cast<GLsizei>(ReflectionMap::kMaxLevels);
  std::array<glm::vec2, ReflectionMap::kMaxLevels> steps{};
  for (std::size_t i = 0; i + 1 < level_sizes_.size(); ++i) {
    const float here = lighting::lobe_peak(shown_->levels[i].roughness);
    steps[i] = {here, 1 / (here - lighting::lobe_peak(shown_->levels[i + 1].roughness))};
  }
  glUniform4fv(uniform(program, "tiles"), kCount, glm::value_ptr(tiles_[0]));
  glUniform2fv(uniform(program, "levels"), kCount, glm::value_ptr(steps[0]));
  glUniform1i(uniform(program, "level_count"), static_cast<GLint>(level_sizes_.size()));
}

void Glossy::begin_part(const GlossyObject& o, const GlossyObject::Part& part,
                        const UseProgram& use, const Placed& placed) {
  const prt::Material& m = o.surface->materials[part.material];
  const GLuint program = use(features_of(o, part));
  set_scene(program, o, placed);
  set_mirrored_lights(program, m);
  set_mirrored_floor(program, o, placed.world_from_floor);
  set_mirrored_objects(program, o);
  set_material(m, program);
  if (o.is_blended(part) ? !m.double_sided : placed.cull_backs && !o.shows_backs)
    glEnable(GL_CULL_FACE);
  else
    glDisable(GL_CULL_FACE);
}

namespace {

void draw_indices(std::size_t first, std::size_t count) {
  glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(count), GL_UNSIGNED_INT,
                 reinterpret_cast<const void*>(first * sizeof(std::uint32_t)));
}

}  // namespace

// Farthest triangles first, of all materials together.
void Glossy::draw_sorted(const GlossyObject& o, const UseProgram& use, const Placed& placed) {
  const glm::vec3 eye(placed.world_from_object.inverse() * placed.eye);
  farthest_.clear();
  for (const GlossyObject::Part& part : placed.parts) {
    if (!o.is_blended(part)) continue;
    for (const auto& t : placed.triangles.subspan(static_cast<std::size_t>(part.first / 3),
                                                  static_cast<std::size_t>(part.count / 3))) {
      const glm::vec3 middle =
          (placed.positions[t[0]] + placed.positions[t[1]] + placed.positions[t[2]]) / 3.f;
      farthest_.push_back({glm::dot(middle - eye, middle - eye), &part, t});
    }
  }
  std::ranges::stable_sort(farthest_, std::greater(), &SortedTriangle::distance2);
  // Each change of material is a draw of its own: where there are too many, one material after the
  // other.
  constexpr int kMaxChanges = 256;
  int changes = 0;
  for (std::size_t i = 1; i < farthest_.size(); ++i)
    changes += farthest_[i].part != farthest_[i - 1].part;
  if (changes > kMaxChanges) std::ranges::stable_sort(farthest_, {}, &SortedTriangle::part);
  order_.clear();
  for (const SortedTriangle& s : farthest_) order_.push_back(s.corners);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.sorted.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, byte_count(order_), order_.data(), GL_STREAM_DRAW);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glDepthMask(GL_FALSE);
  for (std::size_t i = 0, next = 0; i < farthest_.size(); i = next) {
    while (next < farthest_.size() && farthest_[next].part == farthest_[i].part) ++next;
    begin_part(o, *farthest_[i].part, use, placed);
    draw_indices(3 * i, 3 * (next - i));
  }
  glDepthMask(GL_TRUE);
  glDisable(GL_BLEND);
}

void Glossy::draw(const GlossyObject& o, const UseProgram& use, const Placed& placed,
                  bool blended) {
  if (blended) {
    draw_sorted(o, use, placed);
  } else {
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, placed.indices);
    for (const GlossyObject::Part& part : placed.parts) {
      if (o.is_blended(part)) continue;
      begin_part(o, part, use, placed);
      draw_indices(static_cast<std::size_t>(part.first), static_cast<std::size_t>(part.count));
    }
  }
  glDisable(GL_CULL_FACE);
  for (int unit = 0; unit < kMaps; ++unit) glBindSampler(static_cast<GLuint>(kFirstUnit + unit), 0);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace penumbra::compositor
