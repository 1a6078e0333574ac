#include "tools/chart/peers/light_coders.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "codec/log/log_luv.h"
#include "tools/chart/peers/internal/ffmpeg_owned.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavutil/opt.h>
}

namespace penumbra::tools {

namespace {

std::span<std::uint16_t> line(const AVFrame& f, int plane, int y, int width) {
  return {reinterpret_cast<std::uint16_t*>(f.data[plane] + y * f.linesize[plane]),
          static_cast<std::size_t>(width)};
}

// SMPTE ST 2084, of 0..1.
constexpr double kM1 = 2610. / 16384, kM2 = 2523. / 4096 * 128, kC1 = 3424. / 4096,
                 kC2 = 2413. / 4096 * 32, kC3 = 2392. / 4096 * 32;
double pq(double v) {
  const double p = std::pow(std::clamp(v, 0., 1.), kM1);
  return std::pow((kC1 + kC2 * p) / (1 + kC3 * p), kM2);
}
double from_pq(double code) {
  const double p = std::pow(std::clamp(code, 0., 1.), 1 / kM2);
  return std::pow(std::max(0., p - kC1) / (kC2 - kC3 * p), 1 / kM1);
}

// How pixels become codes, and back.
class PixelCodes {
 public:
  PixelCodes(LightCoder coder, std::span<const Image<Rgb>> maps)
      : log_(coder == LightCoder::kHevcLog) {
    double sum = 0, count = 0;
    for (const Image<Rgb>& map : maps)
      for (const Rgb& p : map.pixels()) {
        largest_ = std::max({largest_, p.r, p.g, p.b});
        sum += double(p.r + p.g + p.b) / 3, ++count;
      }
    mean_ = static_cast<float>(std::max(sum / count, 1e-20));
    largest_ = std::max(largest_, 1e-20f);
  }
  AVPixelFormat format() const { return log_ ? AV_PIX_FMT_YUV444P12LE : AV_PIX_FMT_YUV420P10LE; }

  void fill(const Image<Rgb>& map, const AVFrame& out) const {
    const int w = map.width(), h = map.height();
    if (log_) {
      std::vector<Rgb> row(static_cast<std::size_t>(w));
      for (int y = 0; y < h; ++y) {
        std::ranges::transform(map.row(y), row.begin(), [&](Rgb p) { return p * (1 / mean_); });
        codec::log_luv_from_rgb(row, {line(out, 0, y, w), line(out, 1, y, w), line(out, 2, y, w)});
      }
      return;
    }
    for (int y = 0; y < h; y += 2)
      for (int x = 0; x < w; x += 2) {
        double cb = 0, cr = 0;
        for (int k = 0; k < 4; ++k) {
          const Rgb& p = map.at(x + k % 2, y + k / 2);
          const double r = pq(double(p.r / largest_)), g = pq(double(p.g / largest_)),
                       b = pq(double(p.b / largest_));
          const double luma = .2627 * r + .678 * g + .0593 * b;
          line(out, 0, y + k / 2, w)[static_cast<std::size_t>(x + k % 2)] = code(luma);
          cb += (b - luma) / 1.8814 / 4, cr += (r - luma) / 1.4746 / 4;
        }
        line(out, 1, y / 2, w / 2)[static_cast<std::size_t>(x / 2)] = code(cb + .5);
        line(out, 2, y / 2, w / 2)[static_cast<std::size_t>(x / 2)] = code(cr + .5);
      }
  }

  Image<Rgb> read(const AVFrame& in, int w, int h) const {
    Image<Rgb> out(w, h);
    for (int y = 0; y < h; ++y) {
      if (log_) {
        codec::rgb_from_log_luv({line(in, 0, y, w), line(in, 1, y, w), line(in, 2, y, w)},
                                out.row(y));
        for (Rgb& p : out.row(y)) p = p * mean_;
        continue;
      }
      for (int x = 0; x < w; ++x) {
        const double luma = value(line(in, 0, y, w)[static_cast<std::size_t>(x)]),
                     cb = value(line(in, 1, y / 2, w / 2)[static_cast<std::size_t>(x / 2)]) - .5,
                     cr = value(line(in, 2, y / 2, w / 2)[static_cast<std::size_t>(x / 2)]) - .5;
        const double b = luma + 1.8814 * cb, r = luma + 1.4746 * cr,
                     g = (luma - .2627 * r - .0593 * b) / .678;
        const auto linear = [&](double c) { return static_cast<float>(from_pq(c)) * largest_; };
        out.at(x, y) = {linear(r), linear(g), linear(b)};
      }
    }
    return out;
  }

 private:
  static constexpr double kMaxCode = 1023;
  static std::uint16_t code(double v) {
    return static_cast<std::uint16_t>(std::lround(std::clamp(v, 0., 1.) * kMaxCode));
  }
  static double value(std::uint16_t code) { return code / kMaxCode; }
  bool log_;
  float largest_ = 0, mean_ = 1;
};

class LightVideo {
 public:
  LightVideo(LightCoder coder, std::span<const Image<Rgb>> maps)
      : coder_(coder), codes_(coder, maps), width_(maps[0].width()), height_(maps[0].height()) {}

