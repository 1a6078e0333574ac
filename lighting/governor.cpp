#include "lighting/governor.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory_resource>
#include <numeric>

#include "core/conventions.h"
#include "core/threads/scratch.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"

namespace penumbra::lighting {

namespace {

constexpr double kOwnSteps = .008;  // of bake, maps and interpolation, whatever the light
// Of what is tilted, that and what lights do is more: the sphere's light is cut, not the floor's.
constexpr double kTilted = 2.5;
// Of samples and the form of a light, relative to what the light brings. Long shadows of low lights
// are drawn with larger cells, those of wide ones with fewer; what they bring the floor counts by
// the cosine.
constexpr double kFine = .008, kCoarse = .04, kOnObject = .021;
constexpr double kOfLength = .0058, kOfWideLength = .014, kLowest = .1;
// Error that a point-like source causes when nine bands hold it on the floor, and five on objects,
// relative to what it brings. Wider ones cause less, by what of their energy lies beyond.
constexpr double kBeyondOnFloor = .28, kBeyondOnObject = .22;
constexpr double kHeldByNine_rad = .37, kHeldByFive_rad = .63;  // 21 and 36 degrees: all of it
// Of a light that is narrower than the blocks of pixels that it is found in, for a degree.
constexpr double kInBlocks = .06, kInBlocksOnObject = .03;

// How far a round source is from what harmonics hold: 1 for a point, 0 from `held_rad` on.
double narrowness(const DistantLight& source, double held_rad) {
  return std::max(0., 1 - source.radius.value() / held_rad);
}

// Of a light's shadow as long as its object is high: what the cells of its map cost. The wider the
// light, the smoother its shadow.
double of_length(const DistantLight& source, bool wide) {
  return wide ? kOfWideLength * std::sqrt(kWideLight / source.radius) : kOfLength;
}

// The size of a block in degrees, as far as a light is not wider: how narrow it is cannot be told
// from blocks, so it counts alike however it was found.
double too_large_blocks_deg(const DistantLight& source, int map_rows) {
  // A point on the corner of four blocks looks as wide as 1.13 of them.
  constexpr double kFrom = 1.15, kTo = 1.7;
  const double block_rad = kMapBlock * kPi / map_rows,
               wider = (kTo - source.radius.value() / block_rad) / (kTo - kFrom);
  return std::clamp(wider, 0., 1.) * block_rad * 180 / kPi;
}

double mean_square(std::span<const double> values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return values.empty() ? 0 : sum / static_cast<double>(values.size());
}

double open_irradiance(const RadianceSh& light) {
  return std::max(double(luminance(evaluate(irradiance(light), glm::dvec3(0, 1, 0)))), 1e-30);
}

void add(RadianceSh& sum, const RadianceSh& other) {
  for (int n = 0; n < sum.size(); ++n) sum[n] += other[n];
}

// What harmonics leave at the points of a table, [point][n] of so many bands.
class ProbeValues {
 public:
  ProbeValues(std::span<const float> table, int bands, std::pmr::memory_resource* memory)
      : table_(table),
        stride_(static_cast<std::size_t>(coefficient_count(bands))),
        values_(table.size() / stride_, memory) {}

  /// factor * light, from nothing or onto what is there.
  void set(const RadianceSh& light, double factor) {
    std::ranges::fill(values_, 0);
    add(light, factor);
  }
  void add(const RadianceSh& light, double factor) {
    const auto terms = std::min(static_cast<std::size_t>(light.size()), stride_);
    std::array<double, kMaxCoefficients> grey;
    for (std::size_t n = 0; n < terms; ++n) grey[n] = double(luminance(light[static_cast<int>(n)]));
    for (std::size_t p = 0; p < values_.size(); ++p) {
      double sum = 0;
      for (std::size_t n = 0; n < terms; ++n) sum += grey[n] * double(table_[p * stride_ + n]);
      values_[p] += factor * sum;
    }
  }
  void copy(const ProbeValues& other) { std::ranges::copy(other.values_, values_.begin()); }
  double mean_square() const { return lighting::mean_square(values_); }
  bool empty() const { return values_.empty(); }

