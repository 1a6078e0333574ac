// A camera among PipeWire's: a stream that drives the graph with each new frame.
#include <fmt/format.h>
#include <pipewire/pipewire.h>
#include <spa/param/video/format-utils.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "service/outputs/colour_conversion.h"
#include "service/outputs/frame_output.h"
#include "service/outputs/internal/frame_sink.h"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpedantic"  // PipeWire's macros are GNU C

namespace penumbra::service {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds kBetweenTries(2);
constexpr const char* kUnreachable = "cannot be reached: is PipeWire running?";
constexpr int kBytesPerPixel = 4;
constexpr int kLargestSide_px = 16384;

struct Deleter {
  void operator()(pw_thread_loop* p) const { pw_thread_loop_destroy(p); }
  void operator()(pw_context* p) const { pw_context_destroy(p); }
  void operator()(pw_core* p) const { pw_core_disconnect(p); }
  void operator()(pw_stream* p) const { pw_stream_destroy(p); }
};
template <class T>
using Owned = std::unique_ptr<T, Deleter>;

// All of PipeWire's objects but the loop belong to whoever holds the loop's lock: its own thread,
// which calls back, or the output's.
class LoopLock {
 public:
  explicit LoopLock(pw_thread_loop* loop) : loop_(loop) { pw_thread_loop_lock(loop_); }
  ~LoopLock() { pw_thread_loop_unlock(loop_); }
  LoopLock(const LoopLock&) = delete;
  LoopLock& operator=(const LoopLock&) = delete;

 private:
  pw_thread_loop* const loop_;
};

class Library {
 public:
  Library() {
    pw_init(nullptr, nullptr);
    // What goes wrong is told by the output; a server that is not there would be complained of
    // every two seconds.
    if (!std::getenv("PIPEWIRE_DEBUG")) pw_log_set_level(SPA_LOG_LEVEL_NONE);
  }
  ~Library() { pw_deinit(); }
  Library(const Library&) = delete;
  Library& operator=(const Library&) = delete;
};

class PipeWireSink : public FrameSink {
 public:
  PipeWireSink(FrameOutput::PipeWireNode node, FrameRate rate)
      : node_(std::move(node)), rate_(rate) {}
  ~PipeWireSink() override;

  Result<void> start();
  Result<std::string> tend() override;
  Result<bool> put(const FramePixels& pixels, TimestampNs captured,
                   const std::stop_token& stop) override;

 private:
  // These need the lock.
  bool connect();
  void disconnect();
  bool make_stream(int width, int height);
  bool fill(pw_buffer& buffer, const FramePixels& pixels, TimestampNs captured);

  // These are called on the loop's thread.
  static void on_core_error(void* self, std::uint32_t id, int sequence, int result,
                            const char* message);
  static void on_state(void* self, pw_stream_state old, pw_stream_state state, const char* error);
  static void on_format(void* self, std::uint32_t id, const spa_pod* format);

