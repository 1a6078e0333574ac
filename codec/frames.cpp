// Camera frames by their kind, from and to memory.
#include <climits>
#include <string>
#include <utility>
#include <vector>

#include "codec/codec.h"
#include "codec/dct/rgbe_still.h"
#include "codec/internal/formats.h"
#include "codec/internal/frame_codecs.h"
#include "codec/internal/frame_header.h"
#include "codec/log/log_jpeg2000.h"
#include "core/io/files.h"

namespace penumbra::codec {
namespace {

Result<FrameHeader> scan(Bytes bytes, const std::string& name) {
  if (is_png(bytes)) return scan_png(bytes);
  if (is_jpeg(bytes)) return scan_jpeg(bytes);
  if (is_tiff(bytes)) return scan_tiff(bytes);
  return fail(ErrorCode::kUnreadable, name, "is neither PNG, JPEG, TIFF, OpenEXR nor Radiance HDR");
}

Result<std::vector<unsigned char>> encode_as(const std::string& extension,
                                             const Image<Rgb8>& pixels, const std::string& name) {
  constexpr int kQuality = 95;
  if (extension == ".png") return encode_png(pixels, name);
  if (extension == ".jpg" || extension == ".jpeg")
    return encode_jpeg(pixels, kQuality, JpegColours::kHalf, name);
  return encode_tiff(pixels, name);
}
Result<std::vector<unsigned char>> encode_as(const std::string& extension,
                                             const Image<Rgb16>& pixels, const std::string& name) {
  return extension == ".png" ? encode_png(pixels, name) : encode_tiff(pixels, name);
}

template <class Pixel>
Result<void> write(const std::filesystem::path& path, const Image<Pixel>& pixels) {
  const std::string extension = lower_extension(path);
  const bool jpeg = extension == ".jpg" || extension == ".jpeg";
  if (!jpeg && extension != ".png" && extension != ".tif" && extension != ".tiff")
    return fail(ErrorCode::kInvalid, path.string(),
                "ends neither in .png, .jpg, .jpeg, .tif nor in .tiff");
  if (jpeg && sizeof(Pixel::r) > 1)
    return fail(ErrorCode::kInvalid, path.string(),
                "is a JPEG, which holds 8-bit pictures only; .png and .tif hold 16 bits");
  if (pixels.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no pixels");
  PENUMBRA_TRY(check_size(pixels.width(), pixels.height(), path.string()));
  PENUMBRA_ASSIGN(bytes, encode_as(extension, pixels, path.string()));
  return write_bytes(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace

Result<FramePixels> read_frame(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path, INT_MAX));
  const std::string name = path.string();
  // Radiance last: its magic may stand anywhere in the first lines, by chance even in a PNG.
  const bool coded = is_png(bytes) || is_jpeg(bytes) || is_tiff(bytes);
  if (!coded &&
      (is_exr(bytes) || is_jpeg2000(bytes) || is_rgbe_still(bytes) || is_radiance(bytes))) {
    PENUMBRA_ASSIGN(hdr, decode_hdr(bytes, name));
    return std::move(hdr.pixels);
  }
  return decode_frame(bytes, name);
}

Result<FrameWithAlpha> decode_frame_with_alpha(std::span<const unsigned char> bytes,
                                               const std::string& name) {
  PENUMBRA_ASSIGN(header, scan(bytes, name));
  // Truncated files have no trustworthy size, so damage is named first.
  if (header.damage) return fail(ErrorCode::kUnreadable, name, *header.damage);
  PENUMBRA_TRY(check_size(header.width, header.height, name));
  if (is_png(bytes)) return decode_png(bytes, name);
  if (is_jpeg(bytes)) {
    PENUMBRA_ASSIGN(pixels, decode_jpeg(bytes, name));
    return FrameWithAlpha{std::move(pixels)};
  }
  PENUMBRA_ASSIGN(pixels, decode_tiff(bytes, name));
  return FrameWithAlpha{std::move(pixels)};
}

Result<FramePixels> decode_frame(std::span<const unsigned char> bytes, const std::string& name) {
  PENUMBRA_ASSIGN(frame, decode_frame_with_alpha(bytes, name));
  return std::move(frame.pixels);
}

Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb8>& pixels) {
  return write(path, pixels);
}

Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb16>& pixels) {
  return write(path, pixels);
}

Result<std::vector<unsigned char>> encode_jpeg(const Image<Rgb8>& pixels, int quality) {
  const std::string name = "JPEG encoder";
  if (pixels.empty()) return fail(ErrorCode::kInvalid, name, "has no pixels");
  if (quality < 1 || quality > 100)
    return fail(ErrorCode::kInvalid, name,
                "quality " + std::to_string(quality) + " is not in 1..100");
  return encode_jpeg(pixels, quality, JpegColours::kHalf, name);
}

}  // namespace penumbra::codec
