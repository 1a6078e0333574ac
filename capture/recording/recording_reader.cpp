#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <deque>
#include <map>
#include <tuple>

#include "calib/camera/response.h"
#include "capture/frames.h"
#include "capture/raw_formats.h"
#include "capture/recording/folder.h"
#include "capture/recording/folder_format.h"
#include "capture/recording/internal/map_track.h"
#include "capture/recording/internal/recording_format.h"
#include "capture/recording/recording.h"
#include "core/io/toml_keys.h"
#include "core/picture_size.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libswscale/swscale.h>
}

#include <linux/videodev2.h>

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

// Cameras are coded side by side, so that one's frame may stand behind the other's later ones. So
// many frames are read ahead to hand them on in order of time.
constexpr std::size_t kAhead = 64;
// Pictures of one camera that wait for their labels; more in a row without one are no recording of
// ours.
constexpr std::size_t kMaxWaiting = 64;

struct FreeContainer {
  void operator()(AVFormatContext* c) const { avformat_close_input(&c); }
};
struct FreeScaler {
  void operator()(SwsContext* s) const { sws_freeContext(s); }
};

// One camera's pictures, decoded.
class PictureTrack {
 public:
  explicit PictureTrack(int stream) : stream_(stream) {}
  static Result<PictureTrack> open(const AVStream& stream, const CameraInfo& camera);
  Result<FramePixels> decode(const AVPacket& packet);
  [[nodiscard]] bool is_jpeg() const { return jpeg_.has_value(); }
  [[nodiscard]] int stream() const { return stream_; }

  int labels = -1;             // stream
  std::deque<Packet> waiting;  // pictures

 private:
  Result<void> open_decoder(const AVStream& stream);
  Result<FramePixels> from_frame();
  int stream_ = 0, width_ = 0, height_ = 0;
  std::optional<RawConverter> jpeg_;
  AvCodec decoder_;
  AvPicture frame_;
  std::unique_ptr<SwsContext, FreeScaler> to_rgb_;  // only reorders channels
  int scaled_format_ = AV_PIX_FMT_NONE;
};

Result<PictureTrack> PictureTrack::open(const AVStream& stream, const CameraInfo& camera) {
  PictureTrack out(stream.index);
  out.width_ = camera.projection.width;
  out.height_ = camera.projection.height;
  const AVCodecParameters& c = *stream.codecpar;
  if (c.width != out.width_ || c.height != out.height_)
    return fail(ErrorCode::kInvalid, camera.name,
                fmt::format("has pictures of {}x{} pixels instead of {}x{}", c.width, c.height,
                            out.width_, out.height_));
  if (c.codec_id == AV_CODEC_ID_MJPEG) {
    PENUMBRA_ASSIGN(
        converter, RawConverter::make(
                       {.fourcc = V4L2_PIX_FMT_MJPEG, .width = out.width_, .height = out.height_}));
    out.jpeg_ = std::move(converter);
    return out;
  }
  if (c.codec_id != AV_CODEC_ID_FFVHUFF)
    return fail(
        ErrorCode::kInvalid, camera.name,
        fmt::format("is coded as {} instead of ffvhuff or mjpeg", avcodec_get_name(c.codec_id)));
  PENUMBRA_TRY(out.open_decoder(stream));
  return out;
}

Result<void> PictureTrack::open_decoder(const AVStream& stream) {
  const AVCodec* codec = avcodec_find_decoder(AV_CODEC_ID_FFVHUFF);
  if (!codec) return fail(ErrorCode::kUnavailable, "FFmpeg", "has no FFVHUFF decoder");
  decoder_.reset(avcodec_alloc_context3(codec));
  frame_.reset(av_frame_alloc());
  int r = avcodec_parameters_to_context(decoder_.get(), stream.codecpar);
  decoder_->thread_count = 1;
  if (r >= 0) r = avcodec_open2(decoder_.get(), codec, nullptr);
  if (r < 0) return fail(ErrorCode::kUnreadable, "pictures", av_reason(r));
  return {};
}

