#include "tools/chart/peers/internal/jpeg_xl.h"

#include <jxl/decode.h>
#include <jxl/decode_cxx.h>
#include <jxl/encode.h>
#include <jxl/encode_cxx.h>

#include <algorithm>
#include <utility>

namespace penumbra::tools {

namespace {

constexpr JxlPixelFormat kThreeFloats{3, JXL_TYPE_FLOAT, JXL_NATIVE_ENDIAN, 0};
static_assert(sizeof(Rgb) == 3 * sizeof(float));

}  // namespace

Result<std::vector<unsigned char>> encode_jpeg_xl(const Image<Rgb>& picture, float distance) {
  const JxlEncoderPtr encoder = JxlEncoderMake(nullptr);
  JxlBasicInfo info;
  JxlEncoderInitBasicInfo(&info);
  info.xsize = static_cast<std::uint32_t>(picture.width());
  info.ysize = static_cast<std::uint32_t>(picture.height());
  info.bits_per_sample = 32;
  info.exponent_bits_per_sample = 8;
  info.uses_original_profile = JXL_FALSE;
  JxlColorEncoding colours;
  JxlColorEncodingSetToLinearSRGB(&colours, JXL_FALSE);
  JxlEncoderFrameSettings* const settings = JxlEncoderFrameSettingsCreate(encoder.get(), nullptr);
  const bool is_taken = JxlEncoderSetBasicInfo(encoder.get(), &info) == JXL_ENC_SUCCESS &&
                        JxlEncoderSetColorEncoding(encoder.get(), &colours) == JXL_ENC_SUCCESS &&
                        JxlEncoderSetFrameDistance(settings, distance) == JXL_ENC_SUCCESS &&
                        JxlEncoderAddImageFrame(settings, &kThreeFloats, picture.pixels().data(),
                                                picture.area() * sizeof(Rgb)) == JXL_ENC_SUCCESS;
  if (!is_taken) return fail(ErrorCode::kUnwritable, "picture", "libjxl does not take it");
  JxlEncoderCloseInput(encoder.get());
  std::vector<unsigned char> out(1 << 16);
  std::size_t written = 0;
  for (;;) {
    unsigned char* to = out.data() + written;
    std::size_t room = out.size() - written;
    const JxlEncoderStatus status = JxlEncoderProcessOutput(encoder.get(), &to, &room);
    written = static_cast<std::size_t>(to - out.data());
    if (status == JXL_ENC_SUCCESS) break;
    if (status != JXL_ENC_NEED_MORE_OUTPUT)
      return fail(ErrorCode::kUnwritable, "picture", "libjxl cannot code it");
    out.resize(2 * out.size());
  }
  out.resize(written);
  return out;
}

Result<Image<Rgb>> decode_jpeg_xl(std::span<const unsigned char> bytes) {
  const auto damaged = [] {
    return fail(ErrorCode::kUnreadable, "picture", "libjxl cannot read it");
  };
  const JxlDecoderPtr decoder = JxlDecoderMake(nullptr);
  if (JxlDecoderSubscribeEvents(decoder.get(), JXL_DEC_BASIC_INFO | JXL_DEC_COLOR_ENCODING |
                                                   JXL_DEC_FULL_IMAGE) != JXL_DEC_SUCCESS)
    return damaged();
  JxlDecoderSetInput(decoder.get(), bytes.data(), bytes.size());
  JxlDecoderCloseInput(decoder.get());
  Image<Rgb> out;
  for (;;) {
    const JxlDecoderStatus status = JxlDecoderProcessInput(decoder.get());
    if (status == JXL_DEC_BASIC_INFO) {
      JxlBasicInfo info;
      if (JxlDecoderGetBasicInfo(decoder.get(), &info) != JXL_DEC_SUCCESS) return damaged();
      out.reset(static_cast<int>(info.xsize), static_cast<int>(info.ysize));
    } else if (status == JXL_DEC_COLOR_ENCODING) {
      JxlColorEncoding colours;
      JxlColorEncodingSetToLinearSRGB(&colours, JXL_FALSE);
      JxlDecoderSetPreferredColorProfile(decoder.get(), &colours);
    } else if (status == JXL_DEC_NEED_IMAGE_OUT_BUFFER) {
      if (JxlDecoderSetImageOutBuffer(decoder.get(), &kThreeFloats, out.pixels().data(),
                                      out.area() * sizeof(Rgb)) != JXL_DEC_SUCCESS)
        return damaged();
    } else if (status == JXL_DEC_SUCCESS) {
      return out;
    } else if (status != JXL_DEC_FULL_IMAGE) {
      return damaged();
    }
  }
}

}  // namespace penumbra::tools
