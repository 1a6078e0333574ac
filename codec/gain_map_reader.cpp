// Gain maps of any maker: Adobe's XMP or ISO 21496-1, one channel or three, of the base's size or
// smaller.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <glm/common.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "codec/codec.h"
#include "codec/gain_map_jpeg.h"
#include "codec/internal/frame_header.h"
#include "codec/internal/gain_map.h"
#include "codec/internal/icc_profile.h"
#include "core/io/files.h"
#include "core/io/log.h"

namespace penumbra::codec {

namespace {

constexpr std::string_view kIccHead{"ICC_PROFILE\0", 12};

struct Segment {
  std::uint32_t marker;
  Bytes data;  // after the length
  bool starts_with(std::string_view text) const {
    return data.size() >= text.size() && std::equal(text.begin(), text.end(), data.begin());
  }
  Bytes after(std::string_view head) const { return data.subspan(head.size()); }
};

// The segments before the picture's data; all that can be read of them.
std::vector<Segment> segments_of(Bytes jpeg) {
  constexpr std::size_t kMax = 1000;  // an ICC profile or an XMP that goes on takes some dozens
  std::vector<Segment> out;
  detail::Numbers in{jpeg};
  for (std::size_t at = 2;;) {
    while (in.at(at, 1) == 0xff) ++at;
    const std::uint32_t marker = in.at(at, 1);
    if (!in.ok || at < 3 || marker == 0xda || marker == 0xd9 || out.size() == kMax) return out;
    const std::size_t length = in.at(++at, 2);
    if (!in.ok || length < 2 || jpeg.size() - at < length) return out;
    out.push_back({marker, jpeg.subspan(at + 2, length - 2)});
    at += length;
  }
}

std::string_view xmp_of(const std::vector<Segment>& segments) {
  for (const Segment& s : segments)
    if (s.marker == 0xe1 && s.starts_with(kXmpHead)) {
      const Bytes text = s.after(kXmpHead);
      return {reinterpret_cast<const char*>(text.data()), text.size()};
    }
  return {};
}

std::optional<float> number(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t\r\n+");
  if (first == std::string_view::npos) return {};
  text.remove_prefix(first);
  float value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || !std::isfinite(value)) return {};
  return value;
}

// What XMP says under a name: name="value", or an element with the text or a list of three.
std::vector<std::string_view> xmp_values(std::string_view xmp, std::string_view name) {
  const std::size_t at = xmp.find(name);
  if (at == std::string_view::npos) return {};
  const auto trimmed = [](std::string_view text) {
    return text.substr(std::min(text.find_first_not_of(" \t\r\n"), text.size()));
  };
  std::string_view rest = trimmed(xmp.substr(at + name.size()));
  if (rest.starts_with('=')) {
    rest = trimmed(rest.substr(1));
    if (!rest.starts_with('"') && !rest.starts_with('\'')) return {};
    const std::string_view value = rest.substr(1);
    return {value.substr(0, value.find(rest[0]))};
  }
  if (!rest.starts_with(">")) return {};
  rest.remove_prefix(1);
  rest = rest.substr(0, rest.find(std::string("</") + std::string(name)));
  constexpr std::string_view kItem = "<rdf:li";  // attributes, such as a language, may follow
  if (rest.find(kItem) == std::string_view::npos) return {rest};
  std::vector<std::string_view> out;
  for (std::size_t item = rest.find(kItem); item != std::string_view::npos && out.size() < 3;
       item = rest.find(kItem, item + 1)) {
    const std::string_view tag = rest.substr(item),
                           text = tag.substr(std::min(tag.find('>'), tag.size() - 1) + 1);
    out.push_back(text.substr(0, text.find('<')));
  }
  return out;
}

std::optional<std::array<float, 3>> xmp_numbers(std::string_view xmp, std::string_view name) {
  const std::vector<std::string_view> texts = xmp_values(xmp, name);
  if (texts.empty()) return {};
  std::array<float, 3> out{};
  for (std::size_t c = 0; c < 3; ++c) {
    const auto value = number(texts[texts.size() == 3 ? c : 0]);
    if (!value) return {};
    out[c] = *value;
  }
  return out;
}

std::optional<GainMap> from_xmp(std::string_view xmp) {
  const auto max_log2 = xmp_numbers(xmp, "hdrgm:GainMapMax");
  if (!max_log2) return {};  // the one value that has no default
  GainMap out;
  out.max_log2 = *max_log2;
  const auto read = [&](std::string_view name, std::array<float, 3>& to) {
    to = xmp_numbers(xmp, name).value_or(to);
  };
  read("hdrgm:GainMapMin", out.min_log2);
  read("hdrgm:Gamma", out.gamma);
  read("hdrgm:OffsetSDR", out.base_offset);
  read("hdrgm:OffsetHDR", out.offset);
  const auto base = xmp_values(xmp, "hdrgm:BaseRenditionIsHDR");
  out.base_is_hdr = !base.empty() && base[0] == "True";
  return out;
}

// A numerator and a denominator, of which the former may be negative.
struct Fractions {
  detail::Numbers in;
  std::size_t at;
  std::optional<std::uint32_t> common{};
  float next(bool is_signed = true) {
    const std::uint32_t bits = in.at(at, 4);
    const double numerator = is_signed ? static_cast<std::int32_t>(bits) : double(bits);
    at += 4;
    std::uint32_t denominator = common.value_or(0);
    if (!common) denominator = in.at(at, 4), at += 4;
    in.ok = in.ok && denominator != 0;
    return denominator ? static_cast<float>(numerator / denominator) : 0;
  }
};

std::optional<GainMap> from_iso(Bytes data) {
  // The last two are of the drafts; some programs still write them.
  constexpr std::uint32_t kChannels = 0x80, kBasePrimaries = 0x40, kBackward = 0x04,
                          kCommonDenominator = 0x08;
  detail::Numbers in{data};
  if (in.at(0, 2) != 0) return {};  // of a version that none of ours reads
  const std::uint32_t flags = in.at(4, 1);
  Fractions read{in, 5};
  if (flags & kCommonDenominator) read.common = in.at(5, 4), read.at = 9;
  const float of_base = read.next(false), of_other = read.next(false);  // headroom, stops
  GainMap out;
  out.base_is_hdr = (flags & kBackward) || of_base > of_other;
  out.in_base_primaries = (flags & kBasePrimaries) != 0;
  const std::size_t channels = flags & kChannels ? 3 : 1;
  const std::array<std::array<float, 3>*, 5> all{&out.min_log2, &out.max_log2, &out.gamma,
                                                 &out.base_offset, &out.offset};
  for (std::size_t c = 0; c < channels; ++c)
    for (auto* const of : all) (*of)[c] = read.next(of != &out.gamma);
  if (channels == 1)
    for (auto* const of : all) of->fill((*of)[0]);
  if (!read.in.ok) return {};
  return out;
}

bool is_plausible(const GainMap& map) {
  for (std::size_t c = 0; c < 3; ++c)
    if (!(map.gamma[c] > 0) || map.max_log2[c] < map.min_log2[c] ||
        std::abs(map.min_log2[c]) > 64 || std::abs(map.max_log2[c]) > 64)
      return false;
  return true;
}

std::optional<GainMap> metadata_of(Bytes jpeg) {
  const std::vector<Segment> segments = segments_of(jpeg);
  for (const Segment& s : segments)
    if (s.marker == 0xe2 && s.starts_with(kIsoHead))
      if (auto map = from_iso(s.after(kIsoHead)); map && is_plausible(*map)) return map;
  auto map = from_xmp(xmp_of(segments));
  return map && is_plausible(*map) ? map : std::nullopt;
}

// Where the pictures after the first begin, by the index of pictures.
std::vector<Bytes> indexed_pictures(Bytes file, const Segment& segment) {
  constexpr std::size_t kMax = 16;
  const Bytes index = segment.after(kPicturesHead);
  const auto start = static_cast<std::size_t>(index.data() - file.data());
  detail::Numbers in{index, !index.empty() && index[0] == 'M'};
  const std::size_t directory = in.at(4, 4), tags = in.at(directory, 2);
  std::size_t entry = directory + 2;
  for (std::size_t i = 0; i < tags && in.ok && in.at(entry, 2) != 0xb002; ++i) entry += 12;
  const std::size_t count = in.at(entry + 4, 4) / 16, list = in.at(entry + 8, 4);
  std::vector<Bytes> out;
  for (std::size_t k = 1; in.ok && in.at(entry, 2) == 0xb002 && k < std::min(count, kMax); ++k) {
    const std::size_t size = in.at(list + 16 * k + 4, 4), offset = in.at(list + 16 * k + 8, 4),
                      at = start + offset;
    if (in.ok && offset > 0 && at < file.size() && size <= file.size() - at)
      out.push_back(file.subspan(at, size));
  }
  return out;
}

// What follows the first picture in a file; nothing where that does not end.
std::optional<Bytes> behind_first(Bytes file) {
  detail::Numbers in{file};
  for (std::size_t at = 2; in.ok;) {
    while (in.at(at, 1) == 0xff) ++at;
    const std::uint32_t marker = in.at(at, 1);
    if (!in.ok) break;
    if (marker == 0xd9) return file.subspan(at + 1);
    at += 1 + in.at(at + 1, 2);
    if (marker != 0xda) continue;
    // Coded data: 0xff is followed by 0 or by a restart marker there.
    for (;; ++at) {
      if (at + 1 >= file.size()) return {};
      if (file[at] != 0xff || file[at + 1] == 0 || file[at + 1] == 0xff) continue;
      if (file[at + 1] < 0xd0 || file[at + 1] > 0xd7) break;
    }
  }
  return {};
}

// The picture of the length that the XMP of the first one tells: the last one, or where other bytes
// come behind it, the one behind the first.
std::optional<Bytes> told_picture(Bytes file, std::string_view xmp) {
  const std::size_t map = xmp.find("Item:Semantic=\"GainMap\"");
  if (map == std::string_view::npos) return {};
  // Whichever of the item's attributes comes first.
  const std::size_t item = std::min(xmp.rfind('<', map), map);
  const auto told = xmp_values(xmp.substr(item, xmp.find('>', map) - item), "Item:Length");
  std::size_t size = 0;
  if (told.empty() ||
      std::from_chars(told[0].data(), told[0].data() + told[0].size(), size).ec != std::errc() ||
      size == 0 || size >= file.size())
    return {};
  if (is_jpeg(file.last(size))) return file.last(size);
  const auto rest = behind_first(file);
  return rest && rest->size() >= size ? std::optional(rest->first(size)) : std::nullopt;
}

std::vector<Bytes> further_pictures(Bytes file, const std::vector<Segment>& segments) {
  for (const Segment& s : segments)
    if (s.marker == 0xe2 && s.starts_with(kPicturesHead))
      if (auto found = indexed_pictures(file, s); !found.empty()) return found;
  const auto told = told_picture(file, xmp_of(segments));
  return told ? std::vector{*told} : std::vector<Bytes>();
}

struct FoundGainMap {
  Bytes picture;
  GainMap map;
};
std::optional<FoundGainMap> find_gain_map(Bytes file, const std::vector<Segment>& segments) {
  for (const Bytes& picture : further_pictures(file, segments))
    if (const auto map = is_jpeg(picture) ? metadata_of(picture) : std::nullopt)
      return FoundGainMap{picture, *map};
  return {};
}

// Of sRGB: IEC 61966-2-1 adapted to D50 by Bradford's matrix.
const glm::dmat3 kRec709D50{.4360747, .2225045, .0139322, .3850649, .7168786,
                            .0971045, .1430804, .0606169, .7141733};

// All of it: a long one goes on in further segments, by their numbers. Empty without one.
std::vector<unsigned char> icc_of(const std::vector<Segment>& segments) {
  std::vector<Bytes> parts;
  for (const Segment& s : segments)
    if (s.marker == 0xe2 && s.starts_with(kIccHead) && s.data.size() >= kIccHead.size() + 2)
      parts.push_back(s.after(kIccHead));
  std::ranges::stable_sort(parts, {}, [](const Bytes& part) { return part[0]; });
  std::vector<unsigned char> out;
  for (const Bytes& part : parts) out.insert(out.end(), part.begin() + 2, part.end());
  return out;
}

// Of a picture without a profile, or with one of tables alone: sRGB.
IccProfile profile_or_srgb(const std::vector<Segment>& segments, const std::string& name) {
  const IccProfile srgb{kRec709D50, {linear_codes(), linear_codes(), linear_codes()}};
  const std::vector<unsigned char> icc = icc_of(segments);
  if (icc.empty()) return srgb;
  const auto profile = parse_icc_profile(icc);
  if (!profile) log_warning("{}: {}: taken for sRGB", name, profile.error().detail);
  return profile.value_or(srgb);
}
// The same where profiles round.
bool are_same(const glm::dmat3& a, const glm::dmat3& b) {
  double apart = 0;
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) apart = std::max(apart, std::abs(a[i][k] - b[i][k]));
  return apart < .003;
}

