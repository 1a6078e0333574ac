#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <glm/mat3x3.hpp>
#include <memory>

#include "codec/dct/dct_coding.h"
#include "codec/internal/light_planes.h"
#include "codec/internal/rgbe_bases.h"
#include "core/conventions.h"

namespace penumbra::codec {

namespace {

constexpr int kStopBits = 12, kStop = 1 << kStopBits;  // codes of luminance
constexpr int kColourOne = 1 << 15;                    // u' or v' of 1: as kColourPerStop has it
constexpr int kLowestStop = -127, kHighestStop = 127;  // of exponents as frexp has them
constexpr int kMinColour = kColourOne / 10, kMaxColour = kColourOne * 2 / 3;  // beyond Rec.709's

using CodePlane = Image<std::int32_t>;

// Codes of luminance, of u' and v' at half resolution, and exponents, which are 0 for black.
struct ContinuousPlanes {
  CodePlane luminance;
  std::array<CodePlane, 2> colour;
  Image<std::uint8_t> exponent;

  ContinuousPlanes(int width, int height)
      : luminance(width, height),
        colour{CodePlane((width + 1) / 2, (height + 1) / 2),
               CodePlane((width + 1) / 2, (height + 1) / 2)},
        exponent(width, height) {}
};

// A logarithm of straight pieces, from one power of two to the next.
std::int32_t luminance_code(float y) {
  int e = 0;
  const float m = std::frexp(y, &e);
  return kStop * e + static_cast<std::int32_t>(std::lround((2 * m - 1) * kStop));
}

// The value is mantissa 2^(exponent - kStopBits - 1), as frexp's.
struct CodedLuminance {
  int exponent = 0;
  std::int64_t mantissa = 0;
};
CodedLuminance luminance_of_code(std::int32_t code) {
  const std::int32_t in = std::clamp(code, kStop * kLowestStop, kStop * (kHighestStop + 1) - 1);
  return {in >> kStopBits, kStop + (in & (kStop - 1))};
}

// Black, which has none, takes the luminance of what is before it in its row: no edge.
void fill_luminance(const Image<Rgb>& picture, ContinuousPlanes& out) {
  for (int y = 0; y < picture.height(); ++y) {
    std::int32_t before = y > 0 ? out.luminance.at(0, y - 1) : 0;
    for (int x = 0; x < picture.width(); ++x) {
      const Rgb& p = picture.at(x, y);
      int e = 0;
      const float largest = std::max({p.r, p.g, p.b});
      std::frexp(largest, &e);
      if (largest > 0 && e >= kLowestStop) {
        before = luminance_code(luminance(p));
        out.exponent.at(x, y) = static_cast<std::uint8_t>(e + 128);
      }
      out.luminance.at(x, y) = before;
    }
  }
}

// Of the four pixels' light together: the colour of a small lamp is kept.
void fill_colour(const Image<Rgb>& picture, ContinuousPlanes& out) {
  const int width = out.colour[0].width(), height = out.colour[0].height();
  glm::ivec2 before(static_cast<int>(.19784f * kColourOne), static_cast<int>(.46832f * kColourOne));
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      glm::dvec3 rgb(0);
      for (int i = 0; i < 4; ++i) {
        const int px = 2 * x + i % 2, py = 2 * y + i / 2;
        if (px >= picture.width() || py >= picture.height()) continue;
        const Rgb& p = picture.at(px, py);
        rgb += glm::dvec3(p.r, p.g, p.b);
      }
      const glm::dvec3 xyz = glm::dmat3(kXyzFromRgb) * rgb;
      const double sum = xyz.x + 15 * xyz.y + 3 * xyz.z;
      if (sum > 0)
        before = {std::lround(kColourOne * 4 * xyz.x / sum),
                  std::lround(kColourOne * 9 * xyz.y / sum)};
      out.colour[0].at(x, y) = before.x, out.colour[1].at(x, y) = before.y;
    }
}

ContinuousPlanes planes_of(const Image<Rgb>& picture) {
  ContinuousPlanes out(picture.width(), picture.height());
  fill_luminance(picture, out);
  fill_colour(picture, out);
  return out;
}

constexpr int kCosineBits = 13, kFineBits = 4;  // of a coefficient
constexpr std::int64_t kMaxCoefficient = std::int64_t{1} << 28;
using Coefficients = std::array<std::int64_t, 64>;

const std::array<std::int64_t, 64>& whole_cosines() {
  static const std::array<std::int64_t, 64> cosines = [] {
    std::array<std::int64_t, 64> out{};
    for (int k = 0; k < kBlock; ++k) {
      DctBlock one{};
      one[static_cast<std::size_t>(k)] = 1;
      const DctBlock row = transformed(one, true);  // the first row's wave, times that of rows
      for (int i = 0; i < kBlock; ++i)
        out[static_cast<std::size_t>(k * kBlock + i)] =
            std::llround(row[static_cast<std::size_t>(i)] * std::sqrt(8.) * (1 << kCosineBits));
    }
    return out;
  }();
  return cosines;
}

// From coefficients in sixteenths of a code to codes.
std::array<std::int32_t, 64> codes_of(const Coefficients& in) {
  constexpr int kBetween = 6, kLast = 2 * kCosineBits + kFineBits - kBetween;
  const auto& a = whole_cosines();
  Coefficients rows{};
  for (std::size_t y = 0; y < 8; ++y)
    for (std::size_t k = 0; k < 8; ++k)
      for (std::size_t x = 0; x < 8; ++x) rows[y * 8 + x] += a[k * 8 + x] * in[y * 8 + k];
  for (std::int64_t& v : rows) v >>= kBetween;
  Coefficients sums{};
  for (std::size_t k = 0; k < 8; ++k)
    for (std::size_t y = 0; y < 8; ++y)
      for (std::size_t x = 0; x < 8; ++x) sums[y * 8 + x] += a[k * 8 + y] * rows[k * 8 + x];
  std::array<std::int32_t, 64> out{};
  for (std::size_t i = 0; i < 64; ++i)
    out[i] = static_cast<std::int32_t>((sums[i] + (std::int64_t{1} << (kLast - 1))) >> kLast);
  return out;
}

constexpr int kBusyness = 4;  // classes of blocks, by the coefficients beside and above

struct BusyModels {
  NumberModel mean;
  BlockModels block;
};
using PlaneModels = std::array<BusyModels, kBusyness>;

struct ContinuousModels {
  PlaneModels luminance;
  std::array<PlaneModels, 2> colour;
  std::array<BitModel, 3> black;  // by the neighbours that are
  std::array<NumberModel, 16 * 9> exponent;
};

int between(int left, int upper, int corner) {
  return std::clamp(left + upper - corner, std::min(left, upper), std::max(left, upper));
}

template <class Stream>
class ContinuousCoding {
 public:
  ContinuousCoding(Stream& stream, int coarseness) : stream_(stream), step_(coarseness) {}

