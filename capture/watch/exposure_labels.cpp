#include "capture/watch/exposure_labels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <span>

#include "core/median.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kRemembered = 24;  // frames
constexpr std::size_t kFirst = 18,
                      kEnough = 12;   // frames that tell the delay, at the start and later
constexpr double kExact = .12;        // natural logarithm: how well a slip's ratio fits
constexpr double kLabelAgrees = .25;  // a third of a stop: less is flicker
// Of the blocks' offsets: a change of exposure is the same everywhere
constexpr double kLabelUniform = .12;
constexpr double kLabelPatience = 4;      // frames refused before the delay is looked for anew
constexpr double kForgiveness = .8;       // of earlier refusals, for each good frame
constexpr double kForgottenChanges = .9;  // of the light, for each frame
constexpr int kMaxPatience = 24;          // after so many the light has changed after all
constexpr int kFollows = 8;               // good frames in a row that no chance explains
constexpr std::size_t kMinBlocks = 6;
constexpr double kDriftSeconds = .7;  // what changes more slowly is light, not flicker

// Median over the blocks that both know, and the median distance from it.
struct Offset {
  double value = 0, spread = 0;
};
std::optional<Offset> offset_between(std::span<const float> signal,
                                     std::span<const float> radiance) {
  std::array<double, std::size_t{Brightness::kColumns} * Brightness::kRows> all;
  std::size_t count = 0;
  for (std::size_t i = 0; i < std::min({signal.size(), radiance.size(), all.size()}); ++i)
    if (signal[i] > 0 && radiance[i] > 0) all[count++] = std::log(signal[i] / radiance[i]);
  if (count < kMinBlocks) return std::nullopt;
  const std::span logs(all.data(), count);
  Offset out;
  out.value = median(logs);
  for (double& l : logs) l = std::abs(l - out.value);
  out.spread = median(logs);
  return out;
}

}  // namespace

Brightness BrightnessMeter::measure(const FramePixels& pixels) {
  constexpr CellGrid kGrid{Brightness::kColumns, Brightness::kRows, 10, 10, .005f};
  meter_.measure(pixels, kGrid, cells_);
  Brightness out;
  for (std::size_t i = 0; i < std::min(cells_.size(), out.blocks.size()); ++i) {
    const Rgb& cell = cells_[i];
    out.blocks[i] = std::isnan(cell.g) ? 0 : (cell.r + cell.g + cell.b) / 3;
  }
  return out;
}

ExposureLabels::ExposureLabels(std::optional<int> delay) : reported_(delay == 0), delay_(delay) {
  requests_.reserve(kRemembered + kMaxDelay + 1);
  seen_.reserve(kRemembered + 1);
}

void ExposureLabels::requested(std::uint64_t after_frame, Exposure exposure) {
  requests_.push_back({after_frame, exposure});
  if (requests_.size() > kRemembered + kMaxDelay) requests_.erase(requests_.begin());
}

std::optional<Exposure> ExposureLabels::in_force(std::uint64_t frame, int delay) const {
  for (auto r = requests_.rbegin(); r != requests_.rend(); ++r)
    if (r->after_frame + static_cast<std::uint64_t>(delay) <= frame) return r->exposure;
  return std::nullopt;
}

// Mean distance between neighbouring frames' changes of brightness and those that the delay
// explains, without the worst
// fifth: single slips, and frames from before the first request.
double ExposureLabels::disagreement(int delay) const {
  constexpr double kFar = 2;
  std::vector<double> distances;
  for (std::size_t i = 1; i < seen_.size(); ++i) {
    const auto before = in_force(seen_[i - 1].frame, delay), now = in_force(seen_[i].frame, delay);
    const auto change = offset_between(seen_[i].brightness.blocks, seen_[i - 1].brightness.blocks);
    if (!before || !now || !change) continue;
    distances.push_back(
        std::min(kFar, std::abs(change->value - std::log(now->product() / before->product()))));
  }
  if (distances.size() < 4) return kFar;
  std::ranges::sort(distances);
  const std::size_t kept = distances.size() - distances.size() / 5;
  return std::accumulate(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(kept),
                         0.) /
         static_cast<double>(kept);
}

