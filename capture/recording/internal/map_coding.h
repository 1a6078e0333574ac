// Maps of the surroundings as video: HEVC of 12-bit LogLuv for the light, lossless FFV1 for what
// was seen and what was clipped.
// threads: thread-bound
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
}

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/environment.h"
#include "core/image.h"
#include "core/result.h"

namespace penumbra::capture {

template <auto Free>
struct AvFreed {
  template <class T>
  void operator()(T* p) const {
    Free(&p);
  }
};
using AvCodec = std::unique_ptr<AVCodecContext, AvFreed<avcodec_free_context>>;
using AvPicture = std::unique_ptr<AVFrame, AvFreed<av_frame_free>>;
using Packet = std::unique_ptr<AVPacket, AvFreed<av_packet_free>>;

/// Every so many maps one is coded by itself: from there a reader can begin.
inline constexpr int kMapsToKey = 30;

/// A map's size: lat-long, rows even and within 16..1024.
/// errors: kInvalid
Result<void> check_map_size(int width, int height);

/// What a map's label tells beside its time.
struct MapLabel {
  double exposure = 1;  // pixels are radiance times this over the gain
  Rgb gain{1, 1, 1};    // so that all light together is the map's
  /// Pixels that alone carry much of the light, as suns do: y * width + x, and the radiance. In the
  /// picture they look as their neighbours do.
  struct Peak {
    std::uint32_t pixel = 0;
    Rgb radiance;
  };
  std::vector<Peak> peaks{};
  /// Sum of the decoded picture's codes; none in tracks whose packets hold sums of their own.
  std::optional<std::uint64_t> codes{};
};
/// A label's row, and behind it all else, with a checksum (CRC-32 as zlib has it) at the end.
std::string print_map_label(const std::string& row, const MapLabel& label);
struct MapLabelText {
  std::string_view row, rest;
};
/// errors: kInvalid (the checksum is of another text)
Result<MapLabelText> split_map_label(std::string_view text);
/// Of the rest; the exposure stands in the row.
/// errors: kInvalid
Result<MapLabel> parse_map_label(std::string_view rest, double exposure);

class MapEncoder {
 public:
  /// errors: kUnavailable (FFmpeg lacks the coders), kInvalid (size)
  static Result<MapEncoder> create(int width, int height, bool global_header);

  const AVCodecContext& light() const { return *light_; }
  const AVCodecContext& seen() const { return *seen_; }
  std::uint64_t coded() const { return coded_; }
  /// errors: kInvalid (another size), kUnavailable (coder)
  Result<MapLabel> code(const Environment& map, AVPacket& light, AVPacket& seen);

 private:
  Result<void> code_seen(const Environment& map, std::int64_t number, AVPacket& out);

  AvCodec light_, seen_;
  AvPicture light_picture_, seen_picture_;
  AvCodec decoder_;  // of its own packets
  AvPicture decoded_;
  std::uint64_t coded_ = 0;
  Packet coded_seen_;                 // the newest of FFV1, and
  Image<std::uint8_t> coded_levels_;  // of what
  Image<Rgb> exposed_;                // scratch
  Image<std::uint8_t> seen_levels_;   // scratch
};

class MapDecoder {
 public:
  /// errors: kUnavailable (FFmpeg lacks the coders), kUnreadable (headers), kInvalid (size)
  static Result<MapDecoder> open(const AVCodecParameters& light, const AVCodecParameters& seen);

  /// Maps in their order. After one that is missing or damaged none is right until one that was
  /// coded by itself.
  /// errors: kUnreadable
  Result<Environment> decode(const AVPacket& light, const AVPacket& seen, const MapLabel& label);

 private:
  AvCodec light_, seen_;
  AvPicture picture_, mask_;
  int width_ = 0, height_ = 0;
};

}  // namespace penumbra::capture
