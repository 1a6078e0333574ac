#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <mutex>

#include "calib/camera/response.h"
#include "capture/frames.h"
#include "capture/recording/folder_format.h"
#include "capture/recording/internal/map_coding.h"
#include "capture/recording/internal/recording_format.h"
#include "capture/recording/recording.h"
#include "capture/unique_fd.h"
#include "core/io/files.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
}

namespace penumbra::capture {
namespace {

constexpr int kBufferBytes = 1 << 16;

std::string_view coding_name(Coding coding) {
  switch (coding) {
    case Coding::kJpeg:
      return "JPEG";
    case Coding::kRgb8:
      return "8 bits";
    case Coding::kRgb16:
      return "16 bits";
    case Coding::kMap:
      return "a map";
  }
  return "";
}

struct VideoTrack {
  Coding coding = Coding::kRgb8;
  AVStream* stream = nullptr;
  AVStream* labels = nullptr;
  AVCodecContext* encoder = nullptr;
  AVFrame* picture = nullptr;
  AVPacket* packet = nullptr;
  std::optional<TimestampNs> last{};
  // Of a light track:
  std::optional<MapEncoder> maps{};
  MapLabel map_label{};
  AVStream* seen_stream = nullptr;
  AVPacket* seen = nullptr;
};

template <class Pixel>
void fill_planes(const Image<Pixel>& from, AVFrame& to) {
  for (int y = 0; y < from.height(); ++y) {
    auto* const g = reinterpret_cast<std::uint16_t*>(to.data[0] + y * to.linesize[0]);
    auto* const b = reinterpret_cast<std::uint16_t*>(to.data[1] + y * to.linesize[1]);
    auto* const r = reinterpret_cast<std::uint16_t*>(to.data[2] + y * to.linesize[2]);
    const auto row = from.row(y);
    for (std::size_t x = 0; x < row.size(); ++x) {
      r[x] = row[x].r;
      g[x] = row[x].g;
      b[x] = row[x].b;
    }
  }
}

void fill_packed(const Image<Rgb8>& from, AVFrame& to) {
  for (int y = 0; y < from.height(); ++y)
    std::memcpy(to.data[0] + y * to.linesize[0], from.row(y).data(), from.row(y).size_bytes());
}

}  // namespace

Result<Coding> coding_of(const Frame& frame) {
  if (frame.map) return Coding::kMap;
  if (frame.jpeg) return Coding::kJpeg;
  if (!frame.pixels) return fail(ErrorCode::kInvalid, "frame", "has no pixels");
  if (std::holds_alternative<Image<Rgb8>>(*frame.pixels)) return Coding::kRgb8;
  if (std::holds_alternative<Image<Rgb16>>(*frame.pixels)) return Coding::kRgb16;
  return fail(ErrorCode::kInvalid, "frame",
              "has float pixels, which a recording cannot hold: write a capture folder");
}

struct RecordingWriter::Impl {
  std::filesystem::path path;
  std::vector<CameraInfo> cameras;
  std::vector<VideoTrack> tracks;
  UniqueFd file;
  AVFormatContext* container = nullptr;
  AVPacket* label = nullptr;
  std::mutex muxing;  // guards container, label, first
  std::optional<TimestampNs> first;
  int write_errno = 0;  // of the system's first refusal
  std::atomic<std::uint64_t> bytes = 0;

  ~Impl();
  Error error(int code) const {
    return {ErrorCode::kUnwritable, path.string(),
            write_errno ? std::strerror(write_errno) : av_reason(code)};
  }
  Result<void> open(std::span<const Coding> codings, double view_rate);
  Result<void> open_file();
  AVStream* add_stream(const std::string& title);
  Result<void> add_track(const CameraInfo& camera, Coding coding, double rate);
  Result<void> open_encoder(VideoTrack& track, const CameraInfo& camera);
  Result<void> open_maps(VideoTrack& track, const CameraInfo& camera);
  Result<void> attach(const std::string& name, const std::string& text);
  Result<void> attach_cameras(double view_rate);
  Result<void> code(const Frame& frame, VideoTrack& track);
  std::string label_text(const Frame& frame, const VideoTrack& track) const;
  Result<void> mux(const Frame& frame, VideoTrack& track);

  static int write_bytes(void* self, std::uint8_t* data, int size);
  static std::int64_t seek(void* self, std::int64_t offset, int whence);
};

int RecordingWriter::Impl::write_bytes(void* opaque, std::uint8_t* data, int size) {
  auto& self = *static_cast<Impl*>(opaque);
  for (int done = 0; done < size;) {
    const auto n = ::write(self.file.get(), data + done, static_cast<std::size_t>(size - done));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      if (!self.write_errno) self.write_errno = errno;
      return AVERROR(errno);
    }
    done += static_cast<int>(n);
  }
  self.bytes += static_cast<std::uint64_t>(size);
  return size;
}