Result<FramePixels> PictureTrack::decode(const AVPacket& packet) {
  if (jpeg_)
    return jpeg_->convert(
        {reinterpret_cast<const std::byte*>(packet.data), static_cast<std::size_t>(packet.size)});
  int r = avcodec_send_packet(decoder_.get(), &packet);
  if (r >= 0) r = avcodec_receive_frame(decoder_.get(), frame_.get());
  if (r < 0) return fail(ErrorCode::kUnreadable, "picture", av_reason(r));
  auto pixels = from_frame();
  av_frame_unref(frame_.get());
  return pixels;
}

Result<FramePixels> PictureTrack::from_frame() {
  const AVFrame& f = *frame_;
  if (f.width != width_ || f.height != height_)
    return fail(ErrorCode::kUnreadable, "picture",
                fmt::format("has {}x{} pixels, unlike its camera", f.width, f.height));
  if (f.format == AV_PIX_FMT_GBRP16LE) {
    Image<Rgb16> out(width_, height_);
    for (int y = 0; y < height_; ++y) {
      const auto* g = reinterpret_cast<const std::uint16_t*>(f.data[0] + y * f.linesize[0]);
      const auto* b = reinterpret_cast<const std::uint16_t*>(f.data[1] + y * f.linesize[1]);
      const auto* red = reinterpret_cast<const std::uint16_t*>(f.data[2] + y * f.linesize[2]);
      const auto row = out.row(y);
      for (std::size_t x = 0; x < row.size(); ++x) row[x] = {red[x], g[x], b[x]};
    }
    return out;
  }
  const auto format = static_cast<AVPixelFormat>(f.format);
  if (!to_rgb_ || scaled_format_ != f.format) {
    to_rgb_.reset(sws_getContext(width_, height_, format, width_, height_, AV_PIX_FMT_RGB24,
                                 SWS_POINT, nullptr, nullptr, nullptr));
    scaled_format_ = f.format;
  }
  if (!to_rgb_) return fail(ErrorCode::kUnreadable, "picture", "cannot be converted to RGB");
  Image<Rgb8> out(width_, height_);
  std::uint8_t* const to[] = {&out.pixels()[0].r};
  const int stride[] = {3 * width_};
  sws_scale(to_rgb_.get(), f.data, f.linesize, 0, height_, to, stride);
  return out;
}

// ------------------------------------------------------------------------------- the file

struct CodedFrame {
  std::size_t camera;
  std::uint64_t sequence;
  FrameRow row;
  Packet picture;
  MapLabel map_label{};
};

std::string text_of(const AVDictionary* tags, const char* key) {
  const AVDictionaryEntry* entry = av_dict_get(tags, key, nullptr, 0);
  return entry ? entry->value : "";
}

class Recording final : public FrameSource {
 public:
  static Result<std::unique_ptr<FrameSource>> open(const fs::path& path, RecordedLight light,
                                                   Seconds from);
  const std::vector<CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return view_rate_; }
  Result<std::optional<Frame>> next() override;

 private:
  Result<void> open_container();
  Result<void> read_cameras();
  Result<void> read_light_track(const TomlKeys& keys);
  Result<void> choose_light(RecordedLight light);
  const AVStream* find_stream(AVMediaType type, const std::string& title) const;
  Result<void> find_tracks();
  Result<void> begin_at(Seconds from);
  Result<std::optional<Frame>> decode(const CodedFrame& coded);
  Result<std::optional<Frame>> decode_map(const CodedFrame& coded);
  Result<void> keep_picture(Packet packet);
  Result<void> keep_label(const AVPacket& label, std::size_t camera);
  Result<void> read_ahead();
  std::int64_t skipped_before(const AVPacket& packet);
  std::unexpected<Error> unreadable(std::string detail) const {
    return fail(ErrorCode::kUnreadable, path_.string(), std::move(detail));
  }
  // Of a label or picture in this file.
  std::string at(const AVPacket& packet) const {
    return fmt::format("{}, byte {}", path_.string(), packet.pos);
  }

  fs::path path_;
  std::unique_ptr<AVFormatContext, FreeContainer> container_;
  std::vector<CameraInfo> cameras_;
  std::vector<PictureTrack> tracks_;  // a camera each
  std::optional<MapTrack> maps_;      // of the last one, if that gives maps
  std::deque<CodedFrame> ahead_;
  bool ended_ = false;
  bool reads_all_ = false;  // no track is left out
  std::int64_t end_ = -1;   // of the last packet in the file
  double view_rate_ = 0;
  std::int64_t views_from_ms_ = 0;  // by the file's times
};

