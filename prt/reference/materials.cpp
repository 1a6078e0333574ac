#include "prt/reference/materials.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>

#include "core/conventions.h"
#include "core/image.h"
#include "lighting/reflections/ggx.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::prt {

namespace {

constexpr auto kPiF = static_cast<float>(kPi);
constexpr float kMinCosine = 1e-3f;  // of the viewer

float width_of(float roughness) {
  return std::max(roughness * roughness, MaterialLobes::kMinWidth);
}

// D(m); by the sine, which keeps its digits where the lobe is narrow.
float facet_density(float alpha, const glm::vec3& m) {
  if (m.z <= 0) return 0;
  const float a2 = alpha * alpha, t = a2 * m.z * m.z + m.x * m.x + m.y * m.y;
  return a2 / (kPiF * t * t);
}

// Facets that the viewer sees.
// source: Dupuy & Benyoub 2023
glm::vec3 visible_facet(float alpha, const glm::vec3& v, float u1, float u2) {
  const glm::vec3 stretched = glm::normalize(glm::vec3(alpha * v.x, alpha * v.y, v.z));
  const float phi = 2 * kPiF * u1, z = (1 - u2) * (1 + stretched.z) - stretched.z,
              r = std::sqrt(std::max(0.f, 1 - z * z));
  const glm::vec3 h = glm::vec3(r * std::cos(phi), r * std::sin(phi), z) + stretched;
  return glm::normalize(glm::vec3(alpha * h.x, alpha * h.y, std::max(h.z, 1e-7f)));
}

// Both shadowings over that of the viewer, for a facet that the viewer sees.
// source: Heitz 2014, eq. 43 and 99
float kept_of_visible(float alpha, float n_dot_l, float n_dot_v) {
  const float a2 = alpha * alpha;
  const float one = 2 / (n_dot_v + std::sqrt(a2 + (1 - a2) * n_dot_v * n_dot_v));
  return 4 * n_dot_l * lighting::ggx_visibility(alpha, n_dot_l, n_dot_v) / one;
}

// What is mirrored of even light, F0 x + F90 y, by the visible facets: near grazing those of the
// whole distribution (lighting::reflected_of_even) are off by some percent.
glm::vec2 mirrored_of_even(float n_dot_v, float roughness) {
  constexpr int kPlaces = 1024;
  constexpr double kGolden = .6180339887498949;
  const float alpha = width_of(roughness);
  const glm::vec3 v(std::sqrt(1 - n_dot_v * n_dot_v), 0, n_dot_v);
  glm::vec2 sum(0);
  for (int i = 0; i < kPlaces; ++i) {
    const double turns = kGolden * i;
    const glm::vec3 m = visible_facet(alpha, v, static_cast<float>(turns - std::floor(turns)),
                                      (static_cast<float>(i) + .5f) / kPlaces);
    const float v_dot_m = glm::dot(v, m), n_dot_l = 2 * v_dot_m * m.z - v.z;
    if (n_dot_l <= 0) continue;
    const float grazing = std::pow(1 - std::clamp(v_dot_m, 0.f, 1.f), 5.f);
    sum += glm::vec2(1 - grazing, grazing) * kept_of_visible(alpha, n_dot_l, n_dot_v);
  }
  return sum / static_cast<float>(kPlaces);
}

// By the root of n.v and by roughness, both from 0 to 1: most changes near grazing.
constexpr int kEvenTable = 48;
const Image<glm::vec2>& mirrored_of_even_table() {
  static const Image<glm::vec2> table = [] {
    Image<glm::vec2> out(kEvenTable, kEvenTable);
    // On one core: who waits within a parallel loop for another might come by here again.
    for (int y = 0; y < kEvenTable; ++y)
      for (int x = 0; x < kEvenTable; ++x) {
        const float root = static_cast<float>(x) / (kEvenTable - 1);
        out.at(x, y) = mirrored_of_even(std::max(root * root, kMinCosine),
                                        static_cast<float>(y) / (kEvenTable - 1));
      }
    return out;
  }();
  return table;
}

glm::vec2 mirrored_of_even_read(float n_dot_v, float roughness) {
  const Image<glm::vec2>& table = mirrored_of_even_table();
  const float x = std::sqrt(n_dot_v) * (kEvenTable - 1), y = roughness * (kEvenTable - 1);
  const int x0 = std::clamp(static_cast<int>(x), 0, kEvenTable - 2),
            y0 = std::clamp(static_cast<int>(y), 0, kEvenTable - 2);
  const float fx = std::min(x - static_cast<float>(x0), 1.f),
              fy = std::min(y - static_cast<float>(y0), 1.f);
  return (1 - fy) * ((1 - fx) * table.at(x0, y0) + fx * table.at(x0 + 1, y0)) +
         fy * ((1 - fx) * table.at(x0, y0 + 1) + fx * table.at(x0 + 1, y0 + 1));
}

glm::vec3 above_surface(glm::vec3 v) {
  if (v.z >= kMinCosine) return v;
  v.z = kMinCosine;
  return glm::normalize(v);
}

}  // namespace

