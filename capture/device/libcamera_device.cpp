#include "capture/device/internal/libcamera_device.h"

#include <fmt/format.h>
#include <libcamera/libcamera.h>
#include <libcamera/logging.h>
#include <linux/dma-buf.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <map>
#include <mutex>

#include "capture/device/internal/v4l2_node.h"
#include "capture/raw_formats.h"
#include "capture/unique_fd.h"

namespace penumbra::capture {

namespace lc = libcamera;

namespace {

constexpr unsigned kBuffers = 4;
constexpr double kMicrosecond = 1e-6;  // seconds of libcamera's ExposureTime

// One a process, as libcamera wants it; it stops when nobody uses it any more, and the next begins
// only then.
Result<std::shared_ptr<lc::CameraManager>> manager() {
  static std::mutex mutex;
  static lc::CameraManager* running = nullptr;  // guarded by mutex, like users
  static int users = 0;
  const std::scoped_lock lock(mutex);
  if (!running) {
    // What matters comes back as errors; who looks deeper sets libcamera's own variables.
    if (!std::getenv("LIBCAMERA_LOG_LEVELS")) lc::logSetTarget(lc::LoggingTargetNone);
    auto made = std::make_unique<lc::CameraManager>();
    if (const int e = made->start())
      return fail(ErrorCode::kUnavailable, "libcamera",
                  fmt::format("cannot be started: {}", std::strerror(-e)));
    running = made.release();
  }
  ++users;
  return std::shared_ptr<lc::CameraManager>(running, [](lc::CameraManager* used) {
    const std::scoped_lock last(mutex);
    if (--users > 0) return;
    delete used;
    running = nullptr;
  });
}

// libcamera names formats as DRM does, which orders RGB the other way round and counts from the
// lowest bits.
std::uint32_t v4l2_fourcc_of(const lc::PixelFormat& format) {
  const std::uint32_t drm = format.fourcc();
  if (format.modifier() != 0) return 0;  // packed raw formats
  if (drm == v4l2_fourcc('B', 'G', '2', '4')) return V4L2_PIX_FMT_RGB24;
  if (drm == v4l2_fourcc('R', 'G', '2', '4')) return V4L2_PIX_FMT_BGR24;
  if (drm == v4l2_fourcc('R', '8', ' ', ' ')) return V4L2_PIX_FMT_GREY;
  return drm;
}

std::string name_of(const lc::Camera& camera) {
  if (const auto model = camera.properties().get(lc::properties::Model)) return *model;
  return camera.id();
}

std::vector<CameraMode> modes_of(const lc::StreamConfiguration& stream) {
  std::vector<CameraMode> out;
  for (const lc::PixelFormat& format : stream.formats().pixelformats()) {
    const std::uint32_t fourcc = v4l2_fourcc_of(format);
    for (const lc::Size& size : stream.formats().sizes(format))
      out.push_back({fourcc ? fourcc_name(fourcc) : format.toString(), static_cast<int>(size.width),
                     static_cast<int>(size.height), 0, fourcc && format_rank(fourcc) > 0});
  }
  return out;
}

struct ControlLimits {
  std::optional<ControlRange> time_s, gain;
};
ControlLimits limits_of(const lc::Camera& camera) {
  ControlLimits out;
  const lc::ControlInfoMap& controls = camera.controls();
  if (const auto it = controls.find(&lc::controls::ExposureTime); it != controls.end())
    out.time_s = ControlRange{it->second.min().get<std::int32_t>() * kMicrosecond,
                              it->second.max().get<std::int32_t>() * kMicrosecond};
  if (const auto it = controls.find(&lc::controls::AnalogueGain); it != controls.end())
    out.gain =
        ControlRange{double(it->second.min().get<float>()), double(it->second.max().get<float>())};
  return out;
}

// A buffer of one memory, however many planes lie in it.
struct DeviceBuffer {
  MappedBuffer memory;
  int fd;
  std::size_t offset;
};
Result<DeviceBuffer> map_buffer(const lc::FrameBuffer& buffer, const std::string& device) {
  const auto& planes = buffer.planes();
  std::size_t end = 0;
  for (const auto& plane : planes) {
    if (plane.fd.get() != planes[0].fd.get())
      return fail(ErrorCode::kUnavailable, device,
                  "delivers each picture in several buffers, which is not supported");
    end = std::max(end, std::size_t{plane.offset} + plane.length);
  }
  DeviceBuffer out{MappedBuffer(planes[0].fd.get(), end, 0), planes[0].fd.get(), planes[0].offset};
  if (!out.memory)
    return fail(ErrorCode::kUnavailable, device,
                fmt::format("cannot map a buffer: {}", std::strerror(errno)));
  return out;
}

// Caches of the device and of the processor see the same while this lives.
class DmaRead {
 public:
  explicit DmaRead(int fd) : fd_(fd) { sync(DMA_BUF_SYNC_START); }
  ~DmaRead() { sync(DMA_BUF_SYNC_END); }
  DmaRead(const DmaRead&) = delete;
  DmaRead& operator=(const DmaRead&) = delete;

