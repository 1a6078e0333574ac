#include "codec/gain_map_jpeg.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>

#include "codec/codec.h"
#include "codec/display.h"

namespace penumbra::codec {

namespace {

using JpegBytes = std::vector<unsigned char>;

constexpr float kOffset = 1.f / 64;  // of both renditions, as the specification proposes
constexpr std::string_view kXmp{"http://ns.adobe.com/xap/1.0/\0", 29};
constexpr std::string_view kRdf =
    R"(<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0")";
constexpr std::string_view kRdfEnd = "</rdf:RDF></x:xmpmeta>";

// As it is up to half of white, then ever slower towards it; the slope has no step.
float shoulder(float x) {
  return x <= .5f ? x : 1 - .25f / x;
}

float max_channel(const Rgb& c) {
  return std::max({c.r, c.g, c.b, 0.f});
}

// A marker segment: FF, marker, two bytes of length, text and data.
void add_segment(JpegBytes& out, unsigned char marker, std::string_view head,
                 std::string_view data) {
  const std::size_t size = 2 + head.size() + data.size();
  out.insert(out.end(), {0xff, marker, static_cast<unsigned char>(size >> 8),
                         static_cast<unsigned char>(size)});
  out.insert(out.end(), head.begin(), head.end());
  out.insert(out.end(), data.begin(), data.end());
}

void add_u32(std::string& out, std::size_t value) {
  for (const int shift : {24, 16, 8, 0}) out += static_cast<char>(value >> shift);
}
void add_u16(std::string& out, std::size_t value) {
  for (const int shift : {8, 0}) out += static_cast<char>(value >> shift);
}

// The multi-picture index (CIPA DC-007, 5.2), big-endian. Offsets count from its own byte order
// mark, which stands 8 bytes after the segment's begin.
constexpr std::size_t kIndexSize = 8 + 2 + 3 * 12 + 4 + 2 * 16;
std::string picture_index(std::size_t first_size, std::size_t second_offset,
                          std::size_t second_size) {
  constexpr std::size_t kPrimary = 0x030000, kUndefined = 7, kLong = 4;
  std::string out("MM\0*", 4);
  add_u32(out, 8);
  add_u16(out, 3);
  const auto add_entry = [&](std::size_t tag, std::size_t type, std::size_t count) {
    add_u16(out, tag), add_u16(out, type), add_u32(out, count);
  };
  add_entry(0xb000, kUndefined, 4);
  out += "0100";
  add_entry(0xb001, kLong, 1);
  add_u32(out, 2);
  add_entry(0xb002, kUndefined, 32);
  add_u32(out, out.size() + 8);
  add_u32(out, 0);  // no further index
  add_u32(out, kPrimary), add_u32(out, first_size), add_u32(out, 0), add_u32(out, 0);
  add_u32(out, 0), add_u32(out, second_size), add_u32(out, second_offset), add_u32(out, 0);
  return out;
}

struct Renditions {
  Image<Rgb8> base, gains;
  float max_log2 = 0;  // of the gain; the least is 0
};

Renditions split(const Image<Rgb>& pixels, float exposure) {
  Image<Rgb> base(pixels.width(), pixels.height());
  Image<float> log2(pixels.width(), pixels.height());
  Renditions out;
  for (std::size_t i = 0; i < pixels.area(); ++i) {
    const Rgb lit = pixels.pixels()[i] * exposure;
    const float most = max_channel(lit), shown = shoulder(most);
    base.pixels()[i] = most > 0 ? lit * (shown / most) : Rgb{};
    log2.pixels()[i] = std::log2((most + kOffset) / (shown + kOffset));
    out.max_log2 = std::max(out.max_log2, log2.pixels()[i]);
  }
  out.max_log2 = std::max(out.max_log2, .01f);
  out.base = to_display(FramePixels(std::move(base)));
  out.gains = Image<Rgb8>(pixels.width(), pixels.height());
  for (std::size_t i = 0; i < pixels.area(); ++i) {
    const auto code = static_cast<std::uint8_t>(std::lround(255 * log2.pixels()[i] / out.max_log2));
    out.gains.pixels()[i] = {code, code, code};
  }
  return out;
}

}  // namespace

Result<JpegBytes> encode_gain_map_jpeg(const Image<Rgb>& pixels, float exposure, int quality) {
  if (pixels.empty()) return fail(ErrorCode::kInvalid, "picture", "is empty");
  const Renditions both = split(pixels, exposure);
  PENUMBRA_ASSIGN(base, encode_jpeg(both.base, quality));
  PENUMBRA_ASSIGN(gains, encode_jpeg(both.gains, quality));
  const auto start = [](JpegBytes& out, const JpegBytes& jpeg) {
    out.assign(jpeg.begin(), jpeg.begin() + 2);
  };
  const auto end = [](JpegBytes& out, const JpegBytes& jpeg) {
    out.insert(out.end(), jpeg.begin() + 2, jpeg.end());
  };
  JpegBytes second, first;
  start(second, gains);
  add_segment(second, 0xe1, kXmp,
              fmt::format("{} hdrgm:GainMapMin=\"0\" hdrgm:GainMapMax=\"{:.6f}\" hdrgm:Gamma=\"1\" "
                          "hdrgm:OffsetSDR=\"{:.6f}\" hdrgm:OffsetHDR=\"{:.6f}\" "
                          "hdrgm:HDRCapacityMin=\"0\" hdrgm:HDRCapacityMax=\"{:.6f}\" "
                          "hdrgm:BaseRenditionIsHDR=\"False\"/>{}",
                          kRdf, both.max_log2, kOffset, kOffset, both.max_log2, kRdfEnd));
  end(second, gains);
  start(first, base);
  add_segment(
      first, 0xe1, kXmp,
      fmt::format(
          R"({} xmlns:Container="http://ns.google.com/photos/1.0/container/" xmlns:Item="http://ns.google.com/photos/1.0/container/item/"><Container:Directory><rdf:Seq><rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="Primary" Item:Mime="image/jpeg"/></rdf:li><rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="GainMap" Item:Mime="image/jpeg" Item:Length="{}"/></rdf:li></rdf:Seq></Container:Directory></rdf:Description>{})",
          kRdf, second.size(), kRdfEnd));
  constexpr std::string_view kMpf{"MPF\0", 4};
  const std::size_t index_at = first.size() + 8;  // its byte order mark
  const std::size_t first_size = first.size() + 8 + kIndexSize + base.size() - 2;
  add_segment(first, 0xe2, kMpf, picture_index(first_size, first_size - index_at, second.size()));
  end(first, base);
  first.insert(first.end(), second.begin(), second.end());
  return first;
}

}  // namespace penumbra::codec