  /// In: what is to be coded (writing), any (reading); afterwards what a reader gets.
  Image<Rgb> code(ContinuousPlanes& p) {
    code_plane(p.luminance, models_->luminance);
    for (std::size_t c = 0; c < 2; ++c) code_plane(p.colour[c], models_->colour[c]);
    return code_exponents(p);
  }

 private:
  // Steps of coefficients but the mean: what is small is left out, as it costs more than it helps.
  int steps_of(float coefficient, bool mean) const {
    constexpr float kLeftOut = .65f;
    const float size = std::abs(coefficient) / static_cast<float>(step_);
    const int steps = static_cast<int>(size + (mean ? .5f : 1 - kLeftOut));
    return coefficient < 0 ? -steps : steps;
  }

  // Those that are not 0 lie nearer to 0 than the middle of what they stand for.
  std::int64_t coefficient_of(int steps, bool mean) const {
    constexpr std::int64_t kFine = 1 << kFineBits;
    const std::int64_t size = std::abs(std::int64_t{steps}) * step_ * kFine -
                              (mean || steps == 0 ? 0 : step_ * kFine * 3 / 40);
    return std::clamp(steps < 0 ? -size : size, -kMaxCoefficient, kMaxCoefficient);
  }

  std::array<int, 64> steps_of_block(const CodePlane& plane, int x0, int y0) const {
    DctBlock block{};
    for (int i = 0; i < 64; ++i)
      block[static_cast<std::size_t>(i)] =
          static_cast<float>(plane.at(std::min(x0 + i % kBlock, plane.width() - 1),
                                      std::min(y0 + i / kBlock, plane.height() - 1)));
    block = transformed(block, false);
    std::array<int, 64> out{};
    for (std::size_t k = 0; k < 64; ++k)
      out[k] = steps_of(block[static_cast<std::size_t>(zigzag()[k])], k == 0);
    return out;
  }

