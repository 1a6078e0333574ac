#include "prt/geometry/gltf/internal/compression.h"

#include <draco/compression/decode.h>
#include <fmt/format.h>
#include <meshoptimizer.h>

#include <limits>
#include <memory>
#include <string_view>
#include <utility>

namespace penumbra::prt::gltf {

namespace {

std::string text_of(const Json& of, const char* key, const char* fallback) {
  const Json* found = member(of, key);
  return found && found->is_string() ? found->get<std::string>() : fallback;
}

// What a normalised integer is multiplied by; encoders leave that to the accessor (Draco knows a
// flag of its own).
float scale_of(const Document& document, const Json& primitive, const std::string& attribute,
               const draco::PointAttribute& packed) {
  const Json* attributes = member(primitive, "attributes");
  if (packed.normalized() || !attributes) return 1;
  const auto accessor = document.reference(*attributes, attribute.c_str(), "accessors", attribute);
  if (!accessor || !*accessor) return 1;
  const Json& json = document.at("accessors", **accessor);
  const Json* normalised = member(json, "normalized");
  if (!normalised || !normalised->is_boolean() || !normalised->get<bool>()) return 1;
  switch (packed.data_type()) {
    case draco::DT_INT8:
      return 1.f / 127;
    case draco::DT_UINT8:
      return 1.f / 255;
    case draco::DT_INT16:
      return 1.f / 32767;
    case draco::DT_UINT16:
      return 1.f / 65535;
    default:
      return 1;
  }
}

// An attribute's values for the mesh's points.
std::optional<AccessorValues> draco_numbers(const draco::Mesh& mesh,
                                            const draco::PointAttribute& attribute, float scale) {
  const int components = attribute.num_components();
  if (components < 1 || components > 4) return std::nullopt;
  AccessorValues out{static_cast<std::size_t>(components), {}};
  out.values.resize(mesh.num_points() * out.components);
  for (std::uint32_t i = 0; i < mesh.num_points(); ++i) {
    const auto index = attribute.mapped_index(draco::PointIndex(i));
    if (index.value() >= attribute.size() ||
        !attribute.ConvertValue<float>(index, static_cast<std::int8_t>(components),
                                       &out.values[i * out.components]))
      return std::nullopt;
  }
  for (float& v : out.values) v *= scale;
  return out;
}

}  // namespace

Result<std::vector<unsigned char>> unpack_meshopt(const Json& extension, Bytes packed,
                                                  const std::string& whose,
                                                  const std::string& file) {
  const auto invalid = [&](const char* why) {
    return fail(ErrorCode::kInvalid, file, fmt::format("{} {}", whose, why));
  };
  const auto count = whole(extension, "count", 0), stride = whole(extension, "byteStride", 0);
  if (!count || *count == 0 || *count > kMaxElements)
    return invalid("has no count, or too large a one");
  if (!stride || *stride == 0 || *stride > 256)
    return invalid("has a stride that is not in 1..256");
  const std::string mode = text_of(extension, "mode", "");
  const std::string filter = text_of(extension, "filter", "NONE");
  std::vector<unsigned char> out(*count * *stride);
  int failed = 0;
  if (mode == "ATTRIBUTES") {
    if (*stride % 4 != 0) return invalid("has a stride that is not a multiple of 4");
    failed = meshopt_decodeVertexBuffer(out.data(), *count, *stride, packed.data(), packed.size());
  } else if (mode == "TRIANGLES" || mode == "INDICES") {
    if (*stride != 2 && *stride != 4) return invalid("has indices of neither 2 nor 4 bytes");
    if (mode == "TRIANGLES" && *count % 3 != 0) return invalid("has a count that is no triangles'");
    failed = mode == "TRIANGLES" ? meshopt_decodeIndexBuffer(out.data(), *count, *stride,
                                                             packed.data(), packed.size())
                                 : meshopt_decodeIndexSequence(out.data(), *count, *stride,
                                                               packed.data(), packed.size());
  } else {
    return invalid("has an unknown mode");
  }
  if (failed != 0) return fail(ErrorCode::kUnreadable, file, whose + " is damaged");
  if (filter == "OCTAHEDRAL") {
    if (*stride != 4 && *stride != 8)
      return invalid("has octahedral normals of other than 4 or 8 bytes");
    meshopt_decodeFilterOct(out.data(), *count, *stride);
  } else if (filter == "QUATERNION") {
    if (*stride != 8) return invalid("has quaternions of other than 8 bytes");
    meshopt_decodeFilterQuat(out.data(), *count, *stride);
  } else if (filter == "EXPONENTIAL") {
    if (*stride % 4 != 0) return invalid("has exponential numbers that are not of 4 bytes");
    meshopt_decodeFilterExp(out.data(), *count, *stride);
  } else if (filter != "NONE") {
    return invalid("has an unknown filter");
  }
  return out;
}

Result<DracoMesh> unpack_draco(Document& document, const Json& primitive, const Json& extension,
                               const std::string& whose) {
  const std::string name = whose + ", packed by Draco,";
  PENUMBRA_ASSIGN(view, document.reference(extension, "bufferView", "bufferViews", name));
  if (!view) return document.invalid(name + " names no buffer view");
  PENUMBRA_ASSIGN(packed, document.view(*view));
  const Json* attributes = member(extension, "attributes");
  if (!attributes || !attributes->is_object())
    return document.invalid(name + " names no attributes");
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(packed.bytes.data()), packed.bytes.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
  if (!decoded.ok() || !decoded.value())
    return fail(ErrorCode::kUnreadable, document.file(), name + " is damaged");
  const draco::Mesh& mesh = *decoded.value();
  if (mesh.num_points() > kMaxElements || mesh.num_faces() > kMaxElements)
    return document.invalid(
        fmt::format("{} has more than {} vertices or triangles", name, kMaxElements));
  DracoMesh out;
  for (const auto& [key, id] : attributes->items()) {
    const draco::PointAttribute* const found =
        id.is_number_unsigned() &&
                id.get<std::uint64_t>() <= std::numeric_limits<std::uint32_t>::max()
            ? mesh.GetAttributeByUniqueId(id.get<std::uint32_t>())
            : nullptr;
    if (!found) return document.invalid(fmt::format("{} lacks its {}", name, key));
    auto values = draco_numbers(mesh, *found, scale_of(document, primitive, key, *found));
    if (!values) return document.invalid(fmt::format("{} has a damaged {}", name, key));
    out.attributes[key] = std::move(*values);
  }
  for (std::uint32_t f = 0; f < mesh.num_faces(); ++f)
    for (int k = 0; k < 3; ++k) out.indices.push_back(mesh.face(draco::FaceIndex(f))[k].value());
  return out;
}

}  // namespace penumbra::prt::gltf
