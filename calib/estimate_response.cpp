// Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs", eq. 3:
//   min sum_ik w(Z_ik) (g(Z_ik) - ln E_i - ln t_k)^2 + lambda sum_z (smoothness of g at z)^2.
// Differs from the paper, and from OpenCV's CalibrateDebevec (whose hat weight is 1, not 0, on
// clipped codes: a bracket of seven stops then comes out 20 % wrong), in three points:
// - codes that may be clipped or black have weight 0;
// - what is kept smooth is the local exponent dg/d(ln z), not dg/dz: a power of the code, whatever
// its
//   exponent, costs nothing, so the smoothness does not bend the dark end;
// - the ln E_i are eliminated beforehand (Schur complement), which leaves 255 unknowns for any
// number
//   of samples.
//
// The only file of this folder that calls OpenCV (for the linear solver); its exceptions end here.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <opencv2/core.hpp>
#include <utility>
#include <vector>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

using Picture = Image<Rgb8>;
using Pictures = std::span<const Picture* const>;

constexpr int kCodes = 256;
// A code this close to either end may be clipped or buried in noise.
constexpr int kBlack = 3, kClipped = 252;
// Fewer pixels than this do not make a curve; more than that only cost time.
constexpr std::size_t kMinSamples = 50, kMaxSamples = 1500;
constexpr double kSmoothness = .1;
constexpr std::array<const char*, 3> kChannelNames{"red", "green", "blue"};

std::unexpected<Error> invalid(std::string detail) {
  return fail(ErrorCode::kInvalid, "bracket", std::move(detail));
}
std::unexpected<Error> undetermined(std::string detail) {
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
    return invalid(fmt::format("{} pictures, but {} times", pictures.size(), times.size()));
  if (pictures.size() < 2) return invalid("fewer than 2 pictures");
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    if (!pictures[k] || pictures[k]->empty()) return invalid(fmt::format("picture {} is empty", k));
    if (!pictures[k]->same_size(*pictures[0]))
      return invalid(fmt::format("picture {} is {}x{}, picture 0 {}x{}", k, pictures[k]->width(),
                                 pictures[k]->height(), pictures[0]->width(),
                                 pictures[0]->height()));
    if (!std::isfinite(times[k].count()) || times[k].count() <= 0)
      return invalid(
          fmt::format("exposure time {} is {}, not a positive number", k, times[k].count()));
  }
  const auto [shortest, longest] = std::ranges::minmax_element(times);
  // Grossberg & Nayar 2003: without a trusted ratio of exposures every power of a curve fits too.
  if (longest->count() < shortest->count() * 1.01)
    return undetermined("all exposure times are equal");
  return {};
}

// ------------------------------------------------------------------------------- samples

struct Candidate {
  int x = 0, y = 0;
  double mean = 0;   // of its codes over the bracket
  int contrast = 0;  // largest difference to a neighbour: small survives misregistration
};

/// What a coarse walk over the bracket finds, per channel.
struct Survey {
  std::array<std::vector<Candidate>, 3> candidates;  // usable in two pictures or more
  std::array<bool, 3> moves{};  // some usable pixel changes its code with the exposure
  bool any_pixel = false, any_above_black = false, any_below_clip = false;
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

Result<void> check_survey(const Survey& survey) {
  if (!survey.any_pixel) return undetermined("nothing but registration borders");
  if (!survey.any_above_black) return undetermined("every picture is black");
  if (!survey.any_below_clip) return undetermined("every picture is clipped");
  for (std::size_t c = 0; c < 3; ++c) {
    const auto& candidates = survey.candidates[c];
    if (candidates.size() < kMinSamples)
      return undetermined(fmt::format(
          "no overlap: {} sampled pixels are well exposed in two pictures in {}, {} are needed",
          candidates.size(), kChannelNames[c], kMinSamples));
    const auto [low, high] = std::ranges::minmax(candidates, {}, &Candidate::mean);
    if (high.mean - low.mean < 4)
      return undetermined(fmt::format("one colour: {} is the same everywhere", kChannelNames[c]));
    if (!survey.moves[c])
      return undetermined(fmt::format("{} does not change with the exposure", kChannelNames[c]));
  }
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
    for (const Candidate& p : survey.candidates[1]) sum += pictures[k]->at(p.x, p.y).g;
    const double mean = sum / static_cast<double>(survey.candidates[1].size());
    if (mean < previous - 1)
      return undetermined(fmt::format("picture {} is darker than one with a shorter exposure", k));
    previous = mean;
  }
  return {};
}

