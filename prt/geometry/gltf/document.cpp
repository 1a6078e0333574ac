#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/io/files.h"
#include "prt/geometry/gltf/internal/compression.h"
#include "prt/geometry/gltf/internal/document.h"

namespace penumbra::prt::gltf {

namespace {

constexpr std::uint32_t kGlb = 0x46546c67, kJsonChunk = 0x4e4f534a, kBinaryChunk = 0x004e4942;

// Those that are read, or whose absence changes little and is said.
constexpr std::array<std::string_view, 15> kKnown = {
    "KHR_texture_transform",      "KHR_materials_emissive_strength",
    "KHR_materials_unlit",        "KHR_materials_ior",
    "KHR_materials_specular",     "KHR_materials_clearcoat",
    "KHR_materials_transmission", "KHR_materials_pbrSpecularGlossiness",
    "KHR_mesh_quantization",      "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",        "KHR_xmp_json_ld",
    "KHR_materials_variants"};

std::uint32_t word(Bytes bytes, std::size_t at) {
  std::uint32_t out = 0;
  for (std::size_t i = 0; i < 4; ++i) out |= std::uint32_t{bytes[at + i]} << 8 * i;
  return out;
}

std::string advice_on(const std::string& extension) {
  if (extension == "KHR_texture_basisu" || extension == "EXT_texture_webp" ||
      extension == "EXT_texture_avif")
    return ": save its textures as PNG or JPEG";
  return "";
}

std::vector<std::string> names_in(const Json& root, const char* key) {
  std::vector<std::string> out;
  if (const Json* list = member(root, key); list && list->is_array())
    for (const Json& name : *list)
      if (name.is_string()) out.push_back(name.get<std::string>());
  return out;
}

// Who reads the text next may do so on the stack.
constexpr int kMaxNesting = 200;
int nesting_of(Bytes text) {
  int depth = 0, deepest = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const unsigned char c = text[i];
    if (quoted && c == '\\') ++i;
    if (c == '"') quoted = !quoted;
    if (quoted) continue;
    if (c == '{' || c == '[') deepest = std::max(deepest, ++depth);
    if (c == '}' || c == ']') --depth;
  }
  return deepest;
}

}  // namespace

const Json* member(const Json& of, const char* key) {
  if (!of.is_object()) return nullptr;
  const auto found = of.find(key);
  return found == of.end() ? nullptr : &*found;
}

const Json* extension(const Json& of, const char* name) {
  const Json* all = member(of, "extensions");
  const Json* found = all ? member(*all, name) : nullptr;
  return found && found->is_object() ? found : nullptr;
}

float number(const Json& of, const char* key, float fallback, float low, float high) {
  const Json* found = member(of, key);
  if (!found || !found->is_number()) return fallback;
  const double value = found->get<double>();
  return std::isfinite(value)
             ? static_cast<float>(std::clamp(value, static_cast<double>(low), double{high}))
             : fallback;
}

std::optional<std::uint64_t> whole(const Json& of, const char* key, std::uint64_t fallback) {
  const Json* found = member(of, key);
  if (!found) return fallback;
  if (found->is_number_unsigned()) return found->get<std::uint64_t>();
  return std::nullopt;
}

std::string called(const char* kind, std::size_t index, const Json& thing) {
  const Json* name = member(thing, "name");
  if (!name || !name->is_string() || name->get_ref<const std::string&>().empty())
    return fmt::format("{} {}", kind, index);
  // Names are anybody's text: an error stays one line.
  std::string text = name->get<std::string>().substr(0, 80);
  std::ranges::replace_if(
      text, [](unsigned char c) { return c < 32 || c == 127; }, ' ');
  return fmt::format("{} {} (\"{}\")", kind, index, text);
}

Result<Document> Document::open(const std::filesystem::path& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
    return fail(ErrorCode::kNotFound, path.string(),
                std::filesystem::exists(path, error) ? "is not a file" : "no such file");
  PENUMBRA_ASSIGN(bytes, read_bytes(path));
  return parse(std::move(bytes), path);
}

