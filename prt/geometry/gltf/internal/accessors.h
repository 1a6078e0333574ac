// AccessorValues of a glTF file: accessors, of any component type, sparse or not.
// threads: as Document
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "prt/geometry/gltf/internal/document.h"

namespace penumbra::prt::gltf {

/// More elements than this no accessor may have: a file can claim more than it holds.
inline constexpr std::size_t kMaxElements = std::size_t{1} << 25;

struct AccessorValues {
  std::size_t components = 0;  // of an element
  std::vector<float> values;   // element by element

  std::size_t size() const { return components == 0 ? 0 : values.size() / components; }
  std::span<const float> at(std::size_t i) const { return {&values[i * components], components}; }
};

/// The elements as floats; normalised integers by their range (glTF 2.0, 3.6.2.2).
/// in:     `components`: how many an element may have, e.g. 3 and 4
/// errors: kInvalid (type, count or bytes out of bounds), which begin with `whose`
Result<AccessorValues> read_numbers(Document& document, std::size_t accessor,
                                    std::span<const std::size_t> components,
                                    const std::string& whose);

/// Unsigned scalars.
/// errors: as read_numbers
Result<std::vector<std::uint32_t>> read_indices(Document& document, std::size_t accessor,
                                                const std::string& whose);

}  // namespace penumbra::prt::gltf
