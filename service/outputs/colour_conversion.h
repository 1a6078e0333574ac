// Eight-bit RGB in the layouts that other programs take.
// threads: reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "core/image.h"

namespace penumbra::service {

/// Bytes of a picture in 4:2:0, whose chroma has half the size, rounded up.
std::size_t yuv420_bytes(int width, int height);

/// Planes Y, Cb and Cr one after the other: BT.709 in the range of video (16..235, 16..240), each
/// value rounded to the nearest code. Chroma lies on the left luma sample and between two rows, as
/// MPEG-2 has it.
/// out:    yuv420_bytes() bytes
/// source: ITU-R BT.709-6, sections 3 and 4
void to_yuv420(const Image<Rgb8>& in, std::span<std::uint8_t> out);

/// Y0 Cb Y1 Cr of two neighbours, with the same matrix, range and place of chroma.
/// in:  of even width
/// out: rows of row_bytes, which are at least 2 * width
void to_yuyv(const Image<Rgb8>& in, std::uint8_t* out, std::size_t row_bytes);

/// B, G, R and 255.
/// out: rows of row_bytes, which are at least 4 * width
void to_bgrx(const Image<Rgb8>& in, std::uint8_t* out, std::size_t row_bytes);

}  // namespace penumbra::service
