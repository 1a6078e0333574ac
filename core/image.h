// Images: a pixel type, a width and a height; rows are contiguous, row 0 is the top.
// threads: plain values
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <variant>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// Linear Rec.709 float RGB: radiance, irradiance or a ratio, as the owner's name says.
struct Rgb {
  float r = 0, g = 0, b = 0;

  float& operator[](int c) { return (&r)[c]; }
  float operator[](int c) const { return (&r)[c]; }
  friend bool operator==(const Rgb&, const Rgb&) = default;
  friend Rgb operator+(Rgb a, Rgb b) { return {a.r + b.r, a.g + b.g, a.b + b.b}; }
  friend Rgb operator-(Rgb a, Rgb b) { return {a.r - b.r, a.g - b.g, a.b - b.b}; }
  friend Rgb operator*(Rgb a, Rgb b) { return {a.r * b.r, a.g * b.g, a.b * b.b}; }
  friend Rgb operator*(Rgb a, float k) { return {a.r * k, a.g * k, a.b * k}; }
  friend Rgb operator*(float k, Rgb a) { return a * k; }
  Rgb& operator+=(Rgb o) { return *this = *this + o; }
};

/// Sensor codes after the camera's response. Trivial, as the standard library copies images of
/// trivial pixels at once, and others one by one: write Rgb8{} for black.
struct Rgb8 {
  std::uint8_t r, g, b;
  friend bool operator==(const Rgb8&, const Rgb8&) = default;
};
struct Rgb16 {
  std::uint16_t r, g, b;
  friend bool operator==(const Rgb16&, const Rgb16&) = default;
};

static_assert(std::is_trivial_v<Rgb8> && std::is_trivial_v<Rgb16>);

/// Half-float RGB radiance and a fourth channel, as IEEE 754 binary16 bits; eight bytes so that two
/// neighbours load at once. The fourth channel is the confidence 0..1 (0 = clipped or never seen).
struct HalfRgba {
  std::uint16_t r = 0, g = 0, b = 0, a = 0;
  friend bool operator==(const HalfRgba&, const HalfRgba&) = default;
};

template <class Pixel>
class Image {
 public:
  Image() = default;
  Image(int width, int height, Pixel fill = {})
      : width_(width), height_(height), pixels_(checked_area(width, height), fill) {}

  /// Another size, all pixels alike; keeps its memory.
  void reset(int width, int height, Pixel fill = {}) {
    pixels_.assign(checked_area(width, height), fill);
    width_ = width, height_ = height;
  }

  int width() const { return width_; }
  int height() const { return height_; }
  std::size_t area() const { return pixels_.size(); }
  bool empty() const { return pixels_.empty(); }

  Pixel& at(int x, int y) { return pixels_[index(x, y)]; }
  const Pixel& at(int x, int y) const { return pixels_[index(x, y)]; }
  std::span<Pixel> row(int y) { return {&pixels_[index(0, y)], static_cast<std::size_t>(width_)}; }
  std::span<const Pixel> row(int y) const {
    return {&pixels_[index(0, y)], static_cast<std::size_t>(width_)};
  }
  std::span<Pixel> pixels() { return pixels_; }
  std::span<const Pixel> pixels() const { return pixels_; }

  bool same_size(const auto& other) const {
    return width_ == other.width() && height_ == other.height();
  }
  friend bool operator==(const Image&, const Image&) = default;

 private:
  static std::size_t checked_area(int width, int height) {
    assert(width >= 0 && height >= 0);
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  }
  std::size_t index(int x, int y) const {
    assert(x >= 0 && x < width_ && y >= 0 && y < height_);
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }

  int width_ = 0, height_ = 0;
  std::vector<Pixel> pixels_;
};

/// What a camera delivers: 8 or 16 bit codes, or linear float from a float file.
using FramePixels = std::variant<Image<Rgb8>, Image<Rgb16>, Image<Rgb>>;

}  // namespace penumbra
#pragma GCC visibility pop
