// Pictures in the formats of cameras, made into RGB codes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// How a driver lays out a picture.
struct RawLayout {
  std::uint32_t fourcc = 0;  // V4L2_PIX_FMT_...
  int width = 0, height = 0;
  int stride = 0;           // bytes a row of the first plane
  bool full_range = false;  // YUV codes 0..255 instead of 16..235
  bool bt709 = false;       // YUV by BT.709 instead of BT.601
};

std::string fourcc_name(std::uint32_t fourcc);
/// errors: kInvalid (not one to four characters)
Result<std::uint32_t> fourcc_from(std::string_view name);

/// 0 for what cannot be read; larger keeps more of the light: raw sensor codes, then RGB, YUV,
/// JPEG, grey.
int format_rank(std::uint32_t fourcc);

/// Turns pictures of one layout into RGB codes: 8 bits where the format has 8, else 16 (codes
/// spread over the range). Bayer patterns are interpolated.
/// threads: thread-bound
class RawConverter {
 public:
  /// errors: kInvalid (a format that cannot be read, a stride shorter than a row)
  static Result<RawConverter> make(const RawLayout& layout);
  ~RawConverter();
  RawConverter(RawConverter&&) noexcept;
  RawConverter& operator=(RawConverter&&) noexcept;

  /// errors: kUnreadable (fewer bytes than the picture has, a damaged JPEG, a JPEG of another size)
  Result<FramePixels> convert(std::span<const std::byte> bytes) const;
  [[nodiscard]] bool decodes_jpeg() const;

 private:
  struct Impl;
  explicit RawConverter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
