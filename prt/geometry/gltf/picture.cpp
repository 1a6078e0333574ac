#include "prt/geometry/gltf/internal/picture.h"

#include <fmt/format.h>

#include <optional>
#include <string_view>
#include <utility>
#include <variant>

#include "codec/codec.h"

namespace penumbra::prt::gltf {

namespace {

using PictureBytes = std::span<const unsigned char>;

bool begins_with(PictureBytes bytes, std::string_view magic, std::size_t at = 0) {
  if (bytes.size() < at + magic.size()) return false;
  for (std::size_t i = 0; i < magic.size(); ++i)
    if (bytes[at + i] != static_cast<unsigned char>(magic[i])) return false;
  return true;
}

std::size_t big_endian(PictureBytes bytes, std::size_t at, std::size_t count) {
  std::size_t out = 0;
  for (std::size_t i = 0; i < count && at + i < bytes.size(); ++i) out = out << 8 | bytes[at + i];
  return out;
}

// Of its frame header (ISO/IEC 10918-1, B.2.2); 0 where there is none.
std::size_t jpeg_pixels(PictureBytes bytes) {
  std::size_t at = 2;
  while (at + 9 < bytes.size() && bytes[at] == 0xff) {
    const unsigned marker = bytes[at + 1];
    if (marker == 0xff) {
      ++at;
      continue;
    }
    if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc)
      return big_endian(bytes, at + 5, 2) * big_endian(bytes, at + 7, 2);
    at += 2 + big_endian(bytes, at + 2, 2);
  }
  return 0;
}

std::uint8_t code_of_8(std::uint8_t v) {
  return v;
}
std::uint8_t code_of_8(std::uint16_t v) {
  return static_cast<std::uint8_t>((v + 128) / 257);
}

template <class Pixel>
Image<Rgba8> with_alpha(const Image<Pixel>& colours, const Image<std::uint8_t>& alpha) {
  Image<Rgba8> out(colours.width(), colours.height());
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      const Pixel& c = colours.at(x, y);
      out.at(x, y) = {code_of_8(c.r), code_of_8(c.g), code_of_8(c.b),
                      alpha.empty() ? std::uint8_t{255} : alpha.at(x, y)};
    }
  return out;
}

}  // namespace

Result<TexturePicture> decode_picture(std::span<const unsigned char> bytes, const std::string& file,
                                      const std::string& whose) {
  const bool png = begins_with(bytes, "\x89PNG\r\n\x1a\n");
  const bool jpeg = begins_with(bytes, "\xff\xd8\xff");
  const auto refused = [&](std::string_view kind) {
    return fail(ErrorCode::kInvalid, file,
                fmt::format("{} is {}: save it as PNG or JPEG", whose, kind));
  };
  if (begins_with(bytes, "\xabKTX")) return refused("a KTX texture");
  if (begins_with(bytes, "RIFF") && begins_with(bytes, "WEBP", 8)) return refused("a WebP picture");
  if (!png && !jpeg) return refused("neither PNG nor JPEG");
  const std::size_t pixels =
      png ? big_endian(bytes, 16, 4) * big_endian(bytes, 20, 4) : jpeg_pixels(bytes);
  if (pixels > kMaxPicturePixels)
    return fail(ErrorCode::kInvalid, file,
                fmt::format("{} has {} megapixels, and {} are the limit", whose, pixels >> 20,
                            kMaxPicturePixels >> 20));
  const auto frame = codec::decode_frame_with_alpha(bytes, file);
  if (!frame)
    return fail(frame.error().code, file, fmt::format("{}: {}", whose, frame.error().detail));
  TexturePicture out;
  out.mime = png ? "image/png" : "image/jpeg";
  out.file.assign(bytes.begin(), bytes.end());
  if (const auto* codes = std::get_if<Image<Rgb8>>(&frame->pixels))
    out.codes = with_alpha(*codes, frame->alpha);
  else if (const auto* wide = std::get_if<Image<Rgb16>>(&frame->pixels))
    out.codes = with_alpha(*wide, frame->alpha);
  if (out.codes.empty())
    return fail(ErrorCode::kUnreadable, file, whose + " has neither 8-bit nor 16-bit samples");
  return out;
}

}  // namespace penumbra::prt::gltf
