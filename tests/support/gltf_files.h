// Small glTF files with skins, clips and morph targets, written by hand.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

namespace penumbra::test {

/// Collects accessors in one buffer, which goes into the file as base64.
class GltfBuffer {
 public:
  int floats(const std::vector<float>& values, const std::string& type, std::size_t count,
             const std::string& more = "") {
    return add(values.data(), values.size() * 4, 5126, type, count, more);
  }
  int shorts(const std::vector<std::uint16_t>& values, const std::string& type, std::size_t count) {
    return add(values.data(), values.size() * 2, 5123, type, count, "");
  }
  /// `scene` holds nodes, meshes, skins, animations; all but asset, accessors, bufferViews,
  /// buffers.
  std::string file(const std::string& scene) const {
    return R"({"asset":{"version":"2.0"},"scene":0,)" + scene + R"(,"accessors":[)" + accessors_ +
           R"(],"bufferViews":[)" + views_ + R"(],"buffers":[{"byteLength":)" +
           std::to_string(bytes_.size()) + R"(,"uri":"data:application/octet-stream;base64,)" +
           base64() + R"("}]})";
  }
  void write(const std::filesystem::path& path, const std::string& scene) const {
    std::ofstream(path) << file(scene);
  }

 private:
  int add(const void* data, std::size_t size, int component, const std::string& type,
          std::size_t count, const std::string& more) {
    while (bytes_.size() % 4 != 0) bytes_.push_back(0);
    const std::string comma = count_ > 0 ? "," : "";
    views_ += comma + R"({"buffer":0,"byteOffset":)" + std::to_string(bytes_.size()) +
              R"(,"byteLength":)" + std::to_string(size) + "}";
    accessors_ += comma + R"({"bufferView":)" + std::to_string(count_) + R"(,"componentType":)" +
                  std::to_string(component) + R"(,"count":)" + std::to_string(count) +
                  R"(,"type":")" + type + "\"" + more + "}";
    const auto* p = static_cast<const unsigned char*>(data);
    bytes_.insert(bytes_.end(), p, p + size);
    return count_++;
  }
  std::string base64() const {
    static constexpr char kDigits[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    for (std::size_t i = 0; i < bytes_.size(); i += 3) {
      std::uint32_t v = std::uint32_t{bytes_[i]} << 16;
      if (i + 1 < bytes_.size()) v |= std::uint32_t{bytes_[i + 1]} << 8;
      if (i + 2 < bytes_.size()) v |= bytes_[i + 2];
      for (int k = 0; k < 4; ++k)
        out +=
            i + static_cast<std::size_t>(k) > bytes_.size() ? '=' : kDigits[v >> (18 - 6 * k) & 63];
    }
    return out;
  }
  std::vector<unsigned char> bytes_;
  std::string accessors_, views_;
  int count_ = 0;
};

/// A quad of two triangles that two joints hold: the upper joint, at (0, 1, 0), turns by a quarter
/// about z within a second. `weights`: four of the first and the second joint for each of the four
/// vertices.
inline void write_bending_quad(const std::filesystem::path& path,
                               const std::vector<float>& weights) {
  GltfBuffer b;
  b.floats({0, 0, 0, 1, 0, 0, 0, 2, 0, 1, 2, 0}, "VEC3", 4, R"(,"min":[0,0,0],"max":[1,2,0])");
  b.shorts({0, 1, 2, 2, 1, 3}, "SCALAR", 6);
  b.shorts({0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}, "VEC4", 4);
  b.floats(weights, "VEC4", 4);
  b.floats({1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0,  0, 1,
            1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -1, 0, 1},
           "MAT4", 2);
  b.floats({0, 1}, "SCALAR", 2, R"(,"min":[0],"max":[1])");
  b.floats({0, 0, 0, 1, 0, 0, .70710678f, .70710678f}, "VEC4", 2);
  b.write(path, R"("scenes":[{"nodes":[0,1]}],
    "nodes":[{"mesh":0,"skin":0},{"name":"lower","children":[2]},{"name":"upper","translation":[0,1,0]}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":2,"WEIGHTS_0":3},"indices":1}]}],
    "skins":[{"joints":[1,2],"inverseBindMatrices":4}],
    "animations":[{"name":"Bend","channels":[{"sampler":0,"target":{"node":2,"path":"rotation"}}],
                   "samplers":[{"input":5,"output":6,"interpolation":"LINEAR"}]}])");
}

/// A triangle that a morph target lifts by 2 along z, its weight going from 0 to 1 within a second,
/// under a node that goes from x = 0 to x = 4 meanwhile.
inline void write_morphing_triangle(const std::filesystem::path& path) {
  GltfBuffer b;
  b.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3, R"(,"min":[0,0,0],"max":[1,1,0])");
  b.floats({0, 0, 2, 0, 0, 2, 0, 0, 2}, "VEC3", 3, R"(,"min":[0,0,2],"max":[0,0,2])");
  b.floats({0, 1}, "SCALAR", 2, R"(,"min":[0],"max":[1])");
  b.floats({0, 1}, "SCALAR", 2);
  b.floats({0, 0, 0, 4, 0, 0}, "VEC3", 2);
  b.write(path, R"("scenes":[{"nodes":[0]}],"nodes":[{"name":"thing","mesh":0}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0},"targets":[{"POSITION":1}]}],"weights":[0]}],
    "animations":[{"name":"Grow","channels":[{"sampler":0,"target":{"node":0,"path":"weights"}},
                                              {"sampler":1,"target":{"node":0,"path":"translation"}}],
                   "samplers":[{"input":2,"output":3},{"input":2,"output":4}]}])");
}

/// A tetrahedron of height 1 that stands still for a second, but for one moment in the middle, at
/// which it is `dip` lower.
inline void write_dipping_tetrahedron(const std::filesystem::path& path, float dip) {
  GltfBuffer b;
  b.floats({0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0}, "VEC3", 4, R"(,"min":[0,0,0],"max":[1,1,1])");
  b.shorts({0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2}, "SCALAR", 12);
  b.floats({0, .45f, .5f, .55f, 1}, "SCALAR", 5, R"(,"min":[0],"max":[1])");
  b.floats({0, 0, 0, 0, 0, 0, 0, -dip, 0, 0, 0, 0, 0, 0, 0}, "VEC3", 5);
  b.write(path, R"("scenes":[{"nodes":[0]}],"nodes":[{"name":"thing","mesh":0}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
    "animations":[{"name":"Dip","channels":[{"sampler":0,"target":{"node":0,"path":"translation"}}],
                   "samplers":[{"input":2,"output":3}]}])");
}

}  // namespace penumbra::test