// The shortest delay that explains the frames about as well as any: a schedule that repeats hides
// whole turns of it.
void ExposureLabels::find_delay() {
  constexpr double kTie = .03;
  const int shortest = reported_ ? 0 : 1;
  double smallest = 2;
  std::array<double, kMaxDelay + 1> scores{};
  for (int delay = shortest; delay <= kMaxDelay; ++delay)
    smallest = std::min(smallest, scores[static_cast<std::size_t>(delay)] = disagreement(delay));
  suspicion_ = 0;
  ignores_controls_ = smallest > kLabelAgrees;
  if (ignores_controls_) return;
  const auto ties = [&](double score) { return score < smallest + kTie; };
  const int best = static_cast<int>(std::find_if(scores.begin() + shortest, scores.end(), ties) -
                                    scores.begin());
  if (delay_ == best) return;
  delay_ = best;
  refused_in_a_row_ = 0;
  if (radiance_.empty()) begin_with_history();
}

// Single frames of the history may be mislabelled: each block's median is not.
void ExposureLabels::begin_with_history() {
  std::vector<std::vector<double>> blocks;
  for (const LabelledFrame& s : seen_) {
    const auto exposure = in_force(s.frame, *delay_);
    blocks.resize(std::max(blocks.size(), s.brightness.blocks.size()));
    for (std::size_t i = 0; exposure && i < s.brightness.blocks.size(); ++i)
      if (s.brightness.blocks[i] > 0)
        blocks[i].push_back(s.brightness.blocks[i] / exposure->product());
  }
  radiance_.clear();
  for (std::vector<double>& b : blocks)
    radiance_.push_back(b.empty() ? 0.f : static_cast<float>(median(b)));
}

ExposureLabels::Label ExposureLabels::judge(std::uint64_t frame, TimestampNs time,
                                            const Brightness& seen) {
  seen_.push_back({frame, seen});
  while (seen_.size() > (delay_ ? kEnough : kRemembered)) seen_.erase(seen_.begin());
  changes_ *= kForgottenChanges;
  if (!delay_) {
    if (seen_.size() >= kFirst) find_delay();
    return {};
  }
  const auto label = in_force(frame, *delay_);
  if (!label) return {};
  const auto offset = offset_between(seen.blocks, radiance_);
  const double difference = offset ? offset->value - std::log(label->product()) : 0;
  if (!offset && !radiance_.empty())
    return {Verdict::kGood, *label};  // too dark or clipped to tell
  if (std::abs(difference) < kLabelAgrees)
    return accept(*label, time, seen,
                  offset && offset->spread < kLabelUniform ? difference : drift_);
  // A slip changes everything by the ratio of two requests; anything else is a change of light.
  const bool slipped =
      offset->spread < kLabelUniform && std::ranges::any_of(requests_, [&](const Request& r) {
        return std::abs(offset->value - std::log(r.exposure.product())) < kExact &&
               std::abs(std::log(r.exposure.product() / label->product())) > kLabelAgrees;
      });
  if (!slipped || refused_in_a_row_ >= kMaxPatience) {
    radiance_.clear();
    // Light that changes as a whole frame after frame may be labels that are late throughout.
    if (offset->spread < kLabelUniform && ++changes_ >= kLabelPatience) changes_ = 0, find_delay();
    return accept(in_force(frame, *delay_).value_or(*label), time, seen, 0);
  }
  ++refused_in_a_row_;
  good_in_a_row_ = 0;
  if (++suspicion_ >= kLabelPatience) find_delay();
  return {Verdict::kRefused, *label};
}

// Uniform offsets that come and go within a second are the mains' or the metadata's: the exposure
// takes them.
ExposureLabels::Label ExposureLabels::accept(const Exposure& exposure, TimestampNs time,
                                             const Brightness& seen, double offset) {
  const double passed = std::clamp((time - last_).count(), 0., 1.);
  last_ = time;
  refused_in_a_row_ = 0;
  suspicion_ *= kForgiveness;
  if (++good_in_a_row_ >= kFollows) ignores_controls_ = false;
  const double flicker = offset - drift_;
  drift_ += flicker * (1 - std::exp(-passed / kDriftSeconds));
  Label out{Verdict::kGood, exposure};
  out.exposure.gain = exposure.gain * std::exp(flicker);
  const auto scale = static_cast<float>(1 / out.exposure.product());
  radiance_.resize(seen.blocks.size());
  constexpr float kNewFraction = .3f;
  for (std::size_t i = 0; i < radiance_.size(); ++i) {
    if (seen.blocks[i] <= 0) continue;
    const float now = seen.blocks[i] * scale;
    radiance_[i] = radiance_[i] > 0 ? (1 - kNewFraction) * radiance_[i] + kNewFraction * now : now;
  }
  return out;
}

}  // namespace penumbra::capture
