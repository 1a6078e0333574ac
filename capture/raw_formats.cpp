#include "capture/raw_formats.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "codec/codec.h"

extern "C" {
#include <libavutil/imgutils.h>
#include <libswscale/swscale.h>
}

namespace penumbra::capture {

namespace {

struct Yuv {
  std::uint32_t fourcc;
  AVPixelFormat format;
  int rank;
};
constexpr Yuv kYuv[] = {
    {V4L2_PIX_FMT_RGB24, AV_PIX_FMT_RGB24, 5},  {V4L2_PIX_FMT_BGR24, AV_PIX_FMT_BGR24, 5},
    {V4L2_PIX_FMT_YUYV, AV_PIX_FMT_YUYV422, 4}, {V4L2_PIX_FMT_UYVY, AV_PIX_FMT_UYVY422, 4},
    {V4L2_PIX_FMT_YVYU, AV_PIX_FMT_YVYU422, 4}, {V4L2_PIX_FMT_NV12, AV_PIX_FMT_NV12, 3},
    {V4L2_PIX_FMT_NV21, AV_PIX_FMT_NV21, 3},    {V4L2_PIX_FMT_YUV420, AV_PIX_FMT_YUV420P, 3},
};

// OpenCV names a pattern by its second row's second and third pixel.
struct Bayer {
  std::uint32_t fourcc;
  int bits, to_rgb;
};
constexpr Bayer kBayer[] = {
    {V4L2_PIX_FMT_SRGGB8, 8, cv::COLOR_BayerBG2RGB},
    {V4L2_PIX_FMT_SGRBG8, 8, cv::COLOR_BayerGB2RGB},
    {V4L2_PIX_FMT_SGBRG8, 8, cv::COLOR_BayerGR2RGB},
    {V4L2_PIX_FMT_SBGGR8, 8, cv::COLOR_BayerRG2RGB},
    {V4L2_PIX_FMT_SRGGB10, 10, cv::COLOR_BayerBG2RGB},
    {V4L2_PIX_FMT_SGRBG10, 10, cv::COLOR_BayerGB2RGB},
    {V4L2_PIX_FMT_SGBRG10, 10, cv::COLOR_BayerGR2RGB},
    {V4L2_PIX_FMT_SBGGR10, 10, cv::COLOR_BayerRG2RGB},
    {V4L2_PIX_FMT_SRGGB12, 12, cv::COLOR_BayerBG2RGB},
    {V4L2_PIX_FMT_SGRBG12, 12, cv::COLOR_BayerGB2RGB},
    {V4L2_PIX_FMT_SGBRG12, 12, cv::COLOR_BayerGR2RGB},
    {V4L2_PIX_FMT_SBGGR12, 12, cv::COLOR_BayerRG2RGB},
    {V4L2_PIX_FMT_SRGGB16, 16, cv::COLOR_BayerBG2RGB},
    {V4L2_PIX_FMT_SGRBG16, 16, cv::COLOR_BayerGB2RGB},
    {V4L2_PIX_FMT_SGBRG16, 16, cv::COLOR_BayerGR2RGB},
    {V4L2_PIX_FMT_SBGGR16, 16, cv::COLOR_BayerRG2RGB},
};

struct Grey {
  std::uint32_t fourcc;
  int bits;
};
constexpr Grey kGrey[] = {{V4L2_PIX_FMT_GREY, 8},
                          {V4L2_PIX_FMT_Y10, 10},
                          {V4L2_PIX_FMT_Y12, 12},
                          {V4L2_PIX_FMT_Y16, 16},
                          {V4L2_PIX_FMT_Z16, 16}};

bool is_jpeg(std::uint32_t fourcc) {
  return fourcc == V4L2_PIX_FMT_MJPEG || fourcc == V4L2_PIX_FMT_JPEG;
}

template <class Entry, std::size_t n>
const Entry* find(const Entry (&list)[n], std::uint32_t fourcc) {
  const auto at = std::ranges::find(list, fourcc, &Entry::fourcc);
  return at == std::end(list) ? nullptr : at;
}

constexpr std::uint32_t kBigEndian = 1u << 31;

}  // namespace

std::string fourcc_name(std::uint32_t fourcc) {
  std::string name;
  for (int shift = 0; shift < 32; shift += 8)
    name += static_cast<char>((fourcc & ~kBigEndian) >> shift & 0xff);
  while (!name.empty() && name.back() == ' ') name.pop_back();
  return fourcc & kBigEndian ? name + "-BE" : name;
}

Result<std::uint32_t> fourcc_from(std::string_view name) {
  if (name.empty() || name.size() > 4)
    return fail(ErrorCode::kInvalid, std::string(name),
                "is not a pixel format, which has one to four characters");
  std::uint32_t out = 0;
  for (std::size_t i = 0; i < 4; ++i)
    out |= static_cast<std::uint32_t>(static_cast<unsigned char>(i < name.size() ? name[i] : ' '))
           << 8 * i;
  return out;
}

int format_rank(std::uint32_t fourcc) {
  if (const Bayer* b = find(kBayer, fourcc)) return b->bits > 8 ? 7 : 6;
  if (const Yuv* y = find(kYuv, fourcc)) return y->rank;
  if (is_jpeg(fourcc)) return 2;
  return find(kGrey, fourcc) ? 1 : 0;
}

struct RawConverter::Impl {
  RawLayout layout;
  const Yuv* yuv = nullptr;
  const Bayer* bayer = nullptr;
  const Grey* grey = nullptr;
  SwsContext* scaler = nullptr;
  ~Impl() { sws_freeContext(scaler); }