/// `count` candidates spread evenly over brightness, the smoothest ones of each brightness first.
std::vector<Candidate> spread(std::vector<Candidate> candidates, std::size_t count) {
  std::ranges::stable_sort(candidates, {}, &Candidate::contrast);
  std::array<std::vector<Candidate>, kCodes / 2> buckets;
  for (const Candidate& c : candidates)
    buckets[std::min(buckets.size() - 1, static_cast<std::size_t>(c.mean / 2))].push_back(c);
  std::vector<Candidate> chosen;
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

/// One pixel: min over ln E of sum w_k (g_k - ln t_k - ln E)^2 = sum w_k (g_k - ln t_k)^2 less its
/// weighted mean's square.
void add_pixel(Equations& equations, std::span<const std::pair<int, double>> codes_and_log_times) {
  double weights = 0, log_time = 0;
  for (const auto& [code, t] : codes_and_log_times) {
    weights += weight_of(code);
    log_time += weight_of(code) * t;
  }
  if (weights <= 0) return;
  log_time /= weights;
  equations.total_weight += weights;
  for (const auto& [a, ta] : codes_and_log_times) {
    const double wa = weight_of(a);
    equations.right.at<double>(a - 1) += wa * (ta - log_time);
    equations.matrix.at<double>(a - 1, a - 1) += wa;
    for (const auto& [b, tb] : codes_and_log_times)
      equations.matrix.at<double>(a - 1, b - 1) -= wa * weight_of(b) / weights;
  }
}

/// lambda (e(z + 1/2) - e(z - 1/2))^2 with the local exponent e = (g(z+1) - g(z))/ln((z+1)/z), and
/// g(128) = 0 for the scale that no bracket can tell.
void add_smoothness(Equations& equations) {
  const double lambda = kSmoothness * equations.total_weight / kCodes;
  for (int z = 2; z < kCodes - 1; ++z) {
    const double up = 1 / std::log((z + 1.) / z), down = 1 / std::log(z / (z - 1.));
    const std::array<double, 3> row{down, -down - up, up};  // on g(z-1), g(z), g(z+1)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        equations.matrix.at<double>(z - 2 + i, z - 2 + j) +=
            lambda * row[static_cast<std::size_t>(i)] * row[static_cast<std::size_t>(j)];
  }
  equations.matrix.at<double>(kCodes / 2 - 1, kCodes / 2 - 1) += equations.total_weight / kCodes;
}

/// ln of the light for codes 1..255 of one channel.
Result<std::vector<double>> solve_curve(Pictures pictures, std::span<const Seconds> times,
                                        const std::vector<Candidate>& samples, int channel) {
  try {
    Equations equations;
    std::vector<std::pair<int, double>> codes_and_log_times;
    for (const Candidate& s : samples) {
      codes_and_log_times.clear();
      for (std::size_t k = 0; k < pictures.size(); ++k) {
        const int code = channel_of(pictures[k]->at(s.x, s.y), channel);
        if (weight_of(code) > 0) codes_and_log_times.emplace_back(code, std::log(times[k].count()));
      }
      add_pixel(equations, codes_and_log_times);
    }
    add_smoothness(equations);
    cv::Mat curve;
    if (!cv::solve(equations.matrix, equations.right, curve, cv::DECOMP_CHOLESKY))
      return undetermined(fmt::format("the equations of {} are singular",
                                      kChannelNames[static_cast<std::size_t>(channel)]));
    return std::vector<double>(curve.begin<double>(), curve.end<double>());
  } catch (const std::exception& e) {  // cv::Exception is one
    return undetermined(std::string("OpenCV: ") + e.what());
  }
}

/// Least-squares monotone fit (pool adjacent violators; Barlow et al. 1972).
std::vector<double> monotone(const std::vector<double>& values) {
  struct Block {
    double mean;
    std::size_t count;
  };
  std::vector<Block> blocks;
  for (const double v : values) {
    blocks.push_back({v, 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean > blocks.back().mean) {
      const Block last = blocks.back();
      blocks.pop_back();
      Block& into = blocks.back();
      const auto a = static_cast<double>(into.count), b = static_cast<double>(last.count);
      into.mean = (a * into.mean + b * last.mean) / (a + b);
      into.count += last.count;
    }
  }
  std::vector<double> out;
  for (const Block& b : blocks) out.insert(out.end(), b.count, b.mean);
  return out;
}

Result<std::vector<float>> decode_from_curve(const std::vector<double>& log_light) {
  std::vector<double> light{0};
  for (const double g : log_light) light.push_back(std::exp(g - log_light.back()));
  light[0] = std::max(0., 2 * light[1] - light[2]);  // a logarithm cannot say 0
  if (!std::ranges::all_of(light, [](double v) { return std::isfinite(v); }))
    return undetermined("the equations have no finite solution");
  light = monotone(light);
  const double white = light.back();
  if (!(white > 0) || light.front() >= white)
    return undetermined("the equations give no rising curve");
  std::vector<float> decode;
  for (const double v : light) decode.push_back(static_cast<float>(std::clamp(v / white, 0., 1.)));
  return decode;
}

}  // namespace

Result<Response> estimate_response(std::span<const Image<Rgb8>* const> pictures,
                                   std::span<const Seconds> times) {
  PENUMBRA_TRY(check_arguments(pictures, times));
  const Survey survey = survey_bracket(pictures);
  PENUMBRA_TRY(check_survey(survey));
  PENUMBRA_TRY(check_order(pictures, times, survey));
  std::array<std::vector<float>, 3> decode;
  for (int c = 0; c < 3; ++c) {
    const auto n = static_cast<std::size_t>(c);
    const auto count = std::min(kMaxSamples, survey.candidates[n].size());
    PENUMBRA_ASSIGN(curve, solve_curve(pictures, times, spread(survey.candidates[n], count), c));
    PENUMBRA_ASSIGN(channel, decode_from_curve(curve));
    decode[n] = std::move(channel);
  }
  return Response::from_table(std::move(decode));
}

}  // namespace penumbra::calib
