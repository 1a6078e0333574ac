// OpenEXR through its C++ library, and the choice between the two kinds of HDR file. The library
// throws; everything is caught here. Files are read and written through memory: the library's own
// output file swallows errors when it is closed, so a full disk would pass for success.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfPartType.h>
#include <ImfRgbaFile.h>
#include <ImfStandardAttributes.h>
#include <ImfThreading.h>
#include <ImfTileDescriptionAttribute.h>

#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "codec/codec.h"
#include "codec/dct/rgbe_still.h"
#include "codec/gain_map_jpeg.h"
#include "codec/internal/colour.h"
#include "codec/internal/formats.h"
#include "codec/internal/frame_header.h"
#include "codec/log/log_jpeg2000.h"
#include "core/exceptions.h"
#include "core/io/files.h"

namespace penumbra::codec {
namespace {

constexpr std::array<unsigned char, 4> kMagic{0x76, 0x2f, 0x31, 0x01};
constexpr std::size_t kPreamble = 8;  // magic, version and flags
constexpr unsigned kMultiPartFlag = 0x1000;
constexpr std::int64_t kMaxRowBytes = std::int64_t{1} << 23;
constexpr std::uint64_t kMinTileAreaLimit = std::uint64_t{1} << 22;

class MemoryInput : public Imf::IStream {
 public:
  MemoryInput(Bytes bytes, const std::string& name) : Imf::IStream(name.c_str()), bytes_(bytes) {}

  bool read(char* to, int count) override {
    const auto wanted = static_cast<std::size_t>(std::max(count, 0));
    if (position_ > bytes_.size() || bytes_.size() - position_ < wanted)
      throw std::runtime_error("is truncated: its " + std::to_string(bytes_.size()) +
                               " bytes end inside the data that begin at byte " +
                               std::to_string(position_));
    std::memcpy(to, bytes_.data() + position_, wanted);
    position_ += wanted;
    return position_ < bytes_.size();
  }
  std::uint64_t tellg() override { return position_; }
  void seekg(std::uint64_t position) override { position_ = position; }

 private:
  Bytes bytes_;
  std::uint64_t position_ = 0;
};

class MemoryOutput : public Imf::OStream {
 public:
  explicit MemoryOutput(const std::string& name) : Imf::OStream(name.c_str()) {}

