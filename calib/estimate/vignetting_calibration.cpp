#include "calib/estimate/vignetting_calibration.h"

#include <ceres/ceres.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <ranges>
#include <type_traits>

#include "core/image.h"
#include "core/io/toml_keys.h"

namespace penumbra::calib {

namespace {

constexpr int kBlocks = 48;                    // along the longer side
constexpr double kDark = .03, kClipped = .95;  // of full scale
constexpr double kMaxClipped = .005;           // of a block's samples: noise reaches there first
constexpr double kMaxUneven = .02;             // RMS that is left, relative

// Mean linear signal of a block of pixels.
struct PixelBlock {
  glm::dvec2 off;     // from the centre, in half diagonals
  double log_signal;  // of the mean over the channels
};

// A pixel's channel as the sensor gave it, black level and all.
struct SignalReader {
  const Response& response;
  double black_level;
  double operator()(const Rgb8& p, int c) const { return response.decode((&p.r)[c] / 255., c); }
  double operator()(const Rgb16& p, int c) const { return response.decode((&p.r)[c] / 65535., c); }
  double operator()(const Rgb& p, int c) const { return double(p[c]); }
};

struct BlockSum {
  double mean = 0;     // of the channels, without the black level
  double clipped = 0;  // fraction of the samples
};

template <class Pixel>
BlockSum sum_block(const Image<Pixel>& image, const SignalReader& read, const glm::ivec2& low,
                   int side) {
  BlockSum out;
  for (int y = low.y; y < low.y + side; ++y)
    for (int x = low.x; x < low.x + side; ++x)
      for (int c = 0; c < 3; ++c) {
        const double signal = read(image.at(x, y), c);
        out.mean += signal - read.black_level;
        if (!std::is_same_v<Pixel, Rgb> && signal > kClipped) ++out.clipped;
      }
  out.mean /= 3. * side * side;
  out.clipped /= 3. * side * side;
  return out;
}

Result<std::vector<PixelBlock>> blocks_of(const EvenPicture& picture, const CameraModel& camera,
                                          const Vignetting& frame, const SignalReader& read) {
  const auto [width, height] =
      std::visit([](const auto& i) { return std::pair(i.width(), i.height()); }, picture.pixels);
  if (width != camera.width || height != camera.height)
    return fail(ErrorCode::kInvalid, picture.name,
                fmt::format("has {}x{} pixels instead of {}x{}", width, height, camera.width,
                            camera.height));
  const auto undetermined = [&](const std::string& why) {
    return fail(ErrorCode::kUndetermined, picture.name, why);
  };
  const bool is_linear = std::holds_alternative<Image<Rgb>>(picture.pixels);
  const int side = std::clamp(std::max(width, height) / kBlocks, 1, std::min(width, height));
  constexpr int kFewest = 12;  // blocks a side
  if (std::min(width, height) / side < kFewest)
    return undetermined("is too small or too narrow to show the fall-off of a lens");
  std::vector<PixelBlock> out;
  for (int y = 0; y + side <= height; y += side)
    for (int x = 0; x + side <= width; x += side) {
      const auto [mean, clipped] = std::visit(
          [&](const auto& i) {
            return sum_block(i, read, {x, y}, side);
          },
          picture.pixels);
      if (!std::isfinite(mean)) return undetermined("has pixels that are NaN or infinite");
      if (mean <= 0 || (!is_linear && mean < kDark))
        return undetermined(
            "is too dark in places: expose longer, until the middle is at half of full scale");
      if (clipped > kMaxClipped)
        return undetermined(
            "is clipped in places, in at least one colour: expose shorter, until the middle is at "
            "half of full scale");
      const glm::dvec2 at(x + side / 2., y + side / 2.);
      out.push_back({(at - frame.centre_px) / frame.half_diagonal_px, std::log(mean)});
    }
  return out;
}

// log I = brightness + log(1 + slope . off) + log V: a slope is a slanted light, and even about the
// centre is the lens.
struct Residual {
  glm::dvec2 off;
  double seen;
  template <class T>
  bool operator()(const T* picture, const T* terms, T* out) const {
    const T p2 = T(glm::dot(off, off));
    const T v = T(1) + p2 * (terms[0] + p2 * (terms[1] + p2 * terms[2]));
    const T slant = T(1) + picture[1] * off.x + picture[2] * off.y;
    if (!(v > T(.01)) || !(slant > T(.01))) return false;
    out[0] = picture[0] + log(slant) + log(v) - seen;
    return true;
  }
};

struct FalloffFit {
  std::array<double, 3> terms{};
  std::vector<std::array<double, 3>> pictures;  // log brightness, slope in x and y
  double residual = 0;                          // RMS
  double corner_sigma = 0;
};

Result<FalloffFit> fit(std::span<const std::vector<PixelBlock>> pictures) {
  FalloffFit out;
  ceres::Problem problem;
  std::size_t count = 0;
  out.pictures.resize(pictures.size());
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    out.pictures[i] = {pictures[i][pictures[i].size() / 2].log_signal, 0, 0};
    for (const PixelBlock& b : pictures[i]) {
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<Residual, 1, 3, 3>(new Residual{b.off, b.log_signal}),
          new ceres::HuberLoss(kMaxUneven), out.pictures[i].data(), out.terms.data());
      ++count;
    }
  }
  ceres::Solver::Options options;
  options.max_num_iterations = 100;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable())
    return fail(ErrorCode::kUndetermined, "vignetting",
                "no fall-off of a lens fits these pictures");
  double squares = 0;
  for (std::size_t i = 0; i < pictures.size(); ++i)
    for (const PixelBlock& b : pictures[i]) {
      double r = 0;
      Residual{b.off, b.log_signal}(out.pictures[i].data(), out.terms.data(), &r);
      squares += r * r;
    }
  out.residual = std::sqrt(squares / double(count));
  ceres::Covariance covariance{ceres::Covariance::Options{}};
  double c[9] = {};
  const std::vector<std::pair<const double*, const double*>> wanted{
      {out.terms.data(), out.terms.data()}};
  if (!covariance.Compute(wanted, &problem) ||
      !covariance.GetCovarianceBlock(out.terms.data(), out.terms.data(), c))
    return fail(ErrorCode::kUndetermined, "vignetting",
                "these pictures do not determine the fall-off");
  double sum = 0;  // V in the corner is 1 + a1 + a2 + a3
  for (const double v : c) sum += v;
  out.corner_sigma = out.residual * std::sqrt(std::max(0., sum));
  return out;
}