  Result<void> open(int quantiser) {
    const bool av1 = coder_ == LightCoder::kAv1Pq;
    const AVCodec* const encoder = avcodec_find_encoder_by_name(av1 ? "libsvtav1" : "libx265");
    const AVCodec* const decoder =
        av1 ? avcodec_find_decoder_by_name("libdav1d") : avcodec_find_decoder(AV_CODEC_ID_HEVC);
    if (!encoder || !decoder) return unavailable("FFmpeg lacks it");
    encoder_.reset(avcodec_alloc_context3(encoder));
    encoder_->width = width_, encoder_->height = height_;
    encoder_->pix_fmt = codes_.format();
    encoder_->time_base = {1, 30};
    encoder_->color_range = AVCOL_RANGE_JPEG;
    if (av1) {
      // It prints its settings on standard error unless told not to.
      ::setenv("SVT_LOG", "-1", 0);
      av_opt_set_int(encoder_->priv_data, "qp", quantiser, 0);
      av_opt_set_int(encoder_->priv_data, "preset", 8, 0);
      av_opt_set_int(encoder_->priv_data, "rc", 0, 0);
      encoder_->gop_size = kLightCoderKeys;
    } else {
      av_opt_set(encoder_->priv_data, "preset", "superfast", 0);
      const std::string options = fmt::format(
          "qp={1}:ipratio=2.8:keyint={0}:min-keyint={0}:bframes=0:scenecut=0:psy-rd=0:log-level="
          "none",
          kLightCoderKeys, quantiser);
      av_opt_set(encoder_->priv_data, "x265-params", options.c_str(), 0);
    }
    decoder_.reset(avcodec_alloc_context3(decoder));
    decoder_->thread_count = 1;
    if (avcodec_open2(encoder_.get(), encoder, nullptr) < 0 ||
        avcodec_open2(decoder_.get(), decoder, nullptr) < 0)
      return unavailable("cannot be opened");
    return {};
  }

  Result<void> add(const Image<Rgb>& map, CodedLight& out) {
    const FramePointer picture(av_frame_alloc());
    picture->format = codes_.format();
    picture->width = width_, picture->height = height_;
    picture->pts = next_++;
    if (av_frame_get_buffer(picture.get(), 0) < 0) return unavailable("has no memory");
    codes_.fill(map, *picture);
    return encode(picture.get(), out);
  }
  Result<void> finish(CodedLight& out) {
    PENUMBRA_TRY(encode(nullptr, out));
    avcodec_send_packet(decoder_.get(), nullptr);
    decode(out);
    return {};
  }

 private:
  std::unexpected<Error> unavailable(const char* why) const {
    return fail(ErrorCode::kUnavailable, name_of(coder_), why);
  }
  Result<void> encode(const AVFrame* picture, CodedLight& out) {
    if (avcodec_send_frame(encoder_.get(), picture) < 0) return unavailable("refuses a map");
    const OwnedPacket packet(av_packet_alloc());
    while (avcodec_receive_packet(encoder_.get(), packet.get()) == 0) {
      out.bytes += static_cast<std::size_t>(packet->size);
      if (avcodec_send_packet(decoder_.get(), packet.get()) < 0)
        return unavailable("cannot read itself");
      av_packet_unref(packet.get());
      decode(out);
    }
    return {};
  }
  void decode(CodedLight& out) {
    const FramePointer picture(av_frame_alloc());
    while (avcodec_receive_frame(decoder_.get(), picture.get()) == 0)
      out.maps.push_back(codes_.read(*picture, width_, height_));
  }

  LightCoder coder_;
  PixelCodes codes_;
  int width_, height_;
  Codec encoder_, decoder_;
  std::int64_t next_ = 0;
};

}  // namespace

std::string name_of(LightCoder coder) {
  switch (coder) {
    case LightCoder::kHevcPq:
      return "HEVC 10 bit PQ";
    case LightCoder::kAv1Pq:
      return "AV1 10 bit PQ";
    case LightCoder::kHevcLog:
      return "HEVC 12 bit log with suns";
  }
  return "";
}

Result<CodedLight> code_light(LightCoder coder, std::span<const Image<Rgb>> maps, int quantiser) {
  av_log_set_level(AV_LOG_ERROR);
  LightVideo video(coder, maps);
  PENUMBRA_TRY(video.open(quantiser));
  CodedLight out;
  for (const Image<Rgb>& map : maps) PENUMBRA_TRY(video.add(map, out));
  PENUMBRA_TRY(video.finish(out));
  if (out.maps.size() != maps.size())
    return fail(ErrorCode::kUnavailable, name_of(coder), "loses maps");
  return out;
}

}  // namespace penumbra::tools
