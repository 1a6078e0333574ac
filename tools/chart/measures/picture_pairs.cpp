#include "tools/chart/measures/picture_pairs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "core/conventions.h"

namespace penumbra::tools {

namespace {

Result<void> check_pixels(const Image<Rgb>& picture, const char* name) {
  for (int y = 0; y < picture.height(); ++y)
    for (int x = 0; x < picture.width(); ++x)
      if (!is_finite(picture.at(x, y)))
        return fail(ErrorCode::kNonFinite, name, fmt::format("pixel ({}, {}) is not finite", x, y));
  return {};
}

std::uint8_t code_of_unit(float v) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(v, 0.f, 1.f)));
}

}  // namespace

Result<void> check_pair(const Image<Rgb>& reference, const Image<Rgb>& test) {
  if (!reference.same_size(test))
    return fail(ErrorCode::kInvalid, "test picture",
                fmt::format("has {}x{} pixels, but the reference has {}x{}", test.width(),
                            test.height(), reference.width(), reference.height()));
  if (reference.empty()) return fail(ErrorCode::kInvalid, "reference picture", "has no pixels");
  PENUMBRA_TRY(check_pixels(reference, "reference picture"));
  return check_pixels(test, "test picture");
}

Image<float> shown_luminance(const Image<Rgb>& picture) {
  Image<float> out(picture.width(), picture.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const Rgb& c = picture.pixels()[i];
    out.pixels()[i] = luminance({std::max(c.r, 0.f), std::max(c.g, 0.f), std::max(c.b, 0.f)});
  }
  return out;
}

Image<Rgb8> heat_picture(const Image<float>& error) {
  Image<Rgb8> out(error.width(), error.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const float e = 3 * error.pixels()[i];
    out.pixels()[i] = {code_of_unit(e), code_of_unit(e - 1), code_of_unit(e - 2)};
  }
  return out;
}

}  // namespace penumbra::tools
