#include <fmt/format.h>
#include <hwy/aligned_allocator.h>
#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <new>
#include <vector>

#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/latlong_kernel.h"
#include "lighting/sh/map_luminance.h"
#include "lighting/sh/projection.h"
#include "lighting/sh/rotation.h"
#include "lighting/sh/row_overlay.h"
#include "lighting/sh/sh_inpainting.h"

namespace penumbra::lighting {

namespace {

// The rows are summed about +y; this turns the result to the z pole. Local x, y, z are world -z,
// -x, +y, so that a lat-long azimuth p is the local azimuth -p.
const glm::dmat3 kWorldFromRowFrame(glm::dvec3(0, 0, -1), glm::dvec3(-1, 0, 0),
                                    glm::dvec3(0, 1, 0));

constexpr int rounded_up(int n, int multiple) {
  return (n + multiple - 1) / multiple * multiple;
}

hwy::AlignedFreeUniquePtr<float[]> zeros(int count) {
  auto out = hwy::AllocateAligned<float>(static_cast<std::size_t>(count));
  if (!out) throw std::bad_alloc();
  std::fill_n(out.get(), count, 0.f);
  return out;
}

template <class Map>
Error first_non_finite(const Map& map) {
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      if (!is_finite(map.at(x, y)))
        return {ErrorCode::kNonFinite, "environment",
                fmt::format("pixel {},{} is not finite", x, y)};
  return {ErrorCode::kNonFinite, "environment", "has a sum that is not finite"};
}

}  // namespace

// Of one row, about +y, by order and colour.
struct RowSums {
  double cosine[kMaxBands][3] = {}, sine[kMaxBands][3] = {};
};

struct LatLongProjector::Tables {
  static constexpr int kParts = 8;  // rows side by side on several threads
  int width, height, bands;
  hwy::AlignedFreeUniquePtr<float[]> cosine, sine, scratch;  // scratch: for kParts
  std::vector<RowSums> rows;
  std::vector<char> changes;     // by row: it did after the last map had been read, and may again
  std::vector<double> legendre;  // per row: w_j K_lm P_lm(cos th_j), m-major, l >= m
  RowTables row;
  ShRotation to_world;

  Tables(int w, int h, int b) : width(w), height(h), bands(b), to_world(kWorldFromRowFrame, b) {
    const int stride = rounded_up(w / 4, 64);
    cosine = zeros(b * stride), sine = zeros(b * stride);
    scratch = zeros(kParts * 12 * stride);
    rows.resize(static_cast<std::size_t>(h));
    changes.resize(rows.size());
    for (int m = 0; m < b; ++m)
      for (int k = 0; k < w / 4; ++k) {
        const double p = 2 * kPi * (k + .5) / w;
        cosine[static_cast<std::size_t>(m * stride + k)] = static_cast<float>(std::cos(m * p));
        sine[static_cast<std::size_t>(m * stride + k)] = static_cast<float>(std::sin(m * p));
      }
    row = {w, b, stride, cosine.get(), sine.get(), scratch.get()};
    double basis[kMaxCoefficients];
    for (int j = 0; j < h; ++j) {
      // At azimuth 0 the cosine terms of the basis are the weighted Legendre functions themselves.
      const double theta = kPi * (j + .5) / h;
      evaluate_basis(b, {std::sin(theta), 0, std::cos(theta)}, basis);
      for (int m = 0; m < b; ++m)
        for (int l = m; l < b; ++l)
          legendre.push_back(latlong_solid_angle(j, w, h) * basis[sh_index(l, m)]);
    }
  }

  // Those rows that `wanted`, which is asked for each of them, says so.
  template <class Map, class Wanted>
  void sum_rows(const Map& map, const Wanted& wanted) {
    parallel_for(0, kParts, [&](int part) {
      RowTables own = row;
      own.scratch += part * 12 * own.stride;
      for (int j = height * part / kParts; j < height * (part + 1) / kParts; ++j) {
        if (!wanted(j)) continue;
        RowSums& sums = rows[static_cast<std::size_t>(j)];
        row_fourier_sums(own, &map.row(j)[0].r, sums.cosine, sums.sine);
      }
    });
  }
};

LatLongProjector::LatLongProjector(int width, int height, int bands)
    : tables_(std::make_unique<Tables>(width, height, bands)) {
  assert(width >= 4 && width % 4 == 0 && height >= 1 && bands >= 1 && bands <= kMaxBands);
}
LatLongProjector::~LatLongProjector() = default;
LatLongProjector::LatLongProjector(LatLongProjector&&) noexcept = default;
LatLongProjector& LatLongProjector::operator=(LatLongProjector&&) noexcept = default;

namespace {

// ShSums of products in double; index by coefficient, then colour.
struct ShSums {
  double term[kMaxCoefficients][3] = {};

