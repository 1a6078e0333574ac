// Makes glTF files in memory: JSON, buffers, pictures, simple shapes.
// threads: one thread at a time
#pragma once

#include <cstdint>
#include <filesystem>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/image.h"
#include "prt/geometry/material.h"

namespace penumbra::test {

struct GltfShape {
  std::vector<glm::vec3> positions, normals;
  std::vector<glm::vec2> coordinates;  // v down
  std::vector<std::uint32_t> indices;  // counter-clockwise seen from outside
};
/// Resting on y = 0, the picture once around it.
GltfShape gltf_sphere(float radius, int rings);
/// Resting on y = 0, the picture upright and whole on each face.
GltfShape gltf_box(glm::vec3 size);
/// Upright on y = 0 in the plane z = 0, seen from +z.
GltfShape gltf_card(float width, float height);

/// PNG with alpha, or JPEG without.
std::vector<unsigned char> encoded(const Image<prt::Rgba8>& picture, const std::string& extension);

class GltfMaker {
 public:
  /// What the lists below fill; a test may add what it needs, or damage it.
  nlohmann::json root = {{"asset", {{"version", "2.0"}, {"generator", "penumbra tests"}}}};

  int view(const void* data, std::size_t bytes, nlohmann::json more = nlohmann::json::object());
  /// Elements of `components` numbers of one of the component types 5120 to 5126.
  int accessor(const void* data, std::size_t bytes, int component_type, int components,
               std::size_t count, nlohmann::json more = nlohmann::json::object());
  int floats(const std::vector<float>& values, int components);
  int vec2(const std::vector<glm::vec2>& values);
  int vec3(const std::vector<glm::vec3>& values);
  int indices(const std::vector<std::uint32_t>& values);
  /// A picture in the buffer, and a texture of it.
  int texture(const Image<prt::Rgba8>& picture, const std::string& extension = ".png",
              nlohmann::json sampler = nullptr);
  /// Adds to a list of the root and returns the place.
  int add(const char* list, nlohmann::json thing);
  int material(nlohmann::json thing) { return add("materials", std::move(thing)); }
  /// A primitive with positions, normals and coordinates.
  nlohmann::json primitive(const GltfShape& shape, int material = -1);
  int mesh(nlohmann::json primitives, const char* name = "thing");
  /// A node of the scene.
  int node(nlohmann::json thing);
  /// A mesh of one primitive in a node of its own.
  void place(const GltfShape& shape, int material = -1);
  void use(const char* extension, bool required = false);

  /// The bytes as a data URI.
  std::string gltf() const;
  std::vector<unsigned char> glb() const;
  void write_gltf(const std::filesystem::path& path) const;
  void write_glb(const std::filesystem::path& path) const;
  const std::vector<unsigned char>& bytes() const { return bytes_; }

 private:
  std::vector<unsigned char> bytes_;
};

}  // namespace penumbra::test
