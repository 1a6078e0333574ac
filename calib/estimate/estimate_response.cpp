// Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs", eq. 3:
//   min sum_ik w(Z_ik) (g(Z_ik) - ln E_i - ln t_k)^2 + lambda (smoothness of g).
// Differs from the paper, and from OpenCV's CalibrateDebevec (whose hat weight is 1, not 0, on
// clipped codes: a bracket of seven stops then comes out 20 % wrong), in three points:
// - codes that may be clipped or black have weight 0;
// - the curve has a dozen terms, its local exponent dg/d(ln z) at a few codes, none of which may
//   fall: a power of the code, whatever its exponent, costs no smoothness, and neither a toe nor a
//   shoulder is bent;
// - the ln E_i are eliminated beforehand (Schur complement), so that any number of samples costs
//   the same to solve.
//
// Calls OpenCV for the linear solver; its exceptions end here.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <opencv2/core.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "calib/camera/response.h"
#include "calib/estimate/estimate_response.h"
#include "core/median.h"
#include "core/threads/parallel.h"

namespace penumbra::calib {
namespace {

constexpr int kCodes = 256;
// A code this close to either end may be clipped or buried in noise.
constexpr int kBlack = 3, kClipped = 252;
// The last code of which the pictures tell the light.
constexpr int kLastTrusted = kClipped - 1;
// Between it and the end of the codes pixels tell where a channel saturates.
constexpr int kBrightest = 230;
// Fewer pixels than this do not make a curve; more than that only cost time.
constexpr std::size_t kMinSamples = 50, kMaxSamples = 4000;
constexpr double kSmoothness = 1e-6;
constexpr std::array<const char*, 3> kChannelNames{"red", "green", "blue"};

std::unexpected<Error> invalid(std::string detail) {
  return fail(ErrorCode::kInvalid, "bracket", std::move(detail));
}
std::unexpected<Error> response_undetermined(std::string detail) {
  return fail(ErrorCode::kUndetermined, "bracket", std::move(detail));
}

int channel_of(const Rgb8& p, int c) {
  return c == 0 ? p.r : c == 1 ? p.g : p.b;
}
bool is_border(const Rgb8& p) {
  return p == Rgb8{0, 0, 255};
}

Result<void> check_arguments(Pictures pictures, std::span<const Seconds> times) {
  if (pictures.size() != times.size())
    return invalid(
        fmt::format("has {} pictures but {} exposure times", pictures.size(), times.size()));
  if (pictures.size() < 2) return invalid("has fewer than 2 pictures");
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    if (!pictures[k] || pictures[k]->empty())
      return invalid(fmt::format("picture {} is empty", k + 1));
    if (!pictures[k]->same_size(*pictures[0]))
      return invalid(fmt::format("picture {} is {}x{}, but picture 1 is {}x{}", k + 1,
                                 pictures[k]->width(), pictures[k]->height(), pictures[0]->width(),
                                 pictures[0]->height()));
    if (!std::isfinite(times[k].count()) || times[k].count() <= 0)
      return invalid(
          fmt::format("exposure time {} is {} s and not positive", k + 1, times[k].count()));
  }
  const auto [shortest, longest] = std::ranges::minmax_element(times);
  // Grossberg & Nayar 2003: without a trusted ratio of exposures every power of a curve fits too.
  if (longest->count() < shortest->count() * 1.01)
    return response_undetermined("all exposure times are equal");
  return {};
}

// ------------------------------------------------------------------------------- samples

struct SquareCandidate {
  int x = 0, y = 0;
  double mean = 0;   // of its codes over the bracket
  int contrast = 0;  // largest difference to a neighbour: small survives misregistration
};

/// What a coarse walk over the bracket finds, per channel.
struct Survey {
  std::array<std::vector<SquareCandidate>, 3> candidates;  // usable in two pictures or more
  std::array<bool, 3> moves{};  // some usable pixel changes its code with the exposure
  bool any_pixel = false, any_above_black = false, any_below_clip = false;
  std::array<std::array<std::size_t, kCodes>, 3> histogram{};
};

int contrast_at(Pictures pictures, int x, int y, int c) {
  int contrast = 0;
  for (const Picture* p : pictures) {
    const int here = channel_of(p->at(x, y), c);
    for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
      const int nx = std::clamp(x + dx, 0, p->width() - 1),
                ny = std::clamp(y + dy, 0, p->height() - 1);
      contrast = std::max(contrast, std::abs(channel_of(p->at(nx, ny), c) - here));
    }
  }
  return contrast;
}