  RadianceSh to_light(int bands) const {
    RadianceSh light(bands);
    for (int n = 0; n < light.size(); ++n)
      light[n] = {static_cast<float>(term[n][0]), static_cast<float>(term[n][1]),
                  static_cast<float>(term[n][2])};
    return light;
  }
};

}  // namespace

Result<void> LatLongProjector::check_size(int width, int height) const {
  const Tables& t = *tables_;
  if (width == t.width && height == t.height) return {};
  return fail(ErrorCode::kInvalid, "environment",
              fmt::format("has {}x{} pixels instead of {}x{}", width, height, t.width, t.height));
}

// The map itself is only asked which of its pixels is not finite.
template <class Map>
Result<ShProjection> LatLongProjector::sum_up(const Map& map) const {
  const Tables& t = *tables_;
  ShSums all, upper_moments;
  const double* legendre = t.legendre.data();
  for (int j = 0; j < t.height; ++j) {
    // Rows are summed from the zenith; at the horizon the sum so far is the upper hemisphere's. The
    // middle row of an odd number lies half above.
    if (t.height % 2 == 0 && j == t.height / 2) upper_moments = all;
    const bool is_middle = t.height % 2 == 1 && j == t.height / 2;
    if (is_middle) upper_moments = all;
    const RowSums& row = t.rows[static_cast<std::size_t>(j)];
    for (int m = 0; m < t.bands; ++m)
      for (int l = m; l < t.bands; ++l) {
        const double w = *legendre++;
        for (int c = 0; c < 3; ++c) all.term[sh_index(l, m)][c] += w * row.cosine[m][c];
        if (m > 0)  // local azimuth is -p, hence the minus
          for (int c = 0; c < 3; ++c) all.term[sh_index(l, -m)][c] -= w * row.sine[m][c];
      }
    if (is_middle)
      for (int n = 0; n < kMaxCoefficients; ++n)
        for (int c = 0; c < 3; ++c)
          upper_moments.term[n][c] = .5 * (upper_moments.term[n][c] + all.term[n][c]);
  }
  const RadianceSh local = all.to_light(t.bands);
  for (const Rgb& term : local.terms())
    if (!is_finite(term)) return std::unexpected(first_non_finite(map));
  return ShProjection{t.to_world * local, t.to_world * upper_moments.to_light(t.bands), 1};
}

Result<ShProjection> LatLongProjector::project(const Image<Rgb>& map) {
  PENUMBRA_TRY(check_size(map.width(), map.height()));
  tables_->sum_rows(map, [](int) { return true; });
  return sum_up(map);
}

Result<void> LatLongProjector::read(const Image<Rgb>& map, MapLuminance& luminance) {
  PENUMBRA_TRY(check_size(map.width(), map.height()));
  luminance.resize(map.width(), map.height());
  tables_->sum_rows(map, [&](int y) {
    luminance.read_row(map, y);
    return !tables_->changes[static_cast<std::size_t>(y)];
  });
  return {};
}

Result<ShProjection> LatLongProjector::project_read(const RowOverlay& changed) {
  PENUMBRA_TRY(check_size(changed.width(), changed.height()));
  tables_->sum_rows(changed, [&](int y) {
    char& changes = tables_->changes[static_cast<std::size_t>(y)];
    const bool was_left_out = changes;
    changes = changed.is_changed(y);
    return changes || was_left_out;
  });
  return sum_up(changed);
}

Result<ShProjection> project_latlong(const RowOverlay& map, int bands) {
  return project_latlong(map.whole(), bands);
}

Result<ShProjection> project_latlong(const Image<Rgb>& map, int bands) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  if (map.width() % 4 == 0) return LatLongProjector(map.width(), map.height(), bands).project(map);
  std::vector<glm::vec3> direction;
  std::vector<float> solid_angle;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      direction.emplace_back(latlong_direction(x + .5, y + .5, map.width(), map.height()));
      solid_angle.push_back(static_cast<float>(latlong_solid_angle(y, map.width(), map.height())));
    }
  return project_samples({direction, solid_angle, {}, map.pixels()}, bands);
}

namespace {

// `mu` of the penalty at full loss; in proportion to what is unseen
constexpr double kSmoothness = 1e-3;
constexpr double kFullCoverage = .999;  // above this the plain sum is more accurate than a fit
constexpr double kMinCoverage = .02;

using DenseMatrix = Eigen::MatrixXd;
/// Of one light; takes nothing from the heap.
using MomentMatrix = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, kMaxCoefficients, 3>;

// ShSums over the seen pixels of w Y Y^T, of w L Y^T and of w.
struct NormalEquations {
  DenseMatrix gram, moments;
  double seen_sr = 0;

