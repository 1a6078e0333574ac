#include "capture/recording/internal/map_coding.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <glm/vec3.hpp>
#include <utility>

#include "capture/recording/internal/recording_format.h"
#include "codec/log/log_luv.h"
#include "core/conventions.h"

extern "C" {
#include <libavutil/crc.h>
#include <libavutil/opt.h>
}

namespace penumbra::capture {

namespace {

constexpr float kLargestRadiance = 1e30f;  // sums stay finite
// Of maps whose mean is far beyond what light is.
constexpr double kMinExposure = 1e-20, kMaxExposure = 1e20;
constexpr float kMaxGain = 1.25f;  // more is no rounding, but a black map
constexpr AVPixelFormat kLightFormat = AV_PIX_FMT_YUV444P12LE;
// What a pixel of the second picture says: how well it was seen, or that it is a lower bound.
constexpr int kSeenWell = 254, kClipped = 255;

// A map in, a packet out: nothing waits inside. Coarse steps keep the light, as its errors in many
// pixels cancel, and key maps have finer ones, as all up to the next keep their errors
// (docs/methods/recordings.md). It makes no MD5 sums of its pictures: labels hold faster ones.
std::string x265_options() {
  constexpr int kQuantiser = 19;
  constexpr double kFinerKeys = 2.8;
  return fmt::format(
      "qp={}:ipratio={}:keyint={}:min-keyint={}:scenecut=0:bframes=0:rc-lookahead=0:"
      "frame-threads=1:pools=none:ref=1:open-gop=0:aq-mode=0:cutree=0:psy-rd=0:psy-rdoq=0:sao=0:"
      "log-level=none",
      kQuantiser, kFinerKeys, kMapsToKey, kMapsToKey);
}

Result<AvCodec> open_coder(const AVCodec* codec, const char* name, int width, int height,
                           AVPixelFormat format, bool global_header, AVDictionary* options) {
  AvCodec out(codec ? avcodec_alloc_context3(codec) : nullptr);
  int r = AVERROR_ENCODER_NOT_FOUND;
  if (out) {
    out->width = width, out->height = height;
    out->pix_fmt = format;
    out->time_base = {1, 1000};
    out->thread_count = 1;
    if (codec->id == AV_CODEC_ID_FFV1) {  // each by itself, with a checksum
      out->gop_size = 1;
      out->level = 3;
      av_dict_set(&options, "slicecrc", "1", 0);
    }
    if (global_header) out->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    r = avcodec_open2(out.get(), codec, &options);
  }
  av_dict_free(&options);
  if (r < 0)
    return fail(ErrorCode::kUnavailable, "light",
                fmt::format("cannot be coded: FFmpeg's {} says {}", name, av_reason(r)));
  return out;
}

Result<AvPicture> make_picture(const AVCodecContext& of) {
  AvPicture out(av_frame_alloc());
  out->format = of.pix_fmt;
  out->width = of.width, out->height = of.height;
  if (const int r = av_frame_get_buffer(out.get(), 0); r < 0)
    return fail(ErrorCode::kUnavailable, "light", av_reason(r));
  return out;
}

float sum_of(const Rgb& p) {
  return p.r + p.g + p.b;
}

// Colour matrices of cameras give negative channels, which neither codes nor labels hold.
Rgb kept(const Rgb& p) {
  const auto channel = [](float v) {
    return v > 0 && std::isfinite(v) ? std::min(v, kLargestRadiance) : 0;
  };
  return {channel(p.r), channel(p.g), channel(p.b)};
}

std::span<std::uint16_t> codes(const AVFrame& picture, int plane, int y) {
  return {reinterpret_cast<std::uint16_t*>(picture.data[plane] + y * picture.linesize[plane]),
          static_cast<std::size_t>(picture.width)};
}
std::span<std::uint8_t> levels(const AVFrame& picture, int y) {
  return {picture.data[0] + y * picture.linesize[0], static_cast<std::size_t>(picture.width)};
}

void fill_seen(const Environment& map, Image<std::uint8_t>& out) {
  out.reset(map.radiance.width(), map.radiance.height(), kSeenWell);
  for (int y = 0; !map.confidence.empty() && y < out.height(); ++y) {
    const auto row = out.row(y);
    const auto seen = map.confidence.row(y);
    for (std::size_t x = 0; x < row.size(); ++x)
      row[x] = static_cast<std::uint8_t>(
          seen[x] > 0 ? std::clamp(std::lround(seen[x] * kSeenWell), 1L, long{kSeenWell}) : 0);
  }
  for (const std::uint32_t i : map.clipped) out.pixels()[i] = kClipped;
}

// Of a picture's codes, so that damage is found that a decoder conceals: both sums of Fletcher
// (1982) of each row, and FNV-1a over these. A fifth of the time of an MD5 sum.
std::uint64_t sum_of_codes(const AVFrame& picture) {
  constexpr std::uint64_t kPrime = 0x100000001b3;
  std::uint64_t out = 0xcbf29ce484222325;
  for (int plane = 0; plane < 3; ++plane)
    for (int y = 0; y < picture.height; ++y) {
      std::uint32_t sum = 0, by_place = 0, place = 0;
      for (const std::uint16_t code : codes(picture, plane, y)) {
        sum += code;
        by_place += code * ++place;
      }
      out = (out ^ sum) * kPrime;
      out = (out ^ by_place) * kPrime;
    }
  return out;
}

Result<void> encode(AVCodecContext& coder, AVFrame& picture, std::int64_t count, AVPacket& out) {
  picture.pts = count;
  int r = avcodec_send_frame(&coder, &picture);
  if (r >= 0) r = avcodec_receive_packet(&coder, &out);
  if (r < 0) return fail(ErrorCode::kUnavailable, "light", "cannot be coded: " + av_reason(r));
  return {};
}

// checks: of the checksums in the packets
Result<AvCodec> open_decoder(const AVCodecParameters& of, int checks) {
  const AVCodec* codec = avcodec_find_decoder(of.codec_id);
  if (!codec)
    return fail(ErrorCode::kUnavailable, "FFmpeg",
                fmt::format("has no {} decoder", avcodec_get_name(of.codec_id)));
  AvCodec out(avcodec_alloc_context3(codec));
  int r = avcodec_parameters_to_context(out.get(), &of);
  out->thread_count = 1;
  out->flags |= AV_CODEC_FLAG_LOW_DELAY;
  out->err_recognition = checks;
  out->max_pixels = std::int64_t{of.width} * of.height + 64 * 64;  // nothing larger is allocated
  if (r >= 0) r = avcodec_open2(out.get(), codec, nullptr);
  if (r < 0) return fail(ErrorCode::kUnreadable, "light", av_reason(r));
  return out;
}

using AvParameters = std::unique_ptr<AVCodecParameters, AvFreed<avcodec_parameters_free>>;
Result<AvParameters> parameters_of(const AVCodecContext& coder) {
  AvParameters out(avcodec_parameters_alloc());
  if (const int r = avcodec_parameters_from_context(out.get(), &coder); r < 0)
    return fail(ErrorCode::kUnavailable, "light", av_reason(r));
  return out;
}

// FFmpeg's FFV1 decoder conceals slices whose checksum is wrong and calls them decoded, so it is
// held against the bytes here. Slices are found from the packet's end: each ends with its size (3
// bytes), whether it is whole (1) and its checksum (4).
// source: RFC 9043, section 4.9
bool slices_are_whole(const AVPacket& packet) {
  constexpr std::size_t kFooter = 8, kMaxSlices = 1024;
  const AVCRC* const table = av_crc_get_table(AV_CRC_32_IEEE);
  std::span<const std::uint8_t> left(packet.data, static_cast<std::size_t>(packet.size));
  for (std::size_t slices = 0; !left.empty(); ++slices) {
    if (left.size() < kFooter || slices == kMaxSlices) return false;
    const auto footer = left.last(kFooter);
    const std::size_t size =
        kFooter + (std::size_t{footer[0]} << 16 | std::size_t{footer[1]} << 8 | footer[2]);
    if (size > left.size() || av_crc(table, 0, left.last(size).data(), size) != 0) return false;
    left = left.first(left.size() - size);
  }
  return true;
}

Result<void> decode_into(AVCodecContext& coder, const AVPacket& packet, AVPixelFormat format,
                         int width, int height, AVFrame& out) {
  if (coder.codec_id == AV_CODEC_ID_FFV1 && !slices_are_whole(packet))
    return fail(ErrorCode::kUnreadable, "map", "is damaged: its checksum is of other bytes");
  int r = avcodec_send_packet(&coder, &packet);
  if (r >= 0) r = avcodec_receive_frame(&coder, &out);
  if (r >= 0 && out.decode_error_flags != 0) r = AVERROR_INVALIDDATA;
  if (r < 0) {
    avcodec_flush_buffers(&coder);
    return fail(ErrorCode::kUnreadable, "map", av_reason(r));
  }
  if (out.width != width || out.height != height || out.format != format)
    return fail(ErrorCode::kUnreadable, "map", "has another size or other pixels than the first");
  return {};
}

}  // namespace

Result<void> check_map_size(int width, int height) {
  constexpr int kMin = 16, kMax = 1024;
  if (height >= kMin && height <= kMax && height % 2 == 0 && width == 2 * height) return {};
  return fail(
      ErrorCode::kInvalid, "light",
      fmt::format("maps of {} x {} pixels are not lat-long of an even number of rows within "
                  "{}..{}",
                  width, height, kMin, kMax));
}

Result<MapEncoder> MapEncoder::create(int width, int height, bool global_header) {
  PENUMBRA_TRY(check_map_size(width, height));
  MapEncoder out;
  AVDictionary* options = nullptr;
  av_dict_set(&options, "preset", "superfast", 0);
  av_dict_set(&options, "tune", "zerolatency", 0);
  av_dict_set(&options, "x265-params", x265_options().c_str(), 0);
  PENUMBRA_ASSIGN(light, open_coder(avcodec_find_encoder_by_name("libx265"), "libx265", width,
                                    height, kLightFormat, global_header, options));
  PENUMBRA_ASSIGN(seen, open_coder(avcodec_find_encoder(AV_CODEC_ID_FFV1), "FFV1", width, height,
                                   AV_PIX_FMT_GRAY8, global_header, nullptr));
  PENUMBRA_ASSIGN(light_picture, make_picture(*light));
  PENUMBRA_ASSIGN(seen_picture, make_picture(*seen));
  out.light_ = std::move(light), out.seen_ = std::move(seen);
  out.light_picture_ = std::move(light_picture), out.seen_picture_ = std::move(seen_picture);
  PENUMBRA_ASSIGN(parameters, parameters_of(*out.light_));
  PENUMBRA_ASSIGN(decoder, open_decoder(*parameters, AV_EF_EXPLODE));  // of what is whole
  out.decoder_ = std::move(decoder);
  out.decoded_.reset(av_frame_alloc());
  out.coded_seen_.reset(av_packet_alloc());
  out.exposed_.reset(width, height);
  return out;
}

namespace {

// All light of a map: the sum of its channels, over solid angle.
double power_of(const Image<Rgb>& map) {
  double out = 0;
  for (int y = 0; y < map.height(); ++y) {
    const auto row = map.row(y);
    // Several sums, which the processor adds up side by side.
    constexpr std::size_t kSums = 8;
    std::array<float, kSums> sums{};
    std::size_t x = 0;
    for (; x + kSums <= row.size(); x += kSums)
      for (std::size_t k = 0; k < kSums; ++k) sums[k] += sum_of(row[x + k]);
    double all = 0;
    for (; x < row.size(); ++x) all += double(sum_of(row[x]));
    for (const float sum : sums) all += double(sum);
    out += all * latlong_solid_angle(y, map.width(), map.height());
  }
  return out;
}

// Takes out what carries more than its part of all light: a coder's error in it would be one of the
// light. What stands before it in its row takes its place.
std::vector<MapLabel::Peak> take_peaks(Image<Rgb>& map, double total_sr) {
  // In a map of a few pixels each is much of the light, and none stands out.
  constexpr double kMuch = 1. / 400, kTimesMean = 16;
  const double largest = std::max(kMuch, kTimesMean / static_cast<double>(map.area())) * total_sr;
  std::vector<MapLabel::Peak> out;
  for (int y = 0; y < map.height(); ++y) {
    const double solid = latlong_solid_angle(y, map.width(), map.height());
    const auto row = map.row(y);
    const auto limit = static_cast<float>(largest / solid);
    const auto stands_out = [&](const Rgb& p) { return sum_of(p) > limit; };
    if (std::ranges::none_of(row, stands_out)) continue;
    // A row goes on from its end.
    const auto last = std::find_if_not(row.rbegin(), row.rend(), stands_out);
    Rgb before = last == row.rend() ? Rgb{} : *last;
    for (std::size_t x = 0; x < row.size(); ++x) {
      if (!stands_out(row[x])) {
        before = row[x];
        continue;
      }
      out.push_back(
          {static_cast<std::uint32_t>(y * map.width()) + static_cast<std::uint32_t>(x), row[x]});
      row[x] = before;
    }
  }
  return out;
}

// What a coded picture loses or gains in all. Slow changes stay below a coder's steps and would be
// missing in every pixel alike.
Rgb gains_of(const Image<Rgb>& truth, const AVFrame& decoded, const Image<std::uint8_t>& seen) {
  glm::dvec3 wanted(0), got(0);
  std::vector<Rgb> row(static_cast<std::size_t>(truth.width()));
  for (int y = 0; y < truth.height(); ++y) {
    codec::rgb_from_log_luv({codes(decoded, 0, y), codes(decoded, 1, y), codes(decoded, 2, y)},
                            row);
    const double solid = latlong_solid_angle(y, truth.width(), truth.height());
    const auto mask = seen.row(y);
    glm::dvec3 wanted_row(0), got_row(0);
    const auto lit = truth.row(y);
    // A part of a row in floats, which keep six digits of so few, and all parts in doubles.
    constexpr std::size_t kPart = 64;
    for (std::size_t x0 = 0; x0 < row.size(); x0 += kPart) {
      Rgb wanted_part, got_part;
      for (std::size_t x = x0; x < std::min(x0 + kPart, row.size()); ++x) {
        const auto counts = static_cast<float>(mask[x] != 0 && sum_of(lit[x]) > 0);
        wanted_part += counts * lit[x];
        got_part += counts * row[x];
      }
      wanted_row += glm::dvec3(wanted_part.r, wanted_part.g, wanted_part.b);
      got_row += glm::dvec3(got_part.r, got_part.g, got_part.b);
    }
    wanted += wanted_row * solid, got += got_row * solid;
  }
  Rgb out{1, 1, 1};
  for (int c = 0; c < 3; ++c)
    if (const double gain = wanted[c] / got[c]; gain < kMaxGain && gain > 1 / kMaxGain)
      out[c] = static_cast<float>(gain);
  return out;
}

std::string checksum(std::string_view text) {
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(text.data());
  return fmt::format("{:08x}",
                     ~av_crc(av_crc_get_table(AV_CRC_32_IEEE_LE), 0xffffffffu, bytes, text.size()));
}

}  // namespace

std::string print_map_label(const std::string& row, const MapLabel& label) {
  std::string out =
      row + fmt::format(";{:.6g} {:.6g} {:.6g}", label.gain.r, label.gain.g, label.gain.b);
  if (label.codes) out += fmt::format(";{:016x}", *label.codes);
  for (const auto& [pixel, radiance] : label.peaks)
    out += fmt::format(";{} {:.5g} {:.5g} {:.5g}", pixel, radiance.r, radiance.g, radiance.b);
  return out + ";" + checksum(out);
}

Result<MapLabelText> split_map_label(std::string_view text) {
  const auto last = text.rfind(';'), first = text.find(';');
  if (last == std::string_view::npos || text.substr(last + 1) != checksum(text.substr(0, last)))
    return fail(ErrorCode::kInvalid, "label", "has another checksum than it says");
  return MapLabelText{text.substr(0, first), text.substr(first, last - first)};
}

namespace {

// Numbers with a blank between, from `at` on; false unless that is all.
bool read_colour(const char* at, const char* end, Rgb& out) {
  for (int c = 0; c < 3; ++c) {
    const auto read = std::from_chars(at, end, out[c]);
    if (read.ec != std::errc{} || !(out[c] >= 0 && out[c] <= kLargestRadiance)) return false;
    at = read.ptr;
    if (c < 2 && (at == end || *at++ != ' ')) return false;
  }
  return at == end;
}

}  // namespace

Result<MapLabel> parse_map_label(std::string_view text, double exposure) {
  const auto damaged = [](std::string_view part) {
    return fail(ErrorCode::kInvalid, std::string(part), "does not belong into a map's label");
  };
  const auto next = [&text] {
    text.remove_prefix(std::min<std::size_t>(1, text.size()));
    const std::string_view part = text.substr(0, text.find(';'));
    text.remove_prefix(part.size());
    return part;
  };
  MapLabel out;
  out.exposure = exposure;
  if (!(exposure >= kMinExposure && exposure <= kMaxExposure)) return damaged("its exposure");
  const std::string_view gain = next();
  if (!read_colour(gain.data(), gain.data() + gain.size(), out.gain)) return damaged(gain);
  for (int c = 0; c < 3; ++c)
    if (!(out.gain[c] > .99f / kMaxGain && out.gain[c] < 1.01f * kMaxGain)) return damaged(gain);
  for (bool first = true; !text.empty(); first = false) {
    const std::string_view part = next();
    const char* const end = part.data() + part.size();
    if (first && part.find(' ') == std::string_view::npos) {
      const auto sum = std::from_chars(part.data(), end, out.codes.emplace(), 16);
      if (sum.ec != std::errc{} || sum.ptr != end) return damaged(part);
      continue;
    }
    MapLabel::Peak peak;
    const auto number = std::from_chars(part.data(), end, peak.pixel);
    if (number.ec != std::errc{} || number.ptr == end ||
        !read_colour(number.ptr + 1, end, peak.radiance))
      return damaged(part);
    out.peaks.push_back(peak);
  }
  return out;
}

Result<MapLabel> MapEncoder::code(const Environment& map, AVPacket& light, AVPacket& seen) {
  AVFrame& picture = *light_picture_;
  if (map.radiance.width() != picture.width || map.radiance.height() != picture.height)
    return fail(
        ErrorCode::kInvalid, "light",
        fmt::format("has a map of {} x {} pixels, after maps of {} x {}", map.radiance.width(),
                    map.radiance.height(), picture.width, picture.height));
  if (const int r = av_frame_make_writable(&picture); r < 0)
    return fail(ErrorCode::kUnavailable, "light", av_reason(r));
  std::ranges::transform(map.radiance.pixels(), exposed_.pixels().begin(), kept);
  MapLabel label{.peaks = take_peaks(exposed_, power_of(exposed_))};
  const double mean = power_of(exposed_) / (4 * kPi) / 3;
  // A change of all light, by clouds or the hour, is then none of the picture.
  if (mean > 0) label.exposure = std::clamp(1 / mean, kMinExposure, kMaxExposure);
  for (Rgb& p : exposed_.pixels()) p = p * static_cast<float>(label.exposure);
  for (int y = 0; y < picture.height; ++y)
    codec::log_luv_from_rgb(exposed_.row(y),
                            {codes(picture, 0, y), codes(picture, 1, y), codes(picture, 2, y)});
  const auto number = static_cast<std::int64_t>(coded_);
  PENUMBRA_TRY(encode(*light_, picture, number, light));
  PENUMBRA_TRY(code_seen(map, number, seen));
  PENUMBRA_TRY(
      decode_into(*decoder_, light, kLightFormat, picture.width, picture.height, *decoded_));
  label.gain = gains_of(exposed_, *decoded_, seen_levels_);
  label.codes = sum_of_codes(*decoded_);
  ++coded_;
  return label;
}

// What was seen stays as it is for long, and each of its packets stands alone.
Result<void> MapEncoder::code_seen(const Environment& map, std::int64_t number, AVPacket& out) {
  fill_seen(map, seen_levels_);
  if (!std::ranges::equal(seen_levels_.pixels(), coded_levels_.pixels())) {
    AVFrame& picture = *seen_picture_;
    if (const int r = av_frame_make_writable(&picture); r < 0)
      return fail(ErrorCode::kUnavailable, "light", av_reason(r));
    for (int y = 0; y < picture.height; ++y)
      std::ranges::copy(std::as_const(seen_levels_).row(y), levels(picture, y).begin());
    coded_levels_ = {};
    av_packet_unref(coded_seen_.get());
    PENUMBRA_TRY(encode(*seen_, picture, number, *coded_seen_));
    coded_levels_ = seen_levels_;
  }
  if (const int r = av_packet_ref(&out, coded_seen_.get()); r < 0)
    return fail(ErrorCode::kUnavailable, "light", av_reason(r));
  out.pts = out.dts = number;
  return {};
}

namespace {

void read_seen(const AVFrame& mask, Environment& out) {
  const int width = mask.width, height = mask.height;
  bool whole = true;
  double clipped_sr = 0;
  out.confidence.reset(width, height, 1);
  for (int y = 0; y < height; ++y) {
    const auto from = levels(mask, y);
    const auto to = out.confidence.row(y);
    for (std::size_t x = 0; x < from.size(); ++x) {
      if (from[x] == kClipped) {
        out.clipped.push_back(static_cast<std::uint32_t>(y * width) +
                              static_cast<std::uint32_t>(x));
        clipped_sr += latlong_solid_angle(y, width, height);
      } else if (from[x] != kSeenWell) {
        to[x] = static_cast<float>(from[x]) / kSeenWell;
        whole = false;
      }
    }
  }
  out.clipped_fraction = clipped_sr / (4 * kPi);
  if (whole) out.confidence = {};
}

}  // namespace

Result<MapDecoder> MapDecoder::open(const AVCodecParameters& light, const AVCodecParameters& seen) {
  if (light.codec_id != AV_CODEC_ID_HEVC || seen.codec_id != AV_CODEC_ID_FFV1)
    return fail(ErrorCode::kInvalid, "light",
                fmt::format("is coded as {} and {} instead of hevc and ffv1",
                            avcodec_get_name(light.codec_id), avcodec_get_name(seen.codec_id)));
  PENUMBRA_TRY(check_map_size(light.width, light.height));
  MapDecoder out;
  out.width_ = light.width, out.height_ = light.height;
  constexpr int kAll = AV_EF_CRCCHECK | AV_EF_EXPLODE;
  PENUMBRA_ASSIGN(light_decoder, open_decoder(light, kAll));
  PENUMBRA_ASSIGN(seen_decoder, open_decoder(seen, kAll));
  out.light_ = std::move(light_decoder), out.seen_ = std::move(seen_decoder);
  out.picture_.reset(av_frame_alloc());
  out.mask_.reset(av_frame_alloc());
  return out;
}

Result<Environment> MapDecoder::decode(const AVPacket& light, const AVPacket& seen,
                                       const MapLabel& label) {
  PENUMBRA_TRY(decode_into(*light_, light, kLightFormat, width_, height_, *picture_));
  if (label.codes && sum_of_codes(*picture_) != *label.codes)
    return fail(ErrorCode::kUnreadable, "map", "is damaged: its label is of another picture");
  PENUMBRA_TRY(decode_into(*seen_, seen, AV_PIX_FMT_GRAY8, width_, height_, *mask_));
  Environment out;
  out.radiance.reset(width_, height_);
  read_seen(*mask_, out);
  // What is left of black by the coder's errors.
  const auto black = static_cast<float>(3 * .02 * double(codec::kLogLuvToe) / label.exposure);
  double black_sr = 0;
  const Rgb scale = label.gain * static_cast<float>(1 / label.exposure);
  for (int y = 0; y < height_; ++y) {
    const auto row = out.radiance.row(y);
    codec::rgb_from_log_luv(
        {codes(*picture_, 0, y), codes(*picture_, 1, y), codes(*picture_, 2, y)}, row);
    for (Rgb& p : row) p = p * scale;
    const auto mask = levels(*mask_, y);
    for (std::size_t x = 0; x < row.size(); ++x)
      if (mask[x] == 0)
        row[x] = {};
      else if (sum_of(row[x]) <= black)
        black_sr += latlong_solid_angle(y, width_, height_);
  }
  out.black_fraction = black_sr / (4 * kPi);
  for (const auto& [pixel, radiance] : label.peaks) {
    if (pixel >= out.radiance.area())
      return fail(ErrorCode::kUnreadable, "map", "has a bright pixel outside");
    out.radiance.pixels()[pixel] = radiance;
  }
  return out;
}

}  // namespace penumbra::capture