void survey_channel(Pictures pictures, int x, int y, int c, Survey& survey) {
  int usable = 0, lowest = kCodes, highest = -1;
  double sum = 0;
  for (const Picture* p : pictures) {
    const int code = channel_of(p->at(x, y), c);
    sum += code;
    ++survey.histogram[static_cast<std::size_t>(c)][static_cast<std::size_t>(code)];
    survey.any_above_black |= code > kBlack;
    survey.any_below_clip |= code < kClipped;
    if (code <= kBlack || code >= kClipped) continue;
    ++usable;
    lowest = std::min(lowest, code);
    highest = std::max(highest, code);
  }
  if (usable < 2) return;
  const auto n = static_cast<std::size_t>(c);
  survey.moves[n] = survey.moves[n] || highest > lowest;
  survey.candidates[n].push_back(
      {x, y, sum / static_cast<double>(pictures.size()), contrast_at(pictures, x, y, c)});
}

Survey survey_bracket(Pictures pictures) {
  const int width = pictures[0]->width(), height = pictures[0]->height();
  // About 40,000 pixels hold enough to choose from.
  const int step =
      std::max(1, static_cast<int>(std::sqrt(width * static_cast<double>(height) / 4e4)));
  Survey survey;
  for (int y = step / 2; y < height; y += step) {
    for (int x = step / 2; x < width; x += step) {
      if (std::ranges::any_of(pictures, [&](const Picture* p) { return is_border(p->at(x, y)); }))
        continue;
      survey.any_pixel = true;
      for (int c = 0; c < 3; ++c) survey_channel(pictures, x, y, c, survey);
    }
  }
  return survey;
}

/// The largest code of a channel, where pictures pile up at it below those codes that are left out
/// anyway: a camera that does not use its whole range saturates there.
std::optional<int> early_saturation(const std::array<std::size_t, kCodes>& histogram) {
  constexpr int kBefore = 8;
  constexpr std::size_t kFewest = 20, kPile = 10;  // times the codes before
  int last = kCodes - 1;
  while (last > 0 && histogram[static_cast<std::size_t>(last)] == 0) --last;
  if (last >= kClipped || last <= kBefore) return std::nullopt;
  std::size_t before = 0;
  for (int z = last - kBefore; z < last; ++z) before += histogram[static_cast<std::size_t>(z)];
  const std::size_t pile = histogram[static_cast<std::size_t>(last)];
  return pile >= kFewest && pile * kBefore > kPile * before ? std::optional(last) : std::nullopt;
}

Result<void> check_survey(const Survey& survey) {
  if (!survey.any_pixel)
    return response_undetermined("every pixel lies outside one of the aligned pictures");
  if (!survey.any_above_black) return response_undetermined("every picture is black");
  if (!survey.any_below_clip) return response_undetermined("every picture is clipped");
  for (std::size_t c = 0; c < 3; ++c) {
    const auto& candidates = survey.candidates[c];
    if (candidates.size() < kMinSamples)
      return response_undetermined(
          fmt::format("the exposures do not overlap: {} sampled pixels are well exposed in two "
                      "pictures in {}, and {} are needed",
                      candidates.size(), kChannelNames[c], kMinSamples));
    const auto [low, high] = std::ranges::minmax(candidates, {}, &SquareCandidate::mean);
    if (high.mean - low.mean < 4)
      return response_undetermined(
          fmt::format("the scene is too even: {} is the same everywhere", kChannelNames[c]));
    if (!survey.moves[c])
      return response_undetermined(
          fmt::format("{} does not change with the exposure", kChannelNames[c]));
  }
  for (std::size_t c = 0; c < 3; ++c)
    if (const auto last = early_saturation(survey.histogram[c]))
      return response_undetermined(fmt::format(
          "{} saturates at code {} instead of 255: let the camera deliver the full range "
          "of codes",
          kChannelNames[c], *last));
  return {};
}

