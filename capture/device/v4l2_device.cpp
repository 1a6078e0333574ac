#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "capture/device/cameras.h"
#include "capture/device/internal/v4l2_node.h"
#include "capture/raw_formats.h"

namespace penumbra::capture {

namespace {

constexpr std::uint32_t kMappedBuffers = 4;
constexpr std::uint32_t kType = V4L2_BUF_TYPE_VIDEO_CAPTURE;

// CLOCK_MONOTONIC, as drivers stamp frames.
TimestampNs monotonic_now() {
  return {std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count()};
}

// Everything that a camera would change by itself.
void stop_automatics(const V4l2Node& node) {
  node.set(V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL);
  node.set(V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0);
  node.set(V4L2_CID_AUTOGAIN, 0);
  node.set(V4L2_CID_BACKLIGHT_COMPENSATION, 0);
}

// By a value of its own, so that colours are the same at each start, however the camera was left.
Result<void> fix_white_balance(const V4l2Node& node, double wanted_k) {
  node.set(V4L2_CID_AUTO_WHITE_BALANCE, 0);
  if (node.value(V4L2_CID_AUTO_WHITE_BALANCE).value_or(0) != 0)
    return fail(ErrorCode::kUnavailable, node.device(),
                "does not let its automatic white balance be switched off, so that the colour of "
                "the light would follow its pictures");
  const auto control = node.control(V4L2_CID_WHITE_BALANCE_TEMPERATURE);
  if (!control) {
    if (wanted_k <= 0) return {};
    return fail(ErrorCode::kInvalid, node.device(),
                "has no white balance in kelvin, as white_balance_k asks for");
  }
  const double value = wanted_k > 0 ? wanted_k : control->preset;
  if (value < control->low || value > control->high)
    return fail(ErrorCode::kInvalid, node.device(),
                fmt::format("takes a white_balance_k of {} to {} K", control->low, control->high));
  if (const int e = node.set(control->id, static_cast<int>(std::lround(value))))
    return std::unexpected(node.error(ErrorCode::kUnavailable, "refuses its white balance", e));
  return {};
}

class V4l2Device : public CameraDevice {
 public:
  V4l2Device(V4l2Node node, RawConverter converter, const CameraSettings& settings)
      : node_(std::move(node)), converter_(std::move(converter)), controls_(exposure_of(node_)) {
    unit_gain_ = settings.unit_gain;
    if (unit_gain_ <= 0 && controls_.gain) unit_gain_ = node_.value(controls_.gain->id).value_or(1);
    if (unit_gain_ <= 0) unit_gain_ = 1;
  }
  ~V4l2Device() override {
    int type = kType;
    if (streaming_) node_.call(VIDIOC_STREAMOFF, &type);
  }
  Result<void> start();

  const std::string& name() const override { return node_.name(); }
  Exposure nearest(Exposure wanted) const override;
  Result<void> request(Exposure wanted) override;
  Result<std::optional<CameraFrame>> wait(Seconds timeout, Seconds oldest) override;
  Result<FramePixels> pixels() override;
  std::shared_ptr<const std::vector<std::byte>> jpeg() const override { return jpeg_; }
  TimestampNs now() const override { return monotonic_now(); }

 private:
  static int snap(const V4l2Node::Control& c, double value) {
    const double steps = std::round((value - c.low) / c.step);
    return static_cast<int>(std::clamp(c.low + steps * c.step, c.low, c.high));
  }
  Result<void> give_back(std::uint32_t index);
  Result<void> give_back_last();
  // 0, or errno: EAGAIN when nothing is there.
  int take(v4l2_buffer& buffer);

