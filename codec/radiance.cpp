// Radiance pictures (RGBE and XYZE), after "The Radiance picture file format" (G. Ward,
// filefmts.pdf) and "Real Pixels" (Graphics Gems II).
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <string_view>
#include <vector>

#include "codec/codec.h"
#include "codec/internal/colour.h"
#include "codec/internal/formats.h"

namespace penumbra::codec {
namespace {

using Rgbe = std::array<unsigned char, 4>;

constexpr std::size_t kMagicWithin = 4096;
// Narrower and wider scan lines cannot be told from flat pixels, so the format keeps them flat.
constexpr int kMinRunWidth = 8, kMaxRunWidth = 32767;
constexpr glm::dmat3 kIdentity(1);

struct Header {
  bool xyz = false;
  // Product of all EXPOSURE and COLORCORR lines: what the stored numbers were multiplied by.
  std::array<double, 3> multiplier{1, 1, 1};
  std::optional<Chromaticities> primaries;
  int scanlines = 0, length = 0;  // length: pixels along one scan line
  bool columns = false;           // scan lines run along y
  bool x_reversed = false;        // -X: from right to left
  bool y_up = false;              // +Y: from bottom to top
};

// Everything is read through here, so that no read goes past the end.
class Cursor {
 public:
  Cursor(Bytes bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  std::size_t position() const { return position_; }
  void seek(std::size_t position) { position_ = position; }
  bool has(std::size_t count) const { return bytes_.size() - position_ >= count; }
  const unsigned char* peek() const { return bytes_.data() + position_; }
  void skip(std::size_t count) { position_ += count; }

  // Without the line's end; nothing when the bytes stop before one.
  std::optional<std::string_view> line() {
    const std::string_view rest(reinterpret_cast<const char*>(peek()), bytes_.size() - position_);
    const auto end = rest.find('\n');
    if (end == std::string_view::npos) return std::nullopt;
    position_ += end + 1;
    std::string_view text = rest.substr(0, end);
    if (text.ends_with('\r')) text.remove_suffix(1);
    return text;
  }

  std::unexpected<Error> truncated(const std::string& what) const {
    return fail(ErrorCode::kUnreadable, name_,
                "is truncated: its " + std::to_string(bytes_.size()) + " bytes end inside " + what +
                    " (which begins at byte " + std::to_string(position_) + ")");
  }
  std::unexpected<Error> damaged(const std::string& what) const {
    return fail(ErrorCode::kUnreadable, name_, what + " at byte " + std::to_string(position_));
  }

 private:
  Bytes bytes_;
  const std::string& name_;
  std::size_t position_ = 0;
};

std::optional<std::size_t> find_magic(Bytes bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()),
                              std::min(bytes.size(), kMagicWithin));
  for (std::size_t at = 0; (at = text.find("#?", at)) != std::string_view::npos; ++at) {
    const bool line_start = at == 0 || text[at - 1] == '\n';
    const bool named =
        at + 2 < text.size() && std::isalpha(static_cast<unsigned char>(text[at + 2]));
    if (line_start && named) return at;
  }
  return std::nullopt;
}

std::string_view trimmed(std::string_view text) {
  const auto first = text.find_first_not_of(" \t");
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

// The next blank-separated word, taken off the front of `text`.
std::string_view next_word(std::string_view& text) {
  text = trimmed(text);
  const auto word = text.substr(0, text.find_first_of(" \t"));
  text.remove_prefix(word.size());
  return word;
}

template <std::size_t N>
std::optional<std::array<double, N>> numbers(std::string_view text) {
  std::array<double, N> out{};
  for (double& value : out) {
    auto word = next_word(text);
    if (word.starts_with('+')) word.remove_prefix(1);  // from_chars refuses it
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size() || !std::isfinite(value))
      return std::nullopt;
  }
  return out;
}

Result<void> multiply(Header& header, const std::optional<std::array<double, 3>>& factors,
                      const Cursor& cursor) {
  for (std::size_t c = 0; c < 3; ++c) {
    const double product = factors ? header.multiplier[c] * (*factors)[c] : 0;
    if (!(product > 0) || !std::isfinite(product))
      return cursor.damaged("EXPOSURE or COLORCORR is not a positive number");
    header.multiplier[c] = product;
  }
  return {};
}

// Unknown lines are comments or the commands that made the picture. A line that starts with a blank
// belongs to a picture that went into this one, and must not be applied.
Result<void> parse_line(std::string_view line, Header& header, const Cursor& cursor) {
  const auto value = [&](std::string_view key) -> std::optional<std::string_view> {
    if (!line.starts_with(key)) return std::nullopt;
    return trimmed(line.substr(key.size()));
  };
  if (const auto format = value("FORMAT=")) {
    if (*format != "32-bit_rle_rgbe" && *format != "32-bit_rle_xyze")
      return cursor.damaged("FORMAT is not a known one");
    header.xyz = *format == "32-bit_rle_xyze";
  } else if (const auto exposure = value("EXPOSURE=")) {
    const auto one = numbers<1>(*exposure);
    std::optional<std::array<double, 3>> all;
    if (one) all = {(*one)[0], (*one)[0], (*one)[0]};
    return multiply(header, all, cursor);
  } else if (const auto correction = value("COLORCORR=")) {
    return multiply(header, numbers<3>(*correction), cursor);
  } else if (const auto primaries = value("PRIMARIES=")) {
    const auto xy = numbers<8>(*primaries);
    if (!xy) return cursor.damaged("PRIMARIES are not eight numbers");
    // Photoshop writes eight zeros for "not known".
    if (std::ranges::any_of(*xy, [](double v) { return v != 0; })) header.primaries = *xy;
  }
  return {};
}

struct Axis {
  char name = 0;
  bool negative = false;
  std::int64_t count = 0;
};

std::optional<Axis> parse_axis(std::string_view& line) {
  const auto direction = next_word(line);
  const auto count = next_word(line);
  if (direction.size() != 2 || (direction[0] != '+' && direction[0] != '-')) return std::nullopt;
  if (direction[1] != 'X' && direction[1] != 'Y') return std::nullopt;
  Axis axis{direction[1], direction[0] == '-', 0};
  const auto [end, error] = std::from_chars(count.data(), count.data() + count.size(), axis.count);
  if (end != count.data() + count.size() || count.empty()) return std::nullopt;
  // More digits than the type holds: still a size, and too large.
  if (error == std::errc::result_out_of_range)
    axis.count = std::int64_t{1} << 31;
  else if (error != std::errc{})
    return std::nullopt;
  axis.count = std::min(axis.count, std::int64_t{1} << 31);
  return axis;
}

Result<void> parse_resolution(Cursor& cursor, Header& header, const std::string& name) {
  const std::size_t start = cursor.position();
  auto line = cursor.line();
  if (!line) return cursor.truncated("the resolution line");
  const auto slow = parse_axis(*line);
  const auto fast = slow ? parse_axis(*line) : std::nullopt;
  if (!fast || slow->name == fast->name || !trimmed(*line).empty()) {
    cursor.seek(start);
    return cursor.damaged("the resolution line, such as -Y 512 +X 1024, is missing");
  }
  header.columns = slow->name == 'X';
  const Axis& x = header.columns ? *slow : *fast;
  const Axis& y = header.columns ? *fast : *slow;
  PENUMBRA_TRY(check_size(x.count, y.count, name));
  header.x_reversed = x.negative;
  header.y_up = !y.negative;
  header.scanlines = static_cast<int>(slow->count);
  header.length = static_cast<int>(fast->count);
  return {};
}

Result<Header> parse_header(Cursor& cursor, const std::string& name) {
  Header header;
  for (;;) {
    const auto line = cursor.line();
    if (!line) return cursor.truncated("the header");
    if (line->empty()) break;
    PENUMBRA_TRY(parse_line(*line, header, cursor));
  }
  PENUMBRA_TRY(parse_resolution(cursor, header, name));
  return header;
}

// Four planes, each as runs (count + 128, value) and literals (count, values).
Result<void> read_planes(Cursor& cursor, std::span<Rgbe> scanline) {
  for (std::size_t plane = 0; plane < 4; ++plane) {
    for (std::size_t x = 0; x < scanline.size();) {
      if (!cursor.has(2)) return cursor.truncated("a scan line");
      const unsigned code = cursor.peek()[0];
      const bool run = code > 128;
      const std::size_t count = run ? code - 128 : code;
      if (count == 0 || count > scanline.size() - x)
        return cursor.damaged("a run is longer than its scan line");
      if (!cursor.has(run ? 2 : 1 + count)) return cursor.truncated("a scan line");
      const unsigned char* values = cursor.peek() + 1;
      for (std::size_t i = 0; i < count; ++i) scanline[x++][plane] = values[run ? 0 : i];
      cursor.skip(run ? 2 : 1 + count);
    }
  }
  return {};
}

// Flat pixels, where (1, 1, 1, n) repeats the pixel before it; several in a row are the bytes of
// one count, lowest first.
Result<void> read_old_runs(Cursor& cursor, std::span<Rgbe> scanline) {
  unsigned shift = 0;
  for (std::size_t x = 0; x < scanline.size();) {
    if (!cursor.has(4)) return cursor.truncated("a scan line");
    Rgbe pixel;
    std::memcpy(pixel.data(), cursor.peek(), 4);
    if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1) {
      if (x == 0) return cursor.damaged("a run repeats a pixel before the first one");
      if (shift > 16) return cursor.damaged("a run is longer than its scan line");
      const std::size_t count = std::size_t{pixel[3]} << shift;
      if (count > scanline.size() - x) return cursor.damaged("a run is longer than its scan line");
      std::fill_n(scanline.begin() + static_cast<std::ptrdiff_t>(x), count, scanline[x - 1]);
      x += count;
      shift += 8;
    } else {
      scanline[x++] = pixel;
      shift = 0;
    }
    cursor.skip(4);
  }
  return {};
}

