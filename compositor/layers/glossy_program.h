// The shaders of surfaces with materials (prt/geometry/material.h).
// threads: reentrant
#pragma once

#include <fmt/format.h>

#include <compare>
#include <cstdint>
#include <string>

#include "lighting/reflections/reflection_map.h"
#include "prt/geometry/receiver.h"

namespace penumbra::compositor {

/// What a surface's program does beyond diffuse light and the mirrored surroundings.
class GlossyFeatures {
 public:
  enum Feature : std::uint32_t {
    kBaseColourMap,
    kMetallicRoughnessMap,
    kNormalMap,
    kOcclusionMap,
    kEmissionMap,
    kMask,
    kBlend,
    kDoubleSided,
    kUnlit,
    kClearcoat,
    kLights,
    kOcclusionInRoughness,  // one picture for both
    kAlpha,                 // that of the base colour counts
    kBetweenLevels,         // what is mirrored is mixed from two levels
    kLongLobe,              // seen slantwise its lobe is longer than wide
    kFloor,                 // the shadows on the floor are mirrored
    kObjects,               // a picture of this view tells what it mirrors of objects
    kFeatures
  };
  void add(Feature feature, bool wanted) {
    if (wanted) bits_ |= 1u << feature;
  }
  bool has(Feature feature) const { return (bits_ >> feature & 1u) != 0; }
  friend auto operator<=>(const GlossyFeatures&, const GlossyFeatures&) = default;

 private:
  std::uint32_t bits_ = 0;
};

/// Texels a side of the shadow ratios that a mirror shows of the floor.
inline constexpr int kMirroredFloor = 64;

/// in: cut: whether is_shown() may say no
inline std::string glossy_defines(const GlossyFeatures& features, bool cut) {
  constexpr const char* kNames[GlossyFeatures::kFeatures] = {
      "BASE_COLOUR_MAP", "METALLIC_ROUGHNESS_MAP",
      "NORMAL_MAP",      "OCCLUSION_MAP",
      "EMISSION_MAP",    "MASK",
      "BLEND",           "DOUBLE_SIDED",
      "UNLIT",           "CLEARCOAT",
      "LIGHTS",          "OCCLUSION_IN_ROUGHNESS",
      "ALPHA",           "BETWEEN_LEVELS",
      "LONG_LOBE",       "FLOOR",
      "OBJECTS"};
  std::string out = fmt::format(
      "#define MAX_LEVELS {}\n#define MIRRORED_FLOOR {:.1f}\n#define GRID_STRETCH {:.3f}\n"
      "#define NARROW_LOBE {:.5f}\n",
      lighting::ReflectionMap::kMaxLevels, double{kMirroredFloor}, prt::GroundGrid::kStretch,
      lighting::kNarrowLobe);
  if (cut) out += "#define CUT\n";
  for (std::uint32_t i = 0; i < GlossyFeatures::kFeatures; ++i)
    if (features.has(static_cast<GlossyFeatures::Feature>(i)))
      out += std::string("#define ") + kNames[i] + "\n";
  return out;
}

// What follows place_in_picture(). In the frame of the world but for `light`, the object's own
// irradiance/pi.
inline constexpr const char* kGlossyVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 irradiance;
layout(location = 4) in vec3 normal;
layout(location = 5) in vec4 tangent;
layout(location = 6) in vec4 coordinates;
layout(location = 7) in vec3 vertex_tint;
layout(location = 8) in vec4 light_fractions;
layout(location = 9) in vec4 open_towards;
layout(location = 10) in vec4 edged_light;
uniform mat4 world_from_object;
centroid out vec3 light, at, up;
centroid out vec3 tint;
centroid out vec4 along, place, fractions, openness, edged;
void main() {
  light = irradiance;
  at = (world_from_object * vec4(position, 1)).xyz;
  up = mat3(world_from_object) * normal;
  along = vec4(mat3(world_from_object) * tangent.xyz, tangent.w);
  place = coordinates;
  tint = vertex_tint;
  openness = vec4(open_towards.x, mat3(world_from_object) * open_towards.yzw);
  fractions = light_fractions;
  edged = edged_light;
  gl_Position = place_in_picture(position);
})";