Result<Document> Document::parse(std::vector<unsigned char> bytes,
                                 const std::filesystem::path& path) {
  Document out;
  out.path_ = path;
  out.file_ = path.string();
  out.bytes_ = std::move(bytes);
  const Bytes all = out.bytes_;
  const auto damaged = [&](std::string why) {
    return fail(ErrorCode::kUnreadable, out.file_, std::move(why));
  };
  if (all.size() < 4 || word(all, 0) != kGlb) {
    PENUMBRA_TRY(out.parse_json(all));
  } else {
    if (all.size() < 20 || word(all, 8) > all.size()) return damaged("is a truncated binary glTF");
    if (word(all, 4) != 2)
      return fail(ErrorCode::kInvalid, out.file_,
                  fmt::format("is binary glTF {}, and 2 is read", word(all, 4)));
    const std::size_t end = word(all, 8), json = word(all, 12);
    if (word(all, 16) != kJsonChunk || end < 20 || json > end - 20)
      return damaged("is a binary glTF without a whole JSON chunk");
    PENUMBRA_TRY(out.parse_json(all.subspan(20, json)));
    const std::size_t next = 20 + (json + 3) / 4 * 4;
    if (next + 8 <= end && word(all, next + 4) == kBinaryChunk) {
      out.binary_from_ = next + 8;
      out.binary_size_ = word(all, next);
      out.has_binary_ = true;
      if (out.binary_size_ > end - out.binary_from_)
        return damaged("is a binary glTF whose binary chunk is truncated");
    }
  }
  PENUMBRA_TRY(out.check_extensions());
  return out;
}

Result<void> Document::parse_json(Bytes text) {
  // Some programs put a byte order mark before UTF-8.
  if (text.size() >= 3 && text[0] == 0xef && text[1] == 0xbb && text[2] == 0xbf)
    text = text.subspan(3);
  if (nesting_of(text) > kMaxNesting)
    return invalid(fmt::format("nests its JSON deeper than {}", kMaxNesting));
  root_ = Json::parse(text.begin(), text.end(), nullptr, false);
  if (root_.is_discarded() || !root_.is_object())
    return fail(ErrorCode::kUnreadable, file_, "is not glTF: its JSON is damaged");
  const Json* asset = member(root_, "asset");
  const Json* version = asset ? member(*asset, "version") : nullptr;
  if (!version || !version->is_string())
    return fail(ErrorCode::kUnreadable, file_, "is not glTF: it names no version");
  const auto& text_of_version = version->get_ref<const std::string&>();
  if (!text_of_version.starts_with("2."))
    return invalid(fmt::format("is glTF {}, and 2.0 is read", text_of_version.substr(0, 16)));
  return {};
}

Result<void> Document::check_extensions() {
  const auto known = [](const std::string& name) {
    return std::ranges::find(kKnown, name) != kKnown.end();
  };
  for (const std::string& name : names_in(root_, "extensionsRequired"))
    if (!known(name))
      return invalid(
          fmt::format("requires the extension {}, which is not read{}", name, advice_on(name)));
  for (const std::string& name : names_in(root_, "extensionsUsed"))
    if (!known(name)) leave_out(fmt::format("extension {} is not read", name));
  const Json* lights = extension(root_, "KHR_lights_punctual");
  if (lights && member(*lights, "lights"))
    leave_out("lights of the asset are left out: real light and a scene's [[lamp]] shine here");
  if (count("cameras") > 0) leave_out("cameras of the asset are left out");
  if (extension(root_, "KHR_materials_variants"))
    leave_out("material variants are left out: the first look is drawn");
  return {};
}

std::vector<std::string> Document::extensions() const {
  return names_in(root_, "extensionsUsed");
}

std::size_t Document::count(const char* list) const {
  const Json* found = member(root_, list);
  return found && found->is_array() ? found->size() : 0;
}

