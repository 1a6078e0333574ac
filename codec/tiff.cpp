// TIFF through libtiff: grey and RGB of 8 to 16 bits and floats in strips or tiles, together or
// plane by plane, as they are stored; palettes, inks, fewer bits and JPEG inside by libtiff's own
// conversion to RGB.
#include <tiffio.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <memory>

#include "codec/internal/frame_codecs.h"

namespace penumbra::codec {

namespace {

// A file in memory; one that is read is never written.
struct TiffMemory {
  Bytes read{};
  std::vector<unsigned char> written{};
  std::size_t at = 0;
  bool writes = false;
  std::string message{};

  std::size_t size() const { return writes ? written.size() : read.size(); }
};

TiffMemory& memory_of(thandle_t handle) {
  return *static_cast<TiffMemory*>(handle);
}

tmsize_t read_memory(thandle_t handle, void* to, tmsize_t size) {
  TiffMemory& m = memory_of(handle);
  const std::size_t left = m.size() - std::min(m.at, m.size());
  const std::size_t count = std::min(left, static_cast<std::size_t>(size));
  const unsigned char* from = m.writes ? m.written.data() : m.read.data();
  if (count > 0) std::memcpy(to, from + m.at, count);
  m.at += count;
  return static_cast<tmsize_t>(count);
}

tmsize_t write_memory(thandle_t handle, void* from, tmsize_t size) {
  TiffMemory& m = memory_of(handle);
  if (!m.writes) return 0;
  const auto count = static_cast<std::size_t>(size);
  m.written.resize(std::max(m.written.size(), m.at + count));
  std::memcpy(m.written.data() + m.at, from, count);
  m.at += count;
  return size;
}

toff_t seek_memory(thandle_t handle, toff_t by, int from) {
  TiffMemory& m = memory_of(handle);
  const std::size_t start = from == SEEK_SET ? 0 : from == SEEK_CUR ? m.at : m.size();
  return m.at = start + by;
}

int keep_message(TIFF*, void* data, const char*, const char* format, va_list arguments) {
  std::array<char, 256> text{};
  std::vsnprintf(text.data(), text.size(), format, arguments);
  static_cast<TiffMemory*>(data)->message = text.data();
  return 1;  // nothing is printed
}
int ignore_message(TIFF*, void*, const char*, const char*, va_list) {
  return 1;
}

using TiffFile = std::unique_ptr<TIFF, void (*)(TIFF*)>;

TiffFile open_tiff(TiffMemory& memory, const char* mode) {
  const std::unique_ptr<TIFFOpenOptions, void (*)(TIFFOpenOptions*)> options(TIFFOpenOptionsAlloc(),
                                                                             TIFFOpenOptionsFree);
  constexpr tmsize_t kMaxAtOnce = tmsize_t{1} << 30;  // bytes
  TIFFOpenOptionsSetMaxSingleMemAlloc(options.get(), kMaxAtOnce);
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), keep_message, &memory);
  TIFFOpenOptionsSetWarningHandlerExtR(options.get(), ignore_message, nullptr);
  return {TIFFClientOpenExt(
              "memory", mode, &memory, read_memory, write_memory, seek_memory,
              [](thandle_t) { return 0; },
              [](thandle_t handle) { return static_cast<toff_t>(memory_of(handle).size()); },
              nullptr, nullptr, options.get()),
          TIFFClose};
}

struct TiffLayout {
  int width = 0, height = 0;
  std::uint16_t bits = 1, samples = 1, format = SAMPLEFORMAT_UINT, photometric = 0;
  std::uint16_t planes = PLANARCONFIG_CONTIG;
  bool tiled = false;
  // Of a strip or a tile.
  int block_width = 0, block_height = 0;

  int channels() const { return photometric == PHOTOMETRIC_RGB ? 3 : 1; }
  int in_block() const { return planes == PLANARCONFIG_CONTIG ? samples : 1; }
  std::size_t row_bytes() const {
    return (static_cast<std::size_t>(block_width) * static_cast<std::size_t>(in_block()) * bits +
            7) /
           8;
  }
  // A tile may be larger than its picture, within reason.
  bool is_bounded() const {
    constexpr int kBeyond_px = 4096, kMaxSamples = 32;
    return block_width > 0 && block_height > 0 && block_width <= width + kBeyond_px &&
           block_height <= height + kBeyond_px && samples <= kMaxSamples;
  }
  bool is_plain() const {
    const bool grey =
        photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_MINISWHITE;
    return samples >= channels() && (grey || photometric == PHOTOMETRIC_RGB);
  }
};