  const FrameOutput::PipeWireNode node_;
  const FrameRate rate_;
  const Library library_;
  Owned<pw_thread_loop> loop_;
  Owned<pw_context> context_;  // with the lock, as are all below
  Owned<pw_core> core_;
  Owned<pw_stream> stream_;
  spa_hook core_hook_{}, stream_hook_{};
  bool lost_ = false, watched_ = false;
  int width_ = 0, height_ = 0;
  std::uint64_t sequence_ = 0;
  Clock::time_point next_try_ = Clock::now();
};

PipeWireSink::~PipeWireSink() {
  if (!loop_) return;
  {
    const LoopLock lock(loop_.get());
    disconnect();
    context_.reset();
  }
  pw_thread_loop_stop(loop_.get());
}

Result<void> PipeWireSink::start() {
  const auto lacking = [] {
    return fail(ErrorCode::kUnavailable, "PipeWire",
                fmt::format("cannot be used: {}", std::strerror(errno)));
  };
  loop_.reset(pw_thread_loop_new("pipewire-output", nullptr));
  if (!loop_) return lacking();
  context_.reset(pw_context_new(pw_thread_loop_get_loop(loop_.get()), nullptr, 0));
  if (!context_ || pw_thread_loop_start(loop_.get()) < 0) return lacking();
  return {};
}

bool PipeWireSink::connect() {
  static const pw_core_events events = [] {
    pw_core_events out{};
    out.version = PW_VERSION_CORE_EVENTS;
    out.error = on_core_error;
    return out;
  }();
  core_.reset(pw_context_connect(context_.get(), nullptr, 0));
  if (!core_) return false;
  lost_ = false;
  core_hook_ = {};
  pw_core_add_listener(core_.get(), &core_hook_, &events, this);
  return true;
}

void PipeWireSink::disconnect() {
  if (stream_) spa_hook_remove(&stream_hook_);
  stream_.reset();
  if (core_) spa_hook_remove(&core_hook_);
  core_.reset();
  watched_ = false;
}

void PipeWireSink::on_core_error(void* self, std::uint32_t id, int, int result, const char*) {
  if (id == PW_ID_CORE && result == -EPIPE) static_cast<PipeWireSink*>(self)->lost_ = true;
}

void PipeWireSink::on_state(void* self, pw_stream_state, pw_stream_state state, const char*) {
  auto& sink = *static_cast<PipeWireSink*>(self);
  sink.watched_ = state == PW_STREAM_STATE_STREAMING;
  // A node that the server does not keep is made anew, with the connection.
  if (state == PW_STREAM_STATE_ERROR) sink.lost_ = true;
}

// What a buffer holds, once a format is agreed on: one plane, and a header for the time.
void PipeWireSink::on_format(void* self, std::uint32_t id, const spa_pod* format) {
  auto& sink = *static_cast<PipeWireSink*>(self);
  if (id != SPA_PARAM_Format || !format) return;
  std::uint8_t space[512];
  spa_pod_builder builder = SPA_POD_BUILDER_INIT(space, sizeof space);
  const int row_bytes = sink.width_ * kBytesPerPixel;
  const auto* buffers = static_cast<const spa_pod*>(spa_pod_builder_add_object(
      &builder, SPA_TYPE_OBJECT_ParamBuffers, SPA_PARAM_Buffers, SPA_PARAM_BUFFERS_buffers,
      SPA_POD_CHOICE_RANGE_Int(4, 2, 16), SPA_PARAM_BUFFERS_blocks, SPA_POD_Int(1),
      SPA_PARAM_BUFFERS_size, SPA_POD_Int(row_bytes * sink.height_), SPA_PARAM_BUFFERS_stride,
      SPA_POD_Int(row_bytes), SPA_PARAM_BUFFERS_dataType,
      SPA_POD_CHOICE_FLAGS_Int(1 << SPA_DATA_MemFd | 1 << SPA_DATA_MemPtr)));
  const auto* header = static_cast<const spa_pod*>(spa_pod_builder_add_object(
      &builder, SPA_TYPE_OBJECT_ParamMeta, SPA_PARAM_Meta, SPA_PARAM_META_type,
      SPA_POD_Id(SPA_META_Header), SPA_PARAM_META_size,
      SPA_POD_Int(static_cast<int>(sizeof(spa_meta_header)))));
  const spa_pod* params[] = {buffers, header};
  pw_stream_update_params(sink.stream_.get(), params, 2);
}

bool PipeWireSink::make_stream(int width, int height) {
  static const pw_stream_events events = [] {
    pw_stream_events out{};
    out.version = PW_VERSION_STREAM_EVENTS;
    out.state_changed = on_state;
    out.param_changed = on_format;
    return out;
  }();
  if (stream_) spa_hook_remove(&stream_hook_);
  stream_.reset();
  watched_ = false;
  width_ = width, height_ = height;
  stream_.reset(pw_stream_new(
      core_.get(), node_.name.c_str(),
      pw_properties_new(PW_KEY_MEDIA_CLASS, "Video/Source", PW_KEY_MEDIA_ROLE, "Camera",
                        PW_KEY_NODE_NAME, node_.name.c_str(), PW_KEY_NODE_DESCRIPTION,
                        node_.description.c_str(), nullptr)));
  if (!stream_) return false;
  stream_hook_ = {};
  pw_stream_add_listener(stream_.get(), &stream_hook_, &events, this);
  std::uint8_t space[512];
  spa_pod_builder builder = SPA_POD_BUILDER_INIT(space, sizeof space);
  spa_video_info_raw info{};
  info.format = SPA_VIDEO_FORMAT_BGRx;
  info.size = {static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height)};
  info.framerate = {static_cast<std::uint32_t>(rate_.numerator),
                    static_cast<std::uint32_t>(rate_.denominator)};
  const spa_pod* format = spa_format_video_raw_build(&builder, SPA_PARAM_EnumFormat, &info);
  // NOLINTBEGIN(clang-analyzer-optin.core.EnumCastOutOfRange): its values are bits
  constexpr auto kFlags =
      static_cast<pw_stream_flags>(PW_STREAM_FLAG_DRIVER | PW_STREAM_FLAG_MAP_BUFFERS);
  // NOLINTEND(clang-analyzer-optin.core.EnumCastOutOfRange)
  return pw_stream_connect(stream_.get(), PW_DIRECTION_OUTPUT, PW_ID_ANY, kFlags, &format, 1) >= 0;
}