Result<void> read_scanline(Cursor& cursor, std::span<Rgbe> scanline) {
  if (!cursor.has(4)) return cursor.truncated("a scan line");
  const unsigned char* p = cursor.peek();
  const bool planes = std::ssize(scanline) >= kMinRunWidth &&
                      std::ssize(scanline) <= kMaxRunWidth && p[0] == 2 && p[1] == 2 && p[2] < 128;
  if (!planes) return read_old_runs(cursor, scanline);
  if ((std::size_t{p[2]} << 8 | p[3]) != scanline.size())
    return cursor.damaged("a scan line has another width than the picture");
  cursor.skip(4);
  return read_planes(cursor, scanline);
}

// Mantissa m and exponent e mean m 2^(e-136), as in rgbe.c, OpenCV, stb and OpenImageIO. Radiance's
// own programs put the value in the middle of its step (m + .5); at m = 0 that would lift every
// pure colour.
Image<Rgb> to_image(const std::vector<Rgbe>& codes, const Header& header) {
  std::array<std::array<double, 256>, 3> scale{};
  for (std::size_t c = 0; c < 3; ++c)
    for (int e = 1; e < 256; ++e)
      scale[c][static_cast<std::size_t>(e)] = std::ldexp(1., e - 136) / header.multiplier[c];

  Image<Rgb> image(header.columns ? header.scanlines : header.length,
                   header.columns ? header.length : header.scanlines);
  std::size_t next = 0;
  for (int scanline = 0; scanline < header.scanlines; ++scanline) {
    for (int i = 0; i < header.length; ++i) {
      const Rgbe& code = codes[next++];
      const int x = header.columns ? scanline : i;
      const int y = header.columns ? i : scanline;
      Rgb& pixel = image.at(header.x_reversed ? image.width() - 1 - x : x,
                            header.y_up ? image.height() - 1 - y : y);
      for (std::size_t c = 0; c < 3; ++c)
        pixel[static_cast<int>(c)] = static_cast<float>(code[c] * scale[c][code[3]]);
    }
  }
  return image;
}

