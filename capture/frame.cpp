#include <variant>

#include "capture/frames.h"

namespace penumbra::capture {

int width(const FramePixels& pixels) {
  return std::visit([](const auto& image) { return image.width(); }, pixels);
}

int height(const FramePixels& pixels) {
  return std::visit([](const auto& image) { return image.height(); }, pixels);
}

}  // namespace penumbra::capture