// Diffuse light by transfer, what is reflected from the maps of the surroundings by the split sum,
// and the lights as discs. Sources: glTF 2.0, appendix B; Karis 2013; Turquin 2019 (again).
inline constexpr const char* kGlossyFragment = R"(
centroid in vec3 light, at, up;
centroid in vec3 tint;
centroid in vec4 along, place, fractions, openness, edged;
uniform float signal_per_radiance, emission_unit;
uniform vec3 eye;
uniform vec4 base_colour;
uniform float metallic, roughness, normal_scale, occlusion_strength, alpha_cutoff;
uniform float clearcoat, clearcoat_roughness, transmission;
uniform vec3 emission, reflectance;
uniform float grazing_reflectance;
uniform mat3x2 transforms[5];
uniform int sets[5];
uniform sampler2D base_colour_map, metallic_roughness_map, normal_map, occlusion_map, emission_map;
// One octahedral picture for each roughness, beside each other: tiles hold their first texel's
// corner and their size, in the whole's.
uniform highp sampler2D surroundings;
uniform vec4 tiles[MAX_LEVELS];
uniform vec2 levels[MAX_LEVELS];  // lobe_peak() of the roughness, 1/(step to the next)
uniform int level_count;
uniform float level, long_level, clearcoat_level;
uniform sampler2D reflected;
uniform vec3 irradiance_sh[9];
const int kMaxLights = 4;
uniform int light_count, edged_light;
uniform vec4 light_places[4];
uniform vec3 light_irradiances[4];
// The same as they are mirrored: some in parts.
uniform int piece_count;
uniform vec4 piece_places[8];  // w: sine of the radius
uniform vec3 piece_irradiances[8];
uniform int piece_lights[8];
out vec4 colour;