  void write(const char* from, int count) override {
    const auto size = static_cast<std::size_t>(count);
    if (bytes_.size() < position_ + size) bytes_.resize(position_ + size);
    std::memcpy(bytes_.data() + position_, from, size);
    position_ += size;
  }
  std::uint64_t tellp() override { return position_; }
  void seekp(std::uint64_t position) override { position_ = position; }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
  std::size_t position_ = 0;
};

// The library allocates what an attribute says is its size before it reads it, so a damaged size is
// refused here. Returns the offset of the damage.
std::optional<std::size_t> damaged_attribute(Bytes bytes) {
  const bool multi_part = bytes[5] & (kMultiPartFlag >> 8);
  std::size_t at = kPreamble;
  const auto skip_string = [&] {
    const auto end = std::find(bytes.begin() + static_cast<std::ptrdiff_t>(at), bytes.end(), 0);
    at = static_cast<std::size_t>(end - bytes.begin()) + 1;
    return end != bytes.end();
  };
  for (bool first_of_header = true; at < bytes.size(); first_of_header = false) {
    if (bytes[at] == 0) {
      // One zero ends a header; a further one, the list of headers of a multi-part file.
      if (!multi_part || first_of_header) return std::nullopt;
      ++at;
      if (at < bytes.size() && bytes[at] == 0) return std::nullopt;
      continue;
    }
    const std::size_t start = at;
    std::int32_t size = -1;
    if (!skip_string() || !skip_string() || bytes.size() - at < sizeof size) return start;
    std::memcpy(&size, bytes.data() + at, sizeof size);
    at += sizeof size;
    if (size < 0 || static_cast<std::size_t>(size) > bytes.size() - at) return start;
    at += static_cast<std::size_t>(size);
  }
  return bytes.size();
}

// Everything that decides how much the library will allocate.
Result<void> check_header(const Imf::Header& header, const std::string& name) {
  if (header.hasType() && Imf::isDeepData(header.type()))
    return fail(ErrorCode::kUnreadable, name, "deep pictures are not supported");
  const Imath::Box2i& window = header.dataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
  const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
  PENUMBRA_TRY(check_size(width, height, name));
  std::int64_t channels = 0;
  for (auto c = header.channels().begin(); c != header.channels().end(); ++c) ++channels;
  if (channels * width * 4 > kMaxRowBytes)
    return fail(ErrorCode::kInvalid, name, std::to_string(channels) + " channels are too many");
  if (header.hasTileDescription()) {
    const Imf::TileDescription tile = header.tileDescription();
    const auto limit = std::max(kMinTileAreaLimit, static_cast<std::uint64_t>(width * height));
    if (tile.xSize > unsigned{kMaxSide} || tile.ySize > unsigned{kMaxSide} ||
        std::uint64_t{tile.xSize} * tile.ySize > limit)
      return fail(ErrorCode::kInvalid, name, "tiles are too large");
  }
  return {};
}

// Our own: 1 where the radiance is a lower bound.
constexpr const char* kClippedChannel = "clipped";

struct ExrChannels {
  bool luminance_chroma = false;
  std::array<std::string, 3> rgb;  // three times the same for grey
};

std::optional<ExrChannels> choose_channels(const Imf::ChannelList& list) {
  const auto has = [&](const char* channel) { return list.findChannel(channel) != nullptr; };
  if (has("R") && has("G") && has("B")) return ExrChannels{false, {"R", "G", "B"}};
  if (has("Y") && has("RY") && has("BY")) return ExrChannels{true, {}};
  if (has("Y")) return ExrChannels{false, {"Y", "Y", "Y"}};
  std::string only;
  for (auto c = list.begin(); c != list.end(); ++c) {
    if (std::strcmp(c.name(), "A") == 0) continue;
    if (!only.empty()) return std::nullopt;
    only = c.name();
  }
  if (only.empty()) return std::nullopt;
  return ExrChannels{false, {only, only, only}};
}

std::string channel_names(const Imf::ChannelList& list) {
  std::string names;
  for (auto c = list.begin(); c != list.end(); ++c) names += std::string(" ") + c.name();
  return names;
}

// Float slices, since the library's RGBA interface would clamp 32 bit channels to half.
void read_channels(Imf::InputFile& file, const ExrChannels& channels, HdrImage& out) {
  Image<Rgb>& pixels = out.pixels;
  const Imath::Box2i window = file.header().dataWindow();
  const bool grey = channels.rgb[0] == channels.rgb[1];
  Imf::FrameBuffer buffer;
  for (std::size_t c = 0; c < (grey ? 1u : 3u); ++c)
    buffer.insert(
        channels.rgb[c],
        Imf::Slice::Make(Imf::FLOAT, &pixels.at(0, 0)[static_cast<int>(c)], window, sizeof(Rgb),
                         sizeof(Rgb) * static_cast<std::size_t>(pixels.width())));
  const auto take = [&](const char* name, Image<float>& values) {
    const Imf::Channel* const stored = file.header().channels().findChannel(name);
    if (!stored || stored->xSampling != 1 || stored->ySampling != 1 || channels.rgb[0] == name)
      return;
    values = Image<float>(pixels.width(), pixels.height());
    buffer.insert(name, Imf::Slice::Make(Imf::FLOAT, values.pixels().data(), window, sizeof(float),
                                         sizeof(float) * static_cast<std::size_t>(values.width())));
  };
  take("A", out.alpha);
  take(kClippedChannel, out.clipped);
  file.setFrameBuffer(buffer);
  file.readPixels(window.min.y, window.max.y);
  if (grey)
    for (Rgb& p : pixels.pixels()) p = {p.r, p.r, p.r};
}

// Luminance and half-resolution chroma. The library interpolates them in half precision, in which
// such files are stored anyway.
void read_luminance_chroma(Bytes bytes, const std::string& name, Image<Rgb>& pixels) {
  MemoryInput stream(bytes, name);
  Imf::RgbaInputFile file(stream, 0);
  const Imath::Box2i window = file.dataWindow();
  std::vector<Imf::Rgba> row(static_cast<std::size_t>(pixels.width()));
  for (int y = 0; y < pixels.height(); ++y) {
    // A y stride of 0 puts every row into the same buffer.
    file.setFrameBuffer(row.data() - window.min.x, 1, 0);
    file.readPixels(window.min.y + y);
    const auto out = pixels.row(y);
    for (std::size_t x = 0; x < row.size(); ++x) out[x] = {row[x].r, row[x].g, row[x].b};
  }
}

Result<void> convert_to_rec709(const Imf::Header& header, const std::string& name,
                               Image<Rgb>& pixels) {
  if (!Imf::hasChromaticities(header)) return {};
  const Imf::Chromaticities& c = Imf::chromaticities(header);
  const Chromaticities declared{c.red.x,  c.red.y,  c.green.x, c.green.y,
                                c.blue.x, c.blue.y, c.white.x, c.white.y};
  if (is_rec709(declared)) return {};
  const auto matrix = rec709_from(declared);
  if (!matrix) return fail(ErrorCode::kUnreadable, name, "has chromaticities that lie on one line");
  apply(*matrix, pixels.pixels());
  return {};
}

std::optional<EnvironmentAttribute> environment_of(const Imf::Header& header) {
  if (!Imf::hasEnvmap(header)) return std::nullopt;
  return Imf::envmap(header) == Imf::ENVMAP_CUBE ? EnvironmentAttribute::kCube
                                                 : EnvironmentAttribute::kLatLong;
}

Result<HdrImage> decode_checked(Bytes bytes, const std::string& name) {
  MemoryInput stream(bytes, name);
  {
    stream.seekg(kPreamble);
    std::int32_t version = 0;
    std::memcpy(&version, bytes.data() + 4, sizeof version);
    Imf::Header header;
    header.readFrom(stream, version);
    PENUMBRA_TRY(check_header(header, name));
    stream.seekg(0);
  }
  Imf::InputFile file(stream, 0);
  if (!file.isComplete())
    return fail(ErrorCode::kUnreadable, name,
                "is truncated: not all rows are in its " + std::to_string(bytes.size()) + " bytes");
  const Imf::Header& header = file.header();
  const auto channels = choose_channels(header.channels());
  if (!channels)
    return fail(
        ErrorCode::kUnreadable, name,
        "has no colour channels (R G B, Y, or one alone), but:" + channel_names(header.channels()));
  const Imath::Box2i& window = header.dataWindow();
  HdrImage out;
  out.pixels = Image<Rgb>(window.max.x - window.min.x + 1, window.max.y - window.min.y + 1);
  if (channels->luminance_chroma)
    read_luminance_chroma(bytes, name, out.pixels);
  else
    read_channels(file, *channels, out);
  PENUMBRA_TRY(convert_to_rec709(header, name, out.pixels));
  out.non_finite = count_non_finite(out.pixels.pixels());
  out.environment = environment_of(header);
  return out;
}

// A light source above the largest half must stay a number: an infinity would be left out by
// whoever sums the light, and the sun with it.
Imath::half to_half(float value) {
  constexpr float kLargest = HALF_MAX;
  return Imath::half(std::isfinite(value) ? std::clamp(value, -kLargest, kLargest) : value);
}

std::vector<Imath::half> to_halves(const Image<Rgb>& pixels) {
  std::vector<Imath::half> out;
  out.reserve(pixels.area() * 3);
  for (const Rgb& p : pixels.pixels())
    for (int c = 0; c < 3; ++c) out.push_back(to_half(p[c]));
  return out;
}

// Compression takes most of the time of a write. The library's pool is made once: to change its
// size while others write is not safe.
int compression_threads() {
  static const int threads = [] {
    const int count = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    Imf::setGlobalThreadCount(count);
    return count;
  }();
  return threads;
}

std::string encode_exr(const std::string& name, const Image<Rgb>& pixels, Depth depth,
                       std::optional<EnvironmentAttribute> environment, const Image<float>& alpha,
                       const Image<float>& clipped) {
  const Imf::PixelType type = depth == Depth::kHalf ? Imf::HALF : Imf::FLOAT;
  Imf::Header header(pixels.width(), pixels.height());
  header.compression() = Imf::ZIP_COMPRESSION;
  Imf::addChromaticities(header, Imf::Chromaticities());  // Rec.709 is the library's default
  if (environment)
    Imf::addEnvmap(header, *environment == EnvironmentAttribute::kCube ? Imf::ENVMAP_CUBE
                                                                       : Imf::ENVMAP_LATLONG);
  std::vector<Imath::half> halves;
  if (depth == Depth::kHalf) halves = to_halves(pixels);
  const auto* base = depth == Depth::kHalf ? reinterpret_cast<const char*>(halves.data())
                                           : reinterpret_cast<const char*>(pixels.pixels().data());
  const std::size_t channel_bytes = depth == Depth::kHalf ? sizeof(Imath::half) : sizeof(float);
  Imf::FrameBuffer buffer;
  for (std::size_t c = 0; c < 3; ++c) {
    const char* channel = std::array{"R", "G", "B"}[c];
    header.channels().insert(channel, Imf::Channel(type));
    // The library's slices are not const, even for what it only reads.
    buffer.insert(channel,
                  Imf::Slice(type, const_cast<char*>(base) + c * channel_bytes, 3 * channel_bytes,
                             3 * channel_bytes * static_cast<std::size_t>(pixels.width())));
  }
  const auto add = [&](const char* channel, const Image<float>& values) {
    if (values.empty()) return;
    header.channels().insert(channel, Imf::Channel(Imf::FLOAT));
    auto* const first = const_cast<float*>(values.pixels().data());
    buffer.insert(channel, Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(first), sizeof(float),
                                      sizeof(float) * static_cast<std::size_t>(values.width())));
  };
  add("A", alpha);
  add(kClippedChannel, clipped);
  MemoryOutput stream(name);
  {
    Imf::OutputFile file(stream, header, compression_threads());
    file.setFrameBuffer(buffer);
    file.writePixels(pixels.height());
  }  // the table of offsets is written when the file closes
  return stream.bytes();
}

}  // namespace