  // In the order of diagonals; the mean has been coded. Gives how many are not 0.
  int code_waves(BlockModels& models, std::array<int, 64>& steps) {
    int last = 0, count = 0;
    if constexpr (Stream::kWrites)
      for (int k = 1; k < 64; ++k)
        if (steps[static_cast<std::size_t>(k)] != 0) last = k;
    if (stream_.bit(models.empty, last == 0)) return 0;
    for (std::size_t k = 1; k < 64; ++k) {
      const int v = steps[k] = stream_.number(models.coefficient[k], steps[k]);
      if (v == 0) continue;
      ++count;
      if (stream_.bit(models.last[k], static_cast<int>(k) == last)) break;
    }
    return count;
  }

  // Beside: to the left, above, and above to the left, of numbers by block; 0 beyond the edge.
  struct Beside {
    int left = 0, upper = 0, corner = 0;
  };
  static Beside beside(const Image<int>& blocks, int bx, int by) {
    return {bx > 0 ? blocks.at(bx - 1, by) : 0, by > 0 ? blocks.at(bx, by - 1) : 0,
            bx > 0 && by > 0 ? blocks.at(bx - 1, by - 1) : 0};
  }

  void code_plane(CodePlane& plane, PlaneModels& models) {
    const int wide = (plane.width() + kBlock - 1) / kBlock,
              high = (plane.height() + kBlock - 1) / kBlock;
    Image<int> means(wide, high), counts(wide, high);
    for (int by = 0; by < high; ++by)
      for (int bx = 0; bx < wide; ++bx) {
        std::array<int, 64> steps{};
        if constexpr (Stream::kWrites) steps = steps_of_block(plane, bx * kBlock, by * kBlock);
        const Beside n = beside(counts, bx, by), m = beside(means, bx, by);
        const int busy = n.left + n.upper;
        BusyModels& its = models[busy == 0 ? 0 : busy < 6 ? 1 : busy < 20 ? 2 : 3];
        const int guess = by == 0 ? m.left : bx == 0 ? m.upper : between(m.left, m.upper, m.corner);
        steps[0] = guess + stream_.number(its.mean, steps[0] - guess);
        means.at(bx, by) = std::clamp(steps[0], -kMaxMean, kMaxMean);
        counts.at(bx, by) = code_waves(its.block, steps);
        put_block(plane, bx * kBlock, by * kBlock, steps);
      }
  }

  void put_block(CodePlane& plane, int x0, int y0, const std::array<int, 64>& steps) const {
    Coefficients coefficients{};
    for (std::size_t k = 0; k < 64; ++k)
      coefficients[static_cast<std::size_t>(zigzag()[k])] = coefficient_of(steps[k], k == 0);
    const std::array<std::int32_t, 64> codes = codes_of(coefficients);
    for (int i = 0; i < 64; ++i) {
      const int x = x0 + i % kBlock, y = y0 + i / kBlock;
      if (x < plane.width() && y < plane.height())
        plane.at(x, y) = codes[static_cast<std::size_t>(i)];
    }
  }