std::int64_t RecordingWriter::Impl::seek(void* opaque, std::int64_t offset, int whence) {
  if (whence == AVSEEK_SIZE) return AVERROR(ENOSYS);
  const auto at = ::lseek(static_cast<Impl*>(opaque)->file.get(), offset, whence);
  return at < 0 ? AVERROR(errno) : at;
}

RecordingWriter::Impl::~Impl() {
  for (VideoTrack& track : tracks) {
    avcodec_free_context(&track.encoder);
    av_frame_free(&track.picture);
    av_packet_free(&track.packet);
    av_packet_free(&track.seen);
  }
  av_packet_free(&label);
  if (!container) return;
  if (container->pb) {
    av_freep(&container->pb->buffer);
    avio_context_free(&container->pb);
  }
  avformat_free_context(container);
}

Result<void> RecordingWriter::Impl::open_file() {
  file = UniqueFd(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
  if (file.get() < 0)
    return fail(ErrorCode::kUnwritable, path.string(),
                errno == EEXIST ? "exists already: remove it, or choose another name"
                                : std::strerror(errno));
  auto* const buffer = static_cast<unsigned char*>(av_malloc(kBufferBytes));
  container->pb = avio_alloc_context(buffer, kBufferBytes, 1, this, nullptr, write_bytes, seek);
  if (container->pb) return {};
  av_free(buffer);
  return std::unexpected(error(AVERROR(ENOMEM)));
}

Result<void> RecordingWriter::Impl::open_encoder(VideoTrack& track, const CameraInfo& camera) {
  const AVCodec* codec = avcodec_find_encoder(AV_CODEC_ID_FFVHUFF);
  if (!codec)
    return fail(ErrorCode::kUnavailable, path.string(),
                "cannot be written: FFmpeg has no FFVHUFF encoder");
  track.encoder = avcodec_alloc_context3(codec);
  AVCodecContext& e = *track.encoder;
  e.width = camera.projection.width;
  e.height = camera.projection.height;
  e.pix_fmt = track.coding == Coding::kRgb8 ? AV_PIX_FMT_RGB24 : AV_PIX_FMT_GBRP16LE;
  e.time_base = kMilliseconds;
  e.thread_count = 1;  // each camera has a thread of its own; no picture waits inside
  if (container->oformat->flags & AVFMT_GLOBALHEADER) e.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  if (const int r = avcodec_open2(&e, codec, nullptr); r < 0)
    return fail(ErrorCode::kUnavailable, camera.name, "cannot be coded: " + av_reason(r));
  avcodec_parameters_from_context(track.stream->codecpar, &e);
  track.picture = av_frame_alloc();
  track.picture->format = e.pix_fmt;
  track.picture->width = e.width;
  track.picture->height = e.height;
  if (const int r = av_frame_get_buffer(track.picture, 0); r < 0) return std::unexpected(error(r));
  return {};
}

AVStream* RecordingWriter::Impl::add_stream(const std::string& title) {
  AVStream* const stream = avformat_new_stream(container, nullptr);
  stream->time_base = kMilliseconds;
  av_dict_set(&stream->metadata, "title", title.c_str(), 0);
  return stream;
}

Result<void> RecordingWriter::Impl::open_maps(VideoTrack& track, const CameraInfo& camera) {
  PENUMBRA_ASSIGN(encoder, MapEncoder::create(camera.projection.width, camera.projection.height,
                                              container->oformat->flags & AVFMT_GLOBALHEADER));
  avcodec_parameters_from_context(track.stream->codecpar, &encoder.light());
  track.seen_stream = add_stream(seen_title(camera.name));
  track.seen = av_packet_alloc();
  avcodec_parameters_from_context(track.seen_stream->codecpar, &encoder.seen());
  track.maps = std::move(encoder);
  return {};
}

Result<void> RecordingWriter::Impl::add_track(const CameraInfo& camera, Coding coding,
                                              double rate) {
  VideoTrack track{
      .coding = coding, .stream = add_stream(camera.name), .packet = av_packet_alloc()};
  if (rate > 0) track.stream->avg_frame_rate = {static_cast<int>(std::lround(rate * 1000)), 1000};
  tracks.push_back(std::move(track));
  if (coding == Coding::kMap) return open_maps(tracks.back(), camera);
  if (coding != Coding::kJpeg) return open_encoder(tracks.back(), camera);
  AVCodecParameters& c = *tracks.back().stream->codecpar;
  c.codec_type = AVMEDIA_TYPE_VIDEO;
  c.codec_id = AV_CODEC_ID_MJPEG;
  c.width = camera.projection.width;
  c.height = camera.projection.height;
  return {};
}

Result<void> RecordingWriter::Impl::attach(const std::string& name, const std::string& text) {
  AVStream* const stream = avformat_new_stream(container, nullptr);
  AVCodecParameters& c = *stream->codecpar;
  c.codec_type = AVMEDIA_TYPE_ATTACHMENT;
  c.extradata = static_cast<std::uint8_t*>(av_mallocz(text.size() + AV_INPUT_BUFFER_PADDING_SIZE));
  if (!c.extradata) return std::unexpected(error(AVERROR(ENOMEM)));
  std::memcpy(c.extradata, text.data(), text.size());
  c.extradata_size = static_cast<int>(text.size());
  av_dict_set(&stream->metadata, "filename", name.c_str(), 0);
  av_dict_set(&stream->metadata, "mimetype", "application/toml", 0);
  return {};
}

Result<void> RecordingWriter::Impl::attach_cameras(double view_rate) {
  const bool with_light = std::ranges::any_of(cameras, &CameraInfo::gives_maps);
  std::string text = fmt::format("version = {}\nview_rate_fps = {}\n",
                                 with_light ? kVersionWithLight : 1, view_rate);
  for (const CameraInfo& camera : cameras) {
    if (camera.gives_maps) {
      text += fmt::format("\n[{}]\nname = \"{}\"\nwidth = {}\nheight = {}\n", kLightTrack,
                          camera.name, camera.projection.width, camera.projection.height);
      continue;
    }
    std::string response = camera.response.describe();
    if (response.starts_with("table")) {  // has no name: goes into a file of its own
      response = camera.name + std::string(kResponseSuffix);
      PENUMBRA_TRY(attach(response, calib::print_response_file(camera.response)));
    }
    text += print_camera(camera, response);
  }
  return attach(std::string(kCamerasAttachment), text);
}

Result<void> RecordingWriter::Impl::open(std::span<const Coding> codings, double view_rate) {
  if (const int r = avformat_alloc_output_context2(&container, nullptr, "matroska", nullptr); r < 0)
    return fail(ErrorCode::kUnavailable, path.string(), av_reason(r));
  container->flush_packets = 1;
  for (std::size_t i = 0; i < cameras.size(); ++i)
    PENUMBRA_TRY(add_track(cameras[i], codings[i], cameras[i].role == Role::kView ? view_rate : 0));
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    AVStream*& labels = tracks[i].labels;
    labels = add_stream(label_title(cameras[i].name));
    labels->codecpar->codec_type = AVMEDIA_TYPE_SUBTITLE;
    labels->codecpar->codec_id = AV_CODEC_ID_TEXT;
  }
  label = av_packet_alloc();
  PENUMBRA_TRY(attach_cameras(view_rate));
  PENUMBRA_TRY(open_file());
  AVDictionary* options = nullptr;
  av_dict_set(&options, "write_crc32", "0", 0);  // a tenth of the time, and players pass over it
  const int r = avformat_write_header(container, &options);
  av_dict_free(&options);
  if (r < 0 || write_errno) return std::unexpected(error(r));
  return {};
}

