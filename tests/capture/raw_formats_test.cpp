// Camera formats in RGB codes: known colours, any stride, and nothing read beyond what came.
#include "capture/raw_formats.h"
#include "capture/capture.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <cmath>

#include "codec/codec.h"

namespace penumbra::capture {
namespace {

constexpr int kRawWidth = 32, kRawHeight = 16;

struct Yuv {
  int y, u, v;
};
// One colour in YUYV, with `padding` bytes behind each row.
std::vector<std::byte> yuyv(const Yuv& c, int padding) {
  std::vector<std::byte> out;
  for (int row = 0; row < kRawHeight; ++row) {
    for (int x = 0; x < kRawWidth; x += 2)
      for (const int code : {c.y, c.u, c.y, c.v}) out.push_back(static_cast<std::byte>(code));
    out.resize(out.size() + static_cast<std::size_t>(padding), std::byte{0xff});
  }
  return out;
}

Rgb8 centre(const FramePixels& pixels) {
  return std::get<Image<Rgb8>>(pixels).at(kRawWidth / 2, kRawHeight / 2);
}

void expect_near(const Rgb8& seen, int r, int g, int b, const std::string& what) {
  EXPECT_NEAR(seen.r, r, 2) << what;
  EXPECT_NEAR(seen.g, g, 2) << what;
  EXPECT_NEAR(seen.b, b, 2) << what;
}

TEST(RawFormats, YuvByStandardAndRangeWithAnyStride) {
  struct Case {
    Yuv code;
    bool full, bt709;
    int r, g, b;
    const char* what;
  };
  // ITU-R BT.601 and BT.709, equations of section 2.5.
  const Case cases[] = {{{235, 128, 128}, false, false, 255, 255, 255, "white, limited"},
                        {{16, 128, 128}, false, false, 0, 0, 0, "black, limited"},
                        {{255, 128, 128}, true, false, 255, 255, 255, "white, full"},
                        {{82, 90, 240}, false, false, 255, 0, 0, "red, BT.601"},
                        {{63, 102, 240}, false, true, 255, 0, 0, "red, BT.709"},
                        {{145, 54, 34}, false, false, 0, 255, 0, "green, BT.601"}};
  for (const Case& c : cases)
    for (const int padding : {0, 24}) {
      auto converter = RawConverter::make(
          {V4L2_PIX_FMT_YUYV, kRawWidth, kRawHeight, 2 * kRawWidth + padding, c.full, c.bt709});
      ASSERT_TRUE(converter) << c.what;
      auto pixels = converter->convert(yuyv(c.code, padding));
      ASSERT_TRUE(pixels) << c.what;
      expect_near(centre(*pixels), c.r, c.g, c.b, c.what);
    }
}

TEST(RawFormats, TwelveBitsFillSixteen) {
  auto converter =
      RawConverter::make({V4L2_PIX_FMT_Y12, kRawWidth, kRawHeight, 2 * kRawWidth, false, false});
  ASSERT_TRUE(converter);
  for (const std::uint16_t code : {0, 1, 2048, 4095}) {
    const std::vector<std::uint16_t> raw(kRawWidth * kRawHeight, code);
    auto pixels = converter->convert(std::as_bytes(std::span(raw)));
    ASSERT_TRUE(pixels);
    EXPECT_EQ(std::get<Image<Rgb16>>(*pixels).at(3, 3).g, std::lround(code * 65535. / 4095));
  }
}

TEST(RawFormats, DepthStaysAsItIs) {
  auto converter =
      RawConverter::make({V4L2_PIX_FMT_Z16, kRawWidth, kRawHeight, 2 * kRawWidth, false, false});
  ASSERT_TRUE(converter);
  std::vector<std::uint16_t> raw(kRawWidth * kRawHeight);
  for (std::size_t i = 0; i < raw.size(); ++i) raw[i] = static_cast<std::uint16_t>(127 * i);
  const auto pixels = converter->convert(std::as_bytes(std::span(raw)));
  ASSERT_TRUE(pixels);
  for (std::size_t i = 0; i < raw.size(); ++i)
    ASSERT_EQ(std::get<Image<Rgb16>>(*pixels).pixels()[i].r, raw[i]);
}

TEST(RawFormats, EveryShorterFrameIsRefused) {
  for (const std::uint32_t format :
       {V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_NV12, V4L2_PIX_FMT_YUV420, V4L2_PIX_FMT_RGB24,
        V4L2_PIX_FMT_SRGGB8, V4L2_PIX_FMT_SRGGB12, V4L2_PIX_FMT_GREY, V4L2_PIX_FMT_MJPEG}) {
    auto converter =
        RawConverter::make({format, kRawWidth, kRawHeight, 3 * kRawWidth, false, false});
    ASSERT_TRUE(converter) << fourcc_name(format);
    // Exactly as many bytes as there are: a read beyond them is seen by the address sanitizer.
    for (const std::size_t bytes : {0, 1, 100, 500}) {
      const std::vector<std::byte> cut(bytes);
      auto pixels = converter->convert(cut);
      ASSERT_FALSE(pixels) << fourcc_name(format) << " of " << bytes;
      EXPECT_EQ(pixels.error().code, ErrorCode::kUnreadable);
    }
  }
}

TEST(RawFormats, JpegOfAnotherSizeIsRefused) {
  auto converter = RawConverter::make({V4L2_PIX_FMT_MJPEG, kRawWidth, kRawHeight, 0, false, false});
  ASSERT_TRUE(converter);
  const auto picture = [&](int width) {
    const auto jpeg = *codec::encode_jpeg(Image<Rgb8>(width, kRawHeight, {200, 100, 50}), 95);
    return converter->convert(std::as_bytes(std::span(jpeg)));
  };
  auto right = picture(kRawWidth);
  ASSERT_TRUE(right);
  expect_near(centre(*right), 200, 100, 50, "JPEG");
  EXPECT_FALSE(picture(2 * kRawWidth));
}

TEST(RawFormats, WhatCannotBeReadIsNamed) {
  auto unknown = RawConverter::make({V4L2_PIX_FMT_H264, kRawWidth, kRawHeight, 0, false, false});
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().where, "H264");
  EXPECT_FALSE(
      RawConverter::make({V4L2_PIX_FMT_YUYV, kRawWidth, kRawHeight, kRawWidth, false, false}));
  EXPECT_FALSE(RawConverter::make({V4L2_PIX_FMT_YUYV, 0, kRawHeight, 64, false, false}));
  EXPECT_FALSE(RawConverter::make({V4L2_PIX_FMT_SRGGB8, 2, 2, 2, false, false}));
  EXPECT_FALSE(fourcc_from("YUYVX"));
  EXPECT_EQ(fourcc_name(*fourcc_from("Y16")), "Y16");
}

}  // namespace
}  // namespace penumbra::capture
