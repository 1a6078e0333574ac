#include "tools/chart/measures/flip.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "tools/chart/measures/picture_pairs.h"

namespace penumbra::tools {

namespace {

using Channel = Image<float>;
using Kernel = std::vector<float>;  // 2 radius + 1 weights, the middle one at the pixel itself

template <class Body>
void for_rows(int height, const Body& body) {
  parallel_for(0, height, 8, [&](const auto& range) {
    for (int y = range.begin(); y < range.end(); ++y) body(y);
  });
}

// Convolutions repeat the border pixel: a uniform picture stays uniform.
Channel along_rows(const Channel& in, const Kernel& kernel) {
  Channel out(in.width(), in.height());
  const int radius = static_cast<int>(kernel.size() / 2);
  for_rows(in.height(), [&](int y) {
    const auto source = in.row(y);
    const auto target = out.row(y);
    for (int x = 0; x < in.width(); ++x) {
      float sum = 0;
      for (int i = -radius; i <= radius; ++i)
        sum += kernel[static_cast<std::size_t>(i + radius)] *
               source[static_cast<std::size_t>(std::clamp(x + i, 0, in.width() - 1))];
      target[static_cast<std::size_t>(x)] = sum;
    }
  });
  return out;
}

Channel along_columns(const Channel& in, const Kernel& kernel) {
  Channel out(in.width(), in.height());
  const int radius = static_cast<int>(kernel.size() / 2);
  for_rows(in.height(), [&](int y) {
    const auto target = out.row(y);
    for (int i = -radius; i <= radius; ++i) {
      const auto source = in.row(std::clamp(y + i, 0, in.height() - 1));
      const float weight = kernel[static_cast<std::size_t>(i + radius)];
      for (std::size_t x = 0; x < target.size(); ++x) target[x] += weight * source[x];
    }
  });
  return out;
}

Channel blur(const Channel& in, const Kernel& kernel) {
  return along_columns(along_rows(in, kernel), kernel);
}

template <class Weight>
std::vector<double> sampled(int radius, const Weight& weight) {
  std::vector<double> out;
  for (int i = -radius; i <= radius; ++i) out.push_back(weight(static_cast<double>(i)));
  return out;
}

double sum_of(const std::vector<double>& weights) {
  double sum = 0;
  for (const double w : weights) sum += w;
  return sum;
}

// The positive weights come to 1 and the negative ones to -1, so that a derivative of a 0..1
// picture is within -1..1 at every width.
Kernel balanced(const std::vector<double>& weights) {
  double positive = 0, negative = 0;
  for (const double w : weights) (w > 0 ? positive : negative) += w;
  Kernel out;
  for (const double w : weights)
    out.push_back(static_cast<float>(w > 0 ? w / positive : w < 0 ? w / -negative : 0));
  return out;
}

// ---- Colour. XYZ is relative to the white of the display, so white is (1, 1, 1). ----

glm::mat3 make_xyz_from_rgb() {
  // Columns: XYZ of the Rec.709 primaries (IEC 61966-2-1).
  const glm::dmat3 xyz({.4124564, .2126729, .0193339}, {.3575761, .7151522, .1191920},
                       {.1804375, .0721750, .9503041});
  const glm::dvec3 white = xyz[0] + xyz[1] + xyz[2];
  return {glm::vec3(xyz[0] / white), glm::vec3(xyz[1] / white), glm::vec3(xyz[2] / white)};
}

const glm::mat3& xyz_from_rgb() {
  static const glm::mat3 matrix = make_xyz_from_rgb();
  return matrix;
}
const glm::mat3& rgb_from_xyz() {
  static const glm::mat3 matrix(glm::inverse(glm::dmat3(xyz_from_rgb())));
  return matrix;
}

float lab_curve(float t) {
  constexpr float kKnee = 6.f / 29;  // CIE 15: a straight line below the cube of this
  return t > kKnee * kKnee * kKnee ? std::cbrt(t) : t / (3 * kKnee * kKnee) + 4.f / 29;
}

// CIELAB with the Hunt effect: the same chroma looks less colourful where it is dark.
glm::vec3 perceived(const glm::vec3& rgb) {
  const glm::vec3 xyz = xyz_from_rgb() * rgb;
  const float x = lab_curve(xyz.x), y = lab_curve(xyz.y), z = lab_curve(xyz.z);
  const float lightness = 116 * y - 16;
  return {lightness, .01f * lightness * 500 * (x - y), .01f * lightness * 200 * (y - z)};
}

// HyAB (Abasi et al. 2020): city block between lightness and chroma, which holds for large
// differences too. The power brings small ones forward.
float colour_distance(const glm::vec3& a, const glm::vec3& b) {
  constexpr float kPower = .7f;
  return std::pow(std::abs(a.x - b.x) + std::hypot(a.y - b.y, a.z - b.z), kPower);
}

// Distances below pc of the largest take 0..pt of the scale: what lies above is all plainly wrong.
float colour_error(float distance) {
  constexpr float kKnee = .4f, kAtKnee = .95f;
  static const float largest = colour_distance(perceived({0, 1, 0}), perceived({0, 0, 1}));
  const float knee = kKnee * largest;
  if (distance < knee) return kAtKnee / knee * distance;
  return std::min(1.f, kAtKnee + (1 - kAtKnee) * (distance - knee) / (largest - knee));
}

// ---- What the eye resolves. ----

// One term of a contrast sensitivity function: amplitude exp(-width f^2), f in cycles a degree.
struct SensitivityTerm {
  double amplitude, width;
};
constexpr SensitivityTerm kAchromatic{1, .0047}, kRedGreen{1, .0053};
constexpr std::array<SensitivityTerm, 2> kBlueYellow{{{34.1, .04}, {13.5, .025}}};

// The terms as Gaussians over pixels. A sum of two-dimensional Gaussians is not separable, each is.
struct SensitivityFilter {
  Kernel achromatic, red_green;
  std::array<Kernel, 2> blue_yellow;
  std::array<float, 2> blue_yellow_fraction;
};

// in:  the transform of the term, over pixels; out: kernel of unit sum. Returns the sum it had.
double make_gaussian(const SensitivityTerm& term, int radius, double pixels_per_degree,
                     Kernel& kernel) {
  const auto weights = sampled(radius, [&](double i) {
    const double degrees = i / pixels_per_degree;
    return std::exp(-kPi * kPi * degrees * degrees / term.width);
  });
  const double sum = sum_of(weights);
  kernel.clear();
  for (const double w : weights) kernel.push_back(static_cast<float>(w / sum));
  return sum;
}

SensitivityFilter make_sensitivity(double pixels_per_degree) {
  // Three standard deviations of the widest Gaussian, whose variance is width / (2 pi^2).
  const double widest = std::sqrt(kBlueYellow[0].width / (2 * kPi * kPi));
  const int radius = static_cast<int>(std::ceil(3 * widest * pixels_per_degree));
  SensitivityFilter filter;
  make_gaussian(kAchromatic, radius, pixels_per_degree, filter.achromatic);
  make_gaussian(kRedGreen, radius, pixels_per_degree, filter.red_green);
  std::array<double, 2> volume{};
  for (std::size_t k = 0; k < 2; ++k) {
    const SensitivityTerm& term = kBlueYellow[k];
    const double sum = make_gaussian(term, radius, pixels_per_degree, filter.blue_yellow[k]);
    volume[k] = term.amplitude * std::sqrt(kPi / term.width) * sum * sum;
  }
  for (std::size_t k = 0; k < 2; ++k)
    filter.blue_yellow_fraction[k] = static_cast<float>(volume[k] / (volume[0] + volume[1]));
  return filter;
}

// YCxCz without its constants: every channel is filtered by itself with unit sum, so they cancel.
struct Opponent {
  Channel achromatic, red_green, blue_yellow;
};

Opponent to_opponent(const Image<Rgb>& picture) {
  const int width = picture.width(), height = picture.height();
  Opponent out{Channel(width, height), Channel(width, height), Channel(width, height)};
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const Rgb& p = picture.at(x, y);
      const glm::vec3 rgb(std::clamp(p.r, 0.f, 1.f), std::clamp(p.g, 0.f, 1.f),
                          std::clamp(p.b, 0.f, 1.f));
      const glm::vec3 xyz = xyz_from_rgb() * rgb;
      out.achromatic.at(x, y) = xyz.y;
      out.red_green.at(x, y) = xyz.x - xyz.y;
      out.blue_yellow.at(x, y) = xyz.y - xyz.z;
    }
  });
  return out;
}

