// What can be said about a PNG, JPEG or TIFF file before it is decoded: its size, and whether all
// of it is there. Decoders allocate by the declared size, and libjpeg returns a half-filled picture
// when bytes are missing; so both are settled here first.
#pragma once

#include <cstdint>
#include <cstring>
#include <optional>
#include <string_view>
#include <vector>

#include "codec/internal/formats.h"

namespace penumbra::codec {

struct FrameHeader {
  std::int64_t width = 0, height = 0;
  // Where and what, when the file is damaged or stops early.
  std::optional<std::string> damage;
};

namespace detail {

// Numbers from a file, each read checked; past the end `ok` turns false and every number is 0.
struct Numbers {
  Bytes bytes;
  bool big_endian = true;
  bool ok = true;

  std::uint32_t at(std::size_t position, std::size_t count) {
    if (position > bytes.size() || bytes.size() - position < count) {
      ok = false;
      return 0;
    }
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < count; ++i)
      value = value << 8 | bytes[position + (big_endian ? i : count - 1 - i)];
    return value;
  }
};

inline FrameHeader& stop(FrameHeader& header, const char* what, std::size_t at) {
  header.damage = std::string(what) + " at byte " + std::to_string(at);
  return header;
}

}  // namespace detail

inline bool is_png(Bytes bytes) {
  constexpr std::string_view kMagic("\x89PNG\r\n\x1a\n", 8);
  return bytes.size() >= 8 && std::memcmp(bytes.data(), kMagic.data(), 8) == 0;
}

inline bool is_jpeg(Bytes bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

inline bool is_tiff(Bytes bytes) {
  return bytes.size() >= 4 &&
         (std::memcmp(bytes.data(), "II*\0", 4) == 0 || std::memcmp(bytes.data(), "MM\0*", 4) == 0);
}

/// Chunks in order, from IHDR to IEND.
inline FrameHeader scan_png(Bytes bytes) {
  FrameHeader header;
  detail::Numbers in{bytes};
  constexpr std::uint32_t kIhdr = 0x49484452, kIend = 0x49454e44;
  if (in.at(12, 4) != kIhdr) return detail::stop(header, "no IHDR chunk", 8);
  header.width = in.at(16, 4);
  header.height = in.at(20, 4);
  for (std::size_t at = 8;;) {
    const std::size_t length = in.at(at, 4);
    const std::uint32_t type = in.at(at + 4, 4);
    if (!in.ok || bytes.size() - at < 12 || bytes.size() - at - 12 < length)
      return detail::stop(header, "truncated: no end of the chunk begun", at);
    if (type == kIend) return header;
    at += 12 + length;
  }
}

/// Segments in order, and the entropy coded data between them, to the end-of-image marker.
inline FrameHeader scan_jpeg(Bytes bytes) {
  FrameHeader header;
  detail::Numbers in{bytes};
  for (std::size_t at = 2;;) {
    const std::size_t start = at;
    if (in.at(at, 1) != 0xff) return detail::stop(header, "truncated or damaged: no marker", start);
    while (in.at(at, 1) == 0xff) ++at;  // fill bytes
    const std::uint32_t marker = in.at(at++, 1);
    if (marker == 0xd9) return header;
    if (marker == 0x01 || (marker >= 0xd0 && marker <= 0xd8)) continue;  // no length follows
    const std::size_t length = in.at(at, 2);
    if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc) {
      header.height = in.at(at + 3, 2);
      header.width = in.at(at + 5, 2);
    }
    if (!in.ok || length < 2 || bytes.size() - at < length)
      return detail::stop(header, "truncated: no end of the segment begun", start);
    at += length;
    if (marker != 0xda) continue;
    // Coded data holds 0xff only before 0 or a restart marker.
    const auto coded = [&](std::uint32_t after) { return after == 0 || (after & 0xf8) == 0xd0; };
    while (at + 1 < bytes.size() && (bytes[at] != 0xff || coded(bytes[at + 1]))) ++at;
    if (at + 1 >= bytes.size())
      return detail::stop(header, "truncated: no end of the scan begun", start);
  }
}

namespace detail {

// The numbers of a directory entry of type SHORT or LONG.
inline std::vector<std::uint32_t> tiff_values(Numbers& in, std::size_t entry) {
  const std::size_t size = in.at(entry + 2, 2) == 3 ? 2 : 4;
  const std::size_t count = in.at(entry + 4, 4);
  if (count > in.bytes.size() / size) {
    in.ok = false;
    return {};
  }
  const std::size_t from = count * size <= 4 ? entry + 8 : in.at(entry + 8, 4);
  std::vector<std::uint32_t> values;
  for (std::size_t i = 0; i < count; ++i) values.push_back(in.at(from + i * size, size));
  return values;
}

}  // namespace detail

/// First directory, and every strip or tile that it lists.
inline FrameHeader scan_tiff(Bytes bytes) {
  FrameHeader header;
  detail::Numbers in{bytes, bytes[0] == 'M'};
  const std::size_t directory = in.at(4, 4);
  const std::size_t entries = in.at(directory, 2);
  std::vector<std::uint32_t> offsets, sizes;
  for (std::size_t i = 0; i < entries && in.ok; ++i) {
    const std::size_t entry = directory + 2 + 12 * i;
    const std::uint32_t tag = in.at(entry, 2);
    if (tag != 256 && tag != 257 && tag != 273 && tag != 279 && tag != 324 && tag != 325) continue;
    const auto values = detail::tiff_values(in, entry);
    if (tag == 256 && !values.empty()) header.width = values[0];
    if (tag == 257 && !values.empty()) header.height = values[0];
    if (tag == 273 || tag == 324) offsets = values;
    if (tag == 279 || tag == 325) sizes = values;
  }
  if (!in.ok || entries == 0)
    return detail::stop(header, "truncated or damaged directory", directory);
  if (offsets.empty() || offsets.size() != sizes.size())
    return detail::stop(header, "no picture data listed", directory);
  for (std::size_t i = 0; i < offsets.size(); ++i)
    if (offsets[i] > bytes.size() || bytes.size() - offsets[i] < sizes[i])
      return detail::stop(header, "truncated: no end of the strip begun", offsets[i]);
  return header;
}

}  // namespace penumbra::codec
