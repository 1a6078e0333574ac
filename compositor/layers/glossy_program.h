// The shaders of surfaces with materials (prt/geometry/material.h).
#pragma once

namespace penumbra::compositor {

// What follows place_in_picture(). In the frame of the world but for `light`, the object's own
// irradiance/pi.
inline constexpr const char* kGlossyVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 irradiance;
layout(location = 4) in vec3 normal;
layout(location = 5) in vec4 tangent;
layout(location = 6) in vec4 coordinates;
layout(location = 7) in vec4 tint_and_openness;
layout(location = 8) in vec4 light_shares;
uniform mat4 world_from_object;
out vec3 light, at, up;
out vec4 along, place, tint, shares;
void main() {
  light = irradiance;
  at = (world_from_object * vec4(position, 1)).xyz;
  up = mat3(world_from_object) * normal;
  along = vec4(mat3(world_from_object) * tangent.xyz, tangent.w);
  place = coordinates;
  tint = tint_and_openness;
  shares = light_shares;
  gl_Position = place_in_picture(position);
})";

// Diffuse light by transfer, what is reflected from the maps of the surroundings by the split sum,
// and the lights as discs. Sources: glTF 2.0, appendix B; Karis 2013; Turquin 2019 (more_than_once);
// Lagarde & de Rousiers 2014 (occlusion of reflections by the openness).
inline constexpr const char* kGlossyFragment = R"(
in vec3 light, at, up;
in vec4 along, place, tint, shares;
uniform float signal_per_radiance, emission_unit, largest_level;
uniform vec3 eye;
uniform vec4 base_colour;
uniform float metallic, roughness, normal_scale, occlusion_strength, alpha_cutoff;
uniform float clearcoat, clearcoat_roughness, transmission;
uniform vec3 emission, reflectance;
uniform float grazing_reflectance;
uniform int alpha_mode, is_unlit, is_double_sided, has_normals, mapped;
uniform mat3x2 transforms[5];
uniform int sets[5];
uniform sampler2D base_colour_map, metallic_roughness_map, normal_map, occlusion_map, emission_map;
uniform highp samplerCube surroundings;
uniform sampler2D reflected;
uniform vec3 irradiance_sh[9];
const int kMaxLights = 4;
uniform int light_count;
uniform vec4 light_places[4];
uniform vec3 light_irradiances[4];
out vec4 colour;

vec2 place_of(int map) {
  return transforms[map] * vec3(sets[map] == 0 ? place.xy : place.zw, 1);
}
vec3 open_irradiance(vec3 n) {
  return irradiance_sh[0] + irradiance_sh[1] * n.y + irradiance_sh[2] * n.z +
         irradiance_sh[3] * n.x + irradiance_sh[4] * (n.x * n.y) + irradiance_sh[5] * (n.y * n.z) +
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
  for (int i = 0; i < light_count; ++i) {
    vec3 l = light_places[i].xyz;
    float n_dot_l = dot(n, l), share = shares[i];
    if (n_dot_l <= 0.0 || share <= 0.0) continue;
    float a2 = alpha * alpha + 0.25 * light_places[i].w * light_places[i].w;
    vec3 m = normalize(l + v);
    float grazing = pow(1.0 - clamp(dot(v, m), 0.0, 1.0), 5.0);
    sum += light_irradiances[i] * (share * n_dot_l * density(a2, clamp(dot(n, m), 0.0, 1.0)) *
           visibility(a2, n_dot_l, n_dot_v)) * mix(f0, vec3(f90), grazing);
  }
  return sum;
}
vec3 surroundings_towards(vec3 r, float rough) {
  return textureLod(surroundings, r, rough * largest_level).rgb;
}

