// source: ISO/IEC 15444-1, and OpenJPEG's interface
#include <openjpeg.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <memory>
#include <optional>
#include <utility>

#include "codec/internal/formats.h"
#include "codec/internal/wavelets.h"

namespace penumbra::codec {

namespace {

using OwnedImage = std::unique_ptr<opj_image_t, decltype(&opj_image_destroy)>;
using OwnedCodec = std::unique_ptr<opj_codec_t, decltype(&opj_destroy_codec)>;
using OwnedStream = std::unique_ptr<opj_stream_t, decltype(&opj_stream_destroy)>;

constexpr std::size_t kFreePixels = std::size_t{1} << 20, kPixelsPerByte = std::size_t{1} << 10;

// The last of the library's messages, as the reason of an error.
void keep_message(const char* message, void* text) {
  std::string& out = *static_cast<std::string*>(text);
  out = message;
  while (!out.empty() && out.back() == '\n') out.pop_back();
}

struct BytesToRead {
  std::span<const unsigned char> bytes;
  std::size_t at = 0;
};

OwnedStream stream_of(BytesToRead& in) {
  OwnedStream stream(opj_stream_default_create(OPJ_TRUE), opj_stream_destroy);
  opj_stream_set_user_data(stream.get(), &in, nullptr);
  opj_stream_set_user_data_length(stream.get(), in.bytes.size());
  opj_stream_set_read_function(
      stream.get(), [](void* to, OPJ_SIZE_T count, void* user) -> OPJ_SIZE_T {
        auto& from = *static_cast<BytesToRead*>(user);
        const std::size_t n = std::min<std::size_t>(count, from.bytes.size() - from.at);
        if (n == 0) return static_cast<OPJ_SIZE_T>(-1);  // the end
        std::memcpy(to, from.bytes.data() + from.at, n);
        from.at += n;
        return n;
      });
  opj_stream_set_skip_function(stream.get(), [](OPJ_OFF_T count, void* user) -> OPJ_OFF_T {
    auto& from = *static_cast<BytesToRead*>(user);
    if (count < 0) return -1;
    const auto n =
        std::min<std::size_t>(static_cast<std::size_t>(count), from.bytes.size() - from.at);
    from.at += n;
    return n > 0 || count == 0 ? static_cast<OPJ_OFF_T>(n) : -1;
  });
  opj_stream_set_seek_function(stream.get(), [](OPJ_OFF_T to, void* user) -> OPJ_BOOL {
    auto& from = *static_cast<BytesToRead*>(user);
    if (to < 0 || static_cast<std::size_t>(to) > from.bytes.size()) return OPJ_FALSE;
    from.at = static_cast<std::size_t>(to);
    return OPJ_TRUE;
  });
  return stream;
}

struct BytesWritten {
  std::vector<unsigned char> bytes;
  std::size_t at = 0;
};

OwnedStream stream_of(BytesWritten& out) {
  OwnedStream stream(opj_stream_default_create(OPJ_FALSE), opj_stream_destroy);
  opj_stream_set_user_data(stream.get(), &out, nullptr);
  opj_stream_set_write_function(stream.get(),
                                [](void* from, OPJ_SIZE_T count, void* user) -> OPJ_SIZE_T {
                                  auto& to = *static_cast<BytesWritten*>(user);
                                  if (to.bytes.size() < to.at + count)
                                    to.bytes.resize(to.at + count);
                                  std::memcpy(to.bytes.data() + to.at, from, count);
                                  to.at += count;
                                  return count;
                                });
  opj_stream_set_skip_function(stream.get(), [](OPJ_OFF_T count, void* user) -> OPJ_OFF_T {
    static_cast<BytesWritten*>(user)->at += static_cast<std::size_t>(count);
    return count;
  });
  opj_stream_set_seek_function(stream.get(), [](OPJ_OFF_T to, void* user) -> OPJ_BOOL {
    static_cast<BytesWritten*>(user)->at = static_cast<std::size_t>(to);
    return OPJ_TRUE;
  });
  return stream;
}

OwnedImage image_of(const LightPlanes& planes) {
  std::array<opj_image_cmptparm_t, kPlanes> kinds{};
  for (auto& kind : kinds) {
    kind.dx = kind.dy = 1;
    kind.w = static_cast<OPJ_UINT32>(planes.width), kind.h = static_cast<OPJ_UINT32>(planes.height);
    kind.prec = kPlaneBits;
  }
  OwnedImage image(opj_image_create(kPlanes, kinds.data(), OPJ_CLRSPC_SYCC), opj_image_destroy);
  if (!image) return image;
  image->x1 = kinds[0].w, image->y1 = kinds[0].h;
  for (std::size_t c = 0; c < kPlanes; ++c)
    std::ranges::copy(planes.codes[c], image->comps[c].data);
  return image;
}

// How often wavelets halve it: five times, or as often as its shorter side can be.
int levels_of(const LightPlanes& planes) {
  constexpr int kMaxLevels = 5;
  const auto side = static_cast<unsigned>(std::min(planes.width, planes.height));
  return std::min(kMaxLevels, static_cast<int>(std::bit_width(side)) - 1);
}

struct PlaneSize {
  std::uint32_t width = 0, height = 0;
};

// Of a codestream of three planes of 16 bits in one tile, as the encoders write it. It is read here
// since OpenJPEG makes room for all tiles and planes that a stream claims.
// source: ISO/IEC 15444-1, A.5.1
std::optional<PlaneSize> size_of_planes(std::span<const unsigned char> bytes) {
  constexpr std::size_t kBeforePlanes = 42, kBytes = kBeforePlanes + 3 * kPlanes;
  if (bytes.size() < kBytes) return {};
  const auto number = [&](std::size_t at) {
    return std::uint32_t{bytes[at]} << 24 | std::uint32_t{bytes[at + 1]} << 16 |
           std::uint32_t{bytes[at + 2]} << 8 | bytes[at + 3];
  };
  constexpr std::uint32_t kStartAndSize = 0xff4fff51;
  const PlaneSize size{number(8), number(12)};
  const bool at_origin = number(16) == 0 && number(20) == 0 && number(32) == 0 && number(36) == 0;
  if (number(0) != kStartAndSize || !at_origin || number(24) < size.width ||
      number(28) < size.height || bytes[40] != 0 || bytes[41] != kPlanes)
    return {};
  for (std::size_t at = kBeforePlanes; at < kBytes; at += 3)
    if (bytes[at] != kPlaneBits - 1 || bytes[at + 1] != 1 || bytes[at + 2] != 1) return {};
  return size;
}

// The same as the library has read it.
bool is_of_size(const opj_image_t& image, const PlaneSize& size) {
  if (image.numcomps != kPlanes) return false;
  return std::all_of(image.comps, image.comps + kPlanes, [&](const opj_image_comp_t& plane) {
    return plane.w == size.width && plane.h == size.height;
  });
}

}  // namespace

std::size_t min_codestream_bytes(std::int64_t width, std::int64_t height) {
  const auto area = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  return area <= kFreePixels ? 0 : (area - kFreePixels) / kPixelsPerByte;
}

Result<std::vector<unsigned char>> encode_small_wavelets(const LightPlanes& planes,
                                                         double coarseness) {
  opj_cparameters_t parameters;
  opj_set_default_encoder_parameters(&parameters);
  parameters.irreversible = coarseness > 0;
  parameters.numresolution = 1 + levels_of(planes);
  parameters.tcp_numlayers = 1;
  parameters.cp_disto_alloc = 1;
  parameters.tcp_rates[0] = static_cast<float>(coarseness);  // 0: all bits
  const OwnedImage image = image_of(planes);
  const OwnedCodec codec(opj_create_compress(OPJ_CODEC_J2K), opj_destroy_codec);
  std::string reason = "out of memory";
  BytesWritten out;
  const OwnedStream stream = stream_of(out);
  opj_set_error_handler(codec.get(), keep_message, &reason);
  if (!image || !opj_setup_encoder(codec.get(), &parameters, image.get()) ||
      !opj_start_compress(codec.get(), image.get(), stream.get()) ||
      !opj_encode(codec.get(), stream.get()) || !opj_end_compress(codec.get(), stream.get()))
    return fail(ErrorCode::kUnwritable, "picture", "OpenJPEG: " + reason);
  return std::move(out.bytes);
}

Result<LightPlanes> decode_wavelets(std::span<const unsigned char> codestream,
                                    const std::string& name) {
  const auto size = size_of_planes(codestream);
  if (!size)
    return fail(ErrorCode::kUnreadable, name,
                "does not begin as a codestream of three planes of 16 bits in one tile");
  PENUMBRA_TRY(check_size(std::int64_t{size->width}, std::int64_t{size->height}, name));
  if (codestream.size() < min_codestream_bytes(size->width, size->height))
    return fail(ErrorCode::kInvalid, name,
                "says that it has " + std::to_string(size->width) + " x " +
                    std::to_string(size->height) + " pixels, which its " +
                    std::to_string(codestream.size()) + " bytes cannot hold");
  BytesToRead in{codestream};
  const OwnedStream stream = stream_of(in);
  const OwnedCodec codec(opj_create_decompress(OPJ_CODEC_J2K), opj_destroy_codec);
  std::string reason = "its codestream cannot be read";
  opj_set_error_handler(codec.get(), keep_message, &reason);
  opj_dparameters_t parameters;
  opj_set_default_decoder_parameters(&parameters);
  opj_image_t* read = nullptr;
  const bool has_head = opj_setup_decoder(codec.get(), &parameters) &&
                        opj_codec_set_threads(codec.get(), opj_get_num_cpus()) &&
                        opj_decoder_set_strict_mode(codec.get(), OPJ_TRUE) &&
                        opj_read_header(stream.get(), codec.get(), &read);
  const OwnedImage image(read, opj_image_destroy);
  if (!has_head || !image || !is_of_size(*image, *size) ||
      !opj_decode(codec.get(), stream.get(), image.get()) ||
      !opj_end_decompress(codec.get(), stream.get()) || !is_of_size(*image, *size))
    return fail(ErrorCode::kUnreadable, name, "is damaged: " + reason);
  LightPlanes out;
  out.width = static_cast<int>(size->width), out.height = static_cast<int>(size->height);
  const std::size_t area =
      static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height);
  for (std::size_t c = 0; c < kPlanes; ++c) {
    if (image->comps[c].data == nullptr)
      return fail(ErrorCode::kUnreadable, name, "is damaged: a plane is missing");
    out.codes[c].assign(image->comps[c].data, image->comps[c].data + area);
  }
  return out;
}

}  // namespace penumbra::codec