 private:
  std::span<const float> table_;
  std::size_t stride_;
  std::pmr::vector<double> values_;
};

}  // namespace

// The light without its sources and each source, as moments; what the errors are fractions of.
struct ErrorTable::Parts {
  std::pmr::vector<RadianceSh> moments;  // of each light
  std::pmr::vector<double> irradiance;   // of the open floor, by each light
  std::pmr::vector<Squares> fractions;   // of all that the floor gets and the objects send
  double of_objects = 0;                 // mean square of the whole light at their points

  Parts(const SplitLight& light, const SceneProbes& probes, std::pmr::memory_resource* memory)
      : moments(memory), irradiance(memory), fractions(memory) {
    ProbeValues object(probes.transfer, std::max(1, probes.transfer_bands), memory);
    std::pmr::vector<double> on_objects(memory);
    RadianceSh all = light.upper_residual->with_bands(kMaxBands);
    for (const DistantLight& d : light.lights) {
      moments.push_back(project_upper_distant_light(d, kMaxBands));
      irradiance.push_back(luminance(lighting::irradiance(d, glm::dvec3(0, 1, 0))));
      object.set(upper_hemisphere_light(moments.back(), object_bands(probes)), 1);
      on_objects.push_back(object.mean_square());
      add(all, moments.back());
    }
    object.set(upper_hemisphere_light(all, object_bands(probes)), 1);
    of_objects = std::max(object.mean_square(), 1e-60);
    const double open = open_irradiance(upper_hemisphere_light(all, kMaxBands));
    for (std::size_t j = 0; j < moments.size(); ++j) {
      const double shadow = std::pow((probes.level ? 1 : kTilted) * irradiance[j] / open, 2);
      fractions.push_back(
          {probes.has_floor ? shadow : 0, object.empty() ? shadow : on_objects[j] / of_objects});
    }
  }
  static int object_bands(const SceneProbes& probes) {
    return std::clamp(probes.transfer_bands, 1, kMaxBands);
  }
};

void ErrorTable::predict_traced(const SplitLight& light, const Parts& parts) {
  traced_.assign(static_cast<std::size_t>(max_lights_) + 1, {});
  wide_.assign(1, 0);
  const auto add = [](Squares& sum, double shadow, double object, const Squares& fraction) {
    sum.shadow += shadow * shadow * fraction.shadow;
    sum.object += object * object * fraction.object;
  };
  for (std::size_t j = 0; j + 1 < traced_.size(); ++j) {
    const DistantLight& d = light.lights[j];
    Traced& t = traced_[j + 1] = traced_[j];
    const bool wide = d.radius >= kWideLight;
    const double length = of_length(d, wide) / std::max(d.direction.y, kLowest),
                 fine = kFine + length;
    add(t.fine, fine, kOnObject, parts.fractions[j]);
    add(t.coarse, wide ? fine : std::hypot(fine, kCoarse + length), kOnObject, parts.fractions[j]);
    const double block_deg = too_large_blocks_deg(d, map_rows_);
    add(t.in_blocks, kInBlocks * block_deg, kInBlocksOnObject * block_deg, parts.fractions[j]);
    wide_.push_back(wide_.back() + (wide ? 1 : 0));
  }
}

// The floor's ratio and the objects' light at the probes: with fewer bands against all that there
// are.
void ErrorTable::predict_bands(int lights, const RadianceSh& moments, double traced_irradiance,
                               const SceneProbes& probes, const Parts& parts) {
  const Scratch::Scope scope;
  const int object_bands = Parts::object_bands(probes);
  ProbeValues floor(probes.deficit, kMaxBands, scope.memory()),
      floor_cut(probes.deficit, kMaxBands, scope.memory());
  ProbeValues object(probes.transfer, object_bands, scope.memory()),
      object_cut(probes.transfer, object_bands, scope.memory());
  const RadianceSh full = upper_hemisphere_light(moments, kMaxBands);
  floor.set(full, 1 / (open_irradiance(full) + traced_irradiance));
  object.set(upper_hemisphere_light(moments, object_bands), 1);
  for (int bands = 1; bands <= max_bands_; ++bands) {
    Squares& out = omitted_[static_cast<std::size_t>(lights * max_bands_ + bands - 1)].bands;
    out = {1, 1};
    if (!probes.tell_of_bands() && bands < max_bands_) continue;
    const RadianceSh cut = upper_hemisphere_light(moments, bands);
    floor_cut.copy(floor);
    floor_cut.add(cut, -1 / (open_irradiance(cut) + traced_irradiance));
    out = {floor_cut.mean_square(), 0};
    if (bands >= object_bands || !probes.tell_of_bands()) continue;
    object_cut.copy(object);
    object_cut.add(cut, -1);
    out.object = object_cut.mean_square() / parts.of_objects;
  }
}

void ErrorTable::predict(const SplitLight& light, const SceneProbes& probes, int max_bands,
                         int max_lights) {
  max_bands_ = max_bands;
  max_lights_ = std::min(max_lights, static_cast<int>(light.lights.size()));
  map_rows_ = light.map_rows;
  max_map_step_ = light.max_map_step;
  own_ = probes.level ? kOwnSteps : kTilted * kOwnSteps;
  omitted_.resize(static_cast<std::size_t>((max_lights_ + 1) * max_bands_));
  const Scratch::Scope scope;
  const Parts parts(light, probes, scope.memory());
  predict_traced(light, parts);
  // From all lights in the harmonics to as few as may be.
  RadianceSh moments = light.upper_residual->with_bands(kMaxBands);
  Squares beyond;
  for (std::size_t j = light.lights.size() + 1; j-- > 0;) {
    if (const auto lights = static_cast<int>(j); lights <= max_lights_) {
      const double traced =
          std::accumulate(parts.irradiance.begin(), parts.irradiance.begin() + lights, 0.);
      predict_bands(lights, moments, traced, probes, parts);
      for (int bands = 1; bands <= max_bands_; ++bands)
        omitted_[static_cast<std::size_t>(lights * max_bands_ + bands - 1)].lights = beyond;
    }
    if (j == 0) break;
    const DistantLight& d = light.lights[j - 1];
    const Squares& fraction = parts.fractions[j - 1];
    add(moments, parts.moments[j - 1]);
    const double on_floor = kBeyondOnFloor * std::pow(narrowness(d, kHeldByNine_rad), 2),
                 on_object = kBeyondOnObject * narrowness(d, kHeldByFive_rad);
    beyond.shadow += on_floor * on_floor * fraction.shadow;
    beyond.object += on_object * on_object * fraction.object;
  }
}

PredictedErrors ErrorTable::errors(const Treatment& t) const {
  const int lights = std::clamp(t.lights, 0, max_lights_);
  const Omitted& out = omitted(std::clamp(t.bands, 1, max_bands_), lights);
  const Traced& all = traced_[static_cast<std::size_t>(lights)];
  const Traced& fine = traced_[static_cast<std::size_t>(std::clamp(t.fine_lights, 0, lights))];
  const Squares in_blocks = t.map_step > 1 ? all.in_blocks : Squares{};
  const double drawn = fine.fine.shadow + all.coarse.shadow - fine.coarse.shadow;
  return {std::sqrt(own_ * own_ + out.bands.shadow + out.lights.shadow + drawn + in_blocks.shadow),
          std::sqrt(own_ * own_ + out.bands.object + out.lights.object + all.fine.object +
                    in_blocks.object)};
}

PredictedErrors ErrorTable::errors_of_bands(int bands, int lights) const {
  const Squares& out =
      omitted(std::clamp(bands, 1, max_bands_), std::clamp(lights, 0, max_lights_)).bands;
  return {std::sqrt(out.shadow), std::sqrt(out.object)};
}

UpdateCost ErrorTable::cost(const Treatment& t, const CostModel& costs) const {
  const double size = map_rows_ / 512.;
  UpdateCost out;
  out.reading_ms = (t.map_step > 1 ? costs.read_blocks_ms : costs.read_ms) * size * size;
  out.relighting_ms = costs.relight_ms + costs.per_coefficient_ms * coefficient_count(t.bands);
  const int lights = std::clamp(t.lights, 0, max_lights_),
            fine = std::clamp(t.fine_lights, 0, lights);
  const auto wide = [&](int of) { return wide_[static_cast<std::size_t>(of)]; };
  const int narrow_fine = fine - wide(fine), narrow = lights - wide(lights);
  out.lights_ms = wide(lights) * costs.wide_light_ms + narrow_fine * costs.fine_light_ms +
                  (narrow - narrow_fine) * costs.coarse_light_ms;
  return out;
}

Plan Governor::judge(const ErrorTable& errors, const Treatment& treatment, double budget) const {
  const PredictedErrors predicted = errors.errors(treatment);
  Plan plan;
  static_cast<Treatment&>(plan) = treatment;
  plan.error = factor_ * predicted.shadow;
  plan.object_error = factor_ * predicted.object;
  plan.cost = errors.cost(treatment, costs_);
  plan.ms = plan.cost.ms();
  plan.within_budget = std::max(plan.error, plan.object_error) <= budget;
  return plan;
}

Plan Governor::cheapest(const ErrorTable& errors, double budget) const {
  return cheapest(errors, budget, max_lights());
}

bool Governor::takes_too_few_bands(const ErrorTable& errors, const Treatment& t,
                                   double budget) const {
  const int all = std::min(errors.max_bands(), limits_.max_bands);
  return t.bands < all &&
         (t.bands < kMinBands ||
          errors.errors_of_bands(t.bands, t.lights).larger() > kBandsPart * budget);
}

Plan Governor::cheapest(const ErrorTable& errors, double budget, int lights_allowed) const {
  std::optional<Plan> best, most_accurate;
  const auto error_of = [](const Plan& p) { return std::max(p.error, p.object_error); };
  Treatment t;
  for (t.lights = 0; t.lights <= std::min(errors.max_lights(), lights_allowed); ++t.lights)
    for (t.fine_lights = 0; t.fine_lights <= t.lights; ++t.fine_lights)
      for (const int step : {1, kMapBlock})
        for (t.bands = 1; t.bands <= std::min(errors.max_bands(), limits_.max_bands); ++t.bands) {
          t.map_step = step;
          if (step > errors.max_map_step() || takes_too_few_bands(errors, t, budget)) continue;
          const Plan plan = judge(errors, t, budget);
          if (!most_accurate || error_of(plan) < error_of(*most_accurate)) most_accurate = plan;
          if (plan.within_budget && (!best || plan.ms < best->ms)) best = plan;
        }
  return best ? *best : *most_accurate;
}

Plan Governor::update(const ErrorTable& errors, TimestampNs now) {
  Plan plan = choose(errors, now);
  plan.time_limited = !plan.within_budget && max_lights() < limits_.max_lights &&
                      cheapest(errors, limits_.max_error, limits_.max_lights).lights > plan.lights;
  return plan;
}

Plan Governor::with_unseen(Plan plan, double unseen_above) const {
  const bool kept = plan.within_budget;
  const double unseen = factor_ * kUnseen * unseen_above;
  plan.error = std::hypot(plan.error, unseen);
  plan.object_error = std::hypot(plan.object_error, unseen);
  plan.within_budget = kept && std::max(plan.error, plan.object_error) <= limits_.max_error;
  plan.unseen = kept && !plan.within_budget;
  return plan;
}

// No knob of what is taken now further down.
Treatment Governor::at_least(const Treatment& now, const Treatment& needed) const {
  Treatment out;
  out.bands = std::max(now.bands, needed.bands);
  out.lights = std::max(now.lights, needed.lights);
  out.fine_lights = std::max(now.fine_lights, needed.fine_lights);
  out.map_step = std::min(now.map_step, needed.map_step);
  return out;
}

Plan Governor::choose(const ErrorTable& errors, TimestampNs now) {
  const double budget = limits_.max_error;
  const auto needed = [&] { return cheapest(errors, budget); };
  if (!current_ || current_->lights > max_lights()) {
    could_do_less_since_.reset();
    return *(current_ = needed());
  }
  Treatment present = *current_;
  present.map_step = std::min(present.map_step, errors.max_map_step());
  *current_ = judge(errors, present, budget);
  if (!current_->within_budget || takes_too_few_bands(errors, present, budget)) {
    could_do_less_since_.reset();
    return *(current_ = judge(errors, at_least(present, needed()), budget));
  }
  const Plan modest = cheapest(errors, kMargin * budget);
  if (!modest.within_budget || modest.ms >= current_->ms)
    could_do_less_since_.reset();
  else if (!could_do_less_since_)
    could_do_less_since_ = now;
  else if (now - *could_do_less_since_ >= kPatience) {
    could_do_less_since_.reset();
    current_ = judge(errors, modest, budget);
  }
  return *current_;
}

}  // namespace penumbra::lighting
