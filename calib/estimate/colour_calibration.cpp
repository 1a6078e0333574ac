#include "calib/estimate/colour_calibration.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <glm/matrix.hpp>
#include <iterator>

#include "core/io/toml_keys.h"

namespace penumbra::calib {

namespace {

constexpr std::size_t kFewestPairs = 8;
constexpr double kMaxUncertain = .05;  // of an element, against the mean of the diagonal
constexpr const char* kChannels[] = {"red", "green", "blue"};

using Vector = Eigen::Vector3d;
using Matrix = Eigen::Matrix3d;

Vector vector_of(const Rgb& c) {
  return {double(c.r), double(c.g), double(c.b)};
}

// Pairs over the target's mean: bright and dark surfaces count alike.
struct Relative {
  std::vector<Vector> source, target;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + std::ssize(values) / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::vector<double> residuals(const Relative& pairs, const Matrix& m) {
  std::vector<double> out;
  for (std::size_t i = 0; i < pairs.source.size(); ++i)
    out.push_back((pairs.target[i] - m * pairs.source[i]).norm() / std::sqrt(3.));
  return out;
}

Matrix start_by_medians(const Relative& pairs) {
  Matrix out = Matrix::Zero();
  for (int c = 0; c < 3; ++c) {
    std::vector<double> ratios;
    for (std::size_t i = 0; i < pairs.source.size(); ++i)
      ratios.push_back(pairs.target[i][c] / std::max(pairs.source[i][c], 1e-12));
    out(c, c) = median(std::move(ratios));
  }
  return out;
}

// The matrix is linear in its parameters: which elements one sets.
using Parameter = std::vector<std::pair<int, int>>;
std::vector<Parameter> parameters_of(ColourModel model) {
  if (model == ColourModel::kScale) return {{{0, 0}, {1, 1}, {2, 2}}};
  std::vector<Parameter> out;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c)
      if (model == ColourModel::kMatrix || r == c) out.push_back({{r, c}});
  return out;
}

struct ColourFit {
  Matrix matrix = Matrix::Zero(), sigma = Matrix::Zero();
};
std::optional<ColourFit> weighted_fit(const Relative& pairs, const std::vector<double>& weights,
                                      const std::vector<Parameter>& parameters) {
  const auto count = std::ssize(parameters);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(count, count);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(count);
  const auto row = [&](std::size_t i, int r) {
    Eigen::VectorXd a = Eigen::VectorXd::Zero(count);
    for (Eigen::Index p = 0; p < count; ++p)
      for (const auto& [to, from] : parameters[static_cast<std::size_t>(p)])
        if (to == r) a[p] = pairs.source[i][from];
    return a;
  };
  double all = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    all += 3 * weights[i];
    for (int r = 0; r < 3; ++r) {
      const Eigen::VectorXd a = row(i, r);
      normal += weights[i] * a * a.transpose();
      right += weights[i] * a * pairs.target[i][r];
    }
  }
  const Eigen::LDLT<Eigen::MatrixXd> solver(normal);
  if (solver.info() != Eigen::Success || !(solver.rcond() > 1e-14)) return std::nullopt;
  const Eigen::VectorXd solution = solver.solve(right);
  ColourFit out;
  const auto set = [&](Matrix& m, Eigen::Index p, double value) {
    for (const auto& [r, c] : parameters[static_cast<std::size_t>(p)]) m(r, c) = value;
  };
  for (Eigen::Index p = 0; p < count; ++p) set(out.matrix, p, solution[p]);
  double square = 0;
  for (std::size_t i = 0; i < weights.size(); ++i)
    square += weights[i] * (pairs.target[i] - out.matrix * pairs.source[i]).squaredNorm();
  const double variance = square / std::max(1., all - static_cast<double>(count));
  const Eigen::MatrixXd inverse = solver.solve(Eigen::MatrixXd::Identity(count, count));
  for (Eigen::Index p = 0; p < count; ++p)
    set(out.sigma, p, std::sqrt(std::max(0., variance * inverse(p, p))));
  return out;
}

glm::dmat3 to_glm(const Matrix& m) {
  glm::dmat3 out;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) out[c][r] = m(r, c);
  return out;
}

std::unexpected<Error> too_few_colours(const std::string& which) {
  return fail(ErrorCode::kUndetermined, "colour calibration",
              "the surfaces have too few colours to tell " + which +
                  ": put a colour chart or strongly coloured things into both views, or ask for "
                  "--model gains");
}

