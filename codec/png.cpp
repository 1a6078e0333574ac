// PNG through libpng. It leaves by longjmp on an error: what has a destructor stands outside of the
// functions that call setjmp.
#include <png.h>
#include <zlib.h>

#include <array>
#include <csetjmp>
#include <cstring>

#include "codec/internal/frame_codecs.h"

namespace penumbra::codec {

namespace {

// What libpng says on its way out.
struct PngMessage {
  std::array<char, 128> text{};
};

[[noreturn]] void leave_png(png_structp png, png_const_charp message) {
  auto* said = static_cast<PngMessage*>(png_get_error_ptr(png));
  std::strncpy(said->text.data(), message, said->text.size() - 1);
  png_longjmp(png, 1);
}
void ignore_png_warning(png_structp, png_const_charp) {}

// In RGBA: grey, palettes, fewer bits and a transparent colour are unfolded by libpng.
class PngReader {
 public:
  explicit PngReader(Bytes bytes)
      : bytes_(bytes),
        png_(png_create_read_struct(PNG_LIBPNG_VER_STRING, &message_, leave_png,
                                    ignore_png_warning)),
        info_(png_ ? png_create_info_struct(png_) : nullptr) {}
  ~PngReader() { png_destroy_read_struct(&png_, &info_, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;

  // After it, the size and the kind of samples are known.
  bool begin() {
    if (!info_) return false;
    if (setjmp(png_jmpbuf(png_))) return false;
    png_set_read_fn(png_, this, [](png_structp png, png_bytep to, std::size_t size) {
      auto* self = static_cast<PngReader*>(png_get_io_ptr(png));
      if (self->bytes_.size() < size) png_error(png, "ends early");
      std::memcpy(to, self->bytes_.data(), size);
      self->bytes_ = self->bytes_.subspan(size);
    });
    png_set_user_limits(png_, kMaxSide, kMaxSide);
    png_set_chunk_cache_max(png_, 1);  // of texts none: they may be large
    png_read_info(png_, info_);
    const png_byte colour = png_get_color_type(png_, info_);
    alpha = (colour & PNG_COLOR_MASK_ALPHA) || png_get_valid(png_, info_, PNG_INFO_tRNS);
    wide = png_get_bit_depth(png_, info_) == 16;
    png_set_expand(png_);
    png_set_gray_to_rgb(png_);
    png_set_add_alpha(png_, 0xffff, PNG_FILLER_AFTER);
    if (wide) png_set_swap(png_);
    png_set_interlace_handling(png_);
    png_read_update_info(png_, info_);
    width = static_cast<int>(png_get_image_width(png_, info_));
    height = static_cast<int>(png_get_image_height(png_, info_));
    row_bytes = png_get_rowbytes(png_, info_);
    return true;
  }

  bool read(std::vector<unsigned char*>& rows) {
    if (setjmp(png_jmpbuf(png_))) return false;
    png_read_image(png_, rows.data());
    png_read_end(png_, nullptr);
    return true;
  }

  const char* message() const { return message_.text.data(); }

  int width = 0, height = 0;
  std::size_t row_bytes = 0;
  bool alpha = false, wide = false;

 private:
  Bytes bytes_;
  PngMessage message_;
  png_structp png_;
  png_infop info_;
};

std::uint8_t eight_bits_of(std::uint8_t v) {
  return v;
}
std::uint8_t eight_bits_of(std::uint16_t v) {
  return static_cast<std::uint8_t>((v + 128) / 257);
}

template <class Pixel, class Code>
void take_rgba(const PngReader& png, const std::vector<unsigned char>& rgba, FrameWithAlpha& out) {
  Image<Pixel> colours(png.width, png.height);
  if (png.alpha) out.alpha.reset(png.width, png.height);
  for (int y = 0; y < png.height; ++y)
    for (int x = 0; x < png.width; ++x) {
      std::array<Code, 4> sample;
      std::memcpy(&sample,
                  &rgba[static_cast<std::size_t>(y) * png.row_bytes +
                        static_cast<std::size_t>(x) * sizeof sample],
                  sizeof sample);
      colours.at(x, y) = {sample[0], sample[1], sample[2]};
      if (png.alpha) out.alpha.at(x, y) = eight_bits_of(sample[3]);
    }
  out.pixels = std::move(colours);
}

// As for recordings in camera's time: the fastest of zlib, which is half as large as none.
bool write_png_rows(png_structp png, png_infop info, int width, int height, int bits,
                    png_bytepp rows, std::vector<unsigned char>& out) {
  if (!info) return false;
  if (setjmp(png_jmpbuf(png))) return false;
  png_set_write_fn(
      png, &out,
      [](png_structp to, png_bytep data, std::size_t size) {
        auto* bytes = static_cast<std::vector<unsigned char>*>(png_get_io_ptr(to));
        bytes->insert(bytes->end(), data, data + size);
      },
      [](png_structp) {});
  png_set_IHDR(png, info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), bits,
               PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_set_compression_level(png, Z_BEST_SPEED);
  png_set_compression_strategy(png, Z_RLE);
  png_write_info(png, info);
  if (bits == 16) png_set_swap(png);
  png_write_image(png, rows);
  png_write_end(png, info);
  return true;
}

template <class Pixel>
Result<std::vector<unsigned char>> encode_png_of(const Image<Pixel>& pixels,
                                                 const std::string& name) {
  static_assert(sizeof(Pixel) == 3 * sizeof(Pixel::r));
  // libpng reads rows only, though its interface asks for what may be written.
  std::vector<png_bytep> rows;
  for (int y = 0; y < pixels.height(); ++y)
    rows.push_back(reinterpret_cast<png_bytep>(const_cast<Pixel*>(pixels.row(y).data())));
  std::vector<unsigned char> out;
  PngMessage message;
  png_structp png =
      png_create_write_struct(PNG_LIBPNG_VER_STRING, &message, leave_png, ignore_png_warning);
  png_infop info = png ? png_create_info_struct(png) : nullptr;
  const bool written = write_png_rows(png, info, pixels.width(), pixels.height(),
                                      int{8 * sizeof(Pixel::r)}, rows.data(), out);
  png_destroy_write_struct(&png, &info);
  if (!written)
    return fail(ErrorCode::kUnwritable, name,
                std::string("cannot be encoded: ") + message.text.data());
  return out;
}

}  // namespace

Result<FrameWithAlpha> decode_png(Bytes bytes, const std::string& name) {
  PngReader png(bytes);
  const auto damaged = [&] {
    return fail(ErrorCode::kUnreadable, name,
                std::string("has damaged picture data: ") + png.message());
  };
  if (!png.begin()) return damaged();
  PENUMBRA_TRY(check_size(png.width, png.height, name));
  std::vector<unsigned char> rgba(png.row_bytes * static_cast<std::size_t>(png.height));
  std::vector<unsigned char*> rows;
  for (int y = 0; y < png.height; ++y)
    rows.push_back(&rgba[static_cast<std::size_t>(y) * png.row_bytes]);
  if (!png.read(rows)) return damaged();
  FrameWithAlpha out;
  if (png.wide)
    take_rgba<Rgb16, std::uint16_t>(png, rgba, out);
  else
    take_rgba<Rgb8, std::uint8_t>(png, rgba, out);
  return out;
}

Result<std::vector<unsigned char>> encode_png(const Image<Rgb8>& pixels, const std::string& name) {
  return encode_png_of(pixels, name);
}

Result<std::vector<unsigned char>> encode_png(const Image<Rgb16>& pixels, const std::string& name) {
  return encode_png_of(pixels, name);
}

}  // namespace penumbra::codec
