#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <glm/gtc/type_ptr.hpp>
#include <map>
#include <utility>

#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/gltf/internal/accessors.h"
#include "prt/geometry/gltf/internal/document.h"
#include "prt/geometry/gltf/internal/nodes.h"

namespace penumbra::prt::gltf {

namespace {

constexpr int kFloat = 5126;            // component type
constexpr std::size_t kMaxDepth = 500;  // of nodes: Assimp walks them on the stack

std::string base64(std::span<const unsigned char> bytes) {
  constexpr char kLetters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < n; ++k) word |= std::uint32_t{bytes[i + k]} << (16 - 8 * k);
    for (std::size_t k = 0; k < 4; ++k) out += k <= n ? kLetters[word >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

struct AccessorShape {
  std::size_t count = 0, components = 0;
  bool finite = true;
};

// A file in the form that Assimp reads: packed views unpacked, small numbers as floats, instances
// as nodes, matrices that a skin may leave out.
class ClipFile {
 public:
  explicit ClipFile(Document& document) : document_(document), json_(document.root()) {}

  Result<std::string> write() {
    PENUMBRA_TRY(check_nodes());
    PENUMBRA_TRY(check_animations());
    say_rest_of_moved_nodes();
    PENUMBRA_TRY(unpack_views());
    PENUMBRA_TRY(widen_attributes());
    PENUMBRA_TRY(give_skins_their_matrices());
    PENUMBRA_TRY(spread_instances());
    for (const char* list : {"extensionsRequired", "extensionsUsed"}) forget_extensions(list);
    if (!more_.empty())
      json_["buffers"].push_back({{"byteLength", more_.size()}, {"uri", uri_of(more_)}});
    return json_.dump(-1, ' ', false, Json::error_handler_t::replace);
  }

 private:
  static std::string uri_of(std::span<const unsigned char> bytes) {
    return "data:application/octet-stream;base64," + base64(bytes);
  }

  Result<void> check_nodes() {
    PENUMBRA_TRY(placed_meshes(document_));  // its checks alone
    const std::size_t count = document_.count("nodes");
    std::vector<std::size_t> parent(count, count);
    for (std::size_t i = 0; i < count; ++i)
      if (const Json* children = member(document_.at("nodes", i), "children"))
        for (const Json& child : *children) parent[child.get<std::size_t>()] = i;
    for (std::size_t i = 0; i < count; ++i) {
      std::size_t depth = 0;
      for (std::size_t at = i; parent[at] != count; at = parent[at])
        if (++depth > kMaxDepth)
          return document_.invalid(fmt::format("nests its nodes deeper than {}", kMaxDepth));
      const Json& node = document_.at("nodes", i);
      PENUMBRA_TRY(document_.reference(node, "skin", "skins", called("node", i, node)));
    }
    return {};
  }

  // Elements and components, each accessor read once.
  Result<AccessorShape> shape_of(const Json& sampler, const char* key, const std::string& whose) {
    PENUMBRA_ASSIGN(index, document_.reference(sampler, key, "accessors", whose));
    if (!index) return document_.invalid(whose + " has a sampler without values");
    const auto known = shapes_.find(*index);
    if (known != shapes_.end()) return known->second;
    const std::size_t any[] = {1, 3, 4};
    PENUMBRA_ASSIGN(values, read_numbers(document_, *index, any, whose));
    const bool finite =
        std::ranges::all_of(values.values, [](float v) { return std::isfinite(v); });
    return shapes_[*index] = {values.size(), values.components, finite};
  }

  // Assimp reads as many values as there are times.
  Result<void> check_sampler(const Json& sampler, const std::string& whose) {
    PENUMBRA_ASSIGN(times, shape_of(sampler, "input", whose));
    PENUMBRA_ASSIGN(values, shape_of(sampler, "output", whose));
    if (times.components != 1 || !times.finite)
      return document_.invalid(whose + " has times that are not finite");
    const Json* how = member(sampler, "interpolation");
    const std::size_t each = how && *how == "CUBICSPLINE" ? 3 : 1;
    if (values.count < each * times.count)
      return document_.invalid(whose + " has fewer values than times");
    return {};
  }

  Result<void> check_channel(const Json& channel, const Json& sampler, const std::string& whose) {
    const Json* target = member(channel, "target");
    const Json* path = target ? member(*target, "path") : nullptr;
    if (!target || !path || !path->is_string())
      return document_.invalid(whose + " has a channel without a path");
    PENUMBRA_TRY(document_.reference(*target, "node", "nodes", whose));
    PENUMBRA_ASSIGN(values, shape_of(sampler, "output", whose));
    const std::size_t wanted = *path == "rotation"                          ? 4
                               : *path == "translation" || *path == "scale" ? 3
                               : *path == "weights"                         ? 1
                                                                            : values.components;
    if (values.components != wanted)
      return document_.invalid(fmt::format("{} has values of {} numbers for a {}", whose,
                                           values.components, path->get<std::string>()));
    return {};
  }

  Result<void> check_animations() {
    for (std::size_t a = 0; a < document_.count("animations"); ++a) {
      const Json& clip = document_.at("animations", a);
      const std::string whose = called("animation", a, clip);
      const Json *samplers = member(clip, "samplers"), *channels = member(clip, "channels");
      if (!samplers || !samplers->is_array() || !channels || !channels->is_array())
        return document_.invalid(whose + " has no channels or no samplers");
      for (const Json& sampler : *samplers) PENUMBRA_TRY(check_sampler(sampler, whose));
      for (const Json& channel : *channels) {
        const auto sampler = whole(channel, "sampler", samplers->size());
        if (!sampler || *sampler >= samplers->size())
          return document_.invalid(whose + " has a channel without a sampler of its own");
        PENUMBRA_TRY(check_channel(channel, (*samplers)[*sampler], whose));
      }
    }
    return {};
  }

  // Of a node that moves, what the file does not say is none. Assimp would take it from the matrix,
  // where a mirror comes apart into another mirror and a turn.
  void say_rest_of_moved_nodes() {
    for (std::size_t a = 0; a < document_.count("animations"); ++a)
      for (const Json& channel : document_.at("animations", a)["channels"]) {
        const Json& target = channel["target"];
        if (!target.contains("node")) continue;
        Json& node = json_["nodes"][target["node"].get<std::size_t>()];
        if (node.contains("matrix")) continue;
        node.emplace("translation", Json{0, 0, 0});
        node.emplace("rotation", Json{0, 0, 0, 1});
        node.emplace("scale", Json{1, 1, 1});
      }
  }

  std::size_t add_view(std::span<const unsigned char> bytes) {
    more_.resize((more_.size() + 3) / 4 * 4);
    json_["bufferViews"].push_back({{"buffer", document_.count("buffers")},
                                    {"byteOffset", more_.size()},
                                    {"byteLength", bytes.size()}});
    more_.insert(more_.end(), bytes.begin(), bytes.end());
    return json_["bufferViews"].size() - 1;
  }

  std::size_t add_floats(std::span<const float> values, std::size_t count, const char* type) {
    std::vector<unsigned char> bytes(values.size_bytes());
    std::memcpy(bytes.data(), values.data(), bytes.size());
    json_["accessors"].push_back({{"bufferView", add_view(bytes)},
                                  {"componentType", kFloat},
                                  {"count", count},
                                  {"type", type}});
    return json_["accessors"].size() - 1;
  }

  Result<void> unpack_views() {
    constexpr const char* kPacked = "EXT_meshopt_compression";
    for (std::size_t i = 0; i < document_.count("bufferViews"); ++i) {
      if (!extension(document_.at("bufferViews", i), kPacked)) continue;
      PENUMBRA_ASSIGN(view, document_.view(i));
      const std::size_t added = add_view(view.bytes);
      Json unpacked = json_["bufferViews"][added];
      json_["bufferViews"].erase(added);
      if (view.stride > 0) unpacked["byteStride"] = view.stride;
      json_["bufferViews"][i] = std::move(unpacked);
    }
    for (std::size_t i = 0; i < document_.count("buffers"); ++i)
      if (extension(document_.at("buffers", i), kPacked)) {
        constexpr std::array<unsigned char, 4> kNothing{};  // nobody reads it any longer
        json_["buffers"][i] = {{"byteLength", kNothing.size()}, {"uri", uri_of(kNothing)}};
      }
    return {};
  }

  Result<void> widen(Json& attributes, const std::string& whose) {
    constexpr std::array<const char*, 5> kWidened = {"POSITION", "NORMAL", "TANGENT", "TEXCOORD_0",
                                                     "TEXCOORD_1"};
    constexpr std::array<const char*, 5> kTypes = {"", "SCALAR", "VEC2", "VEC3", "VEC4"};
    for (const char* key : kWidened) {
      PENUMBRA_ASSIGN(index, document_.reference(attributes, key, "accessors", whose));
      if (!index || whole(document_.at("accessors", *index), "componentType", 0) == kFloat)
        continue;
      if (!widened_.contains(*index)) {
        const std::size_t some[] = {2, 3, 4};
        PENUMBRA_ASSIGN(values, read_numbers(document_, *index, some, whose));
        widened_[*index] = add_floats(values.values, values.size(), kTypes[values.components]);
      }
      attributes[key] = widened_[*index];
    }
    return {};
  }

  Result<void> widen_attributes() {
    for (std::size_t m = 0; m < document_.count("meshes"); ++m) {
      Json& mesh = json_["meshes"][m];
      const std::string whose = called("mesh", m, mesh);
      if (!mesh.is_object() || !mesh.contains("primitives") || !mesh["primitives"].is_array())
        return document_.invalid(whose + " has no primitives");
      for (Json& primitive : mesh["primitives"]) {
        if (extension(primitive, "KHR_draco_mesh_compression"))
          return document_.invalid(whose +
                                   " is packed by KHR_draco_mesh_compression, which is read "
                                   "without clips alone: save it unpacked");
        if (primitive.is_object() && primitive.contains("attributes"))
          PENUMBRA_TRY(widen(primitive["attributes"], whose));
        if (!primitive.is_object() || !primitive.contains("targets")) continue;
        for (Json& target : primitive["targets"]) PENUMBRA_TRY(widen(target, whose));
      }
    }
    return {};
  }

  Result<void> give_skins_their_matrices() {
    for (std::size_t s = 0; s < document_.count("skins"); ++s) {
      const Json& skin = document_.at("skins", s);
      const std::string whose = called("skin", s, skin);
      const Json* joints = member(skin, "joints");
      if (!joints || !joints->is_array() || joints->empty())
        return document_.invalid(whose + " has no joints");
      for (const Json& joint : *joints)
        if (!joint.is_number_unsigned() || joint.get<std::uint64_t>() >= document_.count("nodes"))
          return document_.invalid(whose + " has a joint that is not there");
      PENUMBRA_ASSIGN(given, document_.reference(skin, "inverseBindMatrices", "accessors", whose));
      if (given) {
        const std::size_t matrix[] = {16};
        PENUMBRA_ASSIGN(matrices, read_numbers(document_, *given, matrix, whose));
        if (matrices.size() < joints->size())
          return document_.invalid(whose + " has fewer matrices than joints");
        continue;
      }
      std::vector<float> values;
      for (std::size_t j = 0; j < joints->size(); ++j)
        for (int i = 0; i < 16; ++i) values.push_back(i % 5 == 0 ? 1.f : 0.f);
      json_["skins"][s]["inverseBindMatrices"] = add_floats(values, joints->size(), "MAT4");
    }
    return {};
  }

  Result<void> spread_instances() {
    std::size_t placed = 0;  // below the limit as long as the loop goes on
    for (std::size_t i = 0; i < document_.count("nodes"); ++i) {
      const Json& node = document_.at("nodes", i);
      if (!extension(node, "EXT_mesh_gpu_instancing") || !member(node, "mesh")) continue;
      PENUMBRA_ASSIGN(places, instance_matrices(document_, node, called("node", i, node)));
      if (places.size() > kMaxPlaced - std::exchange(placed, placed + places.size()))
        return document_.invalid(fmt::format("places more than {} meshes", kMaxPlaced));
      const Json mesh = node.at("mesh");
      Json children = json_["nodes"][i].value("children", Json::array());
      for (const glm::dmat4& place : places) {
        const std::vector<double> matrix(glm::value_ptr(place), glm::value_ptr(place) + 16);
        json_["nodes"].push_back({{"mesh", mesh}, {"matrix", matrix}});
        children.push_back(json_["nodes"].size() - 1);
      }
      json_["nodes"][i].erase("mesh");
      json_["nodes"][i].erase("extensions");
      json_["nodes"][i]["children"] = std::move(children);
    }
    return {};
  }

  void forget_extensions(const char* list) {
    const auto found = json_.find(list);
    if (found == json_.end() || !found->is_array()) return;
    Json kept = Json::array();
    for (const Json& name : *found)
      if (name != "EXT_meshopt_compression" && name != "KHR_mesh_quantization" &&
          name != "EXT_mesh_gpu_instancing")
        kept.push_back(name);
    if (kept.empty())
      json_.erase(list);
    else
      json_[list] = std::move(kept);
  }

  Document& document_;
  Json json_;
  std::vector<unsigned char> more_;
  std::map<std::size_t, std::size_t> widened_;   // accessors, by those of the file
  std::map<std::size_t, AccessorShape> shapes_;  // likewise
};

void put_word(std::vector<unsigned char>& out, std::size_t word) {
  for (int i = 0; i < 4; ++i) out.push_back(static_cast<unsigned char>(word >> 8 * i & 255));
}

}  // namespace

Result<std::vector<unsigned char>> clip_file_bytes(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(document, Document::open(path));
  PENUMBRA_ASSIGN(json, ClipFile(document).write());
  const auto binary = document.binary();
  if (!binary) return std::vector<unsigned char>(json.begin(), json.end());
  json.resize((json.size() + 3) / 4 * 4, ' ');
  std::vector<unsigned char> out = {'g', 'l', 'T', 'F', 2, 0, 0, 0};
  const std::size_t padded = (binary->size() + 3) / 4 * 4;
  put_word(out, 28 + json.size() + padded);
  put_word(out, json.size());
  out.insert(out.end(), {'J', 'S', 'O', 'N'});
  out.insert(out.end(), json.begin(), json.end());
  put_word(out, padded);
  out.insert(out.end(), {'B', 'I', 'N', 0});
  out.insert(out.end(), binary->begin(), binary->end());
  out.resize(out.size() + padded - binary->size());
  return out;
}

}  // namespace penumbra::prt::gltf
