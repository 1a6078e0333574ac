#include "tools/common/number_pairs.h"

#include <fmt/format.h>

#include <charconv>
#include <cstdio>

namespace penumbra::tools {

bool read_pair(const std::string& text, char sign, int& a, int& b) {
  const char* const end = text.data() + text.size();
  const auto first = std::from_chars(text.data(), end, a);
  if (first.ec != std::errc() || first.ptr == end || *first.ptr != sign) return false;
  const auto second = std::from_chars(first.ptr + 1, end, b);
  return second.ec == std::errc() && second.ptr == end;
}

Result<std::array<int, 2>> read_map_size(const std::string& option, const std::string& text) {
  std::array<int, 2> size{};
  const auto good = [](int side) { return side >= 8 && side <= 4096; };
  if (!read_pair(text, 'x', size[0], size[1]) || !good(size[0]) || !good(size[1]))
    return fail(
        ErrorCode::kInvalid, option,
        fmt::format("\"{}\" is not WIDTHxHEIGHT with both sides within 8..4096, such as 256x128",
                    text));
  return size;
}

}  // namespace penumbra::tools