vec2 place_of(int map) {
  return transforms[map] * vec3(sets[map] == 0 ? place.xy : place.zw, 1);
}
vec3 open_irradiance(vec3 n) {
  return irradiance_sh[0] + irradiance_sh[1] * n.y + irradiance_sh[2] * n.z +
         irradiance_sh[3] * n.x +
         irradiance_sh[4] * (n.x * n.y) + irradiance_sh[5] * (n.y * n.z) +
         irradiance_sh[6] * (3.0 * n.z * n.z - 1.0) + irradiance_sh[7] * (n.x * n.z) +
         irradiance_sh[8] * (n.x * n.x - n.y * n.y);
}
float density(float a2, float n_dot_m) {
  float t = n_dot_m * n_dot_m * (a2 - 1.0) + 1.0;
  return a2 / (3.14159265 * t * t);
}
float visibility(float a2, float n_dot_l, float n_dot_v) {
  return 0.5 / (n_dot_l * sqrt(a2 + (1.0 - a2) * n_dot_v * n_dot_v) +
                n_dot_v * sqrt(a2 + (1.0 - a2) * n_dot_l * n_dot_l) + 1e-6);
}
// A disc as a light from its middle before a lobe that is wider by it: the lobe's peak over a
// mirror is the disc's own radiance.
vec3 mirrored_lights(vec3 n, vec3 v, float n_dot_v, float alpha, vec3 f0, float f90) {
  vec3 sum = vec3(0);
  for (int i = 0; i < piece_count; ++i) {
    vec3 l = piece_places[i].xyz;
    float n_dot_l = dot(n, l), fraction = fractions[piece_lights[i]];
    if (n_dot_l <= 0.0 || fraction <= 0.0) continue;
    float a2 = alpha * alpha + 0.25 * piece_places[i].w * piece_places[i].w;
    vec3 m = normalize(l + v);
    float grazing = pow(1.0 - clamp(dot(v, m), 0.0, 1.0), 5.0);
    sum += piece_irradiances[i] * (fraction * n_dot_l * density(a2, clamp(dot(n, m), 0.0, 1.0)) *
           visibility(a2, n_dot_l, n_dot_v)) * mix(f0, vec3(f90), grazing);
  }
  return sum;
}
#if defined(NORMAL_MAP) || defined(DOUBLE_SIDED)
// Irradiance/pi of the vertices' own surface and that of the edged light, turned to a normal on the
// side of the surface that is seen: lights apart by their cosines, the rest by what the open
// surroundings send either way.
vec3 turned(vec3 of_edged, vec3 plain, vec3 facing, vec3 n) {
  vec3 rest = light, sum = vec3(0);
#ifdef LIGHTS
  for (int i = 0; i < light_count; ++i) {
    vec3 l = light_places[i].xyz, e = light_irradiances[i] * (fractions[i] / 3.14159265);
    float on_plain = max(dot(plain, l), 0.0), now = max(dot(n, l), 0.0);
    // What lies below the surface lights none of its bumps.
    now *= clamp(10.0 * dot(facing, l), 0.0, 1.0);
    bool is_edged = i == edged_light;
    if (!is_edged) rest -= e * on_plain;
    sum += is_edged && on_plain > 0.01 ? of_edged * (now / on_plain) : e * now;
  }
#endif
  if (edged_light < 0) rest += of_edged;
  return max(rest, 0.0) *
             clamp(open_irradiance(n) / max(open_irradiance(plain), 1e-6), 0.0, 4.0) + sum;
}
#endif
vec2 reflected_of_even(float n_dot_v, float rough) {
  return texture(reflected, (vec2(n_dot_v, rough) * 31.0 + 0.5) / 32.0).xy;
}
// What the surface lets in from around a direction, of what an open one does: both by two bands of
// harmonics.
float open_fraction(vec3 r, vec3 plain) {
  float here = 0.282095 * openness.x + 0.488603 * dot(openness.yzw, r);
  float open = (1.0 + 2.0 * max(dot(plain, r), 0.0)) / (4.0 * 3.14159265);
  return clamp(here / open, 0.0, 1.0);
}
// As lighting::ReflectionMap::place_of.
float level_of(float rough) {
  float alpha = max(rough * rough, 0.003), peak = 1.0 / (alpha * alpha), at = 0.0;
  for (int i = 0; i + 1 < level_count; ++i)
    at += clamp((levels[i].x - peak) * levels[i].y, 0.0, 1.0);
  return at;
}
// As lighting::octahedral_place.
vec2 octahedral(vec3 d) {
  vec2 p = d.xz / (abs(d.x) + abs(d.y) + abs(d.z));
  if (d.y < 0.0) p = (1.0 - abs(p.yx)) * vec2(p.x < 0.0 ? -1.0 : 1.0, p.y < 0.0 ? -1.0 : 1.0);
  return 0.5 * p + 0.5;
}
vec3 on_level(vec2 at, int i) {
  return textureLod(surroundings, tiles[i].xy + at * tiles[i].zw, 0.0).rgb;
}
#ifdef FLOOR
// What is left of the light on the floor around the object, on a prt::GroundGrid.
uniform sampler2D floor_ratio;
uniform mat4 grid_from_world;
uniform vec4 grid;  // x and z of its centre, half its side, its height
// As much of the lobe as lies below the horizon, and what is left of the light there.
vec4 floor_towards(vec3 r, float spread) {
  vec3 from = (grid_from_world * vec4(at, 1)).xyz;
  float far = max(from.y - grid.w, 0.0) / max(-r.y, 0.5 * spread);
  vec2 p = (from.xz + far * r.xz - grid.xy) / grid.z;
  vec2 side = 1.0 + GRID_STRETCH * abs(p);
  // Metres from one texel to the next, the larger.
  float texel = 2.0 * grid.z / MIRRORED_FLOOR * max(side.x * side.x, side.y * side.y) /
                (1.0 + GRID_STRETCH);
  vec3 ratio = textureLod(floor_ratio, 0.5 + 0.5 * (1.0 + GRID_STRETCH) * p / side,
                          log2(max(2.0 * spread * far / texel, 1.0))).rgb;
  return vec4(1.5 * ratio, clamp(0.5 - 0.5 * r.y / spread, 0.0, 1.0));
}
#endif
// The mean over the lobe around a direction, seen along the normal.
vec3 surroundings_towards(vec3 r, float place) {
  vec2 at_place = octahedral(r);
#ifdef BETWEEN_LEVELS
  int i = clamp(int(place), 0, level_count - 2);
  return mix(on_level(at_place, i), on_level(at_place, i + 1), place - float(i));
#else
  return on_level(at_place, int(place));
#endif
}
#ifdef FLOOR
// What is seen around a direction, less what the floor lacks of it.
vec3 above_floor(vec3 around, vec3 towards, float place, float alpha) {
  vec3 r = mat3(grid_from_world) * towards;
  float spread = 1.3 * alpha + 0.01;  // tangent of half the lobe
  if (r.y >= spread) return around;
  vec4 seen = floor_towards(r, spread);
  vec3 floor_light = around;
  if (r.y > -spread) {
    vec3 lower = transpose(mat3(grid_from_world)) * vec3(r.x, -spread, r.z);
    floor_light = min(around, on_level(octahedral(lower), int(place + 0.5)));
  }
  return max(around - seen.w * (1.0 - seen.rgb) * floor_light, 0.0);
}
#endif
#ifdef LONG_LOBE
// Facets that lean towards the viewer, or away, by some angle turn what is mirrored by twice that,
// those that lean aside by n.v of it: five lobes of .6 of the width in the plane of incidence, .73
// of the width apart, stand for them. Fitted to highlights on a ball (docs/methods/materials.md).
vec3 along_lobe(vec3 n, vec3 v, float n_dot_v, float alpha, float place, vec3 otherwise) {
  vec3 t = normalize(v - n * n_dot_v), sum = vec3(0);
  float weights = 0.0, a2 = alpha * alpha;
  for (float side = -2.0; side < 3.0; side += 1.0) {
    vec3 h = normalize(n + side * 0.73 * alpha * t);
    float v_dot_h = dot(v, h);
    vec3 l = 2.0 * v_dot_h * h - v;
    float n_dot_l = dot(n, l);
    if (v_dot_h <= 0.0 || n_dot_l <= 0.0) continue;
    float part = side == 0.0 ? 0.594 : abs(side) < 1.5 ? 0.167 : 0.036;
    float weight = part * visibility(a2, n_dot_l, n_dot_v) * n_dot_l * v_dot_h / dot(n, h);
    sum += weight * on_level(octahedral(l), int(place + 0.5));
    weights += weight;
  }
  return weights > 0.0 ? sum / weights : otherwise;
}
#endif