void main() {
  vec4 base = base_colour * vec4(tint.rgb, 1);
  if ((mapped & 1) != 0) base *= texture(base_colour_map, place_of(0));
  if (!is_shown() || (alpha_mode == 1 && base.a < alpha_cutoff)) discard;
  if (alpha_mode != 2) base.a = 1.0;
  if (!gl_FrontFacing && is_double_sided == 0) {
    colour = vec4(0, 0, 0, base.a);
    return;
  }
  vec3 glow = emission * emission_unit;
  if ((mapped & 16) != 0) glow *= texture(emission_map, place_of(4)).rgb;
  if (is_unlit != 0) {
    colour = vec4(min(signal_per_radiance * emission_unit * base.rgb, 1000.0) * base.a, base.a);
    return;
  }
  float metal = metallic, rough = roughness;
  if ((mapped & 2) != 0) {
    vec4 t = texture(metallic_roughness_map, place_of(1));
    rough *= t.g;
    metal *= t.b;
  }
  float side = gl_FrontFacing ? 1.0 : -1.0;
  vec3 plain = normalize(up), n = plain * side;
  if ((mapped & 4) != 0) {
    vec3 t = texture(normal_map, place_of(2)).xyz * 2.0 - 1.0;
    t.xy *= normal_scale;
    vec3 tx = normalize(along.xyz), ty = cross(plain, tx) * along.w;
    n = normalize(mat3(tx, ty, plain) * t) * side;
  }
  // What the transfer knows is the light of the vertices' own normals.
  vec3 diffuse_light = light;
  if (n != plain) diffuse_light *= clamp(open_irradiance(n) / max(open_irradiance(plain), 1e-6), 0.0, 4.0);
  float open = tint.a;
  if ((mapped & 8) != 0) {
    float occlusion = 1.0 + occlusion_strength * (texture(occlusion_map, place_of(3)).r - 1.0);
    open *= occlusion;
  }
  vec3 v = normalize(eye - at);
  float n_dot_v = clamp(dot(n, v), 1e-3, 1.0), alpha = max(rough * rough, 1e-3);
  vec2 even = texture(reflected, vec2(n_dot_v, rough)).xy;
  vec3 f0 = mix(reflectance, base.rgb, metal);
  float f90 = mix(grazing_reflectance, 1.0, metal);
  vec3 again = 1.0 + f0 * (1.0 / max(even.x + even.y, 1e-3) - 1.0);
  vec3 share = (f0 * even.x + f90 * even.y) * again;
  vec3 r = reflect(-v, n);
  float seen = clamp(pow(n_dot_v + open, exp2(-16.0 * rough - 1.0)) - 1.0 + open, 0.0, 1.0);
  float above = clamp(1.0 + dot(r, plain * side), 0.0, 1.0);
  seen *= above * above;
  vec3 diffuse = base.rgb * (1.0 - metal) * diffuse_light;
  vec3 own = mix(diffuse, base.rgb * diffuse_light, metal);
  vec3 mirrored = share * mix(own, surroundings_towards(r, rough), seen) +
                  again * mirrored_lights(n, v, n_dot_v, alpha, f0, f90);
  float largest = max(share.r, max(share.g, share.b));
  float through = transmission * (1.0 - metal) * (1.0 - largest);
  diffuse *= (1.0 - share) * (1.0 - transmission);
  vec3 shown = diffuse + mirrored + glow;
  if (clearcoat > 0.0) {
    vec2 coat_even = texture(reflected, vec2(n_dot_v, clearcoat_roughness)).xy;
    float coat = clearcoat * (0.04 * coat_even.x + coat_even.y);
    shown = shown * (1.0 - coat) + coat * seen * surroundings_towards(r, clearcoat_roughness) +
            clearcoat * mirrored_lights(n, v, n_dot_v, max(clearcoat_roughness * clearcoat_roughness, 1e-3),
                                        vec3(0.04), 1.0);
  }
  float cover = base.a * (1.0 - through);
  colour = vec4(min(signal_per_radiance * shown, 1000.0) * base.a, cover);
}
)";

}  // namespace penumbra::compositor