// The colours that remain when detail too fine for the eye is gone.
Image<glm::vec3> perceived_colours(const Opponent& in, const SensitivityFilter& filter) {
  const Channel luminance = blur(in.achromatic, filter.achromatic);
  const Channel red_green = blur(in.red_green, filter.red_green);
  const Channel wide = blur(in.blue_yellow, filter.blue_yellow[0]);
  const Channel narrow = blur(in.blue_yellow, filter.blue_yellow[1]);
  Image<glm::vec3> out(luminance.width(), luminance.height());
  for_rows(out.height(), [&](int y) {
    for (int x = 0; x < out.width(); ++x) {
      const float l = luminance.at(x, y);
      const float blue_yellow = filter.blue_yellow_fraction[0] * wide.at(x, y) +
                                filter.blue_yellow_fraction[1] * narrow.at(x, y);
      const glm::vec3 rgb = rgb_from_xyz() * glm::vec3(l + red_green.at(x, y), l, l - blue_yellow);
      out.at(x, y) = perceived(glm::clamp(rgb, 0.f, 1.f));
    }
  });
  return out;
}

// ---- Edges and points. ----

// A Gaussian and its first two derivatives.
struct FeatureFilter {
  Kernel smooth, edge, point;
};

FeatureFilter make_features(double pixels_per_degree) {
  constexpr double kWidthDegrees = .082;  // of a feature the eye picks out best
  const double sd = .5 * kWidthDegrees * pixels_per_degree;
  const int radius = static_cast<int>(std::ceil(3 * sd));
  const auto gaussian = [sd](double i) { return std::exp(-i * i / (2 * sd * sd)); };
  return {
      balanced(sampled(radius, gaussian)),
      balanced(sampled(radius, [&](double i) { return -i * gaussian(i); })),
      balanced(sampled(radius, [&](double i) { return (i * i / (sd * sd) - 1) * gaussian(i); }))};
}

