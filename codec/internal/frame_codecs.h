// PNG, JPEG and TIFF through their own libraries, from and to memory; frames.cpp checks sizes and
// truncation before.
// threads: every function is reentrant
#pragma once

#include <string>
#include <vector>

#include "codec/codec.h"
#include "codec/internal/formats.h"

namespace penumbra::codec {

/// errors: kUnreadable (damaged)
Result<FrameWithAlpha> decode_png(Bytes bytes, const std::string& name);
/// Of a printer's inks (CMYK) as they look on white paper.
/// errors: kUnreadable (damaged)
Result<Image<Rgb8>> decode_jpeg(Bytes bytes, const std::string& name);
/// 9 to 15 bits come as 16, the largest code as 65535.
/// errors: kUnreadable (damaged, LogLuv, samples that are neither whole numbers of up to 16 bits
///         nor floats)
Result<FramePixels> decode_tiff(Bytes bytes, const std::string& name);

/// Whether colours are kept at full resolution or at half.
enum class JpegColours { kFull, kHalf };

/// errors: kUnwritable
Result<std::vector<unsigned char>> encode_jpeg(const Image<Rgb8>& pixels, int quality,
                                               JpegColours colours, const std::string& name);
Result<std::vector<unsigned char>> encode_png(const Image<Rgb8>& pixels, const std::string& name);
Result<std::vector<unsigned char>> encode_png(const Image<Rgb16>& pixels, const std::string& name);
Result<std::vector<unsigned char>> encode_tiff(const Image<Rgb8>& pixels, const std::string& name);
Result<std::vector<unsigned char>> encode_tiff(const Image<Rgb16>& pixels, const std::string& name);

}  // namespace penumbra::codec