  // Of the brightest of the pixels that a colour is of, as it is their light's.
  static std::int32_t luminance_of_colour(const CodePlane& luminance, int x, int y) {
    std::int32_t out = luminance.at(2 * x, 2 * y);
    for (int i = 1; i < 4; ++i)
      out = std::max(out, luminance.at(std::min(2 * x + i % 2, luminance.width() - 1),
                                       std::min(2 * y + i / 2, luminance.height() - 1)));
    return out;
  }

  struct Colour {
    std::int64_t u = 0, v = 0;
  };

  // Between the middles of four pixels, as JPEG's readers do, but rather of those as bright.
  static Colour colour_at(const ContinuousPlanes& p, int x, int y) {
    constexpr std::int64_t kOne = 1 << 12;
    const CodePlane &us = p.colour[0], &vs = p.colour[1];
    const int nx = x / 2, ny = y / 2;
    const int fx = std::clamp(nx + (x % 2 == 0 ? -1 : 1), 0, us.width() - 1),
              fy = std::clamp(ny + (y % 2 == 0 ? -1 : 1), 0, us.height() - 1);
    const std::int64_t here = p.luminance.at(x, y);
    Colour sum;
    std::int64_t weights = 0;
    const auto add = [&](std::int64_t near, int cx, int cy) {
      const std::int64_t half_stops = std::min<std::int64_t>(
          64, std::abs(here - luminance_of_colour(p.luminance, cx, cy)) / (kStop / 2));
      const std::int64_t weight = near * kOne / (1 + half_stops * half_stops);
      sum.u += weight * us.at(cx, cy), sum.v += weight * vs.at(cx, cy);
      weights += weight;
    };
    add(9, nx, ny), add(3, fx, ny), add(3, nx, fy), add(1, fx, fy);
    return {std::clamp<std::int64_t>(sum.u / weights, kMinColour, kMaxColour),
            std::clamp<std::int64_t>(sum.v / weights, kMinColour, kMaxColour)};
  }

  // Channels of a colour of u' and v', over what its luminance is in the same measure.
  struct Channels {
    std::array<std::int64_t, 3> of{};
    std::int64_t luminance = 1;
  };
  static Channels channels_of(const Colour& colour) {
    constexpr int kBits = 12;
    static const std::array<std::array<std::int64_t, 3>, 3> rgb_from_uv1 = [] {
      // 4 v' times X, Y and Z over Y: 9 u', 4 v', 12 - 3 u' - 20 v'.
      std::array<std::array<std::int64_t, 3>, 3> out{};
      for (int c = 0; c < 3; ++c) {
        const double x = kRgbFromXyz[0][c], y = kRgbFromXyz[1][c], z = kRgbFromXyz[2][c];
        const auto fixed = [](double w) { return std::llround(w * (1 << kBits)); };
        out[static_cast<std::size_t>(c)] = {fixed(9 * x - 3 * z), fixed(4 * y - 20 * z),
                                            fixed(12 * z)};
      }
      return out;
    }();
    Channels out;
    std::int64_t sum = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      const auto& w = rgb_from_uv1[c];
      out.of[c] = std::max<std::int64_t>(0, w[0] * colour.u + w[1] * colour.v + w[2] * kColourOne);
      sum += std::llround(double{kLuminance[static_cast<int>(c)]} * (1 << kBits)) * out.of[c];
    }
    out.luminance = std::max<std::int64_t>(1, sum >> kBits);
    return out;
  }