  Result<FramePixels> from_yuv(std::span<const std::byte> bytes) const;
  template <class Sample, class Pixel>
  Result<FramePixels> from_samples(std::span<const std::byte> bytes, int bits) const;
  Result<FramePixels> from_jpeg(std::span<const std::byte> bytes) const;
};

RawConverter::RawConverter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RawConverter::~RawConverter() = default;
RawConverter::RawConverter(RawConverter&&) noexcept = default;
RawConverter& RawConverter::operator=(RawConverter&&) noexcept = default;

bool RawConverter::decodes_jpeg() const {
  return is_jpeg(impl_->layout.fourcc);
}

Result<RawConverter> RawConverter::make(const RawLayout& layout) {
  const std::string name = fourcc_name(layout.fourcc);
  if (layout.width < 1 || layout.height < 1 || layout.width > codec::kMaxSide ||
      layout.height > codec::kMaxSide)
    return fail(ErrorCode::kInvalid, name, "has a picture size that cannot be read");
  auto impl = std::make_unique<Impl>();
  impl->layout = layout;
  impl->yuv = find(kYuv, layout.fourcc);
  impl->bayer = find(kBayer, layout.fourcc);
  impl->grey = find(kGrey, layout.fourcc);
  if (impl->bayer && (layout.width < 4 || layout.height < 4))
    return fail(ErrorCode::kInvalid, name, "has pictures that are too small to demosaic");
  if (impl->yuv) {
    const int smallest = av_image_get_linesize(impl->yuv->format, layout.width, 0);
    if (layout.stride < smallest) return fail(ErrorCode::kInvalid, name, "has rows that overlap");
    // Exact rounding, and chroma of neighbouring pixels interpolated.
    impl->scaler =
        sws_getContext(layout.width, layout.height, impl->yuv->format, layout.width, layout.height,
                       AV_PIX_FMT_RGB24, SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT,
                       nullptr, nullptr, nullptr);
    if (!impl->scaler) return fail(ErrorCode::kInvalid, name, "cannot be converted to RGB");
    constexpr int kUnchanged = 1 << 16;
    const int* matrix = sws_getCoefficients(layout.bt709 ? SWS_CS_ITU709 : SWS_CS_ITU601);
    sws_setColorspaceDetails(impl->scaler, matrix, layout.full_range, matrix, 1, 0, kUnchanged,
                             kUnchanged);
    return RawConverter(std::move(impl));
  }
  const int bits = impl->bayer ? impl->bayer->bits : impl->grey ? impl->grey->bits : 0;
  if (bits == 0 && !is_jpeg(layout.fourcc))
    return fail(ErrorCode::kInvalid, name, "is a pixel format that cannot be read");
  if (bits > 0 && layout.stride < layout.width * (bits > 8 ? 2 : 1))
    return fail(ErrorCode::kInvalid, name, "has rows that overlap");
  return RawConverter(std::move(impl));
}

Result<FramePixels> RawConverter::Impl::from_yuv(std::span<const std::byte> bytes) const {
  std::array<std::uint8_t*, 4> planes{};
  std::array<int, 4> strides{};
  // Further planes have the first one's stride, halved where they have half the columns.
  av_image_fill_linesizes(strides.data(), yuv->format, layout.width);
  const int ratio = strides[1] ? strides[0] / strides[1] : 1;
  for (int& stride : strides)
    if (stride) stride = &stride == strides.data() ? layout.stride : layout.stride / ratio;
  auto* const at = reinterpret_cast<std::uint8_t*>(const_cast<std::byte*>(bytes.data()));
  const int needed =
      av_image_fill_pointers(planes.data(), yuv->format, layout.height, at, strides.data());
  if (needed < 0 || bytes.size() < static_cast<std::size_t>(needed))
    return fail(ErrorCode::kUnreadable, "frame", "is truncated");
  Image<Rgb8> out(layout.width, layout.height);
  std::uint8_t* const to[] = {&out.pixels()[0].r};
  const int to_stride[] = {3 * layout.width};
  sws_scale(scaler, planes.data(), strides.data(), 0, layout.height, to, to_stride);
  return out;
}

template <class Sample, class Pixel>
Result<FramePixels> RawConverter::Impl::from_samples(std::span<const std::byte> bytes,
                                                     int bits) const {
  constexpr int kDepth = sizeof(Sample) == 1 ? CV_8U : CV_16U;
  const std::size_t needed =
      static_cast<std::size_t>(layout.stride) * static_cast<std::size_t>(layout.height - 1) +
      static_cast<std::size_t>(layout.width) * sizeof(Sample);
  if (bytes.size() < needed) return fail(ErrorCode::kUnreadable, "frame", "is truncated");
  const cv::Mat raw(layout.height, layout.width, kDepth, const_cast<std::byte*>(bytes.data()),
                    static_cast<std::size_t>(layout.stride));
  Image<Pixel> out(layout.width, layout.height);
  cv::Mat rgb(layout.height, layout.width, CV_MAKETYPE(kDepth, 3), out.pixels().data());
  cv::Mat spread = raw;
  // Full scale of the sensor is full scale of the code.
  if (bits > 8 && bits < 16) raw.convertTo(spread, -1, 65535. / ((1 << bits) - 1));
  cv::cvtColor(spread, rgb, bayer ? bayer->to_rgb : static_cast<int>(cv::COLOR_GRAY2RGB));
  return out;
}

Result<FramePixels> RawConverter::Impl::from_jpeg(std::span<const std::byte> bytes) const {
  auto picture = codec::decode_frame(
      {reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size()}, "JPEG frame");
  if (!picture) return picture;
  const auto* codes = std::get_if<Image<Rgb8>>(&*picture);
  if (!codes || codes->width() != layout.width || codes->height() != layout.height)
    return fail(ErrorCode::kUnreadable, "JPEG frame", "has another size than its format states");
  return picture;
}

Result<FramePixels> RawConverter::convert(std::span<const std::byte> bytes) const {
  const Impl& i = *impl_;
  if (i.yuv) return i.from_yuv(bytes);
  if (!i.bayer && !i.grey) return i.from_jpeg(bytes);
  const int bits = i.bayer ? i.bayer->bits : i.grey->bits;
  return bits == 8 ? i.from_samples<std::uint8_t, Rgb8>(bytes, bits)
                   : i.from_samples<std::uint16_t, Rgb16>(bytes, bits);
}

}  // namespace penumbra::capture
