#include "tools/chart/peers/peer_codecs.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "core/half.h"
#include "tools/chart/peers/internal/ffmpeg_owned.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavutil/opt.h>
}

namespace penumbra::tools {

namespace {

// Channels that end in Y are coded with loss; others would not be.
std::string channel(int layer) {
  return fmt::format("c{:02}.Y", layer);
}

Result<void> write_exr(const std::filesystem::path& file, std::span<const Image<float>> layers,
                       float level) {
  const int width = layers[0].width(), height = layers[0].height();
  Imf::Header header(width, height);
  header.compression() = Imf::DWAA_COMPRESSION;
  header.dwaCompressionLevel() = level;
  std::vector<std::vector<std::uint16_t>> halves;
  Imf::FrameBuffer buffer;
  for (std::size_t i = 0; i < layers.size(); ++i) {
    auto& plane = halves.emplace_back(layers[i].area());
    std::ranges::transform(layers[i].pixels(), plane.begin(), half_from_float);
    header.channels().insert(channel(static_cast<int>(i)), Imf::Channel(Imf::HALF));
    buffer.insert(channel(static_cast<int>(i)),
                  Imf::Slice(Imf::HALF, reinterpret_cast<char*>(plane.data()), 2,
                             2 * static_cast<std::size_t>(width)));
  }
  try {
    Imf::OutputFile out(file.c_str(), header);
    out.setFrameBuffer(buffer);
    out.writePixels(height);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnwritable, file.string(), e.what());
  }
  return {};
}

Result<void> read_exr(const std::filesystem::path& file, int width, int height, int layers,
                      std::vector<Image<float>>& out) {
  std::vector<std::vector<std::uint16_t>> halves;
  Imf::FrameBuffer buffer;
  for (int i = 0; i < layers; ++i) {
    auto& plane =
        halves.emplace_back(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    buffer.insert(channel(i), Imf::Slice(Imf::HALF, reinterpret_cast<char*>(plane.data()), 2,
                                         2 * static_cast<std::size_t>(width)));
  }
  try {
    Imf::InputFile in(file.c_str());
    in.setFrameBuffer(buffer);
    in.readPixels(0, height - 1);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, file.string(), e.what());
  }
  for (const auto& plane : halves) {
    Image<float>& map = out.emplace_back(width, height);
    std::ranges::transform(plane, map.pixels().begin(), float_from_half);
  }
  return {};
}

}  // namespace

Result<CodedMaps> code_as_exr(std::span<const Image<float>> maps, int layers, float level,
                              const std::filesystem::path& folder) {
  CodedMaps out;
  const std::filesystem::path file = folder / "frame.exr";
  std::error_code ignored;
  for (std::size_t i = 0; i < maps.size(); i += static_cast<std::size_t>(layers)) {
    PENUMBRA_TRY(write_exr(file, maps.subspan(i, static_cast<std::size_t>(layers)), level));
    out.bytes += std::filesystem::file_size(file, ignored);
    PENUMBRA_TRY(read_exr(file, maps[0].width(), maps[0].height(), layers, out.maps));
  }
  std::filesystem::remove(file, ignored);
  return out;
}

namespace {

constexpr float kLargestCode = 1023;

struct ValueRange {
  float low = 0, high = 0;
  float code(float v) const {
    return high > low ? std::nearbyint((v - low) / (high - low) * kLargestCode) : 0;
  }
  float value(float code) const { return low + code / kLargestCode * (high - low); }
};

// A frame's maps side by side in a square of them.
struct Mosaic {
  int width, height, layers, across;
  int picture_width() const { return (across * width + 15) / 16 * 16; }
  int picture_height() const { return ((layers + across - 1) / across * height + 15) / 16 * 16; }
};

class VideoCoder {
 public:
  VideoCoder(const Mosaic& mosaic, std::vector<ValueRange> ranges)
      : mosaic_(mosaic), ranges_(std::move(ranges)) {}

  Result<void> open(int crf) {
    av_log_set_level(AV_LOG_ERROR);
    const AVCodec* encoder = avcodec_find_encoder_by_name("libx264");
    const AVCodec* decoder = avcodec_find_decoder(AV_CODEC_ID_H264);
    if (!encoder || !decoder)
      return fail(ErrorCode::kUnavailable, "FFmpeg", "has no H.264 encoder");
    encoder_.reset(avcodec_alloc_context3(encoder));
    encoder_->width = mosaic_.picture_width();
    encoder_->height = mosaic_.picture_height();
    encoder_->pix_fmt = AV_PIX_FMT_GRAY10LE;
    encoder_->time_base = {1, 30};
    encoder_->gop_size = 1;
    encoder_->thread_count = 2;
    av_opt_set_int(encoder_->priv_data, "crf", crf, 0);
    av_opt_set(encoder_->priv_data, "preset", "slow", 0);
    decoder_.reset(avcodec_alloc_context3(decoder));
    decoder_->thread_count = 1;
    if (avcodec_open2(encoder_.get(), encoder, nullptr) < 0 ||
        avcodec_open2(decoder_.get(), decoder, nullptr) < 0)
      return fail(ErrorCode::kUnavailable, "FFmpeg", "cannot encode 10-bit H.264");
    return {};
  }