// Pictures without PRIMARIES are taken as Rec.709, whatever their writer meant: Radiance's own
// default differs only slightly, and nearly every .hdr in use comes from programs that mean
// Rec.709.
std::optional<glm::dmat3> conversion(const Header& header) {
  if (header.xyz) return glm::inverse(*xyz_from_rgb(kRec709));
  if (!header.primaries || is_rec709(*header.primaries)) return kIdentity;
  return rec709_from(*header.primaries);
}

constexpr float kLargestRgbe = 255 * 0x1p119f;

Rgbe to_rgbe(const Rgb& colour) {
  // Written so that NaN, like a negative value, becomes 0; infinity becomes the largest code.
  const auto storable = [](float v) { return v > 0 ? std::min(v, kLargestRgbe) : 0.f; };
  const std::array<float, 3> c{storable(colour.r), storable(colour.g), storable(colour.b)};
  const float largest = std::max({c[0], c[1], c[2]});
  int exponent = 0;
  std::frexp(largest, &exponent);
  // Rounding may carry into the next power of two.
  if (std::lround(std::ldexp(largest, 8 - exponent)) > 255) ++exponent;
  if (largest == 0 || exponent < -127) return {};
  Rgbe code{};
  for (std::size_t i = 0; i < 3; ++i)
    code[i] = static_cast<unsigned char>(std::lround(std::ldexp(c[i], 8 - exponent)));
  code[3] = static_cast<unsigned char>(exponent + 128);
  return code;
}