struct Features {
  Channel edge, point;  // magnitudes
};

Channel magnitude(const Channel& x, const Channel& y) {
  Channel out(x.width(), x.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = std::hypot(x.pixels()[i], y.pixels()[i]);
  return out;
}

Features find_features(const Channel& luminance, const FeatureFilter& filter) {
  const Channel smooth_rows = along_rows(luminance, filter.smooth);
  return {magnitude(along_columns(along_rows(luminance, filter.edge), filter.smooth),
                    along_columns(smooth_rows, filter.edge)),
          magnitude(along_columns(along_rows(luminance, filter.point), filter.smooth),
                    along_columns(smooth_rows, filter.point))};
}

float feature_error(float edge_difference, float point_difference) {
  const float larger = std::max(std::abs(edge_difference), std::abs(point_difference));
  return std::min(1.f, std::sqrt(larger / std::sqrt(2.f)));
}

// ---- Exposures. ----

// (n2 x^2 + n1 x) / (d2 x^2 + d1 x + d0), the rational fit of the ACES tone curve, behind the
// factor .6 that is usual with it.
struct ToneCurve {
  double n2 = .36 * 2.51, n1 = .6 * .03, d2 = .36 * 2.43, d1 = .6 * .59, d0 = .14;

  double operator()(double x) const {
    const double bounded = std::min(x, 1e4);  // long white, and its square is still finite
    return std::clamp((n2 * bounded + n1) * bounded / ((d2 * bounded + d1) * bounded + d0), 0., 1.);
  }
  // The positive root of (n2 - t d2) x^2 + (n1 - t d1) x - t d0 with t what is shown.
  double inverse(double shown) const {
    const double a = n2 - shown * d2, b = n1 - shown * d1, c = -shown * d0;
    return (-b + std::sqrt(b * b - 4 * a * c)) / (2 * a);
  }
};

float median(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Factors on the radiance, dark to bright, about one stop apart.
Result<std::vector<double>> choose_exposures(const Image<Rgb>& reference) {
  std::vector<float> values;
  for (const Rgb& p : reference.pixels())
    values.push_back(luminance({std::max(p.r, 0.f), std::max(p.g, 0.f), std::max(p.b, 0.f)}));
  const double brightest = *std::max_element(values.begin(), values.end());
  if (!(brightest > 0))
    return fail(ErrorCode::kUndetermined, "reference picture",
                "is black, so that no exposure shows it");
  double middle = median(values);
  if (!(middle > 0)) {
    std::erase_if(values, [](float v) { return !(v > 0); });
    middle = median(values);
  }
  constexpr double kNearWhite = .85;
  const double near_white = ToneCurve{}.inverse(kNearWhite);
  const double start = std::log2(near_white / brightest), stop = std::log2(near_white / middle);
  const int count = std::max(2, static_cast<int>(std::ceil(stop - start)));
  std::vector<double> out;
  for (int i = 0; i < count; ++i)
    out.push_back(std::exp2(start + (stop - start) * i / (count - 1)));
  return out;
}

Image<Rgb> expose(const Image<Rgb>& radiance, double exposure) {
  const ToneCurve curve;
  Image<Rgb> out(radiance.width(), radiance.height());
  for_rows(out.height(), [&](int y) {
    for (int x = 0; x < out.width(); ++x)
      for (int c = 0; c < 3; ++c)
        out.at(x, y)[c] = static_cast<float>(curve(exposure * std::max(0.f, radiance.at(x, y)[c])));
  });
  return out;
}

Result<void> check(const Image<Rgb>& reference, const Image<Rgb>& test, double pixels_per_degree) {
  if (!(pixels_per_degree >= 1) || !std::isfinite(pixels_per_degree))
    return fail(ErrorCode::kInvalid, "pixels per degree",
                fmt::format("{} is not at least 1", pixels_per_degree));
  return check_pair(reference, test);
}

}  // namespace

Image<float> flip(const Image<Rgb>& reference, const Image<Rgb>& test, double pixels_per_degree) {
  assert(reference.same_size(test) && pixels_per_degree >= 1);
  Image<float> out(reference.width(), reference.height());
  if (out.empty()) return out;
  const SensitivityFilter sensitivity = make_sensitivity(pixels_per_degree);
  const FeatureFilter filter = make_features(pixels_per_degree);
  const Opponent a = to_opponent(reference), b = to_opponent(test);
  const auto colours_a = perceived_colours(a, sensitivity);
  const auto colours_b = perceived_colours(b, sensitivity);
  const Features features_a = find_features(a.achromatic, filter);
  const Features features_b = find_features(b.achromatic, filter);
  for_rows(out.height(), [&](int y) {
    for (int x = 0; x < out.width(); ++x) {
      const float colour = colour_error(colour_distance(colours_a.at(x, y), colours_b.at(x, y)));
      const float feature = feature_error(features_a.edge.at(x, y) - features_b.edge.at(x, y),
                                          features_a.point.at(x, y) - features_b.point.at(x, y));
      out.at(x, y) = std::pow(colour, 1 - feature);  // a changed feature makes colour count more
    }
  });
  return out;
}

Result<Image<float>> hdr_flip(const Image<Rgb>& reference, const Image<Rgb>& test,
                              double pixels_per_degree) {
  PENUMBRA_TRY(check(reference, test, pixels_per_degree));
  PENUMBRA_ASSIGN(exposures, choose_exposures(reference));
  Image<float> largest(reference.width(), reference.height());
  for (const double exposure : exposures) {
    const Image<float> at_exposure =
        flip(expose(reference, exposure), expose(test, exposure), pixels_per_degree);
    for (std::size_t i = 0; i < largest.area(); ++i)
      largest.pixels()[i] = std::max(largest.pixels()[i], at_exposure.pixels()[i]);
  }
  return largest;
}

double mean_flip(const Image<float>& map) {
  double sum = 0;
  for (const float v : map.pixels()) sum += v;
  return map.empty() ? 0 : sum / static_cast<double>(map.area());
}

}  // namespace penumbra::tools
