#include "service/outputs/colour_conversion.h"

#include <algorithm>
#include <cassert>

namespace penumbra::service {

namespace {

// With 16 binary places a value is off by less than 0.01 codes before it is rounded.
constexpr int kPlaces = 16;
constexpr int fixed(double v) {
  return static_cast<int>(v * (1 << kPlaces) + (v < 0 ? -.5 : .5));
}

constexpr double kRed = .2126, kBlue = .0722;
constexpr double kLumaScale = 219. / 255, kChromaScale = 224. / 255;
constexpr int kYr = fixed(kRed * kLumaScale), kYb = fixed(kBlue * kLumaScale);
constexpr int kYg = fixed(kLumaScale) - kYr - kYb;
constexpr int kHalf = fixed(.5 * kChromaScale);
// Of grey nothing remains, so the greens take what is over.
constexpr int kCbR = fixed(-.5 * kChromaScale * kRed / (1 - kBlue)), kCbG = -kHalf - kCbR;
constexpr int kCrB = fixed(-.5 * kChromaScale * kBlue / (1 - kRed)), kCrG = -kHalf - kCrB;

inline std::uint8_t luma(Rgb8 p) {
  constexpr int kOffset = (16 << kPlaces) + (1 << (kPlaces - 1));
  return static_cast<std::uint8_t>((kYr * p.r + kYg * p.g + kYb * p.b + kOffset) >> kPlaces);
}

// What weights of 1 2 1 in the row and 1 1 between rows make of the pixels around an even column.
struct Around {
  int r, g, b;
};
constexpr int kWeights = 3;  // binary places that the weights add

inline Around around(const Rgb8* upper, const Rgb8* lower, int left, int middle, int right) {
  const auto sum = [&](auto channel) {
    return upper[left].*channel + lower[left].*channel +
           2 * (upper[middle].*channel + lower[middle].*channel) + upper[right].*channel +
           lower[right].*channel;
  };
  return {sum(&Rgb8::r), sum(&Rgb8::g), sum(&Rgb8::b)};
}

constexpr int kChromaPlaces = kPlaces + kWeights;
constexpr int kChromaOffset = (128 << kChromaPlaces) + (1 << (kChromaPlaces - 1));

inline std::uint8_t chroma_blue(const Around& a) {
  return static_cast<std::uint8_t>((kCbR * a.r + kCbG * a.g + kHalf * a.b + kChromaOffset) >>
                                   kChromaPlaces);
}
inline std::uint8_t chroma_red(const Around& a) {
  return static_cast<std::uint8_t>((kHalf * a.r + kCrG * a.g + kCrB * a.b + kChromaOffset) >>
                                   kChromaPlaces);
}

// Calls write(column / 2, Cb, Cr) for each even column. The borders repeat.
template <class Write>
void chroma_row(const Rgb8* upper, const Rgb8* lower, int width, Write write) {
  const auto at = [&](int x, int left, int right) {
    const Around a = around(upper, lower, left, x, right);
    write(x / 2, chroma_blue(a), chroma_red(a));
  };
  at(0, 0, std::min(1, width - 1));
  int x = 2;
  for (; x + 1 < width; x += 2) at(x, x - 1, x + 1);
  if (x < width) at(x, x - 1, x);
}

}  // namespace

std::size_t yuv420_bytes(int width, int height) {
  const auto area = [](int w, int h) {
    return static_cast<std::size_t>(w) * static_cast<std::size_t>(h);
  };
  return area(width, height) + 2 * area((width + 1) / 2, (height + 1) / 2);
}

void to_yuv420(const Image<Rgb8>& in, std::span<std::uint8_t> out) {
  const int width = in.width(), height = in.height();
  assert(out.size() == yuv420_bytes(width, height));
  if (in.empty()) return;
  std::ranges::transform(in.pixels(), out.begin(), luma);
  const auto chroma_width = static_cast<std::size_t>((width + 1) / 2);
  std::uint8_t* blue = out.data() + in.area();
  std::uint8_t* red = blue + chroma_width * static_cast<std::size_t>((height + 1) / 2);
  for (int y = 0; y < height; y += 2, blue += chroma_width, red += chroma_width)
    chroma_row(in.row(y).data(), in.row(std::min(y + 1, height - 1)).data(), width,
               [&](int x, std::uint8_t cb, std::uint8_t cr) { blue[x] = cb, red[x] = cr; });
}

void to_yuyv(const Image<Rgb8>& in, std::uint8_t* out, std::size_t row_bytes) {
  assert(in.width() % 2 == 0 && row_bytes >= static_cast<std::size_t>(in.width()) * 2);
  if (in.empty()) return;
  for (int y = 0; y < in.height(); ++y, out += row_bytes) {
    const Rgb8* const row = in.row(y).data();
    chroma_row(row, row, in.width(), [&](int x, std::uint8_t cb, std::uint8_t cr) {
      std::uint8_t* const to = out + 4 * x;
      to[0] = luma(row[2 * x]), to[1] = cb, to[2] = luma(row[2 * x + 1]), to[3] = cr;
    });
  }
}

void to_bgrx(const Image<Rgb8>& in, std::uint8_t* out, std::size_t row_bytes) {
  assert(row_bytes >= static_cast<std::size_t>(in.width()) * 4);
  for (int y = 0; y < in.height(); ++y, out += row_bytes) {
    std::uint8_t* to = out;
    for (const Rgb8& p : in.row(y)) {
      to[0] = p.b, to[1] = p.g, to[2] = p.r, to[3] = 255;
      to += 4;
    }
  }
}

}  // namespace penumbra::service
