#include "tests/support/gltf_maker.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <numbers>
#include <utility>

#include "codec/codec.h"

namespace penumbra::test {

namespace {

std::string base64(const std::vector<unsigned char>& bytes) {
  static constexpr char kDigits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t v = std::uint32_t{bytes[i]} << 16;
    if (i + 1 < bytes.size()) v |= std::uint32_t{bytes[i + 1]} << 8;
    if (i + 2 < bytes.size()) v |= bytes[i + 2];
    for (std::size_t k = 0; k < 4; ++k)
      out += i + k > bytes.size() ? '=' : kDigits[v >> (18 - 6 * k) & 63];
  }
  return out;
}

}  // namespace

GltfShape gltf_sphere(float radius, int rings) {
  GltfShape out;
  const int sides = 2 * rings;
  for (int j = 0; j <= rings; ++j)
    for (int i = 0; i <= sides; ++i) {
      const float u = static_cast<float>(i) / static_cast<float>(sides),
                  v = static_cast<float>(j) / static_cast<float>(rings);
      // The seam's and the poles' vertices share their places to the bit.
      const float around = static_cast<float>(i % sides) / static_cast<float>(sides);
      const float phi = 2 * std::numbers::pi_v<float> * around,
                  theta = std::numbers::pi_v<float> * v;
      const float ring = j == 0 || j == rings ? 0 : std::sin(theta);
      const glm::vec3 n(ring * std::sin(phi), std::cos(theta), ring * std::cos(phi));
      out.normals.push_back(n);
      out.positions.push_back(radius * (n + glm::vec3(0, 1, 0)));
      out.coordinates.emplace_back(u, v);
    }
  const auto at = [&](int i, int j) { return static_cast<std::uint32_t>(j * (sides + 1) + i); };
  for (int j = 0; j < rings; ++j)
    for (int i = 0; i < sides; ++i) {
      if (j + 1 < rings)
        out.indices.insert(out.indices.end(), {at(i, j), at(i, j + 1), at(i + 1, j + 1)});
      if (j > 0) out.indices.insert(out.indices.end(), {at(i, j), at(i + 1, j + 1), at(i + 1, j)});
    }
  return out;
}

GltfShape gltf_box(glm::vec3 size) {
  GltfShape out;
  struct Face {
    glm::vec3 normal, right, up;
  };
  const Face faces[] = {{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}},   {{1, 0, 0}, {0, 0, -1}, {0, 1, 0}},
                        {{0, 0, -1}, {-1, 0, 0}, {0, 1, 0}}, {{-1, 0, 0}, {0, 0, 1}, {0, 1, 0}},
                        {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}},  {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}};
  for (const Face& f : faces) {
    const auto first = static_cast<std::uint32_t>(out.positions.size());
    for (const glm::vec2 uv : {glm::vec2(0, 0), {0, 1}, {1, 1}, {1, 0}}) {
      const glm::vec3 p = f.normal + (2 * uv.x - 1) * f.right + (1 - 2 * uv.y) * f.up;
      out.positions.push_back(.5f * size * (p + glm::vec3(0, 1, 0)));
      out.normals.push_back(f.normal);
      out.coordinates.push_back(uv);
    }
    out.indices.insert(out.indices.end(),
                       {first, first + 1, first + 2, first, first + 2, first + 3});
  }
  return out;
}

GltfShape gltf_card(float width, float height) {
  GltfShape out;
  for (const glm::vec2 uv : {glm::vec2(0, 0), {0, 1}, {1, 1}, {1, 0}}) {
    out.positions.emplace_back((uv.x - .5f) * width, (1 - uv.y) * height, 0);
    out.normals.emplace_back(0, 0, 1);
    out.coordinates.push_back(uv);
  }
  out.indices = {0, 1, 2, 0, 2, 3};
  return out;
}

std::vector<unsigned char> encoded(const Image<prt::Rgba8>& picture, const std::string& extension) {
  if (extension == ".png") {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(picture.width());
    image.height = static_cast<png_uint_32>(picture.height());
    image.format = PNG_FORMAT_RGBA;
    png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
    std::vector<unsigned char> out(size);
    png_image_write_to_memory(&image, out.data(), &size, 0, picture.pixels().data(), 0, nullptr);
    out.resize(size);
    return out;
  }
  Image<Rgb8> colours(picture.width(), picture.height());
  std::ranges::transform(picture.pixels(), colours.pixels().begin(), [](const prt::Rgba8& c) {
    return Rgb8{c.r, c.g, c.b};
  });
  return codec::encode_jpeg(colours, 95).value_or(std::vector<unsigned char>());
}

int GltfMaker::add(const char* list, nlohmann::json thing) {
  root[list].push_back(std::move(thing));
  return static_cast<int>(root[list].size()) - 1;
}

int GltfMaker::view(const void* data, std::size_t bytes, nlohmann::json more) {
  while (bytes_.size() % 4 != 0) bytes_.push_back(0);
  more["buffer"] = 0;
  more["byteOffset"] = bytes_.size();
  more["byteLength"] = bytes;
  const auto* first = static_cast<const unsigned char*>(data);
  bytes_.insert(bytes_.end(), first, first + bytes);
  return add("bufferViews", std::move(more));
}