// Nothing where they are Rec.709's.
std::optional<glm::mat3> to_rec709(const glm::dmat3& primaries) {
  if (are_same(primaries, kRec709D50)) return {};
  return glm::mat3(glm::inverse(kRec709D50) * primaries);
}

// Between the four nearest pixels of a map that may be smaller than the base.
class ScaledCodes {
 public:
  ScaledCodes(const Image<Rgb8>& codes, int width, int height)
      : codes_(codes),
        per_x_(static_cast<float>(codes.width()) / static_cast<float>(width)),
        per_y_(static_cast<float>(codes.height()) / static_cast<float>(height)) {}
  Rgb at(int x, int y) const {
    const float u = (static_cast<float>(x) + .5f) * per_x_ - .5f,
                v = (static_cast<float>(y) + .5f) * per_y_ - .5f;
    const int i = static_cast<int>(std::floor(u)), j = static_cast<int>(std::floor(v));
    const float s = u - static_cast<float>(i), t = v - static_cast<float>(j);
    return code(i, j) * ((1 - s) * (1 - t)) + code(i + 1, j) * (s * (1 - t)) +
           code(i, j + 1) * ((1 - s) * t) + code(i + 1, j + 1) * (s * t);
  }

 private:
  Rgb code(int x, int y) const {
    const Rgb8& c =
        codes_.at(std::clamp(x, 0, codes_.width() - 1), std::clamp(y, 0, codes_.height() - 1));
    return {static_cast<float>(c.r) / 255, static_cast<float>(c.g) / 255,
            static_cast<float>(c.b) / 255};
  }
  const Image<Rgb8>& codes_;
  float per_x_, per_y_;
};