/// Longer exposures are never darker, over the pixels that are used: else the times belong to other
/// pictures, and no curve explains them.
Result<void> check_order(Pictures pictures, std::span<const Seconds> times, const Survey& survey) {
  std::vector<std::size_t> order(pictures.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {}, [&](std::size_t k) { return times[k]; });
  double previous = -1;
  for (const std::size_t k : order) {
    double sum = 0;
    for (const SquareCandidate& p : survey.candidates[1]) sum += pictures[k]->at(p.x, p.y).g;
    const double mean = sum / static_cast<double>(survey.candidates[1].size());
    if (mean < previous - 1)
      return response_undetermined(
          fmt::format("picture {} is darker than one with a shorter exposure", k + 1));
    previous = mean;
  }
  return {};
}

/// `count` candidates spread evenly over brightness, the smoothest ones of each brightness first.
std::vector<SquareCandidate> spread(std::vector<SquareCandidate> candidates, std::size_t count) {
  std::ranges::stable_sort(candidates, {}, &SquareCandidate::contrast);
  std::array<std::vector<SquareCandidate>, kCodes / 2> buckets;
  for (const SquareCandidate& c : candidates)
    buckets[std::min(buckets.size() - 1, static_cast<std::size_t>(c.mean / 2))].push_back(c);
  std::vector<SquareCandidate> chosen;
  for (std::size_t depth = 0; chosen.size() < count; ++depth)
    for (const auto& bucket : buckets)
      if (depth < bucket.size() && chosen.size() < count) chosen.push_back(bucket[depth]);
  return chosen;
}

// ------------------------------------------------------------------------------- curve

/// Hat weight (the paper's eq. 4) over the usable codes, 0 outside.
double weight_of(int code) {
  const double lowest = std::min(code - kBlack, kClipped - code);
  return std::max(0., lowest) / ((kClipped - kBlack) / 2.);
}

/// Normal equations for ln of the light of codes 1..255 (rows code - 1).
struct Equations {
  cv::Mat matrix = cv::Mat::zeros(kCodes - 1, kCodes - 1, CV_64F);
  cv::Mat right = cv::Mat::zeros(kCodes - 1, 1, CV_64F);
  double total_weight = 0;
};

using CodesAndTimes = std::vector<std::pair<int, double>>;  // code, logarithm of the time

/// One pixel: min over ln E of sum w_k (g_k - ln t_k - ln E)^2 = sum w_k (g_k - ln t_k)^2 less its
/// weighted mean's square. `pixel_weight`: how much the pixel counts.
void add_pixel(Equations& equations, const CodesAndTimes& seen, double pixel_weight) {
  double weights = 0, log_time = 0;
  for (const auto& [code, t] : seen) {
    weights += weight_of(code);
    log_time += weight_of(code) * t;
  }
  if (weights <= 0) return;
  log_time /= weights;
  equations.total_weight += pixel_weight * weights;
  for (const auto& [a, ta] : seen) {
    const double wa = pixel_weight * weight_of(a);
    equations.right.at<double>(a - 1) += wa * (ta - log_time);
    equations.matrix.at<double>(a - 1, a - 1) += wa;
    for (const auto& [b, tb] : seen)
      equations.matrix.at<double>(a - 1, b - 1) -= wa * weight_of(b) / weights;
  }
}

