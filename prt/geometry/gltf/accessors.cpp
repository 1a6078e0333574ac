#include "prt/geometry/gltf/internal/accessors.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <string_view>

namespace penumbra::prt::gltf {

namespace {

// The component types' numbers are OpenGL's.
enum class ComponentType { kByte = 5120, kUByte, kShort, kUShort, kUInt = 5125, kFloat = 5126 };

std::size_t size_of(ComponentType c) {
  if (c == ComponentType::kByte || c == ComponentType::kUByte) return 1;
  return c == ComponentType::kShort || c == ComponentType::kUShort ? 2 : 4;
}

std::optional<ComponentType> component_of(const Json& of) {
  const auto code = whole(of, "componentType", 0);
  if (!code || *code < 5120 || *code > 5126 || *code == 5124) return std::nullopt;
  return static_cast<ComponentType>(*code);
}

std::size_t components_of(const Json& accessor) {
  static constexpr std::pair<std::string_view, std::size_t> kTypes[] = {
      {"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}, {"MAT4", 16}};
  const Json* type = member(accessor, "type");
  if (type && type->is_string())
    for (const auto& [name, count] : kTypes)
      if (type->get_ref<const std::string&>() == name) return count;
  return 0;
}

template <class T>
T little_endian(const unsigned char* from) {  // as every machine that this runs on
  T out;
  std::memcpy(&out, from, sizeof(T));
  return out;
}

// As floats: with `normalised`, the range of integers is -1..1 or 0..1.
float value_at(const unsigned char* p, ComponentType c, bool normalised) {
  switch (c) {
    case ComponentType::kByte: {
      const auto v = static_cast<float>(little_endian<std::int8_t>(p));
      return normalised ? std::max(v / 127, -1.f) : v;
    }
    case ComponentType::kUByte:
      return static_cast<float>(*p) / (normalised ? 255.f : 1.f);
    case ComponentType::kShort: {
      const auto v = static_cast<float>(little_endian<std::int16_t>(p));
      return normalised ? std::max(v / 32767, -1.f) : v;
    }
    case ComponentType::kUShort:
      return static_cast<float>(little_endian<std::uint16_t>(p)) / (normalised ? 65535.f : 1.f);
    case ComponentType::kUInt:
      return static_cast<float>(little_endian<std::uint32_t>(p));
    case ComponentType::kFloat:
      return little_endian<float>(p);
  }
  return 0;
}

std::uint32_t index_at(const unsigned char* p, ComponentType c) {
  if (c == ComponentType::kUByte) return *p;
  if (c == ComponentType::kUShort) return little_endian<std::uint16_t>(p);
  return little_endian<std::uint32_t>(p);
}

bool holds_indices(ComponentType c) {
  return c == ComponentType::kUByte || c == ComponentType::kUShort || c == ComponentType::kUInt;
}

// Where `count` elements of `size` bytes stand.
struct Elements {
  Bytes bytes;  // empty: all are zero
  std::size_t stride = 0;
};

Result<Elements> elements_of(Document& document, const Json& of, std::size_t count,
                             std::size_t size, const std::string& whose) {
  PENUMBRA_ASSIGN(index, document.reference(of, "bufferView", "bufferViews", whose));
  if (!index) return Elements{};
  PENUMBRA_ASSIGN(view, document.view(*index));
  const auto offset = whole(of, "byteOffset", 0);
  const std::size_t stride = view.stride == 0 ? size : view.stride;
  if (!offset || *offset > view.bytes.size() || stride < size)
    return document.invalid(whose +
                            " begins beyond its buffer view, or has a stride below its size");
  const std::size_t room = view.bytes.size() - *offset;
  if (count > 0 && (room < size || (room - size) / stride < count - 1))
    return document.invalid(
        fmt::format("{} has {} elements, and buffer view {} ends before", whose, count, *index));
  return Elements{view.bytes.subspan(*offset), stride};
}

struct Accessor {
  const Json* json = nullptr;
  ComponentType component{};
  std::size_t components = 0, count = 0;
  bool normalised = false;
  std::string name;
};

Result<Accessor> accessor_of(Document& document, std::size_t index, const std::string& whose) {
  Accessor a;
  a.json = &document.at("accessors", index);
  a.name = fmt::format("{}: {}", whose, called("accessor", index, *a.json));
  const auto component = component_of(*a.json);
  a.components = components_of(*a.json);
  if (!component || a.components == 0)
    return document.invalid(a.name + " has a type that is none for vertices and indices");
  a.component = *component;
  const auto count = whole(*a.json, "count", 0);
  if (!count || *count == 0 || *count > kMaxElements)
    return document.invalid(
        fmt::format("{} has a count that is not in 1..{}", a.name, kMaxElements));
  a.count = *count;
  const Json* normalised = member(*a.json, "normalized");
  a.normalised = normalised && normalised->is_boolean() && normalised->get<bool>();
  return a;
}

// Of elements that no byte stands for, a short file can claim any number.
constexpr std::size_t kMaxZeros = std::size_t{1} << 20;

// Calls `set(element, bytes)` for each element that the file gives, sparse ones last.
template <class Set>
Result<void> each_element(Document& document, const Accessor& a, const Set& set) {
  const std::size_t size = size_of(a.component) * a.components;
  PENUMBRA_ASSIGN(dense, elements_of(document, *a.json, a.count, size, a.name));
  if (dense.bytes.empty() && a.count > kMaxZeros)
    return document.invalid(fmt::format("{} has {} elements without bytes, and {} are the limit",
                                        a.name, a.count, kMaxZeros));
  if (!dense.bytes.empty())
    for (std::size_t i = 0; i < a.count; ++i) set(i, &dense.bytes[i * dense.stride]);
  const Json* sparse = member(*a.json, "sparse");
  if (!sparse) return {};
  const Json *indices = member(*sparse, "indices"), *values = member(*sparse, "values");
  const auto count = whole(*sparse, "count", 0);
  const auto kind = indices ? component_of(*indices) : std::nullopt;
  if (!indices || !values || !count || *count == 0 || *count > a.count || !kind ||
      !holds_indices(*kind))
    return document.invalid(a.name + " has damaged sparse elements");
  PENUMBRA_ASSIGN(where, elements_of(document, *indices, *count, size_of(*kind), a.name));
  PENUMBRA_ASSIGN(what, elements_of(document, *values, *count, size, a.name));
  if (where.bytes.empty() || what.bytes.empty())
    return document.invalid(a.name + " has sparse elements without a buffer view");
  for (std::size_t i = 0; i < *count; ++i) {
    const std::uint32_t element = index_at(&where.bytes[i * where.stride], *kind);
    if (element >= a.count)
      return document.invalid(
          fmt::format("{} has a sparse element {}, and has {} in all", a.name, element, a.count));
    set(element, &what.bytes[i * what.stride]);
  }
  return {};
}

}  // namespace

Result<AccessorValues> read_numbers(Document& document, std::size_t accessor,
                                    std::span<const std::size_t> components,
                                    const std::string& whose) {
  PENUMBRA_ASSIGN(a, accessor_of(document, accessor, whose));
  if (std::ranges::find(components, a.components) == components.end())
    return document.invalid(fmt::format(
        "{} has {} components an element, which its use does not allow", a.name, a.components));
  AccessorValues out{a.components, std::vector<float>(a.count * a.components)};
  const std::size_t size = size_of(a.component);
  PENUMBRA_TRY(each_element(document, a, [&](std::size_t i, const unsigned char* from) {
    for (std::size_t k = 0; k < a.components; ++k)
      out.values[i * a.components + k] = value_at(from + k * size, a.component, a.normalised);
  }));
  return out;
}

Result<std::vector<std::uint32_t>> read_indices(Document& document, std::size_t accessor,
                                                const std::string& whose) {
  PENUMBRA_ASSIGN(a, accessor_of(document, accessor, whose));
  if (a.components != 1 || !holds_indices(a.component))
    return document.invalid(a.name + " is not of unsigned scalars, as indices are");
  std::vector<std::uint32_t> out(a.count);
  PENUMBRA_TRY(each_element(document, a, [&](std::size_t i, const unsigned char* from) {
    out[i] = index_at(from, a.component);
  }));
  return out;
}

}  // namespace penumbra::prt::gltf
