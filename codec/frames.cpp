// Camera frames through OpenCV's image codecs, from and to memory. OpenCV throws; everything is
// caught here.
#include <climits>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "codec/internal/formats.h"
#include "codec/internal/frame_header.h"
#include "codec/log_jpeg2000.h"
#include "core/io/files.h"

namespace penumbra::codec {
namespace {

// OpenCV orders colours blue, green, red.
template <class Pixel, class Code>
Image<Pixel> from_bgr(const cv::Mat& mat) {
  Image<Pixel> image(mat.cols, mat.rows);
  for (int y = 0; y < mat.rows; ++y) {
    const auto* from = mat.ptr<cv::Vec<Code, 3>>(y);
    for (Pixel& to : image.row(y)) {
      to = {(*from)[2], (*from)[1], (*from)[0]};
      ++from;
    }
  }
  return image;
}

template <class Code, class Pixel>
cv::Mat to_bgr(const Image<Pixel>& image) {
  cv::Mat mat(image.height(), image.width(), CV_MAKETYPE(cv::DataType<Code>::depth, 3));
  for (int y = 0; y < mat.rows; ++y) {
    auto* to = mat.ptr<cv::Vec<Code, 3>>(y);
    for (const Pixel& from : image.row(y)) *to++ = {from.b, from.g, from.r};
  }
  return mat;
}

// Pixels stay where the sensor put them: a turn by the EXIF tag would part them from their lens
// model.
constexpr int kReadFlags = cv::IMREAD_ANYDEPTH | cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION;

Result<FramePixels> decode_pixels(Bytes bytes, const std::string& name) {
  const cv::Mat wrapped(1, static_cast<int>(bytes.size()), CV_8U,
                        const_cast<unsigned char*>(bytes.data()));
  const cv::Mat mat = cv::imdecode(wrapped, kReadFlags);
  if (mat.empty() || mat.channels() != 3)
    return fail(ErrorCode::kUnreadable, name, "has damaged picture data");
  switch (mat.depth()) {
    case CV_8U:
      return from_bgr<Rgb8, unsigned char>(mat);
    case CV_16U:
      return from_bgr<Rgb16, unsigned short>(mat);
    case CV_32F:
      return from_bgr<Rgb, float>(mat);
    default:
      return fail(ErrorCode::kUnreadable, name, "has neither 8-bit nor 16-bit nor float samples");
  }
}

Result<FrameHeader> scan(Bytes bytes, const std::string& name) {
  if (is_png(bytes)) return scan_png(bytes);
  if (is_jpeg(bytes)) return scan_jpeg(bytes);
  if (is_tiff(bytes)) return scan_tiff(bytes);
  return fail(ErrorCode::kUnreadable, name, "is neither PNG, JPEG, TIFF, OpenEXR nor Radiance HDR");
}

Result<std::vector<unsigned char>> encode(const std::string& extension, const cv::Mat& mat,
                                          const std::vector<int>& parameters,
                                          const std::string& name) {
  try {
    std::vector<unsigned char> bytes;
    if (cv::imencode(extension, mat, bytes, parameters)) return bytes;
    return fail(ErrorCode::kUnwritable, name, "cannot be encoded: OpenCV refuses the picture");
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnwritable, name, e.what());
  }
}

template <class Code, class Pixel>
Result<void> write(const std::filesystem::path& path, const Image<Pixel>& pixels) {
  const std::string extension = lower_extension(path);
  const bool jpeg = extension == ".jpg" || extension == ".jpeg";
  if (!jpeg && extension != ".png" && extension != ".tif" && extension != ".tiff")
    return fail(ErrorCode::kInvalid, path.string(),
                "ends neither in .png, .jpg, .jpeg, .tif nor in .tiff");
  // OpenCV would clamp 16 bit codes to 255 without a word.
  if (jpeg && sizeof(Code) > 1)
    return fail(ErrorCode::kInvalid, path.string(),
                "is a JPEG, which holds 8-bit pictures only; .png and .tif hold 16 bits");
  if (pixels.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no pixels");
  PENUMBRA_TRY(check_size(pixels.width(), pixels.height(), path.string()));
  PENUMBRA_ASSIGN(bytes, encode(extension, to_bgr<Code>(pixels), {}, path.string()));
  return write_bytes(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace

Result<FramePixels> read_frame(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path, INT_MAX));
  const std::string name = path.string();
  // Radiance last: its magic may stand anywhere in the first lines, by chance even in a PNG.
  const bool coded = is_png(bytes) || is_jpeg(bytes) || is_tiff(bytes);
  if (!coded && (is_exr(bytes) || is_jpeg2000(bytes) || is_radiance(bytes))) {
    PENUMBRA_ASSIGN(hdr, decode_hdr(bytes, name));
    return std::move(hdr.pixels);
  }
  return decode_frame(bytes, name);
}

Result<FramePixels> decode_frame(std::span<const unsigned char> bytes, const std::string& name) {
  PENUMBRA_ASSIGN(header, scan(bytes, name));
  // Truncated files have no trustworthy size, so damage is named first.
  if (header.damage) return fail(ErrorCode::kUnreadable, name, *header.damage);
  PENUMBRA_TRY(check_size(header.width, header.height, name));
  try {
    return decode_pixels(bytes, name);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, name, e.what());
  }
}

Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb8>& pixels) {
  return write<unsigned char>(path, pixels);
}

Result<void> write_frame(const std::filesystem::path& path, const Image<Rgb16>& pixels) {
  return write<unsigned short>(path, pixels);
}

Result<std::vector<unsigned char>> encode_jpeg(const Image<Rgb8>& pixels, int quality) {
  const std::string name = "JPEG encoder";
  if (pixels.empty()) return fail(ErrorCode::kInvalid, name, "has no pixels");
  if (quality < 1 || quality > 100)
    return fail(ErrorCode::kInvalid, name,
                "quality " + std::to_string(quality) + " is not in 1..100");
  return encode(".jpg", to_bgr<unsigned char>(pixels), {cv::IMWRITE_JPEG_QUALITY, quality}, name);
}

}  // namespace penumbra::codec
