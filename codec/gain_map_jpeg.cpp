#include "codec/gain_map_jpeg.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <variant>

#include "codec/codec.h"
#include "codec/display.h"
#include "codec/internal/frame_codecs.h"
#include "codec/internal/gain_map.h"
#include "core/conventions.h"
#include "core/median.h"

namespace penumbra::codec {

namespace {

using JpegBytes = std::vector<unsigned char>;

constexpr int kGainQuality = 100;
constexpr float kBrightest = 0x1p48f;          // over white: as far as gains of 64 stops reach
constexpr float kSmallestOffset = 1.f / 4096;  // of both renditions: about the darkest code's light
constexpr std::string_view kRdf =
    R"(<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0")";
constexpr std::string_view kRdfEnd = "</rdf:RDF></x:xmpmeta>";

// A marker segment: FF, marker, two bytes of length, text and data.
void add_segment(JpegBytes& out, unsigned char marker, std::string_view head,
                 std::string_view data) {
  const std::size_t size = 2 + head.size() + data.size();
  out.insert(out.end(), {0xff, marker, static_cast<unsigned char>(size >> 8),
                         static_cast<unsigned char>(size)});
  out.insert(out.end(), head.begin(), head.end());
  out.insert(out.end(), data.begin(), data.end());
}

void add_u32(std::string& out, std::size_t value) {
  for (const int shift : {24, 16, 8, 0}) out += static_cast<char>(value >> shift);
}
void add_u16(std::string& out, std::size_t value) {
  for (const int shift : {8, 0}) out += static_cast<char>(value >> shift);
}

// The multi-picture index (CIPA DC-007, 5.2), big-endian. Offsets count from its own byte order
// mark, which stands 8 bytes after the segment's begin.
constexpr std::size_t kIndexSize = 8 + 2 + 3 * 12 + 4 + 2 * 16;
std::string picture_index(std::size_t first_size, std::size_t second_offset,
                          std::size_t second_size) {
  constexpr std::size_t kPrimary = 0x030000, kUndefined = 7, kLong = 4;
  std::string out("MM\0*", 4);
  add_u32(out, 8);
  add_u16(out, 3);
  const auto add_entry = [&](std::size_t tag, std::size_t type, std::size_t count) {
    add_u16(out, tag), add_u16(out, type), add_u32(out, count);
  };
  add_entry(0xb000, kUndefined, 4);
  out += "0100";
  add_entry(0xb001, kLong, 1);
  add_u32(out, 2);
  add_entry(0xb002, kUndefined, 32);
  add_u32(out, out.size() + 8);
  add_u32(out, 0);  // no further index
  add_u32(out, kPrimary), add_u32(out, first_size), add_u32(out, 0), add_u32(out, 0);
  add_u32(out, 0), add_u32(out, second_size), add_u32(out, second_offset), add_u32(out, 0);
  return out;
}

// The same for all channels.
std::string iso_metadata(const GainMap& map) {
  constexpr int kOneChannelInTheBasesPrimaries = 0x40;
  constexpr double kDenominator = 1 << 20;
  std::string out;
  add_u16(out, 0), add_u16(out, 0);  // versions: what a reader needs, what wrote it
  out += static_cast<char>(kOneChannelInTheBasesPrimaries);
  for (const float v : {0.f, std::max(map.max_log2[0], .01f), map.min_log2[0], map.max_log2[0],
                        map.gamma[0], map.base_offset[0], map.offset[0]}) {
    add_u32(out, static_cast<std::uint32_t>(
                     static_cast<std::int32_t>(std::lround(double{v} * kDenominator))));
    add_u32(out, static_cast<std::size_t>(kDenominator));
  }
  return out;
}

std::string xmp_metadata(const GainMap& map) {
  return fmt::format(
      "{} hdrgm:GainMapMin=\"{:.6f}\" hdrgm:GainMapMax=\"{:.6f}\" hdrgm:Gamma=\"{:.6f}\" "
      "hdrgm:OffsetSDR=\"{:.8f}\" hdrgm:OffsetHDR=\"{:.8f}\" hdrgm:HDRCapacityMin=\"0\" "
      "hdrgm:HDRCapacityMax=\"{:.6f}\" hdrgm:BaseRenditionIsHDR=\"False\"/>{}",
      kRdf, map.min_log2[0], map.max_log2[0], map.gamma[0], map.base_offset[0], map.offset[0],
      std::max(map.max_log2[0], .01f), kRdfEnd);
}

// Of the base, with where the gain map is.
std::string xmp_of_base(std::size_t gains_size, float exposure) {
  return fmt::format(
      R"({} xmlns:penumbra="{}" penumbra:Exposure="{:.9g}" xmlns:Container="http://ns.google.com/photos/1.0/container/" xmlns:Item="http://ns.google.com/photos/1.0/container/item/"><Container:Directory><rdf:Seq><rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="Primary" Item:Mime="image/jpeg"/></rdf:li><rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="GainMap" Item:Mime="image/jpeg" Item:Length="{}"/></rdf:li></rdf:Seq></Container:Directory></rdf:Description>{})",
      kRdf, kExposureSpace, exposure, gains_size, kRdfEnd);
}

// The factor that leaves as much of the picture above the base as below it.
float exposure_between(const Image<Rgb>& radiance, const Image<Rgb>& base) {
  std::vector<double> ratios;
  for (std::size_t i = 0; i < radiance.area(); ++i) {
    const float lit = luminance(radiance.pixels()[i]), shown = luminance(base.pixels()[i]);
    if (lit > 0 && shown > 0) ratios.push_back(double{shown} / lit);
  }
  if (ratios.empty()) return 1;
  const auto middle = static_cast<float>(median(ratios));
  return std::isnormal(middle) && std::isnormal(1 / middle) ? middle : 1;
}

Image<Rgb> linear_of(const Image<Rgb8>& picture) {
  const std::array<float, 256> linear = linear_codes();
  Image<Rgb> out(picture.width(), picture.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const Rgb8& c = picture.pixels()[i];
    out.pixels()[i] = {linear[c.r], linear[c.g], linear[c.b]};
  }
  return out;
}

struct CodedGains {
  GainMap map;
  float exposure;
  Image<Rgb8> codes;
};

// What lies below all but a thousandth of the values.
float low_end(const Image<Rgb>& values) {
  std::vector<float> all;
  all.reserve(3 * values.area());
  for (const Rgb& v : values.pixels()) all.insert(all.end(), {v.r, v.g, v.b});
  const auto end = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 1000);
  std::ranges::nth_element(all, end);
  return *end;
}

