// JPEG: decoded by libjpeg, which tells a warning from an error, and coded by TurboJPEG. libjpeg
// leaves by longjmp on an error: what has a destructor stands outside of the functions that call
// setjmp.
#include <turbojpeg.h>

#include <array>
#include <csetjmp>
#include <cstdio>
#include <memory>

#include <jpeglib.h>  // after cstdio, which it needs

#include "codec/internal/frame_codecs.h"

namespace penumbra::codec {

namespace {

static_assert(sizeof(Rgb8) == 3);

constexpr int kMaxScans = 500;  // more are made to take time

struct JpegFailure {
  jpeg_error_mgr manager;
  jpeg_progress_mgr progress;
  std::jmp_buf way_out;
  std::array<char, JMSG_LENGTH_MAX> text{};
};

[[noreturn]] void leave_jpeg(j_common_ptr jpeg) {
  auto* failure = static_cast<JpegFailure*>(jpeg->client_data);
  jpeg->err->format_message(jpeg, failure->text.data());
  std::longjmp(failure->way_out, 1);
}
// Warnings are about bytes that cameras leave between segments, or a smudge: what is there is
// shown, as browsers do.
void ignore_jpeg_message(j_common_ptr, int) {}
void count_scans(j_common_ptr jpeg) {
  auto* failure = static_cast<JpegFailure*>(jpeg->client_data);
  if (reinterpret_cast<j_decompress_ptr>(jpeg)->input_scan_number <= kMaxScans) return;
  std::snprintf(failure->text.data(), failure->text.size(), "more than %d scans", kMaxScans);
  std::longjmp(failure->way_out, 1);
}

class JpegReader {
 public:
  JpegReader() {
    jpeg_.err = jpeg_std_error(&failure_.manager);
    failure_.manager.error_exit = leave_jpeg;
    failure_.manager.emit_message = ignore_jpeg_message;
    jpeg_.client_data = &failure_;
  }
  ~JpegReader() { jpeg_destroy_decompress(&jpeg_); }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;

  // After it, the size is known.
  bool begin(Bytes bytes) {
    if (setjmp(failure_.way_out)) return false;
    jpeg_create_decompress(&jpeg_);
    failure_.progress.progress_monitor = count_scans;
    jpeg_.progress = &failure_.progress;
    jpeg_mem_src(&jpeg_, bytes.data(), bytes.size());
    jpeg_read_header(&jpeg_, TRUE);
    inks = jpeg_.jpeg_color_space == JCS_CMYK || jpeg_.jpeg_color_space == JCS_YCCK;
    jpeg_.out_color_space = inks ? JCS_CMYK : JCS_RGB;
    width = static_cast<int>(jpeg_.image_width);
    height = static_cast<int>(jpeg_.image_height);
    return true;
  }

  // rows: of 3 bytes a pixel, or 4 with inks
  bool read(unsigned char* rows, std::size_t row_bytes) {
    if (setjmp(failure_.way_out)) return false;
    jpeg_start_decompress(&jpeg_);
    while (jpeg_.output_scanline < jpeg_.output_height) {
      JSAMPROW row = rows + jpeg_.output_scanline * row_bytes;
      jpeg_read_scanlines(&jpeg_, &row, 1);
    }
    jpeg_finish_decompress(&jpeg_);
    return true;
  }

  const char* message() const { return failure_.text.data(); }

  int width = 0, height = 0;
  bool inks = false;

 private:
  jpeg_decompress_struct jpeg_{};
  JpegFailure failure_{};
};

// As Adobe's programs write them: 255 is no ink.
Rgb8 without_inks(const unsigned char* cmyk) {
  const auto seen = [&](int c) {
    return static_cast<std::uint8_t>((cmyk[c] * cmyk[3] + 127) / 255);
  };
  return {seen(0), seen(1), seen(2)};
}

using TurboJpeg = std::unique_ptr<void, int (*)(void*)>;

}  // namespace

Result<Image<Rgb8>> decode_jpeg(Bytes bytes, const std::string& name) {
  JpegReader jpeg;
  const auto damaged = [&] {
    return fail(ErrorCode::kUnreadable, name,
                std::string("has damaged picture data: ") + jpeg.message());
  };
  if (!jpeg.begin(bytes)) return damaged();
  PENUMBRA_TRY(check_size(jpeg.width, jpeg.height, name));
  Image<Rgb8> out(jpeg.width, jpeg.height);
  const auto width = static_cast<std::size_t>(jpeg.width);
  if (!jpeg.inks) {
    if (!jpeg.read(&out.pixels()[0].r, 3 * width)) return damaged();
    return out;
  }
  std::vector<unsigned char> cmyk(4 * out.area());
  if (!jpeg.read(cmyk.data(), 4 * width)) return damaged();
  for (std::size_t i = 0; i < out.area(); ++i) out.pixels()[i] = without_inks(&cmyk[4 * i]);
  return out;
}

Result<std::vector<unsigned char>> encode_jpeg(const Image<Rgb8>& pixels, int quality,
                                               JpegColours colours, const std::string& name) {
  const TurboJpeg coder(tjInitCompress(), tjDestroy);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  const bool coded = coder && tjCompress2(coder.get(), &pixels.pixels()[0].r, pixels.width(), 0,
                                          pixels.height(), TJPF_RGB, &bytes, &size,
                                          colours == JpegColours::kFull ? TJSAMP_444 : TJSAMP_420,
                                          quality, TJFLAG_ACCURATEDCT) == 0;
  const std::unique_ptr<unsigned char, void (*)(unsigned char*)> owner(bytes, tjFree);
  if (!coded) return fail(ErrorCode::kUnwritable, name, tjGetErrorStr2(coder.get()));
  return std::vector<unsigned char>(bytes, bytes + size);
}

}  // namespace penumbra::codec