Result<void> Recording::open_container() {
  const AVInputFormat* matroska = av_find_input_format("matroska");
  AVFormatContext* opened = avformat_alloc_context();
  opened->max_index_size = 1 << 16;  // mostly it is read from the first frame to the last
  // "file:" keeps a name with a colon from being taken as a protocol.
  if (const int r =
          avformat_open_input(&opened, ("file:" + path_.string()).c_str(), matroska, nullptr);
      r < 0)
    return unreadable(r == AVERROR_INVALIDDATA ? "is not a Matroska file, or its header is damaged"
                      : r == AVERROR_EOF || r == AVERROR(EIO) ? "ends before its first frame"
                                                              : av_reason(r));
  container_.reset(opened);
  return {};
}

Result<void> Recording::read_cameras() {
  std::map<std::string, std::string> attached;
  for (unsigned i = 0; i < container_->nb_streams; ++i) {
    const AVStream& s = *container_->streams[i];
    if (s.codecpar->codec_type == AVMEDIA_TYPE_ATTACHMENT && s.codecpar->extradata_size > 0)
      attached[text_of(s.metadata, "filename")] =
          std::string(reinterpret_cast<const char*>(s.codecpar->extradata),
                      static_cast<std::size_t>(s.codecpar->extradata_size));
  }
  const auto manifest = attached.find(std::string(kCamerasAttachment));
  if (manifest == attached.end())
    return fail(
        ErrorCode::kInvalid, path_.string(),
        fmt::format("is not a recording by penumbra: it has no attachment {}", kCamerasAttachment));
  const fs::path named = path_ / manifest->first;
  PENUMBRA_ASSIGN(root, parse_toml_text(manifest->second, named));
  const TomlKeys keys(named, root);
  constexpr std::string_view known[] = {"version", "view_rate_fps", "camera", "light_track"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(keys.has(kLightTrack) ? kVersionWithLight : 1));
  PENUMBRA_ASSIGN(rate, keys.number("view_rate_fps"));
  if (rate < 0 || rate > 1e4) return keys.invalid("view_rate_fps", "is not within 0..10000");
  view_rate_ = rate;
  if (!keys.has("camera") && !keys.has(kLightTrack))
    return keys.invalid("camera", "needs at least one table [[camera]]");
  if (keys.has("camera")) {
    PENUMBRA_ASSIGN(cameras, capture::read_cameras(root, named, [&](const std::string& name) {
                      const auto file = attached.find(name);
                      if (file != attached.end())
                        return calib::parse_response_file(file->second, path_ / name);
                      if (name.ends_with(kResponseSuffix))
                        return Result<calib::Response>(
                            fail(ErrorCode::kUnreadable, named.string(), name + " is missing"));
                      return calib::parse_response(name);
                    }));
    cameras_ = std::move(cameras);
  }
  if (!keys.has(kLightTrack)) return {};
  PENUMBRA_ASSIGN(light, keys.table(kLightTrack));
  return read_light_track(light);
}

Result<void> Recording::read_light_track(const TomlKeys& keys) {
  constexpr std::string_view known[] = {"name", "width", "height"};
  PENUMBRA_TRY(keys.only(known));
  CameraInfo track;
  PENUMBRA_ASSIGN(name, keys.text("name"));
  PENUMBRA_ASSIGN(width, keys.integer("width", 1, kMaxSide));
  PENUMBRA_ASSIGN(height, keys.integer("height", 1, kMaxSide));
  PENUMBRA_TRY(check_map_size(width, height));
  track.name = name;
  track.gives_maps = true;
  PENUMBRA_ASSIGN(projection,
                  calib::make_projection(calib::ProjectionKind::kLatLong, width, height));
  track.projection = projection;
  track.response = calib::Response::linear();
  cameras_.push_back(track);
  return check_cameras(cameras_);
}

