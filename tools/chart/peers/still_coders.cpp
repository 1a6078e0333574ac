#include "tools/chart/peers/still_coders.h"

#include <ImfRgbaFile.h>
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <span>
#include <system_error>
#include <utility>

#include "codec/codec.h"
#include "codec/dct/dct_coding.h"
#include "codec/dct/rgbe_still.h"
#include "codec/gain_map_jpeg.h"
#include "codec/log/log_jpeg2000.h"
#include "codec/tone/tone_mapping.h"
#include "tools/chart/peers/internal/jpeg_xl.h"
#include "tools/chart/peers/light_coders.h"

namespace penumbra::tools {

namespace {

double timed_ms(const auto& work) {
  const auto begin = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
      .count();
}

using StillBytes = std::vector<unsigned char>;

// Twice over, as the first time warms up.
Result<CodedPicture> run_coder(const std::function<Result<StillBytes>()>& encode,
                               const std::function<Result<Image<Rgb>>(const StillBytes&)>& decode) {
  CodedPicture out;
  Result<StillBytes> bytes = encode();
  if (bytes) out.encode_ms = timed_ms([&] { bytes = encode(); });
  PENUMBRA_TRY(bytes);
  Result<Image<Rgb>> decoded = decode(*bytes);
  if (decoded) out.decode_ms = timed_ms([&] { decoded = decode(*bytes); });
  PENUMBRA_TRY(decoded);
  out.bytes = bytes->size();
  out.decoded = std::move(*decoded);
  return out;
}

Result<CodedPicture> read_back(const std::filesystem::path& file, CodedPicture out) {
  Result<codec::HdrImage> decoded = codec::read_hdr(file);
  if (decoded) out.decode_ms = timed_ms([&] { decoded = codec::read_hdr(file); });
  std::error_code ignored;
  out.bytes = std::filesystem::file_size(file, ignored);
  std::filesystem::remove(file, ignored);
  PENUMBRA_TRY(decoded);
  out.decoded = std::move(decoded->pixels);
  return out;
}

using StillReader = Result<codec::HdrImage> (*)(std::span<const unsigned char>, const std::string&);

Result<CodedPicture> code_still(const std::function<Result<codec::CodedStill>()>& encode,
                                StillReader read) {
  return run_coder(
      [&]() -> Result<StillBytes> {
        PENUMBRA_ASSIGN(coded, encode());
        return std::move(coded.bytes);
      },
      [&](const StillBytes& bytes) -> Result<Image<Rgb>> {
        PENUMBRA_ASSIGN(image, read(bytes, "picture"));
        return std::move(image.pixels);
      });
}

Result<CodedPicture> code_within_bytes(const Image<Rgb>& picture, codec::WaveletCoder coder,
                                       std::size_t max_bytes) {
  return code_still(
      [&] { return codec::encode_log_jpeg2000(picture, {.max_bytes = max_bytes}, coder); },
      codec::decode_log_jpeg2000);
}

// Every pixel within an error, in place of the fewest bits for the mean.
Result<CodedPicture> code_every_pixel(const Image<Rgb>& picture, double error) {
  return code_still(
      [&] {
        return codec::encode_log_jpeg2000_exactly(picture, {.deviation = std::log10(1 + error)},
                                                  codec::WaveletCoder::kSmall);
      },
      codec::decode_log_jpeg2000);
}

Result<CodedPicture> code_as_gain_map(const Image<Rgb>& picture, int quality) {
  return run_coder(
      [&]() -> Result<StillBytes> {
        PENUMBRA_ASSIGN(base, tone::tone_map(picture, {}));
        return codec::encode_gain_map_jpeg(picture, base.pixels, quality);
      },
      [](const StillBytes& bytes) -> Result<Image<Rgb>> {
        PENUMBRA_ASSIGN(image, codec::decode_gain_map_jpeg(bytes, "picture"));
        return std::move(image.pixels);
      });
}

Result<CodedPicture> code_as_rgbe(const Image<Rgb>& picture, const codec::RgbeCoding& coding) {
  return code_still([&] { return codec::encode_rgbe_still_as(picture, coding); },
                    codec::decode_rgbe_still);
}

// A quality of JPEG's as what the coder takes.
int coarseness_of(int quality) {
  return static_cast<int>(std::lround(64 * codec::table_scale(quality)));
}

// Through a file, whose bytes stay in the system's memory.
Result<CodedPicture> code_as_radiance(const Image<Rgb>& picture,
                                      const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "still.hdr";
  CodedPicture out = {};
  Result<void> written = {};
  out.encode_ms = timed_ms([&] { written = codec::write_hdr(file, picture); });
  PENUMBRA_TRY(written);
  return read_back(file, std::move(out));
}

Result<CodedPicture> code_as_jpeg_xl(const Image<Rgb>& picture, float distance) {
  return run_coder([&] { return encode_jpeg_xl(picture, distance); },
                   [](const StillBytes& bytes) { return decode_jpeg_xl(bytes); });
}

void write_half_exr(const std::filesystem::path& file, const Image<Rgb>& picture,
                    Imf::Compression compression, float level) {
  Imf::Header header(picture.width(), picture.height());
  header.compression() = compression;
  if (compression == Imf::DWAA_COMPRESSION) header.dwaCompressionLevel() = level;
  std::vector<Imf::Rgba> pixels(picture.area());
  const auto half = [](float v) { return std::min(v, 65504.f); };  // the largest one
  std::ranges::transform(picture.pixels(), pixels.begin(),
                         [&](const Rgb& p) { return Imf::Rgba(half(p.r), half(p.g), half(p.b)); });
  Imf::RgbaOutputFile out(file.c_str(), header, Imf::WRITE_RGB);
  out.setFrameBuffer(pixels.data(), 1, static_cast<std::size_t>(picture.width()));
  out.writePixels(picture.height());
}

// Through a file, whose bytes stay in the system's memory.
Result<CodedPicture> code_as_exr_still(const Image<Rgb>& picture, Imf::Compression compression,
                                       float level, const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "still.exr";
  CodedPicture out;
  try {
    out.encode_ms = timed_ms([&] { write_half_exr(file, picture, compression, level); });
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnwritable, file.string(), e.what());
  }
  return read_back(file, std::move(out));
}

// Coder and decoder together: their times are not told apart.
Result<CodedPicture> code_as_av1_still(const Image<Rgb>& picture, int quantiser) {
  CodedPicture out;
  Result<CodedLight> coded = CodedLight{};
  out.encode_ms =
      timed_ms([&] { coded = code_light(LightCoder::kAv1Pq, std::span(&picture, 1), quantiser); });
  PENUMBRA_TRY(coded);
  out.bytes = coded->bytes;
  out.decoded = std::move(coded->maps.at(0));
  return out;
}

}  // namespace