bool is_exr(Bytes bytes) {
  return bytes.size() >= kMagic.size() && std::equal(kMagic.begin(), kMagic.end(), bytes.begin());
}

Result<HdrImage> decode_exr(Bytes bytes, const std::string& name) {
  if (bytes.size() < kPreamble)
    return fail(ErrorCode::kUnreadable, name,
                "is truncated: it has only " + std::to_string(bytes.size()) + " bytes");
  if (const auto at = damaged_attribute(bytes))
    return fail(ErrorCode::kUnreadable, name,
                "has a truncated or damaged header at byte " + std::to_string(*at));
  try {
    return decode_checked(bytes, name);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, name, reason_of(e));
  }
}

Result<HdrImage> decode_hdr(Bytes bytes, const std::string& name) {
  if (is_exr(bytes)) return decode_exr(bytes, name);
  if (is_jpeg(bytes)) return decode_gain_map_jpeg(bytes, name);
  if (is_jpeg2000(bytes)) return decode_log_jpeg2000(bytes, name);
  if (is_rgbe_still(bytes)) return decode_rgbe_still(bytes, name);
  if (is_radiance(bytes)) return decode_radiance(bytes, name);
  return fail(ErrorCode::kUnreadable, name,
              "is neither OpenEXR, Radiance HDR, JPEG 2000, .pnr nor a JPEG with a gain map");
}