  Result<void> add(std::span<const Image<float>> layers, CodedMaps& out) {
    const FramePointer frame(av_frame_alloc());
    frame->format = AV_PIX_FMT_GRAY10LE;
    frame->width = encoder_->width;
    frame->height = encoder_->height;
    frame->pts = next_++;
    if (av_frame_get_buffer(frame.get(), 0) < 0) return broken("no memory for a frame");
    for (int y = 0; y < frame->height; ++y)
      std::fill_n(row(*frame, y), frame->width, std::uint16_t{512});
    for (int i = 0; i < mosaic_.layers; ++i)
      for (int y = 0; y < mosaic_.height; ++y)
        for (int x = 0; x < mosaic_.width; ++x)
          *place(*frame, i, x, y) = static_cast<std::uint16_t>(
              range(i).code(layers[static_cast<std::size_t>(i)].at(x, y)));
    return encode(frame.get(), out);
  }
  Result<void> finish(CodedMaps& out) { return encode(nullptr, out); }

 private:
  static std::unexpected<Error> broken(const char* why) {
    return fail(ErrorCode::kUnavailable, "H.264", why);
  }
  static std::uint16_t* row(const AVFrame& f, int y) {
    return reinterpret_cast<std::uint16_t*>(f.data[0] + y * f.linesize[0]);
  }
  std::uint16_t* place(const AVFrame& f, int layer, int x, int y) const {
    return row(f, layer / mosaic_.across * mosaic_.height + y) +
           layer % mosaic_.across * mosaic_.width + x;
  }
  const ValueRange& range(int layer) const { return ranges_[static_cast<std::size_t>(layer)]; }

  Result<void> encode(const AVFrame* frame, CodedMaps& out) {
    if (avcodec_send_frame(encoder_.get(), frame) < 0) return broken("refuses a frame");
    const OwnedPacket packet(av_packet_alloc());
    while (avcodec_receive_packet(encoder_.get(), packet.get()) == 0) {
      out.bytes += static_cast<std::size_t>(packet->size);
      if (avcodec_send_packet(decoder_.get(), packet.get()) < 0)
        return broken("cannot read itself");
      av_packet_unref(packet.get());
      decode(out);
    }
    if (frame) return {};
    avcodec_send_packet(decoder_.get(), nullptr);
    decode(out);
    return {};
  }
  void decode(CodedMaps& out) {
    const FramePointer frame(av_frame_alloc());
    while (avcodec_receive_frame(decoder_.get(), frame.get()) == 0)
      for (int i = 0; i < mosaic_.layers; ++i) {
        Image<float>& map = out.maps.emplace_back(mosaic_.width, mosaic_.height);
        for (int y = 0; y < mosaic_.height; ++y)
          for (int x = 0; x < mosaic_.width; ++x)
            map.at(x, y) = range(i).value(*place(*frame, i, x, y));
      }
  }

  Mosaic mosaic_;
  std::vector<ValueRange> ranges_;
  Codec encoder_, decoder_;
  std::int64_t next_ = 0;
};

}  // namespace

Result<CodedMaps> code_as_video(std::span<const Image<float>> maps, int layers, int crf) {
  std::vector<ValueRange> ranges(static_cast<std::size_t>(layers));
  for (std::size_t i = 0; i < maps.size(); ++i) {
    ValueRange& r = ranges[i % ranges.size()];
    for (const float v : maps[i].pixels()) r.low = std::min(r.low, v), r.high = std::max(r.high, v);
  }
  const Mosaic mosaic{maps[0].width(), maps[0].height(), layers,
                      static_cast<int>(std::ceil(std::sqrt(static_cast<double>(layers))))};
  VideoCoder coder(mosaic, std::move(ranges));
  PENUMBRA_TRY(coder.open(crf));
  CodedMaps out;
  for (std::size_t i = 0; i < maps.size(); i += static_cast<std::size_t>(layers))
    PENUMBRA_TRY(coder.add(maps.subspan(i, static_cast<std::size_t>(layers)), out));
  PENUMBRA_TRY(coder.finish(out));
  if (out.maps.size() != maps.size()) return fail(ErrorCode::kUnavailable, "H.264", "loses frames");
  return out;
}

}  // namespace penumbra::tools