// The picture as a packet.
Result<void> RecordingWriter::Impl::code(const Frame& frame, VideoTrack& track) {
  if (track.maps) {
    PENUMBRA_ASSIGN(told, track.maps->code(*frame.map, *track.packet, *track.seen));
    track.map_label = std::move(told);
    return {};
  }
  if (track.coding == Coding::kJpeg) {
    if (const int r = av_new_packet(track.packet, static_cast<int>(frame.jpeg->size())); r < 0)
      return std::unexpected(error(r));
    std::memcpy(track.packet->data, frame.jpeg->data(), frame.jpeg->size());
    track.packet->flags |= AV_PKT_FLAG_KEY;
    return {};
  }
  if (const int r = av_frame_make_writable(track.picture); r < 0) return std::unexpected(error(r));
  if (track.coding == Coding::kRgb8)
    fill_packed(std::get<Image<Rgb8>>(*frame.pixels), *track.picture);
  else
    fill_planes(std::get<Image<Rgb16>>(*frame.pixels), *track.picture);
  track.picture->pts = track.encoder->frame_number;
  if (const int r = avcodec_send_frame(track.encoder, track.picture); r < 0)
    return std::unexpected(error(r));
  if (const int r = avcodec_receive_packet(track.encoder, track.packet); r < 0)
    return std::unexpected(error(r));
  return {};
}