Result<void> check_determined(const ColourFit& fit) {
  const double size = fit.matrix.diagonal().cwiseAbs().mean();
  Eigen::Index r = 0, c = 0;
  const double largest = fit.sigma.maxCoeff(&r, &c);
  if (largest <= kMaxUncertain * size) return {};
  return too_few_colours(
      fmt::format("how much {} of the one is in {} of the other ({:.3g} +- {:.3g})", kChannels[c],
                  kChannels[r], fit.matrix(r, c), largest));
}

Result<Relative> relative(std::span<const ColourPair> pairs) {
  Relative out;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const Vector source = vector_of(pairs[i].source), target = vector_of(pairs[i].target);
    const double mean = target.mean();
    if (!source.allFinite() || !target.allFinite() || !(mean > 0))
      return fail(ErrorCode::kNonFinite, fmt::format("colour pair {}", i + 1),
                  "is not finite, or is black");
    out.source.push_back(source / mean);
    out.target.push_back(target / mean);
  }
  return out;
}

}  // namespace

Result<ColourModel> colour_model(std::string_view name) {
  if (name == "matrix") return ColourModel::kMatrix;
  if (name == "gains") return ColourModel::kGains;
  if (name == "scale") return ColourModel::kScale;
  return fail(ErrorCode::kInvalid, std::string(name),
              "is none of the models matrix, gains and scale");
}

Result<ColourCalibration> calibrate_colour(std::span<const ColourPair> pairs, ColourModel model) {
  constexpr double kTukey = 4.685;  // 95 % efficient for Gaussian residuals
  // Standard deviation over the median norm of three residuals / sqrt 3
  constexpr double kOfTheMedian = 1.2;
  constexpr double kExact = 1e-6;
  constexpr int kRounds = 30;
  if (pairs.size() < kFewestPairs)
    return fail(ErrorCode::kUndetermined, "colour calibration",
                fmt::format("only {} surfaces are well exposed in both cameras, and {} are needed",
                            pairs.size(), kFewestPairs));
  PENUMBRA_ASSIGN(scaled, relative(pairs));
  const auto parameters = parameters_of(model);
  ColourFit fit;
  fit.matrix = start_by_medians(scaled);
  std::vector<double> weights(pairs.size());
  ColourCalibration out;
  double cutoff = 0;
  for (int round = 0; round < kRounds; ++round) {
    out.residuals = residuals(scaled, fit.matrix);
    cutoff = kTukey * std::max(kExact, kOfTheMedian * median(out.residuals));
    for (std::size_t i = 0; i < weights.size(); ++i) {
      const double u = out.residuals[i] / cutoff;
      weights[i] = u < 1 ? (1 - u * u) * (1 - u * u) : 0;
    }
    const auto better = weighted_fit(scaled, weights, parameters);
    if (!better) return too_few_colours("the matrix");
    fit = *better;
  }
  out.residuals = residuals(scaled, fit.matrix);
  double square = 0;
  std::size_t used = 0;
  for (const double r : out.residuals) {
    out.used.push_back(r < cutoff);
    if (r < cutoff) square += r * r, ++used;
  }
  constexpr double kFarOff = .1;
  out.rms = std::sqrt(square / static_cast<double>(std::max<std::size_t>(used, 1)));
  if (out.rms > kFarOff)
    return fail(ErrorCode::kUndetermined, "colour calibration",
                fmt::format("{} surfaces disagree by {:.0f} %: are the poses right, did nothing "
                            "move, and would --model matrix fit better?",
                            pairs.size(), 100 * out.rms));
  PENUMBRA_TRY(check_determined(fit));
  out.matrix = to_glm(fit.matrix);
  out.sigma = to_glm(fit.sigma);
  return out;
}

std::string print_colour_file(const ColourCalibration& c, std::string_view source,
                              std::string_view target) {
  const auto rows = [](const glm::dmat3& m) {
    std::string text;
    for (int r = 0; r < 3; ++r)
      text += fmt::format("{}{:.7g}, {:.7g}, {:.7g}", r ? ",\n          " : "", m[0][r], m[1][r],
                          m[2][r]);
    return text;
  };
  return fmt::format(
      "version = 1\n\n[colour]  # radiance of {} = matrix * radiance of {}\nmatrix = [{}]\n"
      "sigma  = [{}]  # one standard deviation each\nrms = {:.4g}  # relative, of {} surfaces of "
      "{}\n",
      toml_quoted(std::string(target)), toml_quoted(std::string(source)), rows(c.matrix),
      rows(c.sigma), c.rms, std::ranges::count(c.used, true), c.used.size());
}

}  // namespace penumbra::calib
