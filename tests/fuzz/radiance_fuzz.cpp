#include <cstddef>
#include <cstdint>

#include "codec/codec.h"

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto result = penumbra::codec::decode_radiance({data, size}, "fuzz");
  // A picture that is neither an error nor of its declared size is a bug too.
  if (result && result->pixels.empty()) __builtin_trap();
  return 0;
}