  // The largest channel, as a mantissa of some bits: what its exponent is expected to be.
  struct LikelyExponent {
    int exponent = 0, sixteenth = 0;  // of the way to the next one
  };
  static LikelyExponent likely_exponent(const CodedLuminance& y, const Channels& c) {
    const std::int64_t largest = std::max({c.of[0], c.of[1], c.of[2]});
    const auto n = static_cast<std::uint64_t>(
        std::max<std::int64_t>(16, (y.mantissa * largest << kFineBits) / c.luminance));
    const int bits = std::bit_width(n);
    return {y.exponent + bits - (kStopBits + 1 + kFineBits),
            static_cast<int>(n >> (bits - 5) & 15)};
  }

  Image<Rgb> code_exponents(ContinuousPlanes& p) {
    const int width = p.exponent.width(), height = p.exponent.height();
    Image<Rgb> out(width, height);
    Image<int> missed(width, height);
    const auto is_black = [&](int x, int y) {
      return x >= 0 && y >= 0 && p.exponent.at(x, y) == 0;
    };
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        std::uint8_t& exponent = p.exponent.at(x, y);
        const int black = is_black(x - 1, y) + is_black(x, y - 1);
        if (stream_.bit(models_->black[static_cast<std::size_t>(black)], exponent == 0)) {
          exponent = 0;
          continue;
        }
        const CodedLuminance light = luminance_of_code(p.luminance.at(x, y));
        const Channels channels = channels_of(colour_at(p, x, y));
        const LikelyExponent guess = likely_exponent(light, channels);
        const int left = x > 0 ? missed.at(x - 1, y) : 0, upper = y > 0 ? missed.at(x, y - 1) : 0;
        const int context =
            guess.sixteenth * 9 + (std::clamp(left, -1, 1) + 1) * 3 + std::clamp(upper, -1, 1) + 1;
        const int off = stream_.number(models_->exponent[static_cast<std::size_t>(context)],
                                       exponent - 128 - guess.exponent);
        missed.at(x, y) = off;
        const int is = std::clamp(guess.exponent + off, kLowestStop, kHighestStop);
        exponent = static_cast<std::uint8_t>(is + 128);
        out.at(x, y) = pixel_of(light, channels, is);
      }
    return out;
  }

  // With a largest channel as its exponent allows: its colour, which is known less well than its
  // luminance, gives way first.
  static Rgb pixel_of(const CodedLuminance& light, const Channels& channels, int exponent) {
    const float y = std::ldexp(static_cast<float>(light.mantissa), light.exponent - kStopBits - 1);
    Rgb out;
    for (int c = 0; c < 3; ++c)
      out[c] = y * (static_cast<float>(channels.of[static_cast<std::size_t>(c)]) /
                    static_cast<float>(channels.luminance));
    const float largest = std::max({out.r, out.g, out.b}), least = std::min({out.r, out.g, out.b});
    const float allowed =
        std::clamp(largest, std::ldexp(257 / 512.f, exponent), std::ldexp(511 / 512.f, exponent));
    if (allowed == largest) return out;
    const float most = least < y ? y / (y - least) : 1;  // of saturation, where a channel is 0
    const float saturation = largest > y ? std::clamp((allowed - y) / (largest - y), 0.f, most) : 1;
    const Rgb grey{y, y, y}, near = grey + saturation * (out - grey);
    return allowed / std::max({near.r, near.g, near.b}) * near;
  }

  static constexpr int kMaxMean = 1 << 24;  // damage does not add up beyond numbers
  Stream& stream_;
  int step_;
  std::unique_ptr<ContinuousModels> models_ = std::make_unique<ContinuousModels>();
};

}  // namespace

std::vector<unsigned char> write_continuous_base(const Image<Rgb>& picture, int coarseness) {
  BitWriter writer;
  ContinuousPlanes planes = planes_of(picture);
  ContinuousCoding(writer, coarseness).code(planes);
  return writer.finish();
}

Image<Rgb> read_continuous_base(std::span<const unsigned char> bytes, int width, int height,
                                int coarseness) {
  BitReader reader(bytes);
  ContinuousPlanes planes(width, height);
  return ContinuousCoding(reader, coarseness).code(planes);
}

}  // namespace penumbra::codec