  V4l2Node node_;
  RawConverter converter_;
  std::shared_ptr<const std::vector<std::byte>> jpeg_;
  V4l2Exposure controls_;
  double unit_gain_ = 1;
  std::vector<MappedBuffer> buffers_;
  std::optional<v4l2_buffer> last_;  // ours until its picture was taken
  int damaged_ = 0;                  // since the last frame
  bool streaming_ = false;
};

Result<void> V4l2Device::start() {
  v4l2_requestbuffers request{};
  request.count = kMappedBuffers, request.type = kType, request.memory = V4L2_MEMORY_MMAP;
  if (const int e = node_.call(VIDIOC_REQBUFS, &request))
    return std::unexpected(node_.error(ErrorCode::kUnavailable, "provides no buffers", e));
  for (std::uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.index = i, buffer.type = kType, buffer.memory = V4L2_MEMORY_MMAP;
    if (const int e = node_.call(VIDIOC_QUERYBUF, &buffer))
      return std::unexpected(node_.error(ErrorCode::kUnavailable, "does not describe a buffer", e));
    buffers_.emplace_back(node_.fd(), buffer.length, buffer.m.offset);
    if (!buffers_.back())
      return std::unexpected(node_.error(ErrorCode::kUnavailable, "cannot map a buffer", errno));
    PENUMBRA_TRY(give_back(i));
  }
  int type = kType;
  if (const int e = node_.call(VIDIOC_STREAMON, &type))
    return std::unexpected(node_.error(ErrorCode::kUnavailable, "cannot be started", e));
  streaming_ = true;
  return {};
}

Exposure V4l2Device::nearest(Exposure wanted) const {
  Exposure out = wanted;
  if (controls_.time)
    out.time = Seconds(snap(*controls_.time, wanted.time.count() / V4l2Exposure::kUnit) *
                       V4l2Exposure::kUnit);
  out.gain = Gain(
      controls_.gain ? snap(*controls_.gain, wanted.gain.value() * unit_gain_) / unit_gain_ : 1);
  return out;
}

Result<void> V4l2Device::request(Exposure wanted) {
  if (!controls_.time)
    return fail(ErrorCode::kInvalid, node_.device(), "has no exposure time that can be set");
  int e = node_.set(controls_.time->id,
                    snap(*controls_.time, wanted.time.count() / V4l2Exposure::kUnit));
  if (!e && controls_.gain)
    e = node_.set(controls_.gain->id, snap(*controls_.gain, wanted.gain.value() * unit_gain_));
  if (!e) return {};
  return std::unexpected(node_.error(e == ENODEV ? ErrorCode::kClosed : ErrorCode::kInvalid,
                                     "refuses the exposure", e));
}

Result<void> V4l2Device::give_back(std::uint32_t index) {
  v4l2_buffer buffer{};
  buffer.index = index, buffer.type = kType, buffer.memory = V4L2_MEMORY_MMAP;
  if (const int e = node_.call(VIDIOC_QBUF, &buffer))
    return std::unexpected(node_.error(ErrorCode::kClosed, "refuses a returned buffer", e));
  return {};
}

TimestampNs time_of(const v4l2_buffer& buffer) {
  const bool monotonic =
      (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  if (!monotonic) return monotonic_now();
  return {buffer.timestamp.tv_sec * 1'000'000'000LL + buffer.timestamp.tv_usec * 1'000LL};
}

Result<void> V4l2Device::give_back_last() {
  if (!last_) return {};
  const std::uint32_t index = last_->index;
  last_.reset();
  return give_back(index);
}

int V4l2Device::take(v4l2_buffer& buffer) {
  buffer = {};
  buffer.type = kType, buffer.memory = V4L2_MEMORY_MMAP;
  return node_.call(VIDIOC_DQBUF, &buffer);
}

Result<std::optional<CameraFrame>> V4l2Device::wait(Seconds timeout, Seconds oldest) {
  PENUMBRA_TRY(give_back_last());
  const TimestampNs end = monotonic_now() + timeout;
  while (true) {
    v4l2_buffer buffer;
    if (const int e = take(buffer); e == EAGAIN) {
      const double left = std::clamp((end - monotonic_now()).count(), 0., 3600.);
      pollfd ready{node_.fd(), POLLIN, 0};
      if (left <= 0 || ::poll(&ready, 1, static_cast<int>(left * 1000) + 1) == 0)
        return std::nullopt;
      continue;
    } else if (e != 0) {
      return std::unexpected(node_.error(ErrorCode::kClosed, "delivers no more frames", e));
    }
    const bool damaged = (buffer.flags & V4L2_BUF_FLAG_ERROR) || buffer.index >= buffers_.size();
    damaged_ += damaged;
    if (damaged || monotonic_now() - time_of(buffer) > oldest) {
      PENUMBRA_TRY(give_back(buffer.index));
      continue;
    }
    last_ = buffer;
    return CameraFrame{buffer.sequence, time_of(buffer), std::exchange(damaged_, 0)};
  }
}

Result<FramePixels> V4l2Device::pixels() {
  if (!last_) return fail(ErrorCode::kUnreadable, node_.device(), "has no frame to read");
  const auto bytes = buffers_[last_->index].bytes();
  const auto used = bytes.first(std::min<std::size_t>(last_->bytesused, bytes.size()));
  auto pixels = converter_.convert(used);
  if (pixels && converter_.decodes_jpeg())
    jpeg_ = std::make_shared<const std::vector<std::byte>>(used.begin(), used.end());
  PENUMBRA_TRY(give_back_last());
  return pixels;
}

Result<RawLayout> negotiate(const V4l2Node& node, const CameraMode& mode, double fps) {
  PENUMBRA_ASSIGN(fourcc, fourcc_from(mode.format));
  v4l2_format format{};
  format.type = kType;
  format.fmt.pix.width = static_cast<std::uint32_t>(mode.width);
  format.fmt.pix.height = static_cast<std::uint32_t>(mode.height);
  format.fmt.pix.pixelformat = fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  if (const int e = node.call(VIDIOC_S_FMT, &format))
    return std::unexpected(node.error(ErrorCode::kUnavailable, "refuses the format", e));
  const v4l2_pix_format& pix = format.fmt.pix;
  if (pix.pixelformat != fourcc || pix.width != static_cast<std::uint32_t>(mode.width) ||
      pix.height != static_cast<std::uint32_t>(mode.height))
    return fail(ErrorCode::kUnavailable, node.device(),
                fmt::format("gives {} {}x{} instead of {} {}x{}", fourcc_name(pix.pixelformat),
                            pix.width, pix.height, mode.format, mode.width, mode.height));
  v4l2_streamparm parameters{};
  parameters.type = kType;
  parameters.parm.capture.timeperframe = {1000,
                                          static_cast<std::uint32_t>(std::lround(fps * 1000))};
  node.call(VIDIOC_S_PARM, &parameters);  // drivers without a choice of rates refuse; frames tell
  std::uint32_t encoding = pix.ycbcr_enc, range = pix.quantization;
  if (encoding == V4L2_YCBCR_ENC_DEFAULT) encoding = V4L2_MAP_YCBCR_ENC_DEFAULT(pix.colorspace);
  if (range == V4L2_QUANTIZATION_DEFAULT)
    range = V4L2_MAP_QUANTIZATION_DEFAULT(false, pix.colorspace, encoding);
  return RawLayout{fourcc,
                   mode.width,
                   mode.height,
                   static_cast<int>(pix.bytesperline),
                   range == V4L2_QUANTIZATION_FULL_RANGE,
                   encoding == V4L2_YCBCR_ENC_709};
}

}  // namespace

Result<std::unique_ptr<CameraDevice>> open_v4l2(const CameraSettings& s) {
  PENUMBRA_ASSIGN(node, V4l2Node::open(s.device));
  PENUMBRA_ASSIGN(mode, choose_mode(node.modes(), s));
  PENUMBRA_ASSIGN(layout, negotiate(node, mode, s.fps));
  auto converter = RawConverter::make(layout);
  if (!converter)
    return fail(converter.error().code, s.device,
                converter.error().where + ": " + converter.error().detail);
  if (s.stop_automatics) {
    stop_automatics(node);
    PENUMBRA_TRY(fix_white_balance(node, s.white_balance_k));
  }
  auto device = std::make_unique<V4l2Device>(std::move(node), std::move(*converter), s);
  PENUMBRA_TRY(device->start());
  return device;
}

}  // namespace penumbra::capture