// Leaves out what is not wanted: it is not read.
Result<void> Recording::choose_light(RecordedLight light) {
  const bool has_track = std::ranges::any_of(cameras_, &CameraInfo::gives_maps),
             has_cameras = std::ranges::any_of(cameras_, [](const CameraInfo&c) {
               return !c.gives_maps && c.role == Role::kEnvironment;
             });
  if (light == RecordedLight::kBoth) return {};
  if (light == RecordedLight::kTrack && !has_track)
    return fail(ErrorCode::kInvalid, path_.string(), "has no light track");
  // Beside a track a ball in a view camera's picture tells nothing new.
  const bool from_track = light == RecordedLight::kTrack ||
                          (light == RecordedLight::kEither && has_track && !has_cameras);
  std::erase_if(cameras_, [&](const CameraInfo& c) {
    return c.gives_maps ? !from_track : from_track && c.role == Role::kEnvironment;
  });
  if (cameras_.empty())
    return fail(ErrorCode::kInvalid, path_.string(), "has a light track alone, and no pictures");
  if (from_track)
    for (CameraInfo& c : cameras_) c.ball.reset();
  return {};
}

const AVStream* Recording::find_stream(AVMediaType type, const std::string& title) const {
  for (unsigned i = 0; i < container_->nb_streams; ++i) {
    const AVStream& s = *container_->streams[i];
    if (s.codecpar->codec_type == type && text_of(s.metadata, "title") == title) return &s;
  }
  return nullptr;
}

Result<void> Recording::find_tracks() {
  for (const CameraInfo& camera : cameras_) {
    const AVStream* const pictures = find_stream(AVMEDIA_TYPE_VIDEO, camera.name);
    const AVStream* const labels = find_stream(AVMEDIA_TYPE_SUBTITLE, label_title(camera.name));
    if (!pictures) return unreadable("has no video track of camera " + camera.name);
    if (!labels) return unreadable("has no labels of camera " + camera.name);
    Result<PictureTrack> track = PictureTrack(pictures->index);
    if (camera.gives_maps) {
      const AVStream* const seen = find_stream(AVMEDIA_TYPE_VIDEO, seen_title(camera.name));
      if (!seen) return unreadable("does not tell what was seen of " + camera.name);
      auto maps = MapTrack::open(*pictures, *seen, camera);
      if (maps)
        maps_ = std::move(*maps);
      else
        track = std::unexpected(maps.error());
    } else {
      track = PictureTrack::open(*pictures, camera);
    }
    if (!track)
      return fail(track.error().code, path_.string(),
                  track.error().where + ": " + track.error().detail);
    track->labels = labels->index;
    tracks_.push_back(std::move(*track));
  }
  reads_all_ = true;
  // What nobody asks for is not read.
  for (unsigned i = 0; i < container_->nb_streams; ++i) {
    const int n = static_cast<int>(i);
    const bool wanted =
        (maps_ && maps_->seen == n) || std::ranges::any_of(tracks_, [n](const PictureTrack& t) {
          return t.stream() == n || t.labels == n;
        });
    container_->streams[i]->discard = wanted ? AVDISCARD_DEFAULT : AVDISCARD_ALL;
    const bool media = container_->streams[i]->codecpar->codec_type != AVMEDIA_TYPE_ATTACHMENT;
    reads_all_ &= wanted || !media;
  }
  return {};
}

// The file's times count from its first frame on, rounded as those of frames are.
Result<void> Recording::begin_at(Seconds from) {
  if (from.count() == 0) return {};
  views_from_ms_ = std::chrono::round<std::chrono::milliseconds>(from).count();
  const auto light_ms = std::chrono::floor<std::chrono::milliseconds>(from - kLightBefore).count();
  if (light_ms <= 0) return {};
  AVStream* const stream = container_->streams[tracks_.back().stream()];  // a light track's is last
  const auto at = av_rescale_q(light_ms, kMilliseconds, stream->time_base);
  end_ = -1;
  if (av_seek_frame(container_.get(), stream->index, at, AVSEEK_FLAG_BACKWARD) >= 0 &&
      avformat_index_get_entry_from_timestamp(stream, at, AVSEEK_FLAG_BACKWARD))
    return {};
  // Nothing of that track stands before: all is read from the start on.
  tracks_.clear();
  maps_.reset();
  PENUMBRA_TRY(open_container());
  return find_tracks();
}

