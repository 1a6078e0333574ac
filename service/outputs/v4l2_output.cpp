// Whole frames written to a V4L2 output device, such as that of v4l2loopback.
#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "capture/unique_fd.h"
#include "service/outputs/colour_conversion.h"
#include "service/outputs/frame_output.h"
#include "service/outputs/internal/frame_sink.h"

namespace penumbra::service {

namespace {

// The first is what every program reads.
constexpr std::array kFormats = {V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_RGB24, V4L2_PIX_FMT_BGR32,
                                 V4L2_PIX_FMT_YUV420};
constexpr const char* kFormatNames = "YUYV, RGB24, BGR32 or YU12";

class V4l2Sink : public FrameSink {
 public:
  explicit V4l2Sink(std::string device) : device_(std::move(device)) {}
  Result<void> open();
  Result<bool> put(const FramePixels& pixels, TimestampNs captured,
                   const std::stop_token& stop) override;

 private:
  template <class Argument>
  int call(unsigned long request, Argument* argument) const;
  Result<void> choose_size(int width, int height);
  Result<bool> set_format(std::uint32_t format, int width, int height);
  void convert(const Image<Rgb8>& picture);
  Result<bool> write(const std::stop_token& stop);
  Error error(ErrorCode code, const char* what, int number) const {
    return {code, device_, fmt::format("{}: {}", what, std::strerror(number))};
  }