/// How far a pixel's codes contradict each other under a curve, RMS of ln of the light.
double contradiction_of(const CodesAndTimes& seen, const cv::Mat& curve) {
  double weights = 0, sum = 0, square = 0;
  for (const auto& [code, t] : seen) {
    const double w = weight_of(code), light = curve.at<double>(code - 1) - t;
    weights += w, sum += w * light, square += w * light * light;
  }
  if (weights <= 0) return 0;
  return std::sqrt(std::max(0., square / weights - sum * sum / (weights * weights)));
}

/// Pixels that contradict themselves more than others do: something moved over them. At first by
/// the sum of distances, which has one minimum; then those far off have no say at all.
/// source: biweight, Beaton & Tukey 1974
std::vector<double> pixel_weights(const std::vector<CodesAndTimes>& pixels, const cv::Mat& curve,
                                  bool first) {
  constexpr double kFar = 4.685, kUsual = .02;  // a code's rounding and noise at least
  std::vector<double> out;
  for (const CodesAndTimes& p : pixels) out.push_back(contradiction_of(p, curve));
  std::vector<double> sorted = out;
  const double scale = std::max(kUsual, 1.4826 * median(sorted));
  for (double& v : out) {
    const double u = v / (kFar * scale);
    v = first ? kUsual / std::max(v, kUsual) : u < 1 ? std::pow(1 - u * u, 2) : 0;
  }
  return out;
}

/// The curves that are looked for, as Grossberg & Nayar 2004 look within a few terms: the local
/// exponent e = dg/d(ln z) is piecewise linear over the code between these knots. Column j holds
/// g(z) for e_j = 1 and all others 0, with g(128) = 0 for the scale that no bracket can tell.
constexpr std::array<double, 13> kKnots{0, 5, 10, 18, 32, 64, 112, 160, 200, 224, 240, 248, 255};
constexpr int kTerms = static_cast<int>(kKnots.size());

cv::Mat curve_terms() {
  cv::Mat out = cv::Mat::zeros(kCodes - 1, kTerms, CV_64F);
  for (int z = 1; z < kCodes - 1; ++z) {  // from z to z + 1
    const double at = z + .5, step = std::log((z + 1.) / z);
    for (int j = 0; j < kTerms; ++j) out.at<double>(z, j) = out.at<double>(z - 1, j);
    const auto above = std::ranges::upper_bound(kKnots, at);
    const auto j = static_cast<int>(above - kKnots.begin());
    const double fraction = (at - *(above - 1)) / (*above - *(above - 1));
    out.at<double>(z, j - 1) += (1 - fraction) * step;
    out.at<double>(z, j) += fraction * step;
  }
  const cv::Mat middle = out.row(kCodes / 2 - 1).clone();
  for (int z = 0; z < kCodes - 1; ++z) out.row(z) -= middle;
  return out;
}

/// Where no pixel speaks the exponent stays as it is beside: lambda (e_j - e_(j+1))^2.
cv::Mat smoothness_of_terms(double total_weight) {
  cv::Mat out = cv::Mat::zeros(kTerms, kTerms, CV_64F);
  const double lambda = kSmoothness * total_weight;
  for (int j = 0; j + 1 < kTerms; ++j) {
    out.at<double>(j, j) += lambda;
    out.at<double>(j + 1, j + 1) += lambda;
    out.at<double>(j, j + 1) -= lambda;
    out.at<double>(j + 1, j) -= lambda;
  }
  return out;
}