#ifdef OBJECTS
// Mean radiance over the lobe where it meets objects, and how much of it does not.
uniform highp sampler2D objects, past_objects;
uniform vec4 objects_place;  // of the canvas's corner in it, and of a sample's step
#endif

void main() {
  vec3 of_edged = light_beside_edge(edged);  // before anything is discarded
#ifdef CUT
  if (!is_shown()) discard;
#endif
  vec4 base = base_colour * vec4(tint, 1);
#ifdef BASE_COLOUR_MAP
  base *= texture(base_colour_map, place_of(0));
#endif
#ifdef MASK
  // The edge of the mask is a pixel wide, however large the texture is seen.
  base.a = clamp((base.a - alpha_cutoff) / max(fwidth(base.a), 1e-4) + 0.5, 0.0, 1.0);
  if (base.a == 0.0) discard;
#elif !defined(ALPHA)
  base.a = 1.0;
#endif
#ifdef UNLIT
  vec4 drawn = vec4(min(signal_per_radiance * emission_unit * base.rgb, 1000.0) * base.a, base.a);
#else
  float metal = metallic, rough = roughness, at_level = level, at_long_level = long_level;
#ifdef METALLIC_ROUGHNESS_MAP
  vec4 t = texture(metallic_roughness_map, place_of(1));
  rough *= t.g;
  metal *= t.b;
  at_level = level_of(rough);
#ifdef LONG_LOBE
  at_long_level = level_of(NARROW_LOBE * rough);
#endif
#endif
  vec3 plain = normalize(up), n = plain, diffuse_light = light + of_edged;
  float occlusion = 1.0;
#ifdef NORMAL_MAP
  vec3 lean = texture(normal_map, place_of(2)).xyz * 2.0 - 1.0;
  lean.xy *= normal_scale;
  vec3 tx = normalize(along.xyz), ty = cross(plain, tx) * along.w;
  n = normalize(mat3(tx, ty, plain) * lean);
#endif
#ifdef DOUBLE_SIDED
  if (!gl_FrontFacing) n = -n;
#endif
#if defined(NORMAL_MAP) || defined(DOUBLE_SIDED)
  // What the transfer knows is the light of the vertices' own normals.
  diffuse_light = turned(of_edged, plain, gl_FrontFacing ? plain : -plain, n);
#endif
#ifdef OCCLUSION_IN_ROUGHNESS
  occlusion += occlusion_strength * (t.r - 1.0);
#elif defined(OCCLUSION_MAP)
  occlusion += occlusion_strength * (texture(occlusion_map, place_of(3)).r - 1.0);
#endif
  vec3 v = normalize(eye - at);
  float n_dot_v = clamp(dot(n, v), 1e-3, 1.0);
  vec2 even = reflected_of_even(n_dot_v, rough);
  vec3 f0 = mix(reflectance, base.rgb, metal);
  float f90 = mix(grazing_reflectance, 1.0, metal);
  vec3 again = 1.0 + f0 * (1.0 / max(even.x + even.y, 1e-3) - 1.0);
  vec3 fraction = (f0 * even.x + f90 * even.y) * again;
  vec3 r = reflect(-v, n);
#ifdef OBJECTS
  vec2 at_objects = objects_place.xy + gl_FragCoord.xy * objects_place.zw;
  vec3 of_objects = textureLod(objects, at_objects, 0.0).rgb;
  // What a picture of occlusion stands for is traced.
  vec3 past = textureLod(past_objects, at_objects, 0.0).rgb, seen = past;
#else
  float seen = occlusion * open_fraction(r, plain);
#endif
#ifdef NORMAL_MAP
  float above = clamp(1.0 + dot(r, plain), 0.0, 1.0);
  above *= above;
  seen *= above;
#endif
  vec3 own = base.rgb * diffuse_light;  // what it sees of itself is lit like it
  float alpha = max(rough * rough, 1e-3);
  vec3 around = surroundings_towards(r, at_level);
#ifdef LONG_LOBE
  // Below n.v of .54 by more than those lobes, as far as what they lack of a round one allows.
  float off = 1.0 - n_dot_v, slant = off * (2.08 + 0.21 * off) * (1.0 - 0.56 * alpha);
  if (slant > 0.02) {
    vec3 row = along_lobe(n, v, n_dot_v, alpha, at_long_level, around);
    around = max(mix(around, row, slant), 0.25 * row);
  }
#endif
#ifdef FLOOR
  around = above_floor(around, r, at_level, alpha);
#endif
#ifdef OBJECTS
#ifdef NORMAL_MAP
  vec3 beside = past * (1.0 - above) * own;
#else
  vec3 beside = vec3(0);
#endif
  vec3 shown = fraction * (of_objects + seen * around + beside);
#else
  vec3 shown = fraction * mix(own, around, seen);
#endif
#ifdef LIGHTS
  shown += again * mirrored_lights(n, v, n_dot_v, alpha, f0, f90);
#endif
  vec3 diffuse = own * (1.0 - metal) * (1.0 - fraction);
  shown += diffuse * (1.0 - transmission);
#ifdef EMISSION_MAP
  shown += emission * emission_unit * texture(emission_map, place_of(4)).rgb;
#else
  shown += emission * emission_unit;
#endif
#ifdef CLEARCOAT
  vec2 coat_even = reflected_of_even(n_dot_v, clearcoat_roughness);
  float coat = clearcoat * (0.04 * coat_even.x + coat_even.y);
  float coat_alpha = max(clearcoat_roughness * clearcoat_roughness, 1e-3);
  vec3 on_coat = surroundings_towards(r, clearcoat_level);
#ifdef FLOOR
  on_coat = above_floor(on_coat, r, clearcoat_level, coat_alpha);
#endif
#ifdef OBJECTS
  on_coat = of_objects + seen * on_coat;  // by the lobe below it
#else
  on_coat *= seen;
#endif
  shown = shown * (1.0 - coat) + coat * on_coat;
#ifdef LIGHTS
  shown += clearcoat * mirrored_lights(n, v, n_dot_v, coat_alpha, vec3(0.04), 1.0);
#endif
#endif
  float cover = base.a;
#ifdef BLEND
  cover *= 1.0 - transmission * (1.0 - metal) * (1.0 - max(fraction.r, max(fraction.g, fraction.b)));
#endif
  vec4 drawn = vec4(min(signal_per_radiance * shown, 1000.0) * base.a, cover);
#endif
#ifndef DOUBLE_SIDED
  if (!gl_FrontFacing) drawn.rgb = vec3(0);
#endif
  colour = with_foreground(drawn);
}
)";

}  // namespace penumbra::compositor