TiffLayout layout_of(TIFF* tiff) {
  TiffLayout out;
  std::uint32_t width = 0, height = 0, block_width = 0, block_height = 0;
  TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width);
  TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &out.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &out.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &out.format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &out.planes);
  if (!TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &out.photometric))
    out.photometric = out.samples >= 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK;
  out.tiled = TIFFIsTiled(tiff);
  if (out.tiled) {
    TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &block_width);
    TIFFGetField(tiff, TIFFTAG_TILELENGTH, &block_height);
  } else {
    TIFFGetFieldDefaulted(tiff, TIFFTAG_ROWSPERSTRIP, &block_height);
    block_width = width;
    block_height = std::min(block_height, height);
  }
  const auto bounded = [](std::uint32_t v) { return static_cast<int>(std::min(v, 1u << 30)); };
  out.width = bounded(width), out.height = bounded(height);
  out.block_width = bounded(block_width), out.block_height = bounded(block_height);
  return out;
}

template <class Code>
Code inverted(Code v) {
  if constexpr (std::is_integral_v<Code>) return static_cast<Code>(~v);
  return static_cast<Code>(1 - v);
}

// A sample of a row as it is stored; those of 9 to 15 bits lie close together, and become 16: the
// largest code the largest, so that what is saturated stays so.
template <class Code>
Code sample_at(const unsigned char* row, std::size_t index, int bits) {
  Code v{};
  if (bits == 8 * int{sizeof v}) {
    std::memcpy(&v, row + index * sizeof v, sizeof v);
  } else if constexpr (sizeof v == 2) {
    const std::size_t first = index * static_cast<std::size_t>(bits);
    std::uint32_t three = 0;  // bytes
    for (std::size_t i = 0; i < 3; ++i) three = three << 8 | row[first / 8 + i];
    const std::uint32_t stored = three << (8 + first % 8) >> (32 - bits);
    v = static_cast<Code>(stored << (16 - bits) | stored >> (2 * bits - 16));
  }
  return v;
}

// The samples of one strip or tile into the picture's channels; of those beyond (alpha) none.
template <class Pixel, class Code>
void place_block(const TiffLayout& in, const std::vector<unsigned char>& block, int x0, int y0,
                 int plane, Image<Pixel>& out) {
  const int first = in.planes == PLANARCONFIG_CONTIG ? 0 : plane;
  const int count = in.planes == PLANARCONFIG_CONTIG ? in.channels() : 1;
  for (int y = y0; y < std::min(y0 + in.block_height, in.height); ++y) {
    const unsigned char* const row = &block[static_cast<std::size_t>(y - y0) * in.row_bytes()];
    for (int x = x0; x < std::min(x0 + in.block_width, in.width); ++x)
      for (int c = 0; c < count; ++c) {
        auto v =
            sample_at<Code>(row, static_cast<std::size_t>((x - x0) * in.in_block() + c), in.bits);
        if (in.photometric == PHOTOMETRIC_MINISWHITE) v = inverted(v);
        Pixel& to = out.at(x, y);
        if (in.channels() == 1)
          to = {v, v, v};
        else
          (&to.r)[first + c] = v;
      }
  }
}

template <class Pixel, class Code>
Result<FramePixels> read_plain(TIFF* tiff, const TiffLayout& in, const TiffMemory& memory,
                               const std::string& name) {
  const auto damaged = [&](const std::string& why) {
    return fail(ErrorCode::kUnreadable, name, "has damaged picture data: " + why);
  };
  const std::size_t bytes = in.row_bytes() * static_cast<std::size_t>(in.block_height);
  if (bytes != static_cast<std::size_t>(in.tiled ? TIFFTileSize(tiff) : TIFFStripSize(tiff)))
    return damaged("strips or tiles of another size than the picture has");
  std::vector<unsigned char> block(bytes + 2);  // sample_at() looks two bytes further
  Image<Pixel> out(in.width, in.height);
  const int planes = in.planes == PLANARCONFIG_CONTIG ? 1 : in.channels();
  for (int plane = 0; plane < planes; ++plane)
    for (int y = 0; y < in.height; y += in.block_height)
      for (int x = 0; x < in.width; x += in.block_width) {
        const auto column = static_cast<std::uint32_t>(x), row = static_cast<std::uint32_t>(y);
        const auto sample = static_cast<std::uint16_t>(plane);
        const tmsize_t size = static_cast<tmsize_t>(bytes);
        const tmsize_t got =
            in.tiled ? TIFFReadEncodedTile(tiff, TIFFComputeTile(tiff, column, row, 0, sample),
                                           block.data(), size)
                     : TIFFReadEncodedStrip(tiff, TIFFComputeStrip(tiff, row, sample), block.data(),
                                            size);
        if (got < 0) return damaged(memory.message);
        place_block<Pixel, Code>(in, block, x, y, plane, out);
      }
  return FramePixels(std::move(out));
}