Result<std::unique_ptr<FrameSource>> Recording::open(const fs::path& path, RecordedLight light,
                                                     Seconds from) {
  av_log_set_level(AV_LOG_FATAL);
  auto out = std::make_unique<Recording>();
  out->path_ = path;
  PENUMBRA_TRY(out->open_container());
  PENUMBRA_TRY(out->read_cameras());
  PENUMBRA_TRY(out->choose_light(light));
  PENUMBRA_TRY(out->find_tracks());
  PENUMBRA_TRY(out->begin_at(from));
  return out;
}

Result<void> Recording::keep_picture(Packet packet) {
  if (maps_ && packet->stream_index == maps_->seen) {
    if (maps_->waiting_seen.size() == kAhead + kMaxWaiting)
      return fail(ErrorCode::kUnreadable, at(*packet), "has maps without labels");
    maps_->waiting_seen.push_back(std::move(packet));
    return {};
  }
  for (PictureTrack& track : tracks_) {
    if (track.stream() != packet->stream_index) continue;
    if (track.waiting.size() == kMaxWaiting)
      return fail(ErrorCode::kUnreadable, at(*packet), "has pictures without labels");
    track.waiting.push_back(std::move(packet));
    break;
  }
  return {};
}

// The label's picture came just before it, at the same time. Damage in the file may have taken
// either: a picture is never given another one's label.
Result<void> Recording::keep_label(const AVPacket& label, std::size_t n) {
  const std::string_view text(reinterpret_cast<const char*>(label.data),
                              static_cast<std::size_t>(label.size));
  const bool of_map = cameras_[n].gives_maps;
  Result<MapLabelText> parts = MapLabelText{text, {}};
  if (of_map) parts = split_map_label(text);
  if (!parts) return fail(ErrorCode::kUnreadable, at(label), parts.error().detail);
  PENUMBRA_ASSIGN(row, parse_row(parts->row, true, at(label)));
  MapLabel map_label;
  if (of_map) {
    auto parsed = parse_map_label(parts->rest, row.exposure.time.count());
    if (!parsed)
      return fail(ErrorCode::kUnreadable, at(label),
                  fmt::format("\"{}\" {}", parsed.error().where, parsed.error().detail));
    map_label = std::move(*parsed);
  }
  const auto slash = row.file.rfind('/');
  std::uint64_t sequence = 0;
  const char* const end = row.file.data() + row.file.size();
  if (slash == std::string::npos || row.file.substr(0, slash) != cameras_[n].name ||
      std::from_chars(row.file.data() + slash + 1, end, sequence).ptr != end)
    return fail(ErrorCode::kUnreadable, at(label),
                fmt::format("\"{}\" is not a frame of {}", row.file, cameras_[n].name));
  auto& waiting = tracks_[n].waiting;
  while (!waiting.empty() && waiting.front()->pts < label.pts) waiting.pop_front();
  if (waiting.empty() || waiting.front()->pts != label.pts) return {};
  const AVRational unit = container_->streams[label.stream_index]->time_base;
  if (cameras_[n].role == Role::kView &&
      av_rescale_q(label.pts, unit, kMilliseconds) < views_from_ms_) {
    waiting.pop_front();
    return {};
  }
  ahead_.push_back({n, sequence, std::move(row), std::move(waiting.front()), std::move(map_label)});
  waiting.pop_front();
  return {};
}

Result<void> Recording::read_ahead() {
  while (!ended_ && ahead_.size() < kAhead) {
    Packet packet(av_packet_alloc());
    const int r = av_read_frame(container_.get(), packet.get());
    ended_ = r < 0;
    // A recording that was cut off ends inside an element.
    if (r == AVERROR_EOF || r == AVERROR_INVALIDDATA) break;
    if (ended_) return unreadable(av_reason(r));  // once: what was read before is still handed on
    const std::int64_t skipped = skipped_before(*packet);
    const std::string place = skipped > 0 ? at(*packet) : std::string();
    const auto labelled = std::ranges::find(tracks_, packet->stream_index, &PictureTrack::labels);
    if (labelled == tracks_.end())
      PENUMBRA_TRY(keep_picture(std::move(packet)));
    else
      PENUMBRA_TRY(keep_label(*packet, static_cast<std::size_t>(labelled - tracks_.begin())));
    if (skipped > 0)
      return fail(ErrorCode::kUnreadable, place,
                  fmt::format("{} bytes before it cannot be read", skipped));
  }
  return {};
}