Result<HdrImage> read_hdr(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path));
  return decode_hdr(bytes, path.string());
}

Result<void> write_hdr(const std::filesystem::path& path, const Image<Rgb>& pixels, Depth depth,
                       std::optional<EnvironmentAttribute> environment, const Image<float>& alpha,
                       const Image<float>& clipped) {
  const std::string extension = lower_extension(path);
  if (extension != ".exr" && extension != ".hdr")
    return fail(ErrorCode::kInvalid, path.string(), "ends neither in .exr nor in .hdr");
  if (pixels.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no pixels");
  PENUMBRA_TRY(check_size(pixels.width(), pixels.height(), path.string()));
  if (!alpha.empty() && (extension == ".hdr" || !alpha.same_size(pixels)))
    return fail(ErrorCode::kInvalid, path.string(),
                extension == ".hdr" ? "cannot say which pixels were seen, their alpha: write .exr"
                                    : "has an alpha of another size than its colours");
  if (!clipped.empty() && (extension == ".hdr" || !clipped.same_size(pixels)))
    return fail(ErrorCode::kInvalid, path.string(),
                extension == ".hdr" ? "cannot say which pixels are clipped: write .exr"
                                    : "has clipped pixels of another size than its colours");
  if (extension == ".hdr") return write_bytes(path, encode_radiance(pixels));
  try {
    return write_bytes(path, encode_exr(path.string(), pixels, depth, environment, alpha, clipped));
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnwritable, path.string(), reason_of(e));
  }
}

}  // namespace penumbra::codec