// In the order of the file's rows, whichever way they are to be seen.
Result<FramePixels> read_as_rgba(TIFF* tiff, const TiffLayout& in, const TiffMemory& memory,
                                 const std::string& name) {
  std::array<char, 1024> why{};
  if (!TIFFRGBAImageOK(tiff, why.data()))
    return fail(ErrorCode::kUnreadable, name,
                std::string("cannot be read as a picture: ") + why.data());
  std::uint16_t orientation = ORIENTATION_TOPLEFT;
  TIFFGetFieldDefaulted(tiff, TIFFTAG_ORIENTATION, &orientation);
  std::vector<std::uint32_t> raster(static_cast<std::size_t>(in.width) *
                                    static_cast<std::size_t>(in.height));
  if (!TIFFReadRGBAImageOriented(tiff, static_cast<std::uint32_t>(in.width),
                                 static_cast<std::uint32_t>(in.height), raster.data(), orientation,
                                 1))
    return fail(ErrorCode::kUnreadable, name, "has damaged picture data: " + memory.message);
  Image<Rgb8> out(in.width, in.height);
  std::ranges::transform(raster, out.pixels().begin(), [](std::uint32_t v) {
    return Rgb8{static_cast<std::uint8_t>(TIFFGetR(v)), static_cast<std::uint8_t>(TIFFGetG(v)),
                static_cast<std::uint8_t>(TIFFGetB(v))};
  });
  return FramePixels(std::move(out));
}

template <class Pixel>
Result<std::vector<unsigned char>> encode_tiff_of(const Image<Pixel>& pixels,
                                                  const std::string& name) {
  static_assert(sizeof(Pixel) == 3 * sizeof(Pixel::r));
  TiffMemory memory;
  memory.writes = true;
  TiffFile tiff = open_tiff(memory, "w");
  const auto refused = [&] {
    return fail(ErrorCode::kUnwritable, name, "cannot be encoded: " + memory.message);
  };
  if (!tiff) return refused();
  TIFFSetField(tiff.get(), TIFFTAG_IMAGEWIDTH, pixels.width());
  TIFFSetField(tiff.get(), TIFFTAG_IMAGELENGTH, pixels.height());
  TIFFSetField(tiff.get(), TIFFTAG_BITSPERSAMPLE, int{8 * sizeof(Pixel::r)});
  TIFFSetField(tiff.get(), TIFFTAG_SAMPLESPERPIXEL, 3);
  TIFFSetField(tiff.get(), TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_RGB);
  TIFFSetField(tiff.get(), TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  TIFFSetField(tiff.get(), TIFFTAG_COMPRESSION, COMPRESSION_LZW);
  TIFFSetField(tiff.get(), TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
  TIFFSetField(tiff.get(), TIFFTAG_ROWSPERSTRIP, TIFFDefaultStripSize(tiff.get(), 0));
  std::vector<Pixel> row(static_cast<std::size_t>(pixels.width()));
  for (int y = 0; y < pixels.height(); ++y) {
    std::ranges::copy(pixels.row(y), row.begin());  // the predictor writes over it
    if (TIFFWriteScanline(tiff.get(), row.data(), static_cast<std::uint32_t>(y), 0) < 0)
      return refused();
  }
  if (!TIFFFlush(tiff.get())) return refused();
  tiff.reset();
  return std::move(memory.written);
}

}  // namespace

Result<FramePixels> decode_tiff(Bytes bytes, const std::string& name) {
  TiffMemory memory{.read = bytes};
  // Without mapping the file, and without cutting what is one strip into several.
  const TiffFile tiff = open_tiff(memory, "rmc");
  if (!tiff) return fail(ErrorCode::kUnreadable, name, "is damaged: " + memory.message);
  const TiffLayout in = layout_of(tiff.get());
  PENUMBRA_TRY(check_size(in.width, in.height, name));
  if (!in.is_bounded())
    return fail(ErrorCode::kUnreadable, name, "is damaged: its tiles or samples are out of range");
  if (in.photometric == PHOTOMETRIC_LOGL || in.photometric == PHOTOMETRIC_LOGLUV)
    return fail(ErrorCode::kUnreadable, name,
                "is a LogLuv TIFF: save it as OpenEXR or Radiance HDR");
  const bool whole = in.format == SAMPLEFORMAT_UINT;
  if (in.is_plain() && whole && in.bits == 8)
    return read_plain<Rgb8, std::uint8_t>(tiff.get(), in, memory, name);
  if (in.is_plain() && whole && in.bits > 8 && in.bits <= 16)
    return read_plain<Rgb16, std::uint16_t>(tiff.get(), in, memory, name);
  if (in.is_plain() && in.format == SAMPLEFORMAT_IEEEFP && in.bits == 32)
    return read_plain<Rgb, float>(tiff.get(), in, memory, name);
  if (in.bits > 16 || !whole)
    return fail(ErrorCode::kUnreadable, name, "has neither 8-bit nor 16-bit nor float samples");
  return read_as_rgba(tiff.get(), in, memory, name);
}

Result<std::vector<unsigned char>> encode_tiff(const Image<Rgb8>& pixels, const std::string& name) {
  return encode_tiff_of(pixels, name);
}

Result<std::vector<unsigned char>> encode_tiff(const Image<Rgb16>& pixels,
                                               const std::string& name) {
  return encode_tiff_of(pixels, name);
}

}  // namespace penumbra::codec
