#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "codec/codec.h"
#include "codec/dct/rgbe_still.h"
#include "codec/gain_map_jpeg.h"
#include "codec/log/log_jpeg2000.h"
#include "core/io/hash.h"

namespace {

// With the fingerprint of what follows it, so that what it keeps out is read, too.
penumbra::Result<penumbra::codec::HdrImage> read_signed_still(const std::uint8_t* data,
                                                              std::size_t size) {
  constexpr std::size_t kAt = 8, kFrom = 16, kHead = 32;
  std::vector<unsigned char> bytes(data, data + size);
  if (size >= kHead) {
    // Sides below 256, as larger ones take time and show nothing else.
    for (const std::size_t byte : {17, 18, 19, 21, 22, 23}) bytes[byte] = 0;
    const std::uint64_t sum =
        penumbra::Fnv1a().add(bytes.data() + kFrom, bytes.size() - kFrom).value();
    std::memcpy(bytes.data() + kAt, &sum, sizeof sum);
  }
  return penumbra::codec::decode_rgbe_still(bytes, "fuzz");
}

}  // namespace

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const bool jpeg = size > 1 && data[0] == 0xff && data[1] == 0xd8;
  const auto result = jpeg ? penumbra::codec::decode_gain_map_jpeg({data, size}, "fuzz")
                      : penumbra::codec::is_rgbe_still({data, size}) ? read_signed_still(data, size)
                      : penumbra::codec::is_jpeg2000({data, size})
                          ? penumbra::codec::decode_log_jpeg2000({data, size}, "fuzz")
                          : penumbra::codec::decode_radiance({data, size}, "fuzz");
  // A picture that is neither an error nor of its declared size is a bug too.
  if (result && result->pixels.empty()) __builtin_trap();
  return 0;
}