MaterialLobes::MaterialLobes(const LocalMaterial& m, const glm::vec3& towards_viewer)
    : world_from_here_(frame_around(m.normal)) {
  const glm::mat3 here = glm::transpose(world_from_here_);
  viewer_ = above_surface(here * towards_viewer);
  plain_ = here * m.plain;
  const glm::vec2 even = mirrored_of_even_read(viewer_.z, m.roughness);
  const glm::vec2 of_coat = mirrored_of_even_read(viewer_.z, m.clearcoat_roughness);
  constexpr float kCoatReflectance = .04f;
  const float coat = m.clearcoat * (kCoatReflectance * of_coat.x + of_coat.y), below = 1 - coat;
  Rgb again, fraction, evenly;
  for (int c = 0; c < 3; ++c) {
    again[c] = lighting::more_than_once(std::max(even.x + even.y, 1e-3f), m.reflectance[c]);
    fraction[c] = (m.reflectance[c] * even.x + m.grazing_reflectance * even.y) * again[c];
    evenly[c] = m.diffuse[c] * std::max(0.f, 1 - fraction[c]);
  }
  lobes_[0] = {width_of(m.roughness), m.reflectance, m.grazing_reflectance, again * below,
               below * luminance(fraction)};
  lobes_[1] = {width_of(m.clearcoat_roughness), Rgb{1, 1, 1} * kCoatReflectance, 1,
               Rgb{1, 1, 1} * m.clearcoat, coat};
  diffuse_chance_ = below * luminance(evenly);
  diffuse_ = evenly * (below / kPiF);
  const float all = lobes_[0].chance + lobes_[1].chance + diffuse_chance_;
  if (all > 0) {
    lobes_[0].chance /= all, lobes_[1].chance /= all, diffuse_chance_ /= all;
  }
  emission_ = m.emission * below;
  cover_ = m.opacity;
  if (m.transmitted > 0)
    cover_ *= 1 - m.transmitted * std::max(0.f, 1 - std::max({fraction.r, fraction.g, fraction.b}));
}

// With the visible facets of Heitz 2018: D G1 / (4 n.v).
float MaterialLobes::lobe_density(const Lobe& lobe, const glm::vec3& l) const {
  const float a2 = lobe.alpha * lobe.alpha;
  const glm::vec3 m = glm::normalize(viewer_ + l);
  return facet_density(lobe.alpha, m) /
         (2 * (viewer_.z + std::sqrt(a2 + (1 - a2) * viewer_.z * viewer_.z)));
}

Rgb MaterialLobes::lobe_value(const Lobe& lobe, const glm::vec3& l) const {
  const glm::vec3 m = glm::normalize(viewer_ + l);
  const float grazing = std::pow(1 - std::clamp(glm::dot(viewer_, m), 0.f, 1.f), 5.f);
  const float value =
      facet_density(lobe.alpha, m) * lighting::ggx_visibility(lobe.alpha, l.z, viewer_.z) * l.z;
  Rgb out;
  for (int c = 0; c < 3; ++c)
    out[c] = lobe.factor[c] * value *
             (lobe.reflectance[c] + (lobe.grazing - lobe.reflectance[c]) * grazing);
  return out;
}

Rgb MaterialLobes::value_here(const glm::vec3& l) const {
  if (l.z <= 0 || glm::dot(l, plain_) <= 0) return {};
  Rgb out = diffuse_ * l.z;
  for (const Lobe& lobe : lobes_)
    if (lobe.chance > 0) out += lobe_value(lobe, l);
  return out;
}

float MaterialLobes::density_here(const glm::vec3& l) const {
  if (l.z <= 0) return 0;
  float out = diffuse_chance_ * l.z / kPiF;
  for (const Lobe& lobe : lobes_)
    if (lobe.chance > 0) out += lobe.chance * lobe_density(lobe, l);
  return out;
}

Rgb MaterialLobes::evaluate(const glm::vec3& towards_light) const {
  return value_here(glm::transpose(world_from_here_) * towards_light);
}

float MaterialLobes::density(const glm::vec3& towards_light) const {
  return density_here(glm::transpose(world_from_here_) * towards_light);
}

// One number chooses the lobe and what is left of it a place in the lobe.
MaterialLobes::Bounce MaterialLobes::sample(float u1, float u2) const {
  glm::vec3 l;
  if (u1 < diffuse_chance_) {
    const float phi = 2 * kPiF * u1 / diffuse_chance_, r = std::sqrt(u2);
    l = {r * std::cos(phi), r * std::sin(phi), std::sqrt(1 - u2)};
  } else {
    u1 -= diffuse_chance_;
    const bool coat = u1 >= lobes_[0].chance && lobes_[1].chance > 0;
    const Lobe& lobe = lobes_[coat ? 1 : 0];
    if (coat) u1 -= lobes_[0].chance;
    if (!(lobe.chance > 0)) return {};
    const glm::vec3 m = visible_facet(lobe.alpha, viewer_, std::min(u1 / lobe.chance, 1.f), u2);
    l = 2 * glm::dot(viewer_, m) * m - viewer_;
  }
  Bounce out;
  if (l.z <= 0) return out;
  out.towards_light = world_from_here_ * l;
  out.density = density_here(l);
  if (out.density > 0) out.weight = value_here(l) * (1 / out.density);
  return out;
}

Rgb MaterialLobes::emission() const {
  return emission_;
}

}  // namespace penumbra::prt