 private:
  void sync(std::uint64_t edge) {
    dma_buf_sync s{edge | DMA_BUF_SYNC_READ};
    ::ioctl(fd_, DMA_BUF_IOCTL_SYNC, &s);
  }
  int fd_;
};

// What libcamera's thread hands to ours.
class Completed {
 public:
  void add(lc::Request* request) {
    const std::scoped_lock lock(mutex_);
    requests_.push_back(request);
    changed_.notify_one();
  }
  void end() {
    const std::scoped_lock lock(mutex_);
    ended_ = true;
    changed_.notify_one();
  }
  bool ended() const {
    const std::scoped_lock lock(mutex_);
    return ended_;
  }
  lc::Request* wait(Seconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return ended_ || !requests_.empty(); });
    if (ended_ || requests_.empty()) return nullptr;
    lc::Request* const request = requests_.front();
    requests_.pop_front();
    return request;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<lc::Request*> requests_;  // at most kBuffers
  bool ended_ = false;
};

class LibcameraDevice : public CameraDevice {
 public:
  LibcameraDevice(std::shared_ptr<lc::CameraManager> cameras, std::shared_ptr<lc::Camera> camera,
                  const CameraSettings& settings)
      : cameras_(std::move(cameras)),
        camera_(std::move(camera)),
        settings_(settings),
        name_(name_of(*camera_)),
        limits_(limits_of(*camera_)),
        unit_gain_(settings.unit_gain) {
    if (unit_gain_ <= 0) unit_gain_ = limits_.gain ? std::max(1., limits_.gain->low) : 1;
  }
  ~LibcameraDevice() override {
    if (started_) camera_->stop();  // no signal comes after it
    camera_->requestCompleted.disconnect(this);
    camera_->disconnected.disconnect(this);
    requests_.clear();
    pictures_.clear();
    allocator_.reset();
    camera_->release();
  }
  Result<void> start();

  const std::string& name() const override { return name_; }
  Exposure nearest(Exposure wanted) const override;
  Result<void> request(Exposure wanted) override;
  Result<std::optional<CameraFrame>> wait(Seconds timeout, Seconds oldest) override;
  Result<FramePixels> pixels() override;
  std::shared_ptr<const std::vector<std::byte>> jpeg() const override { return jpeg_; }
  TimestampNs now() const override {
    return {std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count()};
  }

 private:
  Error error(ErrorCode code, const std::string& what, int negative) const {
    return {code, settings_.device, fmt::format("{}: {}", what, std::strerror(-negative))};
  }
  Result<void> configure();
  lc::ControlList without_automatics() const;
  Result<void> give_back(lc::Request* request);
  Result<void> give_back_last();
  void set_exposure(lc::ControlList& controls) const;
  std::optional<Exposure> applied(lc::Request& request) const;
  void completed(lc::Request* request) { completed_.add(request); }
  void disconnected() { completed_.end(); }

