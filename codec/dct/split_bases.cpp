#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>

#include "codec/dct/dct_coding.h"
#include "codec/internal/rgbe_bases.h"

namespace penumbra::codec {

namespace {

constexpr int kRestlessness = 8;

using BytePlane = Image<std::uint8_t>;

struct RgbePlanes {
  std::array<BytePlane, 3> base;
  BytePlane exponent;

  RgbePlanes(int width, int height)
      : base{BytePlane(width, height), BytePlane(width, height), BytePlane(width, height)},
        exponent(width, height) {}
};

// Equation 4.2, rounded as Radiance's files are; 0 has exponent 0.
RgbePlanes rgbe_of(const Image<Rgb>& picture) {
  RgbePlanes out(picture.width(), picture.height());
  for (std::size_t i = 0; i < picture.area(); ++i) {
    const Rgb& p = picture.pixels()[i];
    const float largest = std::max({p.r, p.g, p.b});
    int e = 0;
    std::frexp(largest, &e);
    // Rounding may carry into the next power of two.
    if (std::lround(std::ldexp(largest, 8 - e)) > 255) ++e;
    if (!(largest > 0) || e < -127) continue;
    for (int c = 0; c < 3; ++c)
      out.base[static_cast<std::size_t>(c)].pixels()[i] =
          static_cast<std::uint8_t>(std::lround(std::ldexp(std::max(p[c], 0.f), 8 - e)));
    out.exponent.pixels()[i] = static_cast<std::uint8_t>(e + 128);
  }
  return out;
}

// Equation 4.3 without its half step, as nothing was cut.
Image<Rgb> picture_of(const RgbePlanes& in) {
  Image<Rgb> out(in.exponent.width(), in.exponent.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const int e = in.exponent.pixels()[i];
    if (e == 0) continue;
    for (int c = 0; c < 3; ++c)
      out.pixels()[i][c] =
          static_cast<float>(std::ldexp(in.base[static_cast<std::size_t>(c)].pixels()[i], e - 136));
  }
  return out;
}

struct SplitModels {
  NumberModel exponent[27];  // by how three neighbours stand to each other
  NumberModel base[3][kRestlessness];
  std::array<BlockModels, 2> block;  // luminance, colours
};

// Of three neighbours, where an edge runs between them, the one on this side of it.
int middle_of(int left, int upper, int corner) {
  return std::clamp(left + upper - corner, std::min(left, upper), std::max(left, upper));
}

template <class Stream>
class SplitCoding {
 public:
  SplitCoding(Stream& stream, const RgbeCoding& coding)
      : stream_(stream),
        base_(coding.base),
        scale_(static_cast<float>(coding.coarseness) / kTableCoarseness) {}

  /// In: what is to be coded (writing), any (reading); afterwards what a reader gets.
  void code(RgbePlanes& p) {
    code_exponents(p.exponent);
    if (base_ == RgbeBase::kLossless)
      code_bases(p);
    else
      code_blocks(p);
  }

 private:
  void code_exponents(BytePlane& e) {
    for (int y = 0; y < e.height(); ++y)
      for (int x = 0; x < e.width(); ++x) {
        const int left = x > 0 ? e.at(x - 1, y) : 0, upper = y > 0 ? e.at(x, y - 1) : 0;
        const int corner = x > 0 && y > 0 ? e.at(x - 1, y - 1) : 0;
        const int next = y > 0 && x + 1 < e.width() ? e.at(x + 1, y - 1) : upper;
        const auto sign = [](int v) { return (v > 0) - (v < 0) + 1; };
        const int context = 9 * sign(left - corner) + 3 * sign(upper - corner) + sign(next - upper);
        const int guess = middle_of(left, upper, corner);
        const int v = guess + stream_.number(models_->exponent[context], e.at(x, y) - guess);
        e.at(x, y) = static_cast<std::uint8_t>(std::clamp(v, 0, 255));
      }
  }

  // A neighbour's base at another exponent.
  static int base_at(const RgbePlanes& p, std::size_t c, int x, int y, int exponent) {
    if (x < 0 || y < 0) return 128;
    const int shift = std::clamp(exponent - p.exponent.at(x, y), -8, 8), v = p.base[c].at(x, y);
    return shift >= 0 ? v >> shift : std::min(v << -shift, 255);
  }

  // The first channel by its neighbours, the others by how they stand to the one before, too.
  void code_bases(RgbePlanes& p) {
    constexpr std::array<std::size_t, 3> kOrder = {1, 0, 2};
    for (int y = 0; y < p.exponent.height(); ++y)
      for (int x = 0; x < p.exponent.width(); ++x) {
        const int e = p.exponent.at(x, y);
        if (e == 0) continue;
        int missed = 0;
        for (std::size_t k = 0; k < 3; ++k) {
          const std::size_t c = kOrder[k];
          const int left = base_at(p, c, x - 1, y, e), upper = base_at(p, c, x, y - 1, e);
          const int corner = base_at(p, c, x - 1, y - 1, e);
          const int guess = std::clamp(middle_of(left, upper, corner) + missed, 0, 255);
          const int restless =
              std::abs(left - corner) + std::abs(upper - corner) + std::abs(missed);
          int context = 0;
          while (context < kRestlessness - 1 && restless >> context > 1) ++context;
          std::uint8_t& v = p.base[c].at(x, y);
          const int coded = guess + stream_.number(models_->base[k][context], v - guess);
          v = static_cast<std::uint8_t>(std::clamp(coded, 0, 255));
          missed = v - middle_of(left, upper, corner);
        }
      }
  }