Result<std::string> PipeWireSink::tend() {
  const LoopLock lock(loop_.get());
  if (core_ && !lost_) return std::string();
  if (core_) {
    disconnect();
    next_try_ = Clock::now() + kBetweenTries;
  }
  if (Clock::now() < next_try_) return std::string(kUnreachable);
  next_try_ = Clock::now() + kBetweenTries;
  return connect() ? std::string() : std::string(kUnreachable);
}

bool PipeWireSink::fill(pw_buffer& buffer, const FramePixels& pixels, TimestampNs captured) {
  spa_buffer& to = *buffer.buffer;
  const int row_bytes = width_ * kBytesPerPixel;
  const std::size_t bytes = static_cast<std::size_t>(row_bytes) * static_cast<std::size_t>(height_);
  if (to.n_datas < 1 || !to.datas[0].data || to.datas[0].maxsize < bytes) return false;
  const DisplayPicture picture(pixels);
  to_bgrx(*picture, static_cast<std::uint8_t*>(to.datas[0].data),
          static_cast<std::size_t>(row_bytes));
  to.datas[0].chunk->offset = 0;
  to.datas[0].chunk->size = static_cast<std::uint32_t>(bytes);
  to.datas[0].chunk->stride = row_bytes;
  to.datas[0].chunk->flags = 0;
  if (void* const meta = spa_buffer_find_meta_data(&to, SPA_META_Header, sizeof(spa_meta_header))) {
    auto& header = *static_cast<spa_meta_header*>(meta);
    header = {};
    header.pts = captured.value;
    header.seq = sequence_;
  }
  return true;
}

Result<bool> PipeWireSink::put(const FramePixels& pixels, TimestampNs captured,
                               const std::stop_token&) {
  const auto [width, height] = std::visit(
      [](const auto& image) { return std::pair(image.width(), image.height()); }, pixels);
  if (width < 1 || height < 1 || std::max(width, height) > kLargestSide_px)
    return fail(ErrorCode::kInvalid, node_.name,
                fmt::format("cannot show pictures of {}x{}", width, height));
  const LoopLock lock(loop_.get());
  if (!core_ || lost_) return false;
  if (!stream_ || width != width_ || height != height_) {
    if (!make_stream(width, height)) lost_ = true;
    return false;
  }
  ++sequence_;
  if (!watched_) return false;
  // Where watchers hold all buffers they get this frame's successor.
  pw_buffer* const buffer = pw_stream_dequeue_buffer(stream_.get());
  if (!buffer) return false;
  const bool filled = fill(*buffer, pixels, captured);
  if (!filled) buffer->buffer->datas[0].chunk->size = 0;
  pw_stream_queue_buffer(stream_.get(), buffer);
  pw_stream_trigger_process(stream_.get());
  return filled;
}

}  // namespace

Result<std::unique_ptr<FrameOutput>> FrameOutput::to_pipewire(const PipeWireNode& node) {
  const std::string name = fmt::format("PipeWire node {}", node.name);
  constexpr std::size_t kLongest = 100;
  const auto plain = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '.' || c == '_' || c == '-';
  };
  if (node.name.empty() || node.name.size() > kLongest || !std::ranges::all_of(node.name, plain))
    return fail(ErrorCode::kInvalid, name,
                "has a name that is not 1 to 100 letters, digits, '.', '_' and '-'");
  PENUMBRA_ASSIGN(rate, FrameRate::from(node.rate_hz, name));
  auto sink = std::make_unique<PipeWireSink>(node, rate);
  PENUMBRA_TRY(sink->start());
  return std::make_unique<FrameOutput>(name, std::move(sink));
}

}  // namespace penumbra::service

#pragma GCC diagnostic pop
