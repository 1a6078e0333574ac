#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <fstream>
#include <map>
#include <optional>
#include <utility>

#include "core/exceptions.h"
#include "core/half.h"
#include "core/io/files.h"
#include "prt/bake/bake.h"
#include "prt/bake/baked_file.h"
#include "prt/bake/internal/baked_surface.h"
#include "prt/bake/internal/model_reader.h"
#include "prt/bake/internal/model_writer.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/transfer.h"
#include "prt/transfer/visibility_map.h"

// Layout: one mesh with POSITION, NORMAL, COLOR_0 (albedo) and _TRANSFER_0.. as float vectors of
// four: value number channel * bands^2 + n stands in component (number % 4) of attribute (number /
// 4). With materials COLOR_0 is the vertices' tint, as viewers multiply it, and _ALBEDO the albedo;
// a primitive for each material shares the attributes. asset.extras.penumbra holds the rest; the
// reflected part and the receiver's texels are accessors of half-float bits in the order of
// prt::Transfer, the vertices' visibility three of words.

namespace penumbra::prt {
namespace {

constexpr int kVersion = 6;
using tinygltf::Model;
using tinygltf::Value;

Value number(double v) {
  return Value(v);
}

// Accessors of the transfers that no viewer needs.
struct OwnAccessors {
  int reflected = -1, ground_deficit = -1, ground_reflected = -1, shadow_probes = -1;
  int floor = -1, ground_floor = -1, floor_again = -1, ground_floor_again = -1;
  int visibility = -1, refined_visibility = -1, fine_visibility = -1;
};

Value::Object describe(const BakedObject& o, const OwnAccessors& own) {
  Value::Object d;
  d["version"] = Value(kVersion);
  d["bands"] = Value(o.transfer.bands);
  d["channels"] = Value(o.transfer.channels);
  d["reflected"] = Value(own.reflected);
  d["reflected_bands"] = Value(o.reflected.bands);
  d["rays"] = number(static_cast<double>(o.report.rays));
  d["seconds"] = number(o.report.seconds);
  d["standard_error"] = number(o.report.standard_error);
  if (!o.visibility.empty())
    d["visibility"] = Value(Value::Object{{"open", Value(own.visibility)},
                                          {"refined", Value(own.refined_visibility)},
                                          {"fine", Value(own.fine_visibility)}});
  if (o.receiver) {
    const GroundGrid& g = o.receiver->grid;
    const Rgb& a = o.receiver->albedo;
    Value::Object r;
    r["size"] = Value(g.size);
    r["centre_m"] = Value(Value::Array{number(g.centre.x), number(g.centre.y)});
    r["half_extent_m"] = number(g.half_extent);
    r["height_m"] = number(g.height);
    r["albedo"] = Value(Value::Array{number(a.r), number(a.g), number(a.b)});
    r["deficit"] = Value(own.ground_deficit);
    r["reflected"] = Value(own.ground_reflected);
    r["probes"] = Value(own.shadow_probes);
    if (o.floor.points > 0) {
      const Rgb& echo = o.floor_echo;
      r["floor"] = Value(Value::Object{
          {"surface", Value(own.floor)},
          {"ground", Value(own.ground_floor)},
          {"surface_again", Value(own.floor_again)},
          {"ground_again", Value(own.ground_floor_again)},
          {"again_bands", Value(o.floor_again.bands)},
          {"echo", Value(Value::Array{number(echo.r), number(echo.g), number(echo.b)})}});
    }
    r["probe_count"] = Value(static_cast<int>(o.shadow_probes.points));
    d["receiver"] = Value(r);
  }
  return d;
}

Model to_model(const BakedObject& o) {
  Model model;
  ModelWriter writer(model);
  std::map<std::string, int> attributes;
  attributes["POSITION"] = writer.add_vertices(o.mesh.positions, TINYGLTF_TYPE_VEC3);
  const Bounds b = bounds_of(o.mesh);
  model.accessors.back().minValues = {b.low.x, b.low.y, b.low.z};
  model.accessors.back().maxValues = {b.high.x, b.high.y, b.high.z};
  attributes["NORMAL"] = writer.add_vertices(o.mesh.normals, TINYGLTF_TYPE_VEC3);
  attributes[o.surface ? "_ALBEDO" : "COLOR_0"] =
      writer.add_vertices(o.mesh.albedo, TINYGLTF_TYPE_VEC3);
  const int per_channel = coefficient_count(o.transfer.bands),
            values = o.transfer.channels * per_channel;
  for (int first = 0; first < values; first += 4) {
    std::vector<std::array<float, 4>> quad(o.transfer.points);
    for (std::size_t p = 0; p < o.transfer.points; ++p)
      for (int k = 0; k < 4 && first + k < values; ++k)
        quad[p][static_cast<std::size_t>(k)] =
            o.transfer.value((first + k) / per_channel, (first + k) % per_channel, p);
    attributes[fmt::format("_TRANSFER_{}", first / 4)] =
        writer.add_vertices(quad, TINYGLTF_TYPE_VEC4);
  }
  add_surface(o.surface.get(), writer, attributes);
  add_primitives(o.mesh, o.surface.get(), writer, attributes);
  const auto add_halves = [&](const Transfer& t) {
    return writer.add(t.values.data(), t.values.size() * 2, t.values.size(),
                      TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_SCALAR, 0);
  };
  const auto add_words = [&](const void* data, std::size_t words) {
    return writer.add(data, words * 4, words, TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT,
                      TINYGLTF_TYPE_SCALAR, 0);
  };
  OwnAccessors own;
  own.reflected = add_halves(o.reflected);
  if (!o.visibility.empty()) {
    own.visibility = add_words(o.visibility.open.data(), o.visibility.open.size());
    own.refined_visibility =
        add_words(o.visibility.refined.data(), 2 * o.visibility.refined.size());
    // An accessor holds at least one.
    if (!o.visibility.fine.empty())
      own.fine_visibility = add_words(o.visibility.fine.data(), 2 * o.visibility.fine.size());
  }
  if (o.receiver) {
    own.ground_deficit = add_halves(o.ground_deficit);
    own.ground_reflected = add_halves(o.ground_reflected);
    if (o.floor.points > 0) {
      own.floor = add_halves(o.floor);
      own.ground_floor = add_halves(o.ground_floor);
      own.floor_again = add_halves(o.floor_again);
      own.ground_floor_again = add_halves(o.ground_floor_again);
    }
    if (o.shadow_probes.points > 0) own.shadow_probes = add_halves(o.shadow_probes);
  }
  model.nodes.emplace_back().mesh = 0;
  model.scenes.emplace_back().nodes = {0};
  model.defaultScene = 0;
  model.asset.version = "2.0";
  model.asset.generator = "penumbra";
  Value::Object extras;
  extras["penumbra"] = Value(describe(o, own));
  model.asset.extras = Value(extras);
  return model;
}

bool read_triangles(const Model& m, const tinygltf::Primitive& p, Mesh& mesh) {
  const auto indices =
      accessor_bytes(m, p.indices, TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR, 4);
  if (!indices || indices->size() % 12 != 0) return false;
  const std::size_t before = mesh.triangles.size();
  mesh.triangles.resize(before + indices->size() / 12);
  std::memcpy(mesh.triangles.data() + before, indices->data(), indices->size());
  return true;
}

bool read_mesh(const Model& m, Mesh& mesh) {
  const auto& primitives = m.meshes[0].primitives;
  const auto& p = primitives[0];
  const char* albedo = p.attributes.contains("_ALBEDO") ? "_ALBEDO" : "COLOR_0";
  if (!read_attribute(m, p, "POSITION", TINYGLTF_TYPE_VEC3, mesh.positions) ||
      !read_attribute(m, p, "NORMAL", TINYGLTF_TYPE_VEC3, mesh.normals) ||
      !read_attribute(m, p, albedo, TINYGLTF_TYPE_VEC3, mesh.albedo))
    return false;
  const std::size_t n = mesh.positions.size();
  if (n == 0 || mesh.normals.size() != n || mesh.albedo.size() != n) return false;
  for (const auto& part : primitives)
    if (part.attributes != p.attributes || !read_triangles(m, part, mesh)) return false;
  return !mesh.triangles.empty() && finite({&mesh.positions[0].x, 3 * n}) &&
         finite({&mesh.normals[0].x, 3 * n}) && finite({&mesh.albedo[0].r, 3 * n}) &&
         std::ranges::all_of(mesh.triangles,
                             [&](const auto& t) { return t[0] < n && t[1] < n && t[2] < n; });
}

bool read_transfer(const Model& m, const tinygltf::Primitive& p, int bands, int channels,
                   BakedObject& o) {
  o.transfer = Transfer(bands, channels, o.mesh.positions.size());
  const int per_channel = coefficient_count(bands), values = channels * per_channel;
  for (int first = 0; first < values; first += 4) {
    std::vector<std::array<float, 4>> quad;
    if (!read_attribute(m, p, fmt::format("_TRANSFER_{}", first / 4), TINYGLTF_TYPE_VEC4, quad) ||
        quad.size() != o.transfer.points || !finite({quad[0].data(), quad.size() * 4}))
      return false;
    for (std::size_t i = 0; i < quad.size(); ++i)
      for (int k = 0; k < 4 && first + k < values; ++k)
        o.transfer.set((first + k) / per_channel, (first + k) % per_channel, i,
                       quad[i][static_cast<std::size_t>(k)]);
  }
  return true;
}

double get(const Value& v, const char* key) {
  const Value& found = v.Get(key);
  return found.IsNumber() ? found.GetNumberAsDouble() : NAN;
}
double get(const Value& v, const char* key, int i) {
  const Value& found = v.Get(key);
  if (!found.IsArray() || found.ArrayLen() <= static_cast<std::size_t>(i)) return NAN;
  const Value& item = found.Get(i);
  return item.IsNumber() ? item.GetNumberAsDouble() : NAN;
}

// `index` as the file gives it; the file must hold the values before any room is made for them.
bool read_halves(const Model& m, double index, int bands, int channels, std::size_t points,
                 Transfer& out) {
  if (!(index >= 0 && index < static_cast<double>(m.accessors.size()))) return false;
  const auto bytes = accessor_bytes(
      m, static_cast<int>(index), TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_SCALAR, 2);
  const std::size_t values = (points + 63) / 64 * 64 * static_cast<std::size_t>(channels) *
                             static_cast<std::size_t>(coefficient_count(bands));
  if (!bytes || bytes->size() != values * 2) return false;
  out = Transfer(bands, channels, points);
  std::memcpy(out.values.data(), bytes->data(), bytes->size());
  return std::ranges::all_of(out.values, [](auto h) { return std::isfinite(float_from_half(h)); });
}

// Words of 32 bits.
template <class T>
bool read_words(const Model& m, double index, std::size_t count, CowVector<T>& out) {
  if (!(index >= 0 && index < static_cast<double>(m.accessors.size()))) return false;
  const auto bytes = accessor_bytes(m, static_cast<int>(index),
                                    TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR, 4);
  if (!bytes || bytes->size() != count * sizeof(T)) return false;
  out.resize(count);
  std::memcpy(out.data(), bytes->data(), bytes->size());
  return true;
}

bool read_visibility(const Model& m, const Value& own, std::size_t vertices, VisibilityMap& out) {
  if (!own.IsObject()) return false;
  if (!read_words(m, get(own, "open"), vertices * VisibilityMap::kWords, out.open) ||
      !read_words(m, get(own, "refined"), vertices, out.refined))
    return false;
  std::size_t blocks = 0;
  for (const std::uint64_t r : out.refined) blocks += static_cast<std::size_t>(std::popcount(r));
  return blocks == 0 || read_words(m, get(own, "fine"), blocks, out.fine);
}

bool read_floor(const Model& m, const Value& floor, std::size_t texels, BakedObject& o) {
  if (!floor.IsObject()) return false;
  o.floor_echo = {static_cast<float>(get(floor, "echo", 0)),
                  static_cast<float>(get(floor, "echo", 1)),
                  static_cast<float>(get(floor, "echo", 2))};
  for (int c = 0; c < 3; ++c)
    if (!(o.floor_echo[c] >= 0 && o.floor_echo[c] < 1)) return false;
  const double again = get(floor, "again_bands");
  if (!(again >= 1 && again <= kMaxBands)) return false;
  const auto read = [&](const char* surface, const char* ground, int bands, Transfer& to_surface,
                        Transfer& to_ground) {
    const int channels = o.transfer.channels;
    return read_halves(m, get(floor, surface), bands, channels, o.transfer.points, to_surface) &&
           read_halves(m, get(floor, ground), bands, channels, texels, to_ground);
  };
  return read("surface", "ground", o.reflected.bands, o.floor, o.ground_floor) &&
         read("surface_again", "ground_again", static_cast<int>(again), o.floor_again,
              o.ground_floor_again);
}

bool read_receiver(const Model& m, const Value& r, BakedObject& o) {
  if (!r.IsObject()) return false;
  GroundGrid g;
  const double size = get(r, "size");
  if (!(size >= 2 && size <= 4096)) return false;
  g.size = static_cast<int>(size);
  g.centre = {get(r, "centre_m", 0), get(r, "centre_m", 1)};
  g.half_extent = static_cast<float>(get(r, "half_extent_m"));
  g.height = static_cast<float>(get(r, "height_m"));
  const Rgb albedo{static_cast<float>(get(r, "albedo", 0)), static_cast<float>(get(r, "albedo", 1)),
                   static_cast<float>(get(r, "albedo", 2))};
  const float all[] = {g.centre.x, g.centre.y, g.half_extent, g.height,
                       albedo.r,   albedo.g,   albedo.b};
  if (!finite(all) || g.half_extent <= 0) return false;
  const double probes = get(r, "probe_count");
  if (!(probes >= 0 && probes <= BakedObject::kShadowProbes)) return false;
  if (probes > 0 && !read_halves(m, get(r, "probes"), kMaxBands, 1,
                                 static_cast<std::size_t>(probes), o.shadow_probes))
    return false;
  const std::size_t texels = static_cast<std::size_t>(g.size) * static_cast<std::size_t>(g.size);
  o.receiver = Receiver{g, albedo};
  if (r.Has("floor") && !read_floor(m, r.Get("floor"), texels, o)) return false;
  return read_halves(m, get(r, "deficit"), o.transfer.bands, o.transfer.channels, texels,
                     o.ground_deficit) &&
         read_halves(m, get(r, "reflected"), o.reflected.bands, o.transfer.channels, texels,
                     o.ground_reflected);
}

const Value* own_extras(const Model& m) {
  if (!m.asset.extras.IsObject() || !m.asset.extras.Has("penumbra")) return nullptr;
  const Value& own = m.asset.extras.Get("penumbra");
  return own.IsObject() ? &own : nullptr;
}

Result<BakedObject> from_model(const Model& m, const std::string& file) {
  const Value* extras = own_extras(m);
  if (!extras)
    return fail(ErrorCode::kInvalid, file, "is a glTF without baked transfer: bake it first");
  if (get(*extras, "version") != kVersion)
    return fail(ErrorCode::kInvalid, file,
                fmt::format("is not of version {}: bake it again", kVersion));
  const double bands = get(*extras, "bands"), channels = get(*extras, "channels");
  if (!(bands >= 1 && bands <= kMaxBands) || !(channels == 1 || channels == 3))
    return fail(ErrorCode::kUnreadable, file, "is damaged: its bands or channels are out of range");
  if (m.meshes.size() != 1 || m.meshes[0].primitives.empty())
    return fail(ErrorCode::kUnreadable, file, "is damaged: it does not have one mesh");
  BakedObject o;
  const auto& primitive = m.meshes[0].primitives[0];
  if (!read_mesh(m, o.mesh)) return fail(ErrorCode::kUnreadable, file, "has a damaged mesh");
  if (!read_transfer(m, primitive, static_cast<int>(bands), static_cast<int>(channels), o))
    return fail(ErrorCode::kUnreadable, file, "has damaged transfer");
  const double reflected_bands = get(*extras, "reflected_bands");
  if (!(reflected_bands >= 1 && reflected_bands <= kMaxBands) ||
      !read_halves(m, get(*extras, "reflected"), static_cast<int>(reflected_bands),
                   o.transfer.channels, o.transfer.points, o.reflected))
    return fail(ErrorCode::kUnreadable, file, "has damaged reflected transfer");
  if (extras->Has("visibility") &&
      !read_visibility(m, extras->Get("visibility"), o.transfer.points, o.visibility))
    return fail(ErrorCode::kUnreadable, file, "has a damaged visibility map");
  if (extras->Has("receiver") && !read_receiver(m, extras->Get("receiver"), o))
    return fail(ErrorCode::kUnreadable, file, "has a damaged receiver");
  const auto figure = [&](const char* key) {  // reports only: absent or damaged ones are 0
    const double v = get(*extras, key);
    return v >= 0 && v < 1e18 ? v : 0;
  };
  o.report = {
      static_cast<std::uint64_t>(figure("rays")), figure("seconds"), figure("standard_error"), {}};
  return o;
}

// A stream that failed half way is not reported: the header tells how long the file has to be.
bool is_whole(const std::filesystem::path& glb) {
  std::array<unsigned char, 12> header{};
  std::ifstream file(glb, std::ios::binary);
  if (!file.read(reinterpret_cast<char*>(header.data()), header.size())) return false;
  std::uint64_t length = 0;
  for (std::size_t i = 0; i < 4; ++i) length |= std::uint64_t{header[8 + i]} << 8 * i;
  std::error_code failed;
  return std::filesystem::file_size(glb, failed) == length && !failed;
}

}  // namespace

Result<void> write_baked(const std::filesystem::path& path, const BakedObject& object) {
  return replace_file(path, [&](const std::filesystem::path& temporary) -> Result<void> {
    Model model = to_model(object);
    if (!tinygltf::TinyGLTF().WriteGltfSceneToFile(&model, temporary.string(), true, true, false,
                                                   true))
      return fail(ErrorCode::kUnwritable, path.string(), "cannot be written");
    if (!is_whole(temporary))
      return fail(ErrorCode::kUnwritable, path.string(),
                  "cannot be written completely: is the disk full?");
    return {};
  });
}

Result<BakedObject> read_baked(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path));
  Model model;
  std::string error, warning;
  tinygltf::TinyGLTF loader;
  // Pictures are decoded with their materials.
  loader.SetImageLoader([](tinygltf::Image*, int, std::string*, std::string*, int, int,
                           const unsigned char*, int, void*) { return true; },
                        nullptr);
  try {
    if (!loader.LoadBinaryFromMemory(&model, &error, &warning, bytes.data(),
                                     static_cast<unsigned>(bytes.size()))) {
      std::ranges::replace(error, '\n', ' ');
      return fail(ErrorCode::kUnreadable, path.string(),
                  error.empty() ? "is not a binary glTF" : error);
    }
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, path.string(), reason_of(e));
  }
  PENUMBRA_ASSIGN(object, from_model(model, path.string()));
  PENUMBRA_ASSIGN(surface, read_surface(model, std::move(bytes), path, object.mesh));
  object.surface = std::move(surface);
  return std::move(object);
}

bool is_baked_file(const std::filesystem::path& path) {
  const auto bytes = read_bytes(path);
  if (!bytes || bytes->size() < 20 || std::memcmp(bytes->data(), "glTF", 4) != 0) return false;
  // The asset entry is part of the JSON chunk that opens the file.
  const std::string_view text(reinterpret_cast<const char*>(bytes->data()), bytes->size());
  return text.find("\"penumbra\"") != std::string_view::npos &&
         text.find("_TRANSFER_0") != std::string_view::npos;
}

}  // namespace penumbra::prt