  explicit NormalEquations(int count)
      : gram(DenseMatrix::Zero(count, count)), moments(DenseMatrix::Zero(count, 3)) {}

  void add(const Eigen::VectorXd& basis, const Eigen::RowVector3d& radiance, double w,
           bool need_gram) {
    moments.noalias() += (w * basis) * radiance;
    if (need_gram) gram.selfadjointView<Eigen::Lower>().rankUpdate(basis, w);
    seen_sr += w;
  }
};

template <class Coefficients>
RadianceSh to_light(const Coefficients& coefficients, int bands) {
  RadianceSh light(bands);
  for (int n = 0; n < light.size(); ++n)
    for (int c = 0; c < 3; ++c) light[n][c] = static_cast<float>(coefficients(n, c));
  return light;
}

// Weighted least squares with the smoothness penalty in proportion to what is unseen.
DenseMatrix penalised(const DenseMatrix& lower_gram, int bands, double unseen) {
  DenseMatrix system = lower_gram.selfadjointView<Eigen::Lower>();
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      system(sh_index(l, m), sh_index(l, m)) +=
          kSmoothness * unseen * l * l * (l + 1.) * (l + 1.) + 1e-9;
  return system;
}

struct BothSums {
  NormalEquations whole, upper_moments;
};

Result<BothSums> accumulate(const LightSamples& s, int bands, bool need_gram) {
  const int count = coefficient_count(bands);
  BothSums sums{NormalEquations(count), NormalEquations(count)};
  Eigen::VectorXd basis(count);
  for (std::size_t i = 0; i < s.radiance.size(); ++i) {
    const double w = s.solid_angle_sr[i] * (s.confidence.empty() ? 1. : double(s.confidence[i]));
    if (w <= 0) continue;
    if (!is_finite(s.radiance[i]))
      return fail(ErrorCode::kNonFinite, "environment", fmt::format("sample {} is not finite", i));
    evaluate_basis(bands, glm::normalize(glm::dvec3(s.direction[i])),
                   {basis.data(), static_cast<std::size_t>(count)});
    const Eigen::RowVector3d radiance(s.radiance[i].r, s.radiance[i].g, s.radiance[i].b);
    sums.whole.add(basis, radiance, w, need_gram);
    if (s.direction[i].y > 0) sums.upper_moments.add(basis, radiance, w, false);
  }
  return sums;
}

// Int over the upper hemisphere of Y_i Y_j on nine bands, by a grid whose rows end at the horizon.
const DenseMatrix& upper_gram() {
  static const DenseMatrix gram = [] {
    constexpr int kWidth = 64, kHeight = 256;
    NormalEquations sums(kMaxCoefficients);
    Eigen::VectorXd basis(kMaxCoefficients);
    for (int y = 0; y < kHeight / 2; ++y)
      for (int x = 0; x < kWidth; ++x) {
        evaluate_basis(kMaxBands, latlong_direction(x + .5, y + .5, kWidth, kHeight),
                       {basis.data(), static_cast<std::size_t>(kMaxCoefficients)});
        sums.add(basis, Eigen::RowVector3d::Zero(), latlong_solid_angle(y, kWidth, kHeight), true);
      }
    return DenseMatrix(sums.gram.selfadjointView<Eigen::Lower>());
  }();
  return gram;
}

// Moments of a light over the upper hemisphere alone.
RadianceSh moments_above(const RadianceSh& light) {
  RadianceSh upper_moments(light.bands());
  for (int i = 0; i < upper_moments.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      double sum = 0;
      for (int k = 0; k < light.size(); ++k) sum += upper_gram()(i, k) * light[k][c];
      upper_moments[i][c] = static_cast<float>(sum);
    }
  return upper_moments;
}

// +1 where the basis is even in y, -1 where it is odd.
double parity(int m) {
  return m < 0 ? -1 : 1;
}

}  // namespace

namespace {

// G_up + e P G_up P for so many bands.
Eigen::LDLT<DenseMatrix> floor_system(int bands) {
  const int count = coefficient_count(bands);
  DenseMatrix system(count, count);
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      for (int k = 0; k < bands; ++k)
        for (int n = -k; n <= k; ++n) {
          const int i = sh_index(l, m), j = sh_index(k, n);
          system(i, j) = upper_gram()(i, j) * (1 + kBelowWeight * parity(m) * parity(n));
        }
  return system.ldlt();
}

}  // namespace