std::vector<StillCoder> still_coders(const std::filesystem::path& folder) {
  std::vector<StillCoder> out;
  for (const auto& [name, coder] :
       {std::pair{"log JPEG 2000, fast (ours)", codec::WaveletCoder::kFast},
        {"log JPEG 2000, small (ours)", codec::WaveletCoder::kSmall}})
    for (const double bits : {8., 4.8, 2.4, 1.2, .48})
      out.push_back({name, fmt::format("{} bits a pixel", bits), [=](const Image<Rgb>& p) {
                       return code_within_bytes(
                           p, coder, static_cast<std::size_t>(bits / 8 * double(p.area())));
                     }});
  for (const double error : {.001, .01})
    out.push_back({"log JPEG 2000, every pixel (ours)", fmt::format("{} %", 100 * error),
                   [=](const Image<Rgb>& p) { return code_every_pixel(p, error); }});
  for (const int step : {150, 400, 1000, 2000, 4000})
    out.push_back({"RGBE, continuous base (ours)", fmt::format("step {} of 4096 a stop", step),
                   [=](const Image<Rgb>& p) { return code_as_rgbe(p, {.coarseness = step}); }});
  for (const auto& [name, base] :
       {std::pair{"RGBE, AJPEG (Xu 2005)", codec::RgbeBase::kAdaptiveJpeg},
        {"RGBE, JPEG (Xu 2005)", codec::RgbeBase::kJpeg}})
    for (const int quality : {95, 85, 70, 50, 25})
      out.push_back({name, fmt::format("quality {}", quality), [=](const Image<Rgb>& p) {
                       return code_as_rgbe(p, {.base = base, .coarseness = coarseness_of(quality)});
                     }});
  out.push_back({"RGBE, arithmetic (Xu 2005)", "without loss", [](const Image<Rgb>& p) {
                   return code_as_rgbe(p, {.base = codec::RgbeBase::kLossless});
                 }});
  out.push_back({"RGBE, Radiance's run lengths", "without loss",
                 [=](const Image<Rgb>& p) { return code_as_radiance(p, folder); }});
  for (const float distance : {.3f, 1.f, 2.f, 4.f, 8.f})
    out.push_back({"JPEG XL", fmt::format("distance {}", distance),
                   [=](const Image<Rgb>& p) { return code_as_jpeg_xl(p, distance); }});
  for (const int quantiser : {8, 20, 32, 44, 56})
    out.push_back({"AVIF, 10 bits in PQ", fmt::format("quantiser {}", quantiser),
                   [=](const Image<Rgb>& p) { return code_as_av1_still(p, quantiser); }});
  for (const int quality : {97, 90, 75, 50})
    out.push_back({"gain-map JPEG (ours)", fmt::format("quality {}", quality),
                   [=](const Image<Rgb>& p) { return code_as_gain_map(p, quality); }});
  for (const float level : {45.f, 200.f, 1000.f, 5000.f})
    out.push_back({"OpenEXR DWAA", fmt::format("level {}", level), [=](const Image<Rgb>& p) {
                     return code_as_exr_still(p, Imf::DWAA_COMPRESSION, level, folder);
                   }});
  out.push_back({"OpenEXR PIZ", "16-bit floats", [=](const Image<Rgb>& p) {
                   return code_as_exr_still(p, Imf::PIZ_COMPRESSION, 0, folder);
                 }});
  return out;
}

}  // namespace penumbra::tools