  const std::string device_;
  capture::UniqueFd file_;
  std::vector<std::uint32_t> offered_;  // in the order of kFormats
  std::uint32_t format_ = 0;
  int width_ = 0, height_ = 0;
  std::size_t row_bytes_ = 0;
  std::vector<std::uint8_t> frame_;
};

// 0 or errno.
template <class Argument>
int V4l2Sink::call(unsigned long request, Argument* argument) const {
  int result;
  do {
    result = ::ioctl(file_.get(), request, argument);
  } while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}

Result<void> V4l2Sink::open() {
  file_ = capture::UniqueFd(::open(device_.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (!file_) {
    const bool missing = errno == ENOENT || errno == ENODEV || errno == ENXIO;
    return std::unexpected(
        error(missing ? ErrorCode::kNotFound : ErrorCode::kUnavailable, "cannot be opened", errno));
  }
  v4l2_capability able{};
  if (const int e = call(VIDIOC_QUERYCAP, &able))
    return std::unexpected(error(ErrorCode::kUnavailable, "is not a video device", e));
  const std::uint32_t caps =
      able.capabilities & V4L2_CAP_DEVICE_CAPS ? able.device_caps : able.capabilities;
  // A loopback device with exclusive_caps is none while it has a writer.
  if (!(caps & V4L2_CAP_VIDEO_OUTPUT))
    return fail(ErrorCode::kInvalid, device_,
                "takes no pictures: it is not a video output, or another program writes to it");
  if (!(caps & V4L2_CAP_READWRITE))
    return fail(ErrorCode::kInvalid, device_, "takes no pictures by write()");
  std::vector<std::uint32_t> found;
  v4l2_fmtdesc description{};
  description.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
  constexpr std::uint32_t kMaxFormats = 512;
  for (; description.index < kMaxFormats && call(VIDIOC_ENUM_FMT, &description) == 0;
       ++description.index)
    found.push_back(description.pixelformat);
  for (const std::uint32_t format : kFormats)
    if (std::ranges::find(found, format) != found.end()) offered_.push_back(format);
  if (offered_.empty())
    return fail(ErrorCode::kInvalid, device_, fmt::format("takes none of {}", kFormatNames));
  return {};
}

// False where the driver takes another format or size.
Result<bool> V4l2Sink::set_format(std::uint32_t format, int width, int height) {
  const auto columns = static_cast<std::uint32_t>(width), rows = static_cast<std::uint32_t>(height);
  v4l2_format asked{};
  asked.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
  v4l2_pix_format& picture = asked.fmt.pix;
  picture.width = columns, picture.height = rows;
  picture.pixelformat = format;
  picture.field = V4L2_FIELD_NONE;
  const bool rgb = format == V4L2_PIX_FMT_RGB24 || format == V4L2_PIX_FMT_BGR32;
  picture.colorspace = rgb ? V4L2_COLORSPACE_SRGB : V4L2_COLORSPACE_REC709;
  picture.xfer_func = V4L2_XFER_FUNC_SRGB;
  picture.ycbcr_enc = V4L2_YCBCR_ENC_709;
  picture.quantization = rgb ? V4L2_QUANTIZATION_FULL_RANGE : V4L2_QUANTIZATION_LIM_RANGE;
  if (const int e = call(VIDIOC_S_FMT, &asked); e == ENODEV)
    return std::unexpected(error(ErrorCode::kClosed, "has gone", e));
  else if (e == EBUSY)
    return std::unexpected(error(ErrorCode::kUnavailable, "is in use", e));
  else if (e != 0)
    return false;
  if (picture.pixelformat != format || picture.width != columns || picture.height != rows)
    return false;
  const std::size_t pixel_bytes = format == V4L2_PIX_FMT_YUYV    ? 2
                                  : format == V4L2_PIX_FMT_RGB24 ? 3
                                  : format == V4L2_PIX_FMT_BGR32 ? 4
                                                                 : 1;
  const std::size_t least = pixel_bytes * columns;
  row_bytes_ = std::max<std::size_t>(picture.bytesperline, least);
  if (format == V4L2_PIX_FMT_YUV420 && row_bytes_ != least) return false;
  // Not the driver's sizeimage, which may be rounded up to whole pages: readers would get all of it
  // and take it for a broken frame.
  frame_.assign(format == V4L2_PIX_FMT_YUV420 ? yuv420_bytes(width, height) : row_bytes_ * rows, 0);
  return true;
}

Result<void> V4l2Sink::choose_size(int width, int height) {
  for (const std::uint32_t format : offered_) {
    // These share chroma between two columns.
    const bool halved = format == V4L2_PIX_FMT_YUYV || format == V4L2_PIX_FMT_YUV420;
    if (halved && (width % 2 != 0 || (format == V4L2_PIX_FMT_YUV420 && height % 2 != 0))) continue;
    PENUMBRA_ASSIGN(taken, set_format(format, width, height));
    if (!taken) continue;
    format_ = format, width_ = width, height_ = height;
    // write() does not need it, and drivers without buffers of ours refuse. But v4l2loopback knows
    // only by this who its writer is, and is an output again for the next one when that leaves.
    int kind = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    (void)call(VIDIOC_STREAMON, &kind);
    return {};
  }
  return fail(ErrorCode::kInvalid, device_,
              fmt::format("takes no pictures of {}x{} as {}", width, height, kFormatNames));
}

void V4l2Sink::convert(const Image<Rgb8>& picture) {
  switch (format_) {
    case V4L2_PIX_FMT_YUYV:
      return to_yuyv(picture, frame_.data(), row_bytes_);
    case V4L2_PIX_FMT_BGR32:
      return to_bgrx(picture, frame_.data(), row_bytes_);
    case V4L2_PIX_FMT_YUV420:
      return to_yuv420(picture, frame_);
    default:
      for (int y = 0; y < height_; ++y)
        std::memcpy(frame_.data() + static_cast<std::size_t>(y) * row_bytes_, picture.row(y).data(),
                    picture.row(y).size_bytes());
  }
}

Result<bool> V4l2Sink::write(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    const ssize_t n = ::write(file_.get(), frame_.data(), frame_.size());
    if (n >= 0) return true;
    if (errno == ENODEV) return std::unexpected(error(ErrorCode::kClosed, "has gone", errno));
    if (errno != EAGAIN && errno != EINTR)
      return std::unexpected(error(ErrorCode::kUnwritable, "cannot be written", errno));
    pollfd ready{file_.get(), POLLOUT, 0};
    ::poll(&ready, 1, kPatience_ms);
  }
  return false;
}

Result<bool> V4l2Sink::put(const FramePixels& pixels, TimestampNs, const std::stop_token& stop) {
  const DisplayPicture picture(pixels);
  if ((*picture).width() != width_ || (*picture).height() != height_)
    PENUMBRA_TRY(choose_size((*picture).width(), (*picture).height()));
  convert(*picture);
  return write(stop);
}

}  // namespace

Result<std::unique_ptr<FrameOutput>> FrameOutput::to_v4l2(const std::string& device) {
  auto sink = std::make_unique<V4l2Sink>(device);
  PENUMBRA_TRY(sink->open());
  return std::make_unique<FrameOutput>(device, std::move(sink));
}

}  // namespace penumbra::service