// A threshold of rounding that is even over any few pixels: where many have one value, as a lamp's
// do, their light would else be off by half a step.
// source: Roberts 2018, the R2 sequence
float threshold(int x, int y, int channel) {
  const double v = x * .7548776662466927 + y * .5698402909980532 + channel * .6180339887498949;
  return static_cast<float>(v - std::floor(v));
}

// A gain below the map's low end, and the light with its offset before and after it.
struct CutGain {
  float gain, base, lit;
  std::size_t channel;
};

// Lower, where the light that cut gains leave standing would be seen in a channel's sum: ringing of
// the base around a lamp on black is more light than the lamp has in its weakest channel.
float low_end_for_light(const std::vector<CutGain>& cut, const std::array<double, 3>& light,
                        float low) {
  constexpr double kMaxAdded = .003;  // of a channel's light
  constexpr float kStep = .25f;       // stops
  if (cut.empty()) return low;
  const float lowest = std::ranges::min_element(cut, {}, &CutGain::gain)->gain;
  for (;; low = std::max(low - kStep, lowest)) {
    std::array<double, 3> added{};
    for (const CutGain& g : cut)
      if (g.gain < low) added[g.channel] += double{g.base} * std::exp2(double{low}) - double{g.lit};
    bool small = true;
    for (std::size_t c = 0; c < 3; ++c) small &= added[c] <= kMaxAdded * light[c];
    if (small || low <= lowest) return low;
  }
}

