#include "codec/cube_ktx.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "core/half.h"

namespace penumbra::codec {

Result<std::vector<unsigned char>> encode_cube_ktx(std::span<const Rgb> texels, int size) {
  const auto edge = static_cast<std::size_t>(std::max(size, 0));
  if (edge == 0 || texels.size() != 6 * edge * edge)
    return fail(ErrorCode::kInvalid, "cube", "has not six faces of its size");
  constexpr std::array<unsigned char, 12> kMagic{0xab, 'K',  'T',  'X',  ' ',  '1',
                                                 '1',  0xbb, '\r', '\n', 0x1a, '\n'};
  constexpr std::uint32_t kByteOrder = 0x04030201, kHalfFloat = 0x140b, kRgba = 0x1908,
                          kRgba16f = 0x881a;
  const auto side = static_cast<std::uint32_t>(size);
  // Type, its bytes, format, stored format, its base; width, height, depth; array elements, faces,
  // levels; bytes of further words; bytes of a face.
  const std::array<std::uint32_t, 14> head{kByteOrder, kHalfFloat,     2, kRgba, kRgba16f, kRgba,
                                           side,       side,           0, 0,     6,        1,
                                           0,          8 * side * side};
  std::vector<unsigned char> out(kMagic.size() + sizeof head + 8 * texels.size());
  std::ranges::copy(kMagic, out.begin());
  std::memcpy(out.data() + kMagic.size(), head.data(), sizeof head);
  unsigned char* to = out.data() + kMagic.size() + sizeof head;
  for (const Rgb& c : texels) {
    const auto half = [](float v) { return half_from_float(std::min(v, 65504.f)); };
    const std::array<std::uint16_t, 4> texel{half(c.r), half(c.g), half(c.b), half_from_float(1)};
    std::memcpy(to, texel.data(), sizeof texel);
    to += sizeof texel;
  }
  return out;
}

}  // namespace penumbra::codec
