#include "tests/support/gltf_assets.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <numbers>
#include <utility>

namespace penumbra::test {

namespace {

using nlohmann::json;
using prt::Rgba8;

constexpr int kSide = 256;
constexpr float kRadius = .15f;
constexpr int kRings = 24;

// `colour` by the place in the picture, 0..1 with v down.
Image<Rgba8> painted(const std::function<Rgba8(float u, float v)>& colour) {
  Image<Rgba8> out(kSide, kSide);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x)
      out.at(x, y) =
          colour((static_cast<float>(x) + .5f) / kSide, (static_cast<float>(y) + .5f) / kSide);
  return out;
}

std::uint8_t code(float v) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(v, 0.f, 1.f) * 255));
}

// Value noise between 0 and 1, of one cell a unit, the same on every machine.
float noise(float x) {
  const auto at = [](int i) {
    auto h = static_cast<std::uint32_t>(i) * 0x9e3779b9u;
    h ^= h >> 15, h *= 0x85ebca6bu, h ^= h >> 13;
    return static_cast<float>(h >> 8) / static_cast<float>(1 << 24);
  };
  const float cell = std::floor(x), t = x - cell;
  const auto i = static_cast<int>(cell);
  return at(i) + (at(i + 1) - at(i)) * t * t * (3 - 2 * t);
}

GltfMaker ball(GltfMaker maker, const json& material) {
  maker.place(gltf_sphere(kRadius, kRings), maker.material(material));
  return maker;
}

json metallic_roughness(std::array<float, 4> base, float metallic, float roughness) {
  return {{"baseColorFactor", base}, {"metallicFactor", metallic}, {"roughnessFactor", roughness}};
}

}  // namespace

GltfMaker gold_ball() {
  return ball({}, {{"name", "gold"},
                   {"pbrMetallicRoughness", metallic_roughness({1, .77f, .34f, 1}, 1, .15f)}});
}

GltfMaker chrome_ball() {
  return ball({}, {{"name", "chrome"},
                   {"pbrMetallicRoughness", metallic_roughness({.55f, .56f, .55f, 1}, 1, .02f)}});
}

GltfMaker brushed_metal_ball() {
  GltfMaker maker;
  json pbr = metallic_roughness({.77f, .78f, .78f, 1}, 1, 1);
  const auto streaks = painted([](float, float v) {
    return Rgba8{0, code(.2f + .35f * noise(180 * v)), 255, 255};
  });
  pbr["metallicRoughnessTexture"] = {{"index", maker.texture(streaks)}};
  return ball(std::move(maker), {{"name", "brushed metal"}, {"pbrMetallicRoughness", pbr}});
}

GltfMaker plastic_ball() {
  GltfMaker maker;
  maker.use("KHR_materials_clearcoat");
  return ball(std::move(maker),
              {{"name", "plastic"},
               {"pbrMetallicRoughness", metallic_roughness({.6f, .03f, .03f, 1}, 0, .3f)},
               {"extensions",
                {{"KHR_materials_clearcoat",
                  {{"clearcoatFactor", 1}, {"clearcoatRoughnessFactor", .05f}}}}}});
}

GltfMaker rubber_ball() {
  GltfMaker maker;
  const auto bumps = painted([](float u, float v) {
    const float turns = 2 * std::numbers::pi_v<float> * 20;
    const glm::vec3 n =
        glm::normalize(glm::vec3(.3f * std::cos(turns * u), -.3f * std::cos(turns * v), 1));
    return Rgba8{code(.5f + .5f * n.x), code(.5f + .5f * n.y), code(.5f + .5f * n.z), 255};
  });
  json material = {{"name", "rubber"},
                   {"pbrMetallicRoughness", metallic_roughness({.04f, .04f, .045f, 1}, 0, .95f)}};
  material["normalTexture"] = {{"index", maker.texture(bumps)}, {"scale", .8f}};
  return ball(std::move(maker), material);
}

GltfMaker wooden_box() {
  GltfMaker maker;
  const auto ring = [](float u, float v) {
    const float across = std::hypot(u - .2f, .25f * (v - .5f));
    return .5f + .5f * std::sin(90 * across + 6 * noise(3 * v + 5 * u));
  };
  const auto grain = painted([&](float u, float v) {
    const float t = ring(u, v);
    return Rgba8{code(.45f + .25f * t), code(.29f + .18f * t), code(.15f + .1f * t), 255};
  });
  const auto rough = painted([&](float u, float v) {
    return Rgba8{0, code(.75f - .25f * ring(u, v)), 0, 255};
  });
  json pbr = metallic_roughness({1, 1, 1, 1}, 0, 1);
  pbr["baseColorTexture"] = {{"index", maker.texture(grain, ".jpg")}};
  pbr["metallicRoughnessTexture"] = {{"index", maker.texture(rough)}};
  maker.place(gltf_box({.3f, .3f, .3f}),
              maker.material({{"name", "wood"}, {"pbrMetallicRoughness", pbr}}));
  return maker;
}

GltfMaker masked_leaf() {
  GltfMaker maker;
  const auto leaf = painted([](float u, float v) {
    const float half = .42f * std::sin(std::numbers::pi_v<float> * v);
    const bool inside = std::abs(u - .5f) < half * (1 - .12f * noise(24 * v));
    const bool vein = std::abs(u - .5f) < .01f;
    return inside ? Rgba8{code(vein ? .5f : .2f), code(vein ? .6f : .45f), 40, 255}
                  : Rgba8{0, 0, 0, 0};
  });
  json pbr = metallic_roughness({1, 1, 1, 1}, 0, .7f);
  pbr["baseColorTexture"] = {
      {"index", maker.texture(leaf, ".png", {{"wrapS", 33071}, {"wrapT", 33071}})}};
  maker.place(gltf_card(.2f, .3f), maker.material({{"name", "leaf"},
                                                   {"pbrMetallicRoughness", pbr},
                                                   {"alphaMode", "MASK"},
                                                   {"alphaCutoff", .5f},
                                                   {"doubleSided", true}}));
  return maker;
}

GltfMaker glass_ball() {
  return ball({}, {{"name", "glass"},
                   {"pbrMetallicRoughness", metallic_roughness({.9f, 1, .95f, .2f}, 0, .03f)},
                   {"alphaMode", "BLEND"}});
}

GltfMaker emissive_sign() {
  GltfMaker maker;
  maker.use("KHR_materials_emissive_strength");
  // An arrow to the right.
  const auto arrow = painted([](float u, float v) {
    const float y = std::abs(v - .5f);
    const bool shaft = u > .15f && u < .55f && y < .1f;
    const bool head = u >= .55f && u < .85f && y < .3f * (.85f - u) / .3f;
    return shaft || head ? Rgba8{255, 180, 60, 255} : Rgba8{0, 0, 0, 255};
  });
  maker.place(
      gltf_box({.4f, .25f, .04f}),
      maker.material(
          {{"name", "sign"},
           {"pbrMetallicRoughness", metallic_roughness({.05f, .05f, .05f, 1}, 0, .6f)},
           {"emissiveFactor", {1, 1, 1}},
           {"emissiveTexture", {{"index", maker.texture(arrow)}}},
           {"extensions", {{"KHR_materials_emissive_strength", {{"emissiveStrength", 8}}}}}}));
  return maker;
}

}  // namespace penumbra::test