// A map is coded as what has changed since the one before, so its label counts what was coded.
std::string RecordingWriter::Impl::label_text(const Frame& frame, const VideoTrack& track) const {
  const std::string& name = cameras[static_cast<std::size_t>(frame.camera)].name;
  if (!track.maps)
    return print_row({fmt::format("{}/{}", name, frame.sequence), frame.time, frame.exposure,
                      frame.world_from_camera, frame.opacity});
  const Exposure exposure{Seconds(track.map_label.exposure), Gain(1)};
  return print_map_label(print_row({fmt::format("{}/{}", name, track.maps->coded() - 1), frame.time,
                                    exposure, Pose{}}),
                         track.map_label);
}

Result<void> RecordingWriter::Impl::mux(const Frame& frame, VideoTrack& track) {
  const std::string text = label_text(frame, track);
  const std::scoped_lock lock(muxing);
  if (write_errno) return std::unexpected(error(0));
  if (!first) first = frame.time;
  const auto since = std::chrono::nanoseconds(frame.time.value - first->value);
  const std::int64_t ms =
      std::max<std::int64_t>(0, std::chrono::round<std::chrono::milliseconds>(since).count());
  if (const int r = av_new_packet(label, static_cast<int>(text.size())); r < 0)
    return std::unexpected(error(r));
  std::memcpy(label->data, text.data(), text.size());
  label->duration = 1;
  label->stream_index = track.labels->index;
  track.packet->stream_index = track.stream->index;
  if (track.seen) track.seen->stream_index = track.seen_stream->index;
  for (AVPacket* const packet : {track.packet, track.seen, label}) {
    if (!packet) continue;
    packet->pts = packet->dts =
        av_rescale_q(ms, kMilliseconds, container->streams[packet->stream_index]->time_base);
    const int r = av_write_frame(container, packet);
    av_packet_unref(packet);
    if (r < 0 || write_errno) return std::unexpected(error(r));
  }
  // Ends the cluster: the frame is the system's from here on.
  const int r = av_write_frame(container, nullptr);
  if (r < 0 || write_errno) return std::unexpected(error(r));
  return {};
}

RecordingWriter::RecordingWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RecordingWriter::~RecordingWriter() = default;
RecordingWriter::RecordingWriter(RecordingWriter&&) noexcept = default;
RecordingWriter& RecordingWriter::operator=(RecordingWriter&&) noexcept = default;

Result<RecordingWriter> RecordingWriter::create(const std::filesystem::path& path,
                                                std::vector<CameraInfo> cameras,
                                                std::span<const Coding> codings, double view_rate) {
  PENUMBRA_TRY(check_cameras(cameras));
  for (std::size_t i = 0; i < cameras.size(); ++i)
    if (cameras[i].gives_maps != (codings[i] == Coding::kMap) ||
        (cameras[i].gives_maps && i + 1 != cameras.size()))
      return fail(ErrorCode::kInvalid, cameras[i].name,
                  "is not kept like that: maps are those of one light track, the last of all");
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  impl->cameras = std::move(cameras);
  av_log_set_level(AV_LOG_ERROR);
  if (auto opened = impl->open(codings, view_rate); !opened) {
    std::error_code ignored;
    if (impl->file.get() >= 0) std::filesystem::remove(path, ignored);
    return std::unexpected(opened.error());
  }
  return RecordingWriter(std::move(impl));
}

Result<void> RecordingWriter::write(const Frame& frame) {
  const auto n = static_cast<std::size_t>(frame.camera);
  if (frame.camera < 0 || n >= impl_->tracks.size())
    return fail(ErrorCode::kInvalid, "recording", fmt::format("has no camera {}", frame.camera));
  VideoTrack& track = impl_->tracks[n];
  const CameraInfo& camera = impl_->cameras[n];
  PENUMBRA_TRY(check_frame(frame, camera, track.last));
  PENUMBRA_ASSIGN(coding, coding_of(frame));
  if (coding != track.coding)
    return fail(ErrorCode::kInvalid, fmt::format("{}, frame {}", camera.name, frame.sequence),
                fmt::format("is {}, but the recording holds {}", coding_name(coding),
                            coding_name(track.coding)));
  PENUMBRA_TRY(impl_->code(frame, track));
  track.last = frame.time;
  return impl_->mux(frame, track);
}

Result<void> RecordingWriter::finish() {
  Impl& i = *impl_;
  const int r = av_write_trailer(i.container);
  if (r < 0 || i.write_errno) return std::unexpected(i.error(r));
  return {};
}

std::uint64_t RecordingWriter::bytes() const {
  return impl_->bytes;
}

}  // namespace penumbra::capture
