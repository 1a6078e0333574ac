// Camera frames and textures: PNG, JPEG, TIFF and OpenEXR, by content.
#include <cstddef>
#include <cstdint>
#include <variant>

#include "codec/codec.h"

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto frame = penumbra::codec::decode_frame_with_alpha({data, size}, "fuzz");
  if (!frame) return 0;
  const auto has_pixels = [](const auto& image) {
    return image.width() > 0 && image.height() > 0 &&
           image.area() ==
               static_cast<std::size_t>(image.width()) * static_cast<std::size_t>(image.height());
  };
  if (!std::visit(has_pixels, frame->pixels)) __builtin_trap();
  if (!frame->alpha.empty() && !has_pixels(frame->alpha)) __builtin_trap();
  return 0;
}