// FFmpeg goes on silently behind what it cannot read. Where all tracks are read, packets follow
// each other with little between them.
std::int64_t Recording::skipped_before(const AVPacket& packet) {
  constexpr std::int64_t kHeads = 4096;  // of clusters and blocks
  if (!reads_all_ || packet.pos < 0) return 0;
  const std::int64_t before = std::exchange(end_, packet.pos + packet.size);
  return before >= 0 && packet.pos > before + kHeads ? packet.pos - before : 0;
}

Result<std::optional<Frame>> Recording::decode_map(const CodedFrame& coded) {
  auto map = maps_->decode(*coded.picture, coded.sequence, coded.map_label);
  if (!map)
    return fail(ErrorCode::kUnreadable, at(*coded.picture),
                fmt::format("{}: {}", coded.row.file, map.error().detail));
  if (!*map) return std::nullopt;
  (*map)->time = coded.row.time;
  Frame frame{.camera = static_cast<int>(coded.camera),
              .sequence = coded.sequence,
              .time = coded.row.time,
              .exposure = {Seconds(1), Gain(1)},
              .world_from_camera = *coded.row.pose,
              .pixels = {}};
  frame.map = std::make_shared<const Environment>(std::move(**map));
  return frame;
}

Result<std::optional<Frame>> Recording::decode(const CodedFrame& coded) {
  if (cameras_[coded.camera].gives_maps) return decode_map(coded);
  PictureTrack& track = tracks_[coded.camera];
  auto pixels = track.decode(*coded.picture);
  if (!pixels)
    return fail(ErrorCode::kUnreadable, at(*coded.picture),
                fmt::format("{}: {}", coded.row.file, pixels.error().detail));
  Frame frame{static_cast<int>(coded.camera),
              coded.sequence,
              coded.row.time,
              coded.row.exposure,
              *coded.row.pose,
              std::make_shared<const FramePixels>(std::move(*pixels))};
  frame.opacity = coded.row.opacity;
  if (track.is_jpeg()) {
    const auto* bytes = reinterpret_cast<const std::byte*>(coded.picture->data);
    frame.jpeg = std::make_shared<const std::vector<std::byte>>(bytes, bytes + coded.picture->size);
  }
  return frame;
}

Result<std::optional<Frame>> Recording::next() {
  for (;;) {
    PENUMBRA_TRY(read_ahead());
    if (ahead_.empty()) return std::nullopt;
    // At the same time the light comes before the picture that it lights.
    const auto first = std::ranges::min_element(ahead_, {}, [&](const CodedFrame& c) {
      return std::tuple(c.row.time, cameras_[c.camera].role == Role::kView, c.camera);
    });
    const CodedFrame coded = std::move(*first);
    ahead_.erase(first);
    PENUMBRA_ASSIGN(frame, decode(coded));
    if (frame) return frame;
  }
}

}  // namespace

Result<RecordedLight> recorded_light(std::string_view name) {
  if (name == "auto") return RecordedLight::kEither;
  if (name == "cameras") return RecordedLight::kCameras;
  if (name == "track") return RecordedLight::kTrack;
  return fail(ErrorCode::kInvalid, std::string(name), "is none of auto, cameras and track");
}

Result<std::unique_ptr<FrameSource>> open_recording(const fs::path& path, RecordedLight light,
                                                    Seconds from) {
  std::error_code ignored;
  if (!fs::exists(path, ignored)) return fail(ErrorCode::kNotFound, path.string(), "no such file");
  PENUMBRA_TRY(check_from(from));
  return Recording::open(path, light, from);
}

Result<std::unique_ptr<FrameSource>> open_capture(const fs::path& path, RecordedLight light,
                                                  Seconds from) {
  std::error_code ignored;
  if (!fs::exists(path, ignored))
    return fail(ErrorCode::kNotFound, path.string(), "is neither a recording nor a capture folder");
  if (fs::is_regular_file(path, ignored)) return open_recording(path, light, from);
  if (light == RecordedLight::kTrack)
    return fail(ErrorCode::kInvalid, path.string(),
                "is a capture folder, which has no light track: a recording may have one");
  return open_capture_folder(path, from);
}

}  // namespace penumbra::capture