  std::shared_ptr<lc::CameraManager> cameras_;
  std::shared_ptr<lc::Camera> camera_;
  CameraSettings settings_;
  std::string name_;
  ControlLimits limits_;
  double unit_gain_;
  lc::Stream* stream_ = nullptr;
  std::optional<RawConverter> converter_;
  std::unique_ptr<lc::FrameBufferAllocator> allocator_;
  std::map<const lc::FrameBuffer*, DeviceBuffer> pictures_;
  std::vector<std::unique_ptr<lc::Request>> requests_;
  Completed completed_;
  std::optional<Exposure> wanted_;
  lc::Request* last_ = nullptr;  // ours until its picture was taken
  std::shared_ptr<const std::vector<std::byte>> jpeg_;
  int damaged_ = 0;  // since the last frame
  bool started_ = false;
};

Result<void> LibcameraDevice::configure() {
  auto configuration = camera_->generateConfiguration({lc::StreamRole::VideoRecording});
  if (!configuration || configuration->empty())
    return fail(ErrorCode::kUnavailable, settings_.device, "has no video stream");
  lc::StreamConfiguration& stream = configuration->at(0);
  PENUMBRA_ASSIGN(mode, choose_mode(modes_of(stream), settings_));
  const auto formats = stream.formats().pixelformats();
  const auto format = std::ranges::find_if(formats, [&](const lc::PixelFormat& f) {
    const std::uint32_t fourcc = v4l2_fourcc_of(f);
    return fourcc && fourcc_name(fourcc) == mode.format;
  });
  stream.pixelFormat = *format;
  stream.size = {static_cast<unsigned>(mode.width), static_cast<unsigned>(mode.height)};
  stream.bufferCount = kBuffers;
  const lc::PixelFormat asked = stream.pixelFormat;
  const lc::Size size = stream.size;
  if (configuration->validate() == lc::CameraConfiguration::Invalid ||
      stream.pixelFormat != asked || stream.size != size)
    return fail(ErrorCode::kUnavailable, settings_.device,
                fmt::format("does not give {} {}x{}", mode.format, mode.width, mode.height));
  if (const int e = camera_->configure(configuration.get()))
    return std::unexpected(error(ErrorCode::kUnavailable, "refuses the format", e));
  stream_ = stream.stream();
  RawLayout layout{v4l2_fourcc_of(asked), mode.width, mode.height, static_cast<int>(stream.stride)};
  if (stream.colorSpace) {
    layout.full_range = stream.colorSpace->range == lc::ColorSpace::Range::Full;
    layout.bt709 = stream.colorSpace->ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec709;
  }
  auto converter = RawConverter::make(layout);
  if (!converter)
    return fail(converter.error().code, settings_.device,
                converter.error().where + ": " + converter.error().detail);
  converter_ = std::move(*converter);
  return {};
}

// At the frame rate that was asked for.
lc::ControlList LibcameraDevice::without_automatics() const {
  const lc::ControlInfoMap& known = camera_->controls();
  const auto has = [&](const lc::ControlId& id) { return known.find(&id) != known.end(); };
  lc::ControlList out(known);
  if (has(lc::controls::AeEnable)) out.set(lc::controls::AeEnable, false);
  if (has(lc::controls::AwbEnable)) out.set(lc::controls::AwbEnable, false);
  if (has(lc::controls::FrameDurationLimits)) {
    const auto period = static_cast<std::int64_t>(1e6 / settings_.fps);
    out.set(lc::controls::FrameDurationLimits, {period, period});
  }
  return out;
}

Result<void> LibcameraDevice::start() {
  PENUMBRA_TRY(configure());
  allocator_ = std::make_unique<lc::FrameBufferAllocator>(camera_);
  if (const int e = allocator_->allocate(stream_); e < 0)
    return std::unexpected(error(ErrorCode::kUnavailable, "provides no buffers", e));
  for (const auto& buffer : allocator_->buffers(stream_)) {
    PENUMBRA_ASSIGN(picture, map_buffer(*buffer, settings_.device));
    pictures_.emplace(buffer.get(), std::move(picture));
    requests_.push_back(camera_->createRequest());
    if (!requests_.back() || requests_.back()->addBuffer(stream_, buffer.get()) != 0)
      return fail(ErrorCode::kUnavailable, settings_.device, "refuses a capture request");
  }
  camera_->requestCompleted.connect(this, &LibcameraDevice::completed);
  camera_->disconnected.connect(this, &LibcameraDevice::disconnected);
  lc::ControlList controls = without_automatics();
  if (const int e = camera_->start(&controls))
    return std::unexpected(error(ErrorCode::kUnavailable, "cannot be started", e));
  started_ = true;
  for (const auto& request : requests_) {
    // Once more: some pipelines take no controls at the start. Exposures follow later, which
    // automatics would refuse.
    request->controls().merge(controls);
    if (const int e = camera_->queueRequest(request.get()))
      return std::unexpected(error(ErrorCode::kUnavailable, "refuses a capture request", e));
  }
  return {};
}

Exposure LibcameraDevice::nearest(Exposure wanted) const {
  Exposure out = wanted;
  if (limits_.time_s)
    out.time =
        Seconds(kMicrosecond * std::round(std::clamp(wanted.time.count(), limits_.time_s->low,
                                                     limits_.time_s->high) /
                                          kMicrosecond));
  out.gain = Gain(limits_.gain ? std::clamp(wanted.gain.value() * unit_gain_, limits_.gain->low,
                                            limits_.gain->high) /
                                     unit_gain_
                               : 1);
  return out;
}

// Goes with the next request: the cameras of libcamera take exposures frame by frame.
Result<void> LibcameraDevice::request(Exposure wanted) {
  if (!limits_.time_s)
    return fail(ErrorCode::kInvalid, settings_.device, "has no exposure time that can be set");
  wanted_ = wanted;
  return {};
}

void LibcameraDevice::set_exposure(lc::ControlList& controls) const {
  if (!wanted_) return;
  controls.set(lc::controls::ExposureTime,
               static_cast<std::int32_t>(std::lround(wanted_->time.count() / kMicrosecond)));
  if (limits_.gain)
    controls.set(lc::controls::AnalogueGain,
                 static_cast<float>(wanted_->gain.value() * unit_gain_));
}

Result<void> LibcameraDevice::give_back(lc::Request* request) {
  request->reuse(lc::Request::ReuseBuffers);
  set_exposure(request->controls());
  if (const int e = camera_->queueRequest(request))
    return std::unexpected(error(ErrorCode::kClosed, "refuses a capture request", e));
  return {};
}

Result<void> LibcameraDevice::give_back_last() {
  return last_ ? give_back(std::exchange(last_, nullptr)) : Result<void>{};
}

// What the sensor's metadata say, where there is a sensor that has any.
std::optional<Exposure> LibcameraDevice::applied(lc::Request& request) const {
  const auto time = request.metadata().get(lc::controls::ExposureTime);
  if (!time || *time <= 0) return std::nullopt;
  const auto gain = request.metadata().get(lc::controls::AnalogueGain);
  return Exposure{Seconds(*time * kMicrosecond), Gain(gain ? double(*gain) / unit_gain_ : 1)};
}

Result<std::optional<CameraFrame>> LibcameraDevice::wait(Seconds timeout, Seconds oldest) {
  PENUMBRA_TRY(give_back_last());
  const TimestampNs end = now() + timeout;
  while (true) {
    lc::Request* const request = completed_.wait(Seconds(std::max(0., (end - now()).count())));
    if (completed_.ended())
      return fail(ErrorCode::kClosed, settings_.device, "is not connected any more");
    if (!request) return std::nullopt;
    const lc::FrameMetadata& frame = request->findBuffer(stream_)->metadata();
    const TimestampNs time{static_cast<std::int64_t>(frame.timestamp)};
    const bool damaged = frame.status != lc::FrameMetadata::FrameSuccess;
    damaged_ += damaged;
    if (damaged || now() - time > oldest) {
      PENUMBRA_TRY(give_back(request));
      continue;
    }
    last_ = request;
    return CameraFrame{frame.sequence, time, std::exchange(damaged_, 0), applied(*request)};
  }
}

Result<FramePixels> LibcameraDevice::pixels() {
  if (!last_) return fail(ErrorCode::kUnreadable, settings_.device, "has no frame to read");
  const lc::FrameBuffer* const buffer = last_->findBuffer(stream_);
  const DeviceBuffer& picture = pictures_.at(buffer);
  std::size_t used = 0;
  for (const auto& plane : buffer->metadata().planes()) used += plane.bytesused;
  const auto all = picture.memory.bytes().subspan(picture.offset);
  const auto bytes = all.first(std::min(used, all.size()));
  auto pixels = [&] {
    const DmaRead reading(picture.fd);
    auto out = converter_->convert(bytes);
    if (out && converter_->decodes_jpeg())
      jpeg_ = std::make_shared<const std::vector<std::byte>>(bytes.begin(), bytes.end());
    return out;
  }();
  PENUMBRA_TRY(give_back_last());
  return pixels;
}

}  // namespace