  using Samples = Image<float>;

  static float at(const Samples& plane, int x, int y) {
    return plane.at(std::min(x, plane.width() - 1), std::min(y, plane.height() - 1));
  }

  // How much finer the steps of a block are: `scale` pixels of the exponents to one of its own.
  float finer(const BytePlane& e, int x0, int y0, int scale) const {
    if (base_ == RgbeBase::kJpeg) return 1;
    int low = 255, high = 0;
    for (int y = y0 * scale; y < std::min((y0 + kBlock) * scale, e.height()); ++y)
      for (int x = x0 * scale; x < std::min((x0 + kBlock) * scale, e.width()); ++x) {
        low = std::min<int>(low, e.at(x, y));
        high = std::max<int>(high, e.at(x, y));
      }
    return finer_where_exponents_differ(low, high);
  }

  void code_plane(Samples& plane, const BytePlane& exponents, bool colour) {
    const QuantiserTable& table = colour ? kColourSteps : kLuminanceSteps;
    for (int y0 = 0; y0 < plane.height(); y0 += kBlock)
      for (int x0 = 0; x0 < plane.width(); x0 += kBlock) {
        DctBlock block{};
        if constexpr (Stream::kWrites) {
          for (int i = 0; i < 64; ++i)
            block[static_cast<std::size_t>(i)] = at(plane, x0 + i % kBlock, y0 + i / kBlock);
          block = transformed(block, false);
        }
        const float divided = finer(exponents, x0, y0, colour ? 2 : 1);
        code_block(stream_, models_->block[colour], block,
                   [&](int i) { return quantiser(table, scale_, i) / divided; });
        block = transformed(block, true);
        for (int i = 0; i < 64; ++i) {
          const int x = x0 + i % kBlock, y = y0 + i / kBlock;
          if (x < plane.width() && y < plane.height())
            plane.at(x, y) = block[static_cast<std::size_t>(i)];
        }
      }
  }

  // Luminance about 0 and two colours at half resolution (ITU-T T.871).
  static std::array<Samples, 3> ycc_of(const RgbePlanes& p) {
    const int width = p.exponent.width(), height = p.exponent.height();
    const int half_width = (width + 1) / 2, half_height = (height + 1) / 2;
    std::array<Samples, 3> out{Samples(width, height), Samples(half_width, half_height),
                               Samples(half_width, half_height)};
    Samples count(half_width, half_height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const float r = p.base[0].at(x, y), g = p.base[1].at(x, y), b = p.base[2].at(x, y);
        const float luma = .299f * r + .587f * g + .114f * b;
        out[0].at(x, y) = luma - 128;
        out[1].at(x / 2, y / 2) += (b - luma) / 1.772f;
        out[2].at(x / 2, y / 2) += (r - luma) / 1.402f;
        ++count.at(x / 2, y / 2);
      }
    for (std::size_t i = 0; i < count.area(); ++i)
      for (std::size_t c = 1; c < 3; ++c) out[c].pixels()[i] /= count.pixels()[i];
    return out;
  }

  // Between the middles of four pixels, as JPEG's readers do.
  static float smooth_at(const Samples& plane, int x, int y) {
    const auto near = [](int v) { return v / 2; };
    const auto far = [](int v, int size) {
      return std::clamp(v / 2 + (v % 2 == 0 ? -1 : 1), 0, size - 1);
    };
    const int fx = far(x, plane.width()), fy = far(y, plane.height());
    return (9 * plane.at(near(x), near(y)) + 3 * plane.at(fx, near(y)) + 3 * plane.at(near(x), fy) +
            plane.at(fx, fy)) /
           16;
  }

  void code_blocks(RgbePlanes& p) {
    std::array<Samples, 3> ycc = ycc_of(p);
    for (std::size_t c = 0; c < 3; ++c) code_plane(ycc[c], p.exponent, c > 0);
    const auto code_of = [](float v) {
      return static_cast<std::uint8_t>(std::clamp(v + .5f, 0.f, 255.f));
    };
    for (int y = 0; y < p.exponent.height(); ++y)
      for (int x = 0; x < p.exponent.width(); ++x) {
        const float luma = ycc[0].at(x, y) + 128;
        const float cb = smooth_at(ycc[1], x, y), cr = smooth_at(ycc[2], x, y);
        p.base[0].at(x, y) = code_of(luma + 1.402f * cr);
        p.base[1].at(x, y) = code_of(luma - .344136f * cb - .714136f * cr);
        p.base[2].at(x, y) = code_of(luma + 1.772f * cb);
      }
  }

  Stream& stream_;
  RgbeBase base_;
  float scale_;
  std::unique_ptr<SplitModels> models_ = std::make_unique<SplitModels>();
};

}  // namespace

std::vector<unsigned char> write_split_bases(const Image<Rgb>& picture, const RgbeCoding& coding) {
  BitWriter writer;
  RgbePlanes planes = rgbe_of(picture);
  SplitCoding(writer, coding).code(planes);
  return writer.finish();
}

Image<Rgb> read_split_bases(std::span<const unsigned char> bytes, int width, int height,
                            const RgbeCoding& coding) {
  BitReader reader(bytes);
  RgbePlanes planes(width, height);
  SplitCoding(reader, coding).code(planes);
  return picture_of(planes);
}

}  // namespace penumbra::codec