/// The solution of `matrix` x = `right` with no x below a least slope: what would fall is held
/// there and the rest solved again (an active set, Lawson & Hanson 1974). Nothing when singular.
std::optional<cv::Mat> rising(const cv::Mat& matrix, const cv::Mat& right) {
  constexpr double kMin = .1;  // twice the code is at least a tenth of an octave more light
  std::vector<bool> held(static_cast<std::size_t>(kTerms), false);
  for (;;) {
    cv::Mat m = matrix.clone(), r = right.clone(), x;
    for (int j = 0; j < kTerms; ++j) {
      if (!held[static_cast<std::size_t>(j)]) continue;
      r -= kMin * m.col(j);
      m.row(j) = 0;
      m.col(j) = 0;
      m.at<double>(j, j) = 1;
      r.at<double>(j) = kMin;
    }
    if (!cv::solve(m, r, x, cv::DECOMP_CHOLESKY)) return std::nullopt;
    bool falls = false;
    for (int j = 0; j < kTerms; ++j) {
      if (held[static_cast<std::size_t>(j)] || x.at<double>(j) >= kMin) continue;
      held[static_cast<std::size_t>(j)] = falls = true;
    }
    if (!falls) return x;
  }
}

/// ln of the light for codes 1..255 of one channel.
Result<std::vector<double>> solve_curve(Pictures pictures, std::span<const Seconds> times,
                                        const std::vector<SquareCandidate>& samples, int channel) {
  constexpr int kFirstRounds = 12, kRounds = 16;
  try {
    std::vector<CodesAndTimes> pixels;
    for (const SquareCandidate& s : samples) {
      CodesAndTimes& seen = pixels.emplace_back();
      for (std::size_t k = 0; k < pictures.size(); ++k) {
        const int code = channel_of(pictures[k]->at(s.x, s.y), channel);
        if (weight_of(code) > 0) seen.emplace_back(code, std::log(times[k].count()));
      }
    }
    const cv::Mat terms = curve_terms();
    std::vector<double> pixel_weight(pixels.size(), 1);
    cv::Mat curve;
    for (int round = 0; round < kRounds; ++round) {
      Equations equations;
      for (std::size_t i = 0; i < pixels.size(); ++i)
        add_pixel(equations, pixels[i], pixel_weight[i]);
      const auto exponents =
          rising(terms.t() * equations.matrix * terms + smoothness_of_terms(equations.total_weight),
                 terms.t() * equations.right);
      if (!exponents)
        return response_undetermined(
            fmt::format("the pictures do not determine the curve of {}: its equations are singular",
                        kChannelNames[static_cast<std::size_t>(channel)]));
      curve = terms * *exponents;
      pixel_weight = pixel_weights(pixels, curve, round < kFirstRounds);
    }
    return std::vector<double>(curve.begin<double>(), curve.end<double>());
  } catch (const std::exception& e) {  // cv::Exception is one
    return response_undetermined(std::string("OpenCV: ") + e.what());
  }
}

/// Least-squares monotone fit (pool adjacent violators; Barlow et al. 1972).
std::vector<double> monotone(const std::vector<double>& values) {
  struct ResponseBlock {
    double mean;
    std::size_t count;
  };
  std::vector<ResponseBlock> blocks;
  for (const double v : values) {
    blocks.push_back({v, 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean > blocks.back().mean) {
      const ResponseBlock last = blocks.back();
      blocks.pop_back();
      ResponseBlock& into = blocks.back();
      const auto a = static_cast<double>(into.count), b = static_cast<double>(last.count);
      into.mean = (a * into.mean + b * last.mean) / (a + b);
      into.count += last.count;
    }
  }
  std::vector<double> out;
  for (const ResponseBlock& b : blocks) out.insert(out.end(), b.count, b.mean);
  return out;
}

/// Light at which a channel saturates, by pixels that shorter exposures tell: the limit that parts
/// codes 255 from lower ones best. Nothing where too few pixels are on either side.
std::optional<double> saturation_light(Pictures pictures, std::span<const Seconds> times,
                                       const std::vector<SquareCandidate>& samples, int channel,
                                       const std::vector<double>& log_light) {
  constexpr std::size_t kFewest = 30;
  std::vector<std::pair<double, bool>> seen;  // logarithm of the light, saturated
  for (const SquareCandidate& s : samples) {
    double weights = 0, sum = 0;
    const auto code_in = [&](std::size_t k) {
      return channel_of(pictures[k]->at(s.x, s.y), channel);
    };
    for (std::size_t k = 0; k < pictures.size(); ++k) {
      const int code = code_in(k);
      const double w = code < kBrightest ? weight_of(code) : 0;
      if (w <= 0) continue;
      weights += w;
      sum += w * (log_light[static_cast<std::size_t>(code - 1)] - std::log(times[k].count()));
    }
    if (weights <= 0) continue;
    for (std::size_t k = 0; k < pictures.size(); ++k)
      if (code_in(k) >= kBrightest)
        seen.emplace_back(sum / weights + std::log(times[k].count()), code_in(k) == kCodes - 1);
  }
  std::ranges::sort(seen);
  const auto saturated =
      static_cast<std::size_t>(std::ranges::count(seen, true, &std::pair<double, bool>::second));
  if (saturated < kFewest || seen.size() - saturated < kFewest) return std::nullopt;
  // Wrong: saturated ones below the limit, others above it.
  std::size_t wrong = seen.size() - saturated, fewest = wrong, at = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    seen[i].second ? ++wrong : --wrong;
    if (wrong < fewest) fewest = wrong, at = i + 1;
  }
  if (at == 0 || at == seen.size()) return std::nullopt;
  return std::exp((seen[at - 1].first + seen[at].first) / 2);
}

