// JPEG through TurboJPEG.
#include <turbojpeg.h>

#include <memory>

#include "codec/internal/frame_codecs.h"

namespace penumbra::codec {

namespace {

static_assert(sizeof(Rgb8) == 3);

using TurboJpeg = std::unique_ptr<void, int (*)(void*)>;

}  // namespace

Result<Image<Rgb8>> decode_jpeg(Bytes bytes, const std::string& name) {
  const TurboJpeg decoder(tjInitDecompress(), tjDestroy);
  const auto damaged = [&] {
    return fail(ErrorCode::kUnreadable, name,
                std::string("has damaged picture data: ") + tjGetErrorStr2(decoder.get()));
  };
  int width = 0, height = 0, subsampling = 0, space = 0;
  if (!decoder || tjDecompressHeader3(decoder.get(), bytes.data(), bytes.size(), &width, &height,
                                      &subsampling, &space) != 0)
    return damaged();
  if (space == TJCS_CMYK || space == TJCS_YCCK)
    return fail(ErrorCode::kUnreadable, name, "has the inks of a printer (CMYK): save it as RGB");
  PENUMBRA_TRY(check_size(width, height, name));
  Image<Rgb8> out(width, height);
  // A warning is about bytes that cameras leave between segments, or a smudge: what is there is
  // shown, as browsers do. Progressive files of endless scans are refused.
  if (tjDecompress2(decoder.get(), bytes.data(), bytes.size(), &out.pixels()[0].r, width, 0, height,
                    TJPF_RGB, TJFLAG_ACCURATEDCT | TJFLAG_LIMITSCANS) != 0 &&
      tjGetErrorCode(decoder.get()) != TJERR_WARNING)
    return damaged();
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
