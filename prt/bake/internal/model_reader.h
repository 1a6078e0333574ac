// Reads checked values out of a tinygltf model.
// threads: reentrant
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "prt/bake/internal/tinygltf.h"

namespace penumbra::prt {

/// Bytes of an accessor, checked against view and buffer; nothing when anything is off.
inline std::optional<std::span<const unsigned char>> accessor_bytes(const tinygltf::Model& m,
                                                                    int index, int component,
                                                                    int type,
                                                                    std::size_t element_bytes) {
  if (index < 0 || static_cast<std::size_t>(index) >= m.accessors.size()) return std::nullopt;
  const auto& a = m.accessors[static_cast<std::size_t>(index)];
  if (a.componentType != component || a.type != type || a.bufferView < 0 || a.byteOffset != 0 ||
      static_cast<std::size_t>(a.bufferView) >= m.bufferViews.size())
    return std::nullopt;
  const auto& v = m.bufferViews[static_cast<std::size_t>(a.bufferView)];
  if (v.buffer < 0 || static_cast<std::size_t>(v.buffer) >= m.buffers.size() || v.byteStride != 0)
    return std::nullopt;
  const auto& data = m.buffers[static_cast<std::size_t>(v.buffer)].data;
  if (v.byteOffset > data.size() || v.byteLength > data.size() - v.byteOffset ||
      a.count > v.byteLength / element_bytes)
    return std::nullopt;
  return std::span(data).subspan(v.byteOffset, a.count * element_bytes);
}

/// Floats of an attribute, one T a vertex; false where it is absent, damaged or empty.
template <class T>
bool read_attribute(const tinygltf::Model& m, const tinygltf::Primitive& p, const std::string& name,
                    int type, std::vector<T>& out) {
  const auto found = p.attributes.find(name);
  if (found == p.attributes.end()) return false;
  const auto bytes =
      accessor_bytes(m, found->second, TINYGLTF_COMPONENT_TYPE_FLOAT, type, sizeof(T));
  if (!bytes) return false;
  out.resize(bytes->size() / sizeof(T));
  if (!out.empty()) std::memcpy(out.data(), bytes->data(), bytes->size());
  return !out.empty();
}

inline bool finite(std::span<const float> values) {
  return std::ranges::all_of(values, [](float v) { return std::isfinite(v); });
}

}  // namespace penumbra::prt