/// The last codes, up to 255: to the light that saturates or, where nobody saw it, on as the codes
/// before rise. It is the 1 of every response, whatever its source.
void continue_to_white(std::vector<double>& light, std::optional<double> white) {
  const auto last = std::size_t{kLastTrusted}, before = last - 8;
  if (!white || *white < light[last]) {
    const double exponent = std::log(light[last] / light[before]) /
                            std::log(static_cast<double>(last) / static_cast<double>(before));
    white = light[last] * std::pow((kCodes - 1.) / kLastTrusted, exponent);
  }
  for (std::size_t z = last + 1; z < light.size(); ++z)
    light[z] =
        std::lerp(light[last], *white,
                  static_cast<double>(z - last) / static_cast<double>(kCodes - 1 - kLastTrusted));
}

Result<std::vector<float>> decode_from_curve(const std::vector<double>& log_light,
                                             std::optional<double> white) {
  std::vector<double> light{0};
  for (const double g : log_light) light.push_back(std::exp(g));
  light[0] = std::max(0., 2 * light[1] - light[2]);  // a logarithm cannot say 0
  if (!std::ranges::all_of(light, [](double v) { return std::isfinite(v); }))
    return response_undetermined("the pictures give no finite curve");
  light = monotone(light);
  if (!(light[std::size_t{kLastTrusted}] > light.front()))
    return response_undetermined("the pictures give no rising curve");
  continue_to_white(light, white);
  std::vector<float> decode;
  for (const double v : light) decode.push_back(static_cast<float>(v / light.back()));
  return decode;
}

}  // namespace

Result<Response> estimate_response(Pictures pictures, std::span<const Seconds> times) {
  PENUMBRA_TRY(check_arguments(pictures, times));
  const Survey survey = survey_bracket(pictures);
  PENUMBRA_TRY(check_survey(survey));
  PENUMBRA_TRY(check_order(pictures, times, survey));
  std::array<std::vector<float>, 3> decode;
  for (int c = 0; c < 3; ++c) {
    const auto n = static_cast<std::size_t>(c);
    const auto count = std::min(kMaxSamples, survey.candidates[n].size());
    PENUMBRA_ASSIGN(curve, solve_curve(pictures, times, spread(survey.candidates[n], count), c));
    const auto white = saturation_light(pictures, times, survey.candidates[n], c, curve);
    PENUMBRA_ASSIGN(channel, decode_from_curve(curve, white));
    decode[n] = std::move(channel);
  }
  return Response::from_table(std::move(decode));
}

}  // namespace penumbra::calib
