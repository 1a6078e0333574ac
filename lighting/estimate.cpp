#include <algorithm>
#include <cmath>
#include <utility>

#include "lighting/disc.h"
#include "lighting/discs.h"
#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/irradiance.h"
#include "lighting/light_estimate.h"
#include "lighting/light_filter.h"
#include "lighting/projection.h"
#include "lighting/internal/hole_fit.h"

namespace penumbra::lighting {

namespace {

constexpr int kGlance = 8;  // maps between predictions where no disc would be used
constexpr int kCalm = 8;    // maps without clipping before that

// Whether a projector can read maps of this width; others take the slow way.
bool in_quarters(int width) {
  return width % 4 == 0;
}

void add_discs(std::span<const Disc> discs, Projection& projection) {
  for (const Disc& disc : discs) {
    const RadianceSh whole = project_disc(disc, kMaxBands),
                     above = project_disc_above(disc, kMaxBands);
    for (int n = 0; n < kMaxCoefficients; ++n) {
      projection.light[n] += whole[n];
      projection.above[n] += above[n];
    }
  }
}

}  // namespace

LightEstimator::LightEstimator(const EstimateOptions& options) : options_(options) {}
LightEstimator::~LightEstimator() = default;
LightEstimator::LightEstimator(LightEstimator&&) noexcept = default;
LightEstimator& LightEstimator::operator=(LightEstimator&&) noexcept = default;

LatLongProjector& LightEstimator::projector_for(const Image<Rgb>& map) {
  if (!projector_ || width_ != map.width() || height_ != map.height()) {
    projector_ = std::make_unique<LatLongProjector>(map.width(), map.height(), kMaxBands);
    width_ = map.width();
    height_ = map.height();
  }
  return *projector_;
}

Result<Projection> LightEstimator::project(const Image<Rgb>& map) {
  if (!in_quarters(map.width())) return project_latlong(map, kMaxBands);
  return projector_for(map).project(map);
}

// After peel().
Result<Projection> LightEstimator::project_rest() {
  if (!in_quarters(split_.rest.width())) return project_latlong(split_.rest, kMaxBands);
  return projector_->project_read(split_.rest);
}

Result<Projection> LightEstimator::fill_holes(const Result<Projection>& moments,
                                              const Image<float>& confidence) {
  if (!moments || confidence.empty()) return moments;
  if (!hole_fit_ || !(hole_fit_->confidence() == confidence))
    hole_fit_ = std::make_unique<HoleFit>(confidence);
  return hole_fit_->fill(moments->light);
}

// Into split_ and left_over_.
Result<void> LightEstimator::peel(const Environment& environment) {
  maps_since_split_ = 0;
  DiscOptions found = options_.discs;
  found.least_share /= 2;
  const Image<Rgb>& map = environment.radiance;
  if (in_quarters(map.width())) {
    PENUMBRA_TRY(projector_for(map).read(map, luminance_));
    PENUMBRA_TRY(split_discs(map, luminance_, found, split_, environment.clipped));
  } else {
    PENUMBRA_TRY(split_discs(map, found, split_, environment.clipped));
  }
  const double irradiance = kPi * split_.mean_luminance;
  tracker_.update(environment.time, options_.discs.least_share, irradiance, split_.discs,
                  left_over_);
  completions_.apply(split_.discs, left_over_);
  return {};
}

// As many as the plan says, and all that are clipped; the others are left over.
void LightEstimator::choose_discs() {
  auto used = std::min(split_.discs.size(), static_cast<std::size_t>(plan_->discs));
  for (std::size_t i = used; i < split_.discs.size(); ++i)
    if (split_.discs[i].clipped) used = i + 1;
  plan_->discs = std::max(plan_->discs, static_cast<int>(used));
  left_over_.insert(left_over_.end(), split_.discs.begin() + static_cast<std::ptrdiff_t>(used),
                    split_.discs.end());
  split_.discs.resize(used);
}

// Without discs: the whole light in harmonics. Split now and then, for what the governor predicts.
Result<Projection> LightEstimator::measure_whole(const Environment& environment) {
  if (++maps_since_split_ >= kGlance) {
    PENUMBRA_TRY(peel(environment));
    PENUMBRA_ASSIGN(rest, fill_holes(project_rest(), environment.confidence));
    add_discs(left_over_, rest);
    plan_ = plan_for(rest, environment.time);
  }
  split_.discs.clear();
  auto whole = fill_holes(project(environment.radiance), environment.confidence);
  if (whole && options_.filter) filter_.update(environment.time, *whole);
  return whole;
}

// With the plan's discs in split_, all others in harmonics.
Result<Projection> LightEstimator::measure_split(const Environment& environment) {
  left_over_.clear();
  if (options_.discs.most > 0) PENUMBRA_TRY(peel(environment));
  auto projection =
      fill_holes(options_.discs.most > 0 ? project_rest() : project(environment.radiance),
                 environment.confidence);
  if (!projection) return projection;
  // Sources too weak for a number are part of the rest whichever side of the limit they are on.
  // What tracked ones leave over is not filtered: it completes the disc of this map.
  const auto is_weak = [](const Disc& disc) { return disc.id == 0; };
  for (const Disc& disc : left_over_)
    if (is_weak(disc)) add_discs({&disc, 1}, *projection);
  std::erase_if(left_over_, is_weak);
  if (options_.filter) filter_.update(environment.time, *projection);
  if (governor_) {
    plan_ = plan_for(*projection, environment.time);
    choose_discs();
  }
  add_discs(left_over_, *projection);
  return projection;
}

Result<void> LightEstimator::estimate(const Environment& environment, LightEstimate& out) {
  if (environment.radiance.empty())
    return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  // A source at the edge of clipping must not change sides with every map.
  maps_unclipped_ = environment.clipped.empty() ? std::min(maps_unclipped_ + 1, kCalm) : 0;
  const bool without_discs = options_.discs.most > 0 && governor_ && governor_->most_discs() == 0 &&
                             maps_unclipped_ == kCalm;
  if (without_discs != without_discs_) {
    // Another part of the light is measured from now on.
    without_discs_ = without_discs;
    maps_since_split_ = kGlance;
    filter_ = LightFilter();
  }
  // All nine bands are measured whatever is used: the rest predicts the truncation error.
  const auto projection = without_discs ? measure_whole(environment) : measure_split(environment);
  if (!projection) return std::unexpected(projection.error());
  make_estimate(*projection, plan_ ? plan_->bands : options_.bands, split_.discs, out);
  out.plan = plan_;
  out.time = environment.time;
  out.clipped_fraction = environment.clipped_fraction;
  return {};
}

void LightEstimator::govern(const Governance& governance) {
  governance_ = governance;
  governance_->limits.most_bands = options_.bands;
  governance_->limits.most_discs = options_.discs.most;
  governor_.emplace(governance_->limits, governance_->costs);
}

void LightEstimator::allow_discs(int most) {
  if (!governor_) return;
  governor_->allow_discs(most);
}

Plan LightEstimator::plan_for(const Projection& rest, TimestampNs time) {
  errors_.predict({&rest.above, split_.discs}, governance_->probes, governance_->limits.most_bands,
                  governance_->limits.most_discs);
  return governor_->update(errors_, time);
}

LightEstimate make_estimate(const Projection& projection, int bands, std::vector<Disc> discs) {
  LightEstimate estimate;
  make_estimate(projection, bands, std::span<const Disc>(discs), estimate);
  return estimate;
}

void make_estimate(const Projection& projection, int bands, std::span<const Disc> discs,
                   LightEstimate& estimate) {
  const RadianceSh& nine_bands = projection.light;
  std::vector<Disc> list = std::move(estimate.discs);
  list.assign(discs.begin(), discs.end());
  estimate = {};
  estimate.light = nine_bands.with_bands(bands);
  estimate.floor_light = floor_light(projection.above, bands);
  estimate.discs = std::move(list);
  estimate.valid = true;
  estimate.coverage = projection.coverage;
  // A fit to a small part of the sphere may swing below zero elsewhere.
  const Rgb mean = nine_bands[0] * static_cast<float>(1 / std::sqrt(4 * kPi));
  estimate.mean_radiance = {std::max(mean.r, 0.f), std::max(mean.g, 0.f), std::max(mean.b, 0.f)};
  for (const Disc& d : estimate.discs)
    estimate.mean_radiance += d.radiance * static_cast<float>(d.solid_angle_sr() / (4 * kPi));
  // Orthonormality makes the mean square over normals a plain sum: (1/4pi) sum_{l >= B} A_l^2
  // |l_l|^2.
  double left_out = 0;
  for (int l = bands; l < nine_bands.bands(); ++l)
    for (int m = -l; m <= l; ++m) {
      const double y = luminance(nine_bands[sh_index(l, m)]);
      left_out += std::pow(cosine_coefficient(l) * y, 2);
    }
  const double mean_irradiance = kPi * luminance(estimate.mean_radiance);
  if (bands < nine_bands.bands() && mean_irradiance > 0)
    estimate.truncation_error = std::sqrt(left_out / (4 * kPi)) / mean_irradiance;
}

Result<LightEstimate> estimate_map(const Image<Rgb>& map, const EstimateOptions& options) {
  return LightEstimator(options).estimate({map, {}, {}, 0, 0});
}

RadianceSh whole_light(const LightEstimate& e) {
  RadianceSh sum = e.light;
  for (const Disc& d : e.discs) {
    const RadianceSh own = project_disc(d, sum.bands());
    for (int n = 0; n < sum.size(); ++n) sum[n] += own[n];
  }
  return sum;
}

RadianceSh whole_floor_light(const LightEstimate& e) {
  RadianceSh above(e.floor_light.bands()), sum = e.floor_light;
  for (const Disc& d : e.discs) {
    const RadianceSh own = project_disc_above(d, above.bands());
    for (int n = 0; n < above.size(); ++n) above[n] += own[n];
  }
  if (e.discs.empty()) return sum;
  above = floor_light(above, above.bands());
  for (int n = 0; n < sum.size(); ++n) sum[n] += above[n];
  return sum;
}

double largest_visible_change(const RadianceSh& before, const RadianceSh& after) {
  // |sum dl_n t_n| <= |dl| |t| and |t|^2 <= (1/pi^2) Int cos+^2 = 2/(3 pi).
  double largest = 0;
  const int bands = std::max(before.bands(), after.bands());
  const RadianceSh a = before.with_bands(bands), b = after.with_bands(bands);
  for (int c = 0; c < 3; ++c) {
    double square = 0;
    for (int n = 0; n < a.size(); ++n) square += std::pow(double(b[n][c]) - a[n][c], 2);
    const double mean = a[0][c] / std::sqrt(4 * kPi);
    const double change = std::sqrt(square * 2 / (3 * kPi));
    largest = std::max(largest, mean > 0 ? change / mean : (change > 0 ? HUGE_VAL : 0));
  }
  return largest;
}

}  // namespace penumbra::lighting
