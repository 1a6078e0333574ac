#include <cstddef>
#include <cstdint>

#include "codec/codec.h"
#include "codec/gain_map_jpeg.h"
#include "codec/log/log_jpeg2000.h"

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const bool jpeg = size > 1 && data[0] == 0xff && data[1] == 0xd8;
  const auto result = jpeg ? penumbra::codec::decode_gain_map_jpeg({data, size}, "fuzz")
                      : penumbra::codec::is_jpeg2000({data, size})
                          ? penumbra::codec::decode_log_jpeg2000({data, size}, "fuzz")
                          : penumbra::codec::decode_radiance({data, size}, "fuzz");
  // A picture that is neither an error nor of its declared size is a bug too.
  if (result && result->pixels.empty()) __builtin_trap();
  return 0;
}