RadianceSh upper_hemisphere_light(const RadianceSh& upper_moments, int bands) {
  // (G_up + e G_low) c = b_up + e b_mirror with G_low = P G_up P and b_mirror = P b_up.
  static const std::vector<Eigen::LDLT<DenseMatrix>> systems = [] {
    std::vector<Eigen::LDLT<DenseMatrix>> all;
    for (int b = 1; b <= kMaxBands; ++b) all.push_back(floor_system(b));
    return all;
  }();
  const RadianceSh used = upper_moments.with_bands(bands);
  MomentMatrix moments(coefficient_count(bands), 3);
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      for (int c = 0; c < 3; ++c)
        moments(sh_index(l, m), c) = used[sh_index(l, m)][c] * (1 + kBelowWeight * parity(m));
  const MomentMatrix fit = systems[static_cast<std::size_t>(bands - 1)].solve(moments);
  return to_light(fit, bands);
}

Result<ShProjection> project_samples(const LightSamples& s, int bands) {
  const std::size_t n = s.radiance.size();
  if (s.direction.size() != n || s.solid_angle_sr.size() != n ||
      (!s.confidence.empty() && s.confidence.size() != n))
    return fail(ErrorCode::kInvalid, "environment",
                "has different numbers of directions, weights and pixels");
  double seen = 0;
  for (std::size_t i = 0; i < n; ++i)
    seen += s.solid_angle_sr[i] * (s.confidence.empty() ? 1. : double(s.confidence[i]));
  const double coverage = std::min(1., seen / (4 * kPi));
  if (coverage < kMinCoverage)
    return fail(ErrorCode::kUndetermined, "environment",
                fmt::format("covers only {:.1f} % of the sphere", 100 * coverage));
  const bool complete = coverage > kFullCoverage;
  PENUMBRA_ASSIGN(sums, accumulate(s, bands, !complete));
  if (complete)
    return ShProjection{to_light(sums.whole.moments, bands),
                        to_light(sums.upper_moments.moments, bands), coverage};
  const DenseMatrix fit =
      penalised(sums.whole.gram, bands, 1 - coverage).ldlt().solve(sums.whole.moments);
  const RadianceSh light = to_light(fit, bands);
  return ShProjection{light, moments_above(light), coverage};
}

ShInpainting::ShInpainting(const Image<float>& confidence) : confidence_(confidence) {
  // The gram is smooth in its directions: blocks of at most 256 x 128 stand for their pixels.
  const int width = confidence.width(), height = confidence.height();
  const int block = std::max(1, (width + 255) / 256);
  NormalEquations sums(kMaxCoefficients);
  Eigen::VectorXd basis(kMaxCoefficients);
  double seen_above = 0, above = 0;
  for (int y = 0; y < height; y += block)
    for (int x = 0; x < width; x += block) {
      const int x1 = std::min(x + block, width), y1 = std::min(y + block, height);
      double w = 0;
      for (int j = y; j < y1; ++j)
        for (int i = x; i < x1; ++i)
          w += latlong_solid_angle(j, width, height) * double(confidence.at(i, j));
      const glm::dvec3 middle = latlong_direction((x + x1) / 2., (y + y1) / 2., width, height);
      for (int j = y; j < y1; ++j)
        above += std::max(0., middle.y) * (x1 - x) * latlong_solid_angle(j, width, height);
      seen_above += std::max(0., middle.y) * w;
      if (w <= 0) continue;
      evaluate_basis(kMaxBands, middle, {basis.data(), static_cast<std::size_t>(kMaxCoefficients)});
      sums.add(basis, Eigen::RowVector3d::Zero(), w, true);
    }
  coverage_ = std::min(1., sums.seen_sr / (4 * kPi));
  unseen_above_ = std::clamp(1 - seen_above / above, 0., 1.);
  system_.compute(penalised(sums.gram, kMaxBands, 1 - coverage_));
}

Result<ShProjection> ShInpainting::fill(const RadianceSh& moments) const {
  if (coverage_ < kMinCoverage)
    return fail(ErrorCode::kUndetermined, "environment",
                fmt::format("covers only {:.1f} % of the sphere", 100 * coverage_));
  MomentMatrix right(kMaxCoefficients, 3);
  for (int n = 0; n < kMaxCoefficients; ++n)
    for (int c = 0; c < 3; ++c) right(n, c) = moments[n][c];
  const MomentMatrix fit = system_.solve(right);
  const RadianceSh light = to_light(fit, kMaxBands);
  return ShProjection{light, moments_above(light), coverage_};
}

}  // namespace penumbra::lighting