std::size_t run_at(std::span<const unsigned char> plane, std::size_t x) {
  std::size_t count = 1;
  while (count < 127 && x + count < plane.size() && plane[x + count] == plane[x]) ++count;
  return count;
}

void append_plane(std::span<const unsigned char> plane, std::string& out) {
  constexpr std::size_t kWorthARun = 4;
  for (std::size_t x = 0; x < plane.size();) {
    if (const std::size_t run = run_at(plane, x); run >= kWorthARun) {
      out += static_cast<char>(128 + run);
      out += static_cast<char>(plane[x]);
      x += run;
      continue;
    }
    const std::size_t start = x;
    while (x < plane.size() && x - start < 128 && run_at(plane, x) < kWorthARun) ++x;
    out += static_cast<char>(x - start);
    out.append(reinterpret_cast<const char*>(&plane[start]), x - start);
  }
}

}  // namespace

bool is_radiance(Bytes bytes) {
  return find_magic(bytes).has_value();
}

Result<HdrImage> decode_radiance(std::span<const unsigned char> bytes, const std::string& name) {
  const auto magic = find_magic(bytes);
  if (!magic)
    return fail(ErrorCode::kUnreadable, name,
                "is not a Radiance HDR picture: its first line does not begin with #?");
  Cursor cursor(bytes, name);
  cursor.seek(*magic);
  PENUMBRA_ASSIGN(header, parse_header(cursor, name));
  const auto matrix = conversion(header);
  if (!matrix) return cursor.damaged("PRIMARIES lie on one line");

  // Grows with what the file really holds, so that a short file cannot ask for the memory of a
  // large one.
  std::vector<Rgbe> codes;
  const auto length = static_cast<std::size_t>(header.length);
  for (int scanline = 0; scanline < header.scanlines; ++scanline) {
    if (!cursor.has(4)) return cursor.truncated("the scan lines");
    codes.resize(codes.size() + length);
    PENUMBRA_TRY(read_scanline(cursor, std::span(codes).last(length)));
  }
  HdrImage out{to_image(codes, header), 0, std::nullopt};
  if (*matrix != kIdentity) apply(*matrix, out.pixels.pixels());
  out.non_finite = count_non_finite(out.pixels.pixels());
  return out;
}

std::string encode_radiance(const Image<Rgb>& pixels) {
  const int width = pixels.width();
  std::string out = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y " + std::to_string(pixels.height()) +
                    " +X " + std::to_string(width) + "\n";
  std::array<std::vector<unsigned char>, 4> planes;
  for (int y = 0; y < pixels.height(); ++y) {
    for (auto& plane : planes) plane.clear();
    for (const Rgb& pixel : pixels.row(y)) {
      const Rgbe code = to_rgbe(pixel);
      for (std::size_t c = 0; c < 4; ++c) planes[c].push_back(code[c]);
    }
    if (width >= kMinRunWidth && width <= kMaxRunWidth) {
      out += {2, 2, static_cast<char>(width >> 8), static_cast<char>(width & 255)};
      for (const auto& plane : planes) append_plane(plane, out);
    } else {
      for (std::size_t x = 0; x < planes[0].size(); ++x)
        for (const auto& plane : planes) out += static_cast<char>(plane[x]);
    }
  }
  return out;
}

}  // namespace penumbra::codec