int GltfMaker::accessor(const void* data, std::size_t bytes, int component_type, int components,
                        std::size_t count, nlohmann::json more) {
  static constexpr std::array kTypes = {"SCALAR", "VEC2", "VEC3", "VEC4"};
  more["bufferView"] = view(data, bytes);
  more["componentType"] = component_type;
  more["type"] = kTypes.at(static_cast<std::size_t>(components - 1));
  more["count"] = count;
  return add("accessors", std::move(more));
}

int GltfMaker::floats(const std::vector<float>& values, int components) {
  return accessor(values.data(), values.size() * 4, 5126, components,
                  values.size() / static_cast<std::size_t>(components));
}

int GltfMaker::vec2(const std::vector<glm::vec2>& values) {
  return accessor(values.data(), values.size() * 8, 5126, 2, values.size());
}

int GltfMaker::vec3(const std::vector<glm::vec3>& values) {
  glm::vec3 low = values.empty() ? glm::vec3(0) : values[0], high = low;
  for (const glm::vec3& v : values) low = glm::min(low, v), high = glm::max(high, v);
  return accessor(values.data(), values.size() * 12, 5126, 3, values.size(),
                  {{"min", {low.x, low.y, low.z}}, {"max", {high.x, high.y, high.z}}});
}

int GltfMaker::indices(const std::vector<std::uint32_t>& values) {
  return accessor(values.data(), values.size() * 4, 5125, 1, values.size());
}

int GltfMaker::texture(const Image<prt::Rgba8>& picture, const std::string& extension,
                       nlohmann::json sampler) {
  const auto bytes = encoded(picture, extension);
  const int image = add("images", {{"bufferView", view(bytes.data(), bytes.size())},
                                   {"mimeType", extension == ".png" ? "image/png" : "image/jpeg"}});
  nlohmann::json out = {{"source", image}};
  if (!sampler.is_null()) out["sampler"] = add("samplers", std::move(sampler));
  return add("textures", std::move(out));
}

nlohmann::json GltfMaker::primitive(const GltfShape& shape, int material) {
  nlohmann::json out = {{"attributes", {{"POSITION", vec3(shape.positions)}}},
                        {"indices", indices(shape.indices)}};
  if (!shape.normals.empty()) out["attributes"]["NORMAL"] = vec3(shape.normals);
  if (!shape.coordinates.empty()) out["attributes"]["TEXCOORD_0"] = vec2(shape.coordinates);
  if (material >= 0) out["material"] = material;
  return out;
}

int GltfMaker::mesh(nlohmann::json primitives, const char* name) {
  return add("meshes", {{"name", name}, {"primitives", std::move(primitives)}});
}

int GltfMaker::node(nlohmann::json thing) {
  const int out = add("nodes", std::move(thing));
  if (!root.contains("scenes")) root["scenes"] = {{{"nodes", nlohmann::json::array()}}};
  root["scenes"][0]["nodes"].push_back(out);
  root["scene"] = 0;
  return out;
}

void GltfMaker::place(const GltfShape& shape, int material) {
  node({{"mesh", mesh(nlohmann::json::array({primitive(shape, material)}))}});
}

void GltfMaker::use(const char* extension, bool required) {
  root["extensionsUsed"].push_back(extension);
  if (required) root["extensionsRequired"].push_back(extension);
}

std::string GltfMaker::gltf() const {
  nlohmann::json out = root;
  if (!bytes_.empty() && !out.contains("buffers"))
    out["buffers"] = {{{"byteLength", bytes_.size()},
                       {"uri", "data:application/octet-stream;base64," + base64(bytes_)}}};
  return out.dump();
}

std::vector<unsigned char> GltfMaker::glb() const {
  nlohmann::json json = root;
  if (!bytes_.empty() && !json.contains("buffers"))
    json["buffers"] = {{{"byteLength", bytes_.size()}}};
  std::string text = json.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  std::vector<unsigned char> out;
  const auto word = [&](std::size_t v) {
    for (int i = 0; i < 4; ++i) out.push_back(static_cast<unsigned char>(v >> 8 * i & 255));
  };
  const std::size_t binary = (bytes_.size() + 3) / 4 * 4;
  word(0x46546c67), word(2), word(12 + 8 + text.size() + (binary > 0 ? 8 + binary : 0));
  word(text.size()), word(0x4e4f534a);
  out.insert(out.end(), text.begin(), text.end());
  if (binary == 0) return out;
  word(binary), word(0x004e4942);
  out.insert(out.end(), bytes_.begin(), bytes_.end());
  out.resize(out.size() + binary - bytes_.size(), 0);
  return out;
}

void GltfMaker::write_gltf(const std::filesystem::path& path) const {
  std::ofstream(path, std::ios::binary) << gltf();
}

void GltfMaker::write_glb(const std::filesystem::path& path) const {
  const auto file = glb();
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(file.data()), static_cast<std::streamsize>(file.size()));
}

}  // namespace penumbra::test