Result<Image<Rgb8>> decode_picture(Bytes jpeg, const std::string& name) {
  PENUMBRA_ASSIGN(pixels, decode_frame(jpeg, name));
  if (auto* const codes = std::get_if<Image<Rgb8>>(&pixels)) return std::move(*codes);
  return fail(ErrorCode::kUnreadable, name, "has not 8 bits");
}

}  // namespace

bool has_gain_map(std::span<const unsigned char> jpeg) {
  return is_jpeg(jpeg) && find_gain_map(jpeg, segments_of(jpeg));
}

Result<HdrImage> decode_gain_map_jpeg(std::span<const unsigned char> jpeg,
                                      const std::string& name) {
  const std::vector<Segment> segments = segments_of(jpeg);
  const auto found = is_jpeg(jpeg) ? find_gain_map(jpeg, segments) : std::nullopt;
  if (!found)
    return fail(ErrorCode::kUnreadable, name,
                "is a JPEG without a gain map, which holds no radiance");
  const GainMap& map = found->map;
  if (map.base_is_hdr)
    return fail(ErrorCode::kInvalid, name, "has a gain map from a base that is the brighter one");
  const IccProfile profile = profile_or_srgb(segments, name);
  if (!map.in_base_primaries &&
      !are_same(profile.primaries,
                profile_or_srgb(segments_of(found->picture), name + ", gain map").primaries))
    return fail(ErrorCode::kInvalid, name, "has a gain map in other primaries than its base");
  PENUMBRA_ASSIGN(base, decode_picture(jpeg, name));
  PENUMBRA_ASSIGN(codes, decode_picture(found->picture, name + ", gain map"));
  const auto exposure = xmp_numbers(xmp_of(segments), "penumbra:Exposure");
  const float scale = exposure && std::isnormal(1 / (*exposure)[0]) ? 1 / (*exposure)[0] : 1;
  const auto rec709 = to_rec709(profile.primaries);
  const auto& linear = profile.linear;
  const ScaledCodes gains(codes, base.width(), base.height());
  HdrImage out{Image<Rgb>(base.width(), base.height()), 0, {}, {}};
  for (int y = 0; y < base.height(); ++y)
    for (int x = 0; x < base.width(); ++x) {
      const Rgb code = gains.at(x, y);
      const Rgb8& shown = base.at(x, y);
      glm::vec3 lit(map.radiance(0, linear[0][shown.r], code.r),
                    map.radiance(1, linear[1][shown.g], code.g),
                    map.radiance(2, linear[2][shown.b], code.b));
      if (rec709) lit = *rec709 * lit;
      lit = glm::max(lit, glm::vec3(0)) * scale;
      out.pixels.at(x, y) = {lit.x, lit.y, lit.z};
    }
  out.non_finite = count_non_finite(out.pixels.pixels());
  return out;
}

Result<FramePixels> read_picture(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path));
  if (!has_gain_map(bytes)) return read_frame(path);
  auto hdr = decode_gain_map_jpeg(bytes, path.string());
  if (hdr) return std::move(hdr->pixels);
  log_warning("{}: its gain map is left out, which {}", path.string(), hdr.error().detail);
  return read_frame(path);
}

}  // namespace penumbra::codec