const Json& Document::at(const char* list, std::size_t index) const {
  static const Json kNone;
  return index < count(list) ? (*member(root_, list))[index] : kNone;
}

Result<std::optional<std::size_t>> Document::reference(const Json& of, const char* key,
                                                       const char* list,
                                                       const std::string& whose) const {
  const Json* found = member(of, key);
  if (!found) return std::nullopt;
  if (!found->is_number_unsigned())
    return invalid(fmt::format("{}: its \"{}\" is not an index", whose, key));
  const auto index = found->get<std::uint64_t>();
  if (index >= count(list))
    return invalid(fmt::format("{}: its \"{}\" is {}, and the file has {} {}", whose, key, index,
                               count(list), list));
  return static_cast<std::size_t>(index);
}

Result<Bytes> Document::buffer(std::size_t index) {
  const Json& json = at("buffers", index);
  const std::string whose = called("buffer", index, json);
  const auto length = whole(json, "byteLength", 0);
  if (!length || *length == 0) return invalid(whose + " has no length");
  const Json* uri = member(json, "uri");
  Bytes bytes;
  if (uri) {
    if (!uri->is_string()) return invalid(whose + " has a URI that is no text");
    if (const auto known = buffers_.find(index); known != buffers_.end()) {
      bytes = known->second;
    } else {
      PENUMBRA_ASSIGN(read, resource(uri->get_ref<const std::string&>(), whose));
      bytes = buffers_[index] = std::move(read);
    }
  } else {
    if (index != 0 || !has_binary_) return invalid(whose + " has no bytes and no URI");
    bytes = Bytes(bytes_).subspan(binary_from_, binary_size_);
  }
  if (*length > bytes.size())
    return invalid(fmt::format("{} says {} bytes, and {} are there", whose, *length, bytes.size()));
  return bytes.first(*length);
}

Result<Bytes> Document::slice(const Json& of, const std::string& whose) {
  PENUMBRA_ASSIGN(index, reference(of, "buffer", "buffers", whose));
  if (!index) return invalid(whose + " names no buffer");
  const auto offset = whole(of, "byteOffset", 0), length = whole(of, "byteLength", 0);
  if (!offset || !length || *length == 0) return invalid(whose + " has no length");
  PENUMBRA_ASSIGN(bytes, buffer(*index));
  if (*offset > bytes.size() || *length > bytes.size() - *offset)
    return invalid(fmt::format("{} reaches beyond buffer {}", whose, *index));
  return bytes.subspan(*offset, *length);
}

Result<Document::ViewBytes> Document::view(std::size_t index) {
  const Json& json = at("bufferViews", index);
  const std::string whose = called("buffer view", index, json);
  const Json* packed = extension(json, "EXT_meshopt_compression");
  const auto stride = whole(json, "byteStride", 0);
  if (!stride || *stride > 252) return invalid(whose + " has a stride that is not in 4..252");
  if (packed) {
    PENUMBRA_ASSIGN(bytes, unpacked(index, *packed));
    return ViewBytes{bytes, static_cast<std::size_t>(*stride)};
  }
  PENUMBRA_ASSIGN(bytes, slice(json, whose));
  return ViewBytes{bytes, static_cast<std::size_t>(*stride)};
}

Result<Bytes> Document::unpacked(std::size_t index, const Json& packed) {
  if (const auto known = unpacked_.find(index); known != unpacked_.end()) return known->second;
  const std::string whose = fmt::format("buffer view {}, packed by meshopt,", index);
  PENUMBRA_ASSIGN(bytes, slice(packed, whose));
  PENUMBRA_ASSIGN(out, unpack_meshopt(packed, bytes, whose, file_));
  return unpacked_[index] = std::move(out);
}

void Document::leave_out(std::string line) {
  if (std::ranges::find(left_out_, line) == left_out_.end()) left_out_.push_back(std::move(line));
}

}  // namespace penumbra::prt::gltf