CodedGains gains_between(const Image<Rgb>& base, const Image<Rgb>& radiance) {
  CodedGains out{{}, exposure_between(radiance, base), Image<Rgb8>(base.width(), base.height())};
  Image<Rgb> log2(base.width(), base.height());
  float high = -1e30f;
  std::array<double, 3> light{};
  const auto lit_at = [&](std::size_t i, int c) {
    return std::clamp(radiance.pixels()[i][c], 0.f, kBrightest / out.exposure) * out.exposure;
  };
  for (std::size_t i = 0; i < base.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const float lit = lit_at(i, c);
      const float gain =
          std::log2((lit + kSmallestOffset) / (base.pixels()[i][c] + kSmallestOffset));
      light[static_cast<std::size_t>(c)] += double{lit};
      log2.pixels()[i][c] = gain;
      high = std::max(high, gain);
    }
  const float most_of_all = low_end(log2);
  std::vector<CutGain> cut;
  for (std::size_t i = 0; i < base.area(); ++i)
    for (int c = 0; c < 3; ++c)
      if (log2.pixels()[i][c] < most_of_all)
        cut.push_back({log2.pixels()[i][c], base.pixels()[i][c] + kSmallestOffset,
                       lit_at(i, c) + kSmallestOffset, static_cast<std::size_t>(c)});
  const float low = std::min(low_end_for_light(cut, light, most_of_all), high - .01f);
  out.map.min_log2.fill(low), out.map.max_log2.fill(high);
  out.map.base_offset.fill(kSmallestOffset), out.map.offset.fill(kSmallestOffset);
  for (int y = 0; y < base.height(); ++y)
    for (int x = 0; x < base.width(); ++x) {
      const auto code = [&](int channel, float gain) {
        const float exact = 255 * std::max(gain - low, 0.f) / (high - low);
        return static_cast<std::uint8_t>(std::min(exact + threshold(x, y, channel), 255.f));
      };
      const Rgb& g = log2.at(x, y);
      out.codes.at(x, y) = {code(0, g.r), code(1, g.g), code(2, g.b)};
    }
  return out;
}

// A JPEG with more segments after its start.
JpegBytes with_segments(const JpegBytes& jpeg, const JpegBytes& segments) {
  JpegBytes out(jpeg.begin(), jpeg.begin() + 2);
  out.insert(out.end(), segments.begin(), segments.end());
  out.insert(out.end(), jpeg.begin() + 2, jpeg.end());
  return out;
}

}  // namespace

Result<JpegBytes> encode_gain_map_jpeg(const Image<Rgb>& radiance, const Image<Rgb8>& base,
                                       int quality) {
  if (radiance.empty()) return fail(ErrorCode::kInvalid, "picture", "is empty");
  if (!base.same_size(radiance))
    return fail(ErrorCode::kInvalid, "base", "has another size than the radiance");
  for (int y = 0; y < radiance.height(); ++y)
    for (int x = 0; x < radiance.width(); ++x)
      if (!is_finite(radiance.at(x, y)))
        return fail(ErrorCode::kNonFinite, "picture",
                    fmt::format("is not finite at pixel {}, {}", x, y));
  PENUMBRA_ASSIGN(base_jpeg, encode_jpeg(base, quality));
  PENUMBRA_ASSIGN(shown, decode_frame(base_jpeg, "base"));
  const CodedGains gains = gains_between(linear_of(std::get<Image<Rgb8>>(shown)), radiance);
  // At the colours' full resolution: gains of a small sun are in it.
  PENUMBRA_ASSIGN(gains_jpeg,
                  encode_jpeg(gains.codes, kGainQuality, JpegColours::kFull, "gain map"));
  JpegBytes head;
  add_segment(head, 0xe1, kXmpHead, xmp_metadata(gains.map));
  add_segment(head, 0xe2, kIsoHead, iso_metadata(gains.map));
  const JpegBytes second = with_segments(gains_jpeg, head);
  head.clear();
  add_segment(head, 0xe1, kXmpHead, xmp_of_base(second.size(), gains.exposure));
  add_segment(head, 0xe2, kIsoHead, std::string(4, '\0'));  // its versions alone
  const std::size_t index_at = 2 + head.size() + 8;         // its byte order mark
  const std::size_t first_size = base_jpeg.size() + head.size() + 8 + kIndexSize;
  add_segment(head, 0xe2, kPicturesHead,
              picture_index(first_size, first_size - index_at, second.size()));
  JpegBytes first = with_segments(base_jpeg, head);
  first.insert(first.end(), second.begin(), second.end());
  return first;
}

}  // namespace penumbra::codec
