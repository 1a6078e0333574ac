// Nine assets of known materials, some 0.3 m high: what a contact sheet shows.
// threads: reentrant
#pragma once

#include "tests/support/gltf_maker.h"

namespace penumbra::test {

GltfMaker gold_ball();           // metal, roughness 0.15
GltfMaker chrome_ball();         // metal, roughness 0.02
GltfMaker brushed_metal_ball();  // metal, roughness in streaks by a map
GltfMaker plastic_ball();        // red, roughness 0.3, with a clear coat
GltfMaker rubber_ball();         // nearly black, roughness 0.95, bumps by a normal map
GltfMaker wooden_box();          // rings by a picture, rough by a map
GltfMaker masked_leaf();         // a card whose picture's alpha cuts a leaf out, double-sided
GltfMaker glass_ball();          // blended, opacity 0.2, smooth
GltfMaker emissive_sign();       // a dark box whose picture shines at 8 times white paper

struct NamedAsset {
  const char* name;
  GltfMaker (*make)();
};
inline constexpr NamedAsset kGltfAssets[] = {
    {"gold", gold_ball},       {"chrome", chrome_ball}, {"brushed_metal", brushed_metal_ball},
    {"plastic", plastic_ball}, {"rubber", rubber_ball}, {"wood", wooden_box},
    {"leaf", masked_leaf},     {"glass", glass_ball},   {"sign", emissive_sign}};

}  // namespace penumbra::test
