extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
}

#include <unistd.h>

#include <cmath>

#include "compositor/composite/compositor.h"

namespace penumbra::compositor {

namespace {

std::string reason(int code) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  av_strerror(code, text, sizeof text);
  return text;
}

}  // namespace

struct VideoWriter::Impl {
  std::filesystem::path target, temporary;
  int source_width = 0, source_height = 0;
  AVFormatContext* container = nullptr;
  AVCodecContext* codec = nullptr;
  AVStream* stream = nullptr;
  AVFrame* frame = nullptr;
  AVPacket* packet = nullptr;
  SwsContext* scaler = nullptr;
  std::int64_t next = 0;
  bool finished = false;

  ~Impl() {
    if (container && container->pb) avio_closep(&container->pb);
    avformat_free_context(container);
    avcodec_free_context(&codec);
    av_frame_free(&frame);
    av_packet_free(&packet);
    sws_freeContext(scaler);
    std::error_code ignored;
    if (!finished) std::filesystem::remove(temporary, ignored);
  }

  Error error(int code) const { return {ErrorCode::kUnwritable, target.string(), reason(code)}; }
  Result<void> open(double fps, bool live);
  Result<void> open_encoder(double fps, bool live);
  Result<void> drain();
};

Result<void> VideoWriter::Impl::open_encoder(double fps, bool live) {
  const AVCodec* encoder = avcodec_find_encoder_by_name("libx264");
  if (!encoder)
    return fail(ErrorCode::kUnavailable, target.string(),
                "cannot be written: FFmpeg has no H.264 encoder");
  codec = avcodec_alloc_context3(encoder);
  codec->width = source_width / 2 * 2;
  codec->height = source_height / 2 * 2;
  codec->pix_fmt = AV_PIX_FMT_YUV420P;
  codec->time_base = {1000, static_cast<int>(std::lround(fps * 1000))};
  codec->framerate = {codec->time_base.den, codec->time_base.num};
  codec->color_range = AVCOL_RANGE_MPEG;
  codec->colorspace = AVCOL_SPC_BT709;
  codec->color_primaries = AVCOL_PRI_BT709;
  codec->color_trc = AVCOL_TRC_IEC61966_2_1;
  codec->thread_count = 1;  // identical bytes on every machine
  if (container->oformat->flags & AVFMT_GLOBALHEADER) codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  av_opt_set(codec->priv_data, "preset", live ? "ultrafast" : "superfast", 0);
  av_opt_set(codec->priv_data, "crf", "20", 0);
  if (const int e = avcodec_open2(codec, encoder, nullptr); e < 0) return std::unexpected(error(e));
  return {};
}

Result<void> VideoWriter::Impl::open(double fps, bool live) {
  if (const int e = avformat_alloc_output_context2(&container, nullptr, "mp4", temporary.c_str());
      e < 0)
    return std::unexpected(error(e));
  container->flags |= AVFMT_FLAG_BITEXACT;
  PENUMBRA_TRY(open_encoder(fps, live));
  stream = avformat_new_stream(container, nullptr);
  stream->time_base = codec->time_base;
  avcodec_parameters_from_context(stream->codecpar, codec);
  if (const int e = avio_open(&container->pb, temporary.c_str(), AVIO_FLAG_WRITE); e < 0)
    return std::unexpected(error(e));
  if (const int e = avformat_write_header(container, nullptr); e < 0)
    return std::unexpected(error(e));
  frame = av_frame_alloc();
  frame->format = codec->pix_fmt;
  frame->width = codec->width;
  frame->height = codec->height;
  if (const int e = av_frame_get_buffer(frame, 0); e < 0) return std::unexpected(error(e));
  packet = av_packet_alloc();
  scaler = sws_getContext(codec->width, codec->height, AV_PIX_FMT_RGB24, codec->width,
                          codec->height, codec->pix_fmt, SWS_POINT, nullptr, nullptr, nullptr);
  if (!scaler)
    return fail(ErrorCode::kUnavailable, target.string(),
                "cannot be written: FFmpeg does not convert to YUV 4:2:0");
  sws_setColorspaceDetails(scaler, sws_getCoefficients(SWS_CS_ITU709), 1,
                           sws_getCoefficients(SWS_CS_ITU709), 0, 0, 1 << 16, 1 << 16);
  return {};
}

Result<void> VideoWriter::Impl::drain() {
  for (;;) {
    const int e = avcodec_receive_packet(codec, packet);
    if (e == AVERROR(EAGAIN) || e == AVERROR_EOF) return {};
    if (e < 0) return std::unexpected(error(e));
    av_packet_rescale_ts(packet, codec->time_base, stream->time_base);
    packet->stream_index = stream->index;
    if (const int w = av_interleaved_write_frame(container, packet); w < 0)
      return std::unexpected(error(w));
  }
}

VideoWriter::VideoWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
VideoWriter::~VideoWriter() = default;
VideoWriter::VideoWriter(VideoWriter&&) noexcept = default;
VideoWriter& VideoWriter::operator=(VideoWriter&&) noexcept = default;

Result<VideoWriter> VideoWriter::create(const std::filesystem::path& path, int width, int height,
                                        double frames_per_second, bool live) {
  if (width < 2 || height < 2 || !(frames_per_second > 0))
    return fail(ErrorCode::kInvalid, path.string(),
                "has a frame size below 2x2 or a frame rate that is not positive");
  av_log_set_level(AV_LOG_ERROR);
  auto impl = std::make_unique<Impl>();
  impl->target = path;
  impl->temporary = path.parent_path() / ("." + path.stem().string() + ".partial-" +
                                          std::to_string(::getpid()) + path.extension().string());
  impl->source_width = width;
  impl->source_height = height;
  PENUMBRA_TRY(impl->open(frames_per_second, live));
  return VideoWriter(std::move(impl));
}

Result<void> VideoWriter::write(const Image<Rgb8>& picture) {
  Impl& i = *impl_;
  if (picture.width() != i.source_width || picture.height() != i.source_height)
    return fail(ErrorCode::kInvalid, i.target.string(), "gets frames of different sizes");
  if (const int e = av_frame_make_writable(i.frame); e < 0) return std::unexpected(i.error(e));
  const auto* rows = reinterpret_cast<const std::uint8_t*>(picture.pixels().data());
  const int stride = picture.width() * 3;
  sws_scale(i.scaler, &rows, &stride, 0, i.codec->height, i.frame->data, i.frame->linesize);
  i.frame->pts = i.next++;
  if (const int e = avcodec_send_frame(i.codec, i.frame); e < 0) return std::unexpected(i.error(e));
  return i.drain();
}

Result<void> VideoWriter::finish() {
  Impl& i = *impl_;
  if (const int e = avcodec_send_frame(i.codec, nullptr); e < 0) return std::unexpected(i.error(e));
  PENUMBRA_TRY(i.drain());
  if (const int e = av_write_trailer(i.container); e < 0) return std::unexpected(i.error(e));
  if (const int e = avio_closep(&i.container->pb); e < 0) return std::unexpected(i.error(e));
  std::error_code error;
  std::filesystem::rename(i.temporary, i.target, error);
  if (error) return fail(ErrorCode::kUnwritable, i.target.string(), error.message());
  i.finished = true;
  return {};
}

}  // namespace penumbra::compositor
