// glTF files. An even length: a whole file with bytes changed, three bytes a change and one the
// value; an odd one: a file.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/mesh.h"
#include "tests/fuzz/file_input.h"

namespace {

using namespace penumbra;

// A textured triangle with most of what the reader knows, as binary glTF.
const std::vector<unsigned char>& whole_file() {
  static const std::vector<unsigned char> file = [] {
    std::string json = R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
      "extensionsUsed":["EXT_mesh_gpu_instancing","KHR_texture_transform","KHR_materials_ior"],
      "nodes":[{"mesh":0,"scale":[-1,1,1],"children":[1]},{"mesh":0,"rotation":[0,0,0,1],"extensions":
        {"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":0}}}}],
      "meshes":[{"primitives":[{"attributes":{"POSITION":0,"NORMAL":0,"TEXCOORD_0":1,"COLOR_0":0},
        "indices":2,"material":0,"mode":5},{"attributes":{"POSITION":3,"TEXCOORD_1":1},"material":1}]}],
      "materials":[{"normalTexture":{"index":0,"scale":2},"alphaMode":"MASK","emissiveFactor":[1,1,1],
        "pbrMetallicRoughness":{"metallicFactor":0.5,"baseColorTexture":{"index":0,"extensions":
        {"KHR_texture_transform":{"scale":[2,2],"rotation":1,"texCoord":1}}}},"extensions":
        {"KHR_materials_ior":{"ior":1.3}}},{"pbrMetallicRoughness":{"baseColorFactor":[1,0,0,1]}}],
      "textures":[{"source":0,"sampler":0}],"samplers":[{"wrapS":33071,"magFilter":9728}],
      "images":[{"bufferView":2,"mimeType":"image/png"}],
      "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3},
        {"bufferView":0,"componentType":5123,"type":"VEC2","count":3,"normalized":true},
        {"bufferView":1,"componentType":5121,"type":"SCALAR","count":3},
        {"bufferView":0,"componentType":5126,"type":"VEC3","count":3,"sparse":{"count":1,"indices":
        {"bufferView":1,"componentType":5121},"values":{"bufferView":0}}}],
      "bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":3},
        {"buffer":0,"byteOffset":40,"byteLength":70}],"buffers":[{"byteLength":110}]})";
    // Three places, three indices, a PNG of one pixel.
    const unsigned char binary[] = {
        0,   0,  0,   0,  0,  0,   0,   0,  0,  0,   0,   0,   0,  0,  128, 63,  0,  0,  0,
        0,   0,  0,   0,  0,  0,   0,   0,  0,  0,   0,   128, 63, 0,  0,   0,   0,  0,  1,
        2,   0,  137, 80, 78, 71,  13,  10, 26, 10,  0,   0,   0,  13, 73,  72,  68, 82, 0,
        0,   0,  1,   0,  0,  0,   1,   8,  6,  0,   0,   0,   31, 21, 196, 137, 0,  0,  0,
        13,  73, 68,  65, 84, 120, 156, 99, 56, 208, 224, 208, 0,  0,  5,   133, 2,  1,  208,
        194, 0,  43,  0,  0,  0,   0,   73, 69, 78,  68,  174, 66, 96, 130, 0,   0};
    json.resize((json.size() + 3) / 4 * 4, ' ');
    std::vector<unsigned char> out;
    const auto word = [&](std::size_t v) {
      for (int i = 0; i < 4; ++i) out.push_back(static_cast<unsigned char>(v >> 8 * i & 255));
    };
    word(0x46546c67), word(2), word(28 + json.size() + sizeof(binary));
    word(json.size()), word(0x4e4f534a);
    out.insert(out.end(), json.begin(), json.end());
    word(sizeof(binary)), word(0x004e4942);
    out.insert(out.end(), std::begin(binary), std::end(binary));
    return out;
  }();
  return file;
}

// What is read is sound.
void check(const prt::Import& import) {
  const std::size_t n = import.mesh.positions.size();
  bool sound = import.mesh.normals.size() == n && import.mesh.albedo.size() == n;
  for (const auto& t : import.mesh.triangles)
    for (const auto i : t) sound &= i < n;
  for (const Rgb& a : import.mesh.albedo) sound &= a.r >= 0 && a.g >= 0 && a.b >= 0 && a.r <= 1;
  if (import.surface) {
    sound &= import.surface->material.size() == n;
    for (const auto m : import.surface->material) sound &= m < import.surface->materials.size();
    for (const glm::vec4& t : import.surface->tangents) sound &= std::isfinite(t.x + t.y + t.z);
  }
  if (!sound) __builtin_trap();
}

}  // namespace

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<unsigned char> bytes(data, data + size);
  if (size % 2 == 0) bytes = test::edited(whole_file(), data, size);
  // A folder that holds no files to be named.
  if (const auto import =
          prt::gltf::import_bytes(std::move(bytes), "/proc/self/task/mesh.glb", {.5f, .5f, .5f}))
    check(*import);
  return 0;
}