void list_libcamera(CameraList& list) {
  auto cameras = manager();
  if (!cameras) {
    list.rejected.push_back(cameras.error());
    return;
  }
  for (const auto& camera : (*cameras)->cameras()) {
    const std::string device = std::string(kLibcamera) + camera->id();
    const auto configuration = camera->generateConfiguration({lc::StreamRole::VideoRecording});
    if (!configuration || configuration->empty()) {
      list.rejected.push_back({ErrorCode::kUnavailable, device, "has no video stream"});
      continue;
    }
    const ControlLimits limits = limits_of(*camera);
    list.cameras.push_back({device, name_of(*camera), "libcamera", modes_of(configuration->at(0)),
                            limits.time_s, limits.gain});
  }
}

Result<std::unique_ptr<CameraDevice>> open_libcamera(const CameraSettings& settings) {
  PENUMBRA_ASSIGN(cameras, manager());
  const std::string id = settings.device.substr(kLibcamera.size());
  auto camera = cameras->get(id);
  if (!camera) return fail(ErrorCode::kNotFound, settings.device, "is not a connected camera");
  if (const int e = camera->acquire())
    return fail(ErrorCode::kUnavailable, settings.device,
                fmt::format("cannot be opened: {}", std::strerror(-e)));
  auto device = std::make_unique<LibcameraDevice>(std::move(cameras), std::move(camera), settings);
  PENUMBRA_TRY(device->start());
  return device;
}

}  // namespace penumbra::capture