double corner_of(const std::array<double, 3>& terms) {
  return 1 + terms[0] + terms[1] + terms[2];
}

// Light that is brighter in its middle looks like a lens, but not in every picture of a turned
// camera.
Result<void> check_agreement(std::span<const EvenPicture> pictures,
                             std::span<const std::vector<PixelBlock>> blocks, double corner) {
  constexpr double kMaxApart = .03;
  for (std::size_t i = 0; i < pictures.size() && pictures.size() > 1; ++i) {
    PENUMBRA_ASSIGN(alone, fit(blocks.subspan(i, 1)));
    if (std::abs(corner_of(alone.terms) - corner) > kMaxApart)
      return fail(ErrorCode::kUndetermined, pictures[i].name,
                  fmt::format("has {:.0f} % of the light in the corners where all pictures "
                              "together have {:.0f} %: the surface is not evenly lit",
                              100 * corner_of(alone.terms), 100 * corner));
  }
  return {};
}

std::vector<VignettingCalibration::Ring> rings_of(std::span<const std::vector<PixelBlock>> pictures,
                                                  const FalloffFit& fitted) {
  constexpr int kRings = 24;
  std::vector<VignettingCalibration::Ring> rings(kRings);
  std::vector<int> counts(kRings);
  for (std::size_t i = 0; i < pictures.size(); ++i)
    for (const PixelBlock& b : pictures[i]) {
      const auto ring =
          std::min(static_cast<std::size_t>(glm::length(b.off) * kRings), rings.size() - 1);
      const auto& [log_brightness, sx, sy] = fitted.pictures[i];
      rings[ring].distance += glm::length(b.off);
      rings[ring].seen +=
          std::exp(b.log_signal - log_brightness) / (1 + sx * b.off.x + sy * b.off.y);
      ++counts[ring];
    }
  for (std::size_t r = 0; r < rings.size(); ++r)
    if (counts[r] > 0) rings[r].distance /= counts[r], rings[r].seen /= counts[r];
  std::erase_if(rings, [](const auto& r) { return r.seen == 0; });
  return rings;
}

}  // namespace

Result<VignettingCalibration> calibrate_vignetting(std::span<const EvenPicture> pictures,
                                                   const CameraModel& camera,
                                                   const Response& response, double black_level) {
  if (pictures.empty()) return fail(ErrorCode::kInvalid, "pictures", "there is none");
  VignettingCalibration out;
  out.vignetting = vignetting_of(camera, {});
  std::vector<std::vector<PixelBlock>> blocks;
  for (const EvenPicture& p : pictures) {
    PENUMBRA_ASSIGN(found, blocks_of(p, camera, out.vignetting, {response, black_level}));
    blocks.push_back(std::move(found));
  }
  PENUMBRA_ASSIGN(fitted, fit(blocks));
  if (fitted.residual > kMaxUneven)
    return fail(ErrorCode::kUndetermined, pictures[0].name,
                fmt::format("differs by {:.1f} % from any fall-off of a lens: photograph something "
                            "even, such as white paper out of focus",
                            100 * fitted.residual));
  PENUMBRA_TRY(check_agreement(pictures, blocks, corner_of(fitted.terms)));
  out.vignetting.terms = fitted.terms;
  if (!is_plausible(out.vignetting, camera))
    return fail(ErrorCode::kUndetermined, pictures[0].name,
                "gives a fall-off that no lens has: less than 2 % or more than 150 % of the light "
                "somewhere");
  out.corner = corner_of(fitted.terms);
  out.corner_sigma = fitted.corner_sigma;
  out.residual = fitted.residual;
  out.rings = rings_of(blocks, fitted);
  return out;
}

std::string print_vignetting_file(const VignettingCalibration& c) {
  return fmt::format(
      "version = 1\n[vignetting]\n# fraction of the light: 1 + a1 p^2 + a2 p^4 + a3 p^6, p in half "
      "diagonals "
      "from the centre\nterms = [{:.17g}, {:.17g}, {:.17g}]\ncorner = {:.6g}\ncorner_sigma = "
      "{:.3g}\n",
      c.vignetting.terms[0], c.vignetting.terms[1], c.vignetting.terms[2], c.corner,
      c.corner_sigma);
}

}  // namespace penumbra::calib
