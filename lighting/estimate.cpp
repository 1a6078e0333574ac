#include <algorithm>
#include <cmath>
#include <utility>

#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/light_filter.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/map_average.h"
#include "lighting/sh/projection.h"
#include "lighting/sh/sh_inpainting.h"

namespace penumbra::lighting {

namespace {

// Whether a projector can read maps of this width; others take the slow way.
bool in_quarters(int width) {
  return width % 4 == 0;
}

void add_distant_lights(std::span<const DistantLight> lights, ShProjection& projection) {
  for (const DistantLight& source : lights) {
    const RadianceSh whole = project_distant_light(source, kMaxBands),
                     upper_moments = project_upper_distant_light(source, kMaxBands);
    for (int n = 0; n < kMaxCoefficients; ++n) {
      projection.light[n] += whole[n];
      projection.upper_moments[n] += upper_moments[n];
    }
  }
}

// Whether part of the light is known from below alone. What is clipped and found no place among the
// lights is in the harmonics, as dark as it was measured.
bool holds_a_lower_bound(const Environment& environment, std::span<const DistantLight> lights) {
  if (std::ranges::any_of(lights, &DistantLight::is_lower_bound)) return true;
  const auto seen_clipped = [](const DistantLight& d) { return d.clipped && d.id != kUnseenSun; };
  return !environment.clipped.empty() && std::ranges::none_of(lights, seen_clipped);
}

}  // namespace

LightEstimator::LightEstimator(const EstimateOptions& options) : options_(options) {}
LightEstimator::~LightEstimator() = default;
LightEstimator::LightEstimator(LightEstimator&&) noexcept = default;
LightEstimator& LightEstimator::operator=(LightEstimator&&) noexcept = default;

LatLongProjector& LightEstimator::projector_for(const Image<Rgb>& map) {
  auto known = std::ranges::find_if(projectors_, [&](const auto& p) { return p.is_for(map); });
  if (known == projectors_.end()) {
    // Over the one that was not used last: of other sizes nothing comes back.
    known = projectors_[0].projector.get() == projector_ ? projectors_.begin() + 1
                                                         : projectors_.begin();
    *known = {map.width(), map.height(),
              std::make_unique<LatLongProjector>(map.width(), map.height(), kMaxBands)};
  }
  projector_ = known->projector.get();
  return *projector_;
}

Result<ShProjection> LightEstimator::project(const Image<Rgb>& map) {
  if (!in_quarters(map.width())) return project_latlong(map, kMaxBands);
  return projector_for(map).project(map);
}

// After extract().
Result<ShProjection> LightEstimator::project_residual() {
  if (!in_quarters(extraction_.residual.width()))
    return project_latlong(extraction_.residual, kMaxBands);
  return projector_->project_read(extraction_.residual);
}

void LightEstimator::follow_holes(const Image<float>& confidence) {
  if (confidence.empty())
    inpainting_.reset();
  else if (!inpainting_ || !(inpainting_->confidence() == confidence))
    inpainting_ = std::make_unique<ShInpainting>(confidence);
}

Result<ShProjection> LightEstimator::fill_holes(const Result<ShProjection>& moments) const {
  if (!moments || !inpainting_) return moments;
  return inpainting_->fill(moments->light);
}

// Into extraction_ and unused_.
Result<void> LightEstimator::extract(const Environment& environment) {
  ExtractionOptions found = options_.lights;
  found.min_irradiance_fraction /= 2;
  if (inpainting_) found.coverage = inpainting_->coverage();
  const Image<Rgb>& map = environment.radiance;
  if (in_quarters(map.width())) {
    PENUMBRA_TRY(projector_for(map).read(map, luminance_));
    PENUMBRA_TRY(extract_lights(map, luminance_, found, extraction_, environment.clipped));
  } else {
    PENUMBRA_TRY(extract_lights(map, found, extraction_, environment.clipped));
  }
  const double irradiance = kPi * extraction_.mean_luminance;
  tracker_.update(environment.time, options_.lights.min_irradiance_fraction, irradiance,
                  extraction_.lights, unused_);
  if (unseen_sun_) extraction_.lights.push_back(unseen_sun(*unseen_sun_));
  recoveries_.apply(extraction_.lights, unused_);
  return {};
}

// A fixed time is that of the first map.
void LightEstimator::find_unseen_sun(const Environment& environment) {
  unseen_sun_.reset();
  if (!options_.sun || options_.lights.max_count < 1) return;
  if (!first_) first_ = environment.time;
  const Image<float>& seen = environment.confidence;
  if (!looks_for_sun_ || seen.empty()) return;
  const auto since = std::chrono::duration_cast<std::chrono::seconds>(environment.time - *first_);
  const glm::dvec3 sun = options_.sun->time
                             ? sun_direction(*options_.sun, *options_.sun->time + since)
                             : sun_direction(*options_.sun);
  const glm::dvec2 at = latlong_pixel(sun, seen.width(), seen.height());
  const int x = std::clamp(static_cast<int>(at.x), 0, seen.width() - 1),
            y = std::clamp(static_cast<int>(at.y), 0, seen.height() - 1);
  if (sun.y > 0 && seen.at(x, y) == 0) unseen_sun_ = sun;
}

// As many as the plan says, and all that are clipped, drawn finely. Behind them those that the
// light needs beside, without the time for them; the others are left over.
// A sun that no camera sees counts where it is among the strongest. Else it is carried along, for
// whoever finds its power.
void LightEstimator::choose_max_lights() {
  std::optional<DistantLight> weak_sun;
  const auto sun = std::ranges::find(extraction_.lights, kUnseenSun, &DistantLight::id);
  if (sun != extraction_.lights.end() && sun - extraction_.lights.begin() >= plan_->lights) {
    weak_sun = *sun;
    extraction_.lights.erase(sun);
  }
  auto used = std::min(extraction_.lights.size(), static_cast<std::size_t>(plan_->lights));
  for (std::size_t i = used; i < extraction_.lights.size(); ++i)
    if (extraction_.lights[i].clipped) used = i + 1;
  if (static_cast<int>(used) > plan_->lights) {
    Treatment with_clipped = *plan_;
    with_clipped.lights = with_clipped.fine_lights = static_cast<int>(used);
    const bool time_limited = plan_->time_limited;
    plan_ = governor_->judge(errors_, with_clipped, governor_config_->limits.max_error);
    plan_->time_limited = time_limited && !plan_->within_budget;
  }
  const auto needed = std::min(extraction_.lights.size(),
                               std::max(used, static_cast<std::size_t>(unhurried_plan_->lights)));
  unused_.insert(unused_.end(), extraction_.lights.begin() + static_cast<std::ptrdiff_t>(needed),
                 extraction_.lights.end());
  extraction_.lights.resize(needed);
  if (weak_sun) extraction_.lights.push_back(*weak_sun);
}

// With the lights that are needed in extraction_, all others in harmonics.
Result<ShProjection> LightEstimator::measure(const Environment& environment) {
  unused_.clear();
  if (options_.lights.max_count > 0) PENUMBRA_TRY(extract(environment));
  auto projection = fill_holes(options_.lights.max_count > 0 ? project_residual()
                                                             : project(environment.radiance));
  if (!projection) return projection;
  // Sources too weak for a number are part of the rest whichever side of the limit they are on.
  // What tracked ones leave over is not filtered: it completes the light of this map.
  const auto is_weak = [](const DistantLight& source) { return source.id == 0; };
  for (const DistantLight& source : unused_)
    if (is_weak(source)) add_distant_lights({&source, 1}, *projection);
  std::erase_if(unused_, is_weak);
  if (options_.filter) filter_.update(environment.time, *projection);
  if (governor_) {
    plan_for(*projection, environment.time);
    choose_max_lights();
  }
  add_distant_lights(unused_, *projection);
  return projection;
}

// Null where it is to be read as it is: also what is clipped or hidden is told by pixel.
const Environment* LightEstimator::in_blocks(const Environment& environment) {
  const Image<Rgb>& map = environment.radiance;
  const bool whole = environment.clipped.empty() && environment.confidence.empty();
  map_rows_ = map.height();
  max_map_step_ = whole && divides_into_blocks(map, kMapBlock) ? kMapBlock : 1;
  const int wanted = plan_ ? plan_->map_step : options_.map_step;
  if (wanted == 1 || max_map_step_ == 1) return nullptr;
  average_blocks(map, kMapBlock, in_blocks_.radiance);
  in_blocks_.time = environment.time;
  in_blocks_.clipped_fraction = environment.clipped_fraction;
  return &in_blocks_;
}

namespace {

// All of it within twice its radius, which cut_out() takes from the map.
bool is_compact(const DistantLight& light) {
  const double least = std::cos(2 * light.radius.value());
  return std::ranges::all_of(
      light.shape, [&](const glm::dvec3& d) { return glm::dot(d, light.direction) > least; });
}

std::vector<std::size_t> compact_below(double radius_rad, const LightEstimate& light) {
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < light.lights.size() && out.size() < kMaxLightsApart; ++i)
    if (light.is_affordable(i) && light.lights[i].radius.value() < radius_rad &&
        is_compact(light.lights[i]))
      out.push_back(i);
  return out;
}

}  // namespace

std::vector<std::size_t> lights_apart(const LightEstimate& light) {
  return compact_below(
      largest_light_apart_rad(light.reflections ? light.reflections->levels.front().roughness : 0),
      light);
}

void LightEstimator::mirror(const SurfaceRoughness& surfaces, float size_factor) {
  mirror_.reset();
  if (!surfaces.empty()) mirror_.emplace(surfaces, size_factor);
}

void LightEstimator::cut_out(const DistantLight& light, Image<Rgb>& map) const {
  const RowOverlay& residual = extraction_.residual;
  const int width = map.width(), height = map.height(),
            step = std::max(1, height / std::max(1, residual.height()));
  const double reach = 2 * light.radius.value() + 2 * kPi * step / height,
               polar = std::acos(std::clamp(light.direction.y, -1., 1.));
  for (int y = 0; y < height; ++y) {
    if (std::abs(polar - kPi * (y + .5) / height) > reach) continue;
    for (int x = 0; x < width; ++x)
      if (glm::dot(latlong_direction(x + .5, y + .5, width, height), light.direction) >
          std::cos(reach))
        map.at(x, y) = residual.at(x / step, y / step);
  }
}

// Lights that are mirrored apart are cut down to what surrounds them, as the residual is. The map
// is the whole one also where light is read in blocks: a mirror shows each pixel.
void LightEstimator::find_reflections(const Environment& whole_map, LightEstimate& out) {
  if (!mirror_) return;
  const std::vector<std::size_t> apart =
      compact_below(largest_light_apart_rad(mirror_->least_roughness()), out);
  if (!apart.empty()) mirrored_map_ = whole_map.radiance;
  for (const std::size_t i : apart) cut_out(out.lights[i], mirrored_map_);
  auto map = std::make_shared<ReflectionMap>();
  mirror_->filter(apart.empty() ? whole_map.radiance : mirrored_map_, whole_map.confidence,
                  out.light, *map);
  out.reflections = std::move(map);
}

Result<void> LightEstimator::estimate(const Environment& whole_map, LightEstimate& out) {
  if (whole_map.radiance.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  const Environment* const blocks = in_blocks(whole_map);
  const Environment& environment = blocks ? *blocks : whole_map;
  follow_holes(environment.confidence);
  find_unseen_sun(environment);
  // All nine bands are measured whatever is used: the rest predicts the truncation error.
  const auto projection = measure(environment);
  // The whole map names its own pixel.
  if (!projection && blocks) PENUMBRA_TRY(project_latlong(whole_map.radiance, 1));
  PENUMBRA_TRY(projection);
  const int bands = plan_ ? std::max(plan_->bands, unhurried_plan_->bands) : options_.bands;
  make_estimate(*projection, bands, extraction_.lights, out);
  out.plan = plan_;
  if (out.plan && inpainting_)
    out.plan = governor_->with_unseen(*out.plan, inpainting_->unseen_above());
  const bool lower_bound = holds_a_lower_bound(environment, out.lights);
  if (out.plan && lower_bound) {
    out.plan->lower_bound = true;
    out.plan->within_budget = false;
  }
  tell_uncertainty(lower_bound, out);
  out.time = environment.time;
  out.clipped_fraction = environment.clipped_fraction;
  find_reflections(whole_map, out);
  return {};
}

void LightEstimator::tell_uncertainty(bool lower_bound, LightEstimate& out) const {
  LightUncertainty& u = out.uncertainty;
  u.unseen = LightUncertainty::kContinued * (1 - out.coverage);
  const double mean_irradiance = kPi * luminance(out.mean_radiance);
  const auto noise = options_.filter ? filter_.irradiance_noise() : std::nullopt;
  if (noise && mean_irradiance > 0) u.noise = *noise / mean_irradiance;
  if (!lower_bound) u.total = std::hypot(u.noise.value_or(0), u.unseen);
}

void LightEstimator::set_governor(const GovernorConfig& governor_config) {
  governor_config_ = governor_config;
  governor_config_->limits.max_bands = options_.bands;
  governor_config_->limits.max_lights = options_.lights.max_count;
  governor_.emplace(governor_config_->limits, governor_config_->costs);
  unhurried_.emplace(governor_config_->limits, governor_config_->costs);
}

void LightEstimator::allow_lights(int max_count) {
  if (!governor_) return;
  governor_->allow_lights(max_count);
}

void LightEstimator::plan_for(const ShProjection& residual, TimestampNs time) {
  errors_.predict({&residual.upper_moments, extraction_.lights, map_rows_, max_map_step_},
                  governor_config_->probes, governor_config_->limits.max_bands,
                  governor_config_->limits.max_lights);
  plan_ = governor_->update(errors_, time);
  unhurried_plan_ = governor_->is_hurried() ? unhurried_->update(errors_, time) : *plan_;
}

Result<SeenLight> project_seen(const Environment& environment) {
  const ShInpainting holes(environment.confidence);
  LightExtraction split;
  ExtractionOptions all;
  all.min_irradiance_fraction /= 2;
  all.coverage = holes.coverage();
  PENUMBRA_TRY(extract_lights(environment.radiance, all, split, environment.clipped));
  PENUMBRA_ASSIGN(moments, project_latlong(split.residual, kMaxBands));
  PENUMBRA_ASSIGN(whole, holes.fill(moments.light));
  SeenLight out{whole, whole.light};
  add_distant_lights(split.lights, out.whole);
  return out;
}

LightEstimate make_estimate(const ShProjection& projection, int bands,
                            std::vector<DistantLight> lights) {
  LightEstimate estimate;
  make_estimate(projection, bands, std::span<const DistantLight>(lights), estimate);
  return estimate;
}

void make_estimate(const ShProjection& projection, int bands, std::span<const DistantLight> lights,
                   LightEstimate& estimate) {
  const RadianceSh& nine_bands = projection.light;
  std::vector<DistantLight> list = std::move(estimate.lights);
  list.assign(lights.begin(), lights.end());
  estimate = {};
  estimate.light = nine_bands.with_bands(bands);
  estimate.upper_hemisphere_light = upper_hemisphere_light(projection.upper_moments, bands);
  estimate.lights = std::move(list);
  estimate.valid = true;
  estimate.coverage = projection.coverage;
  // A fit to a small part of the sphere may swing below zero elsewhere.
  const Rgb mean = nine_bands[0] * static_cast<float>(1 / std::sqrt(4 * kPi));
  estimate.mean_radiance = {std::max(mean.r, 0.f), std::max(mean.g, 0.f), std::max(mean.b, 0.f)};
  for (const DistantLight& d : estimate.lights)
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

bool LightEstimate::is_affordable(std::size_t light) const {
  return !plan || light < static_cast<std::size_t>(plan->lights) || lights[light].id == kUnseenSun;
}

void keep_affordable(LightEstimate& e) {
  RadianceSh upper_moments(e.upper_hemisphere_light.bands());
  std::size_t kept = 0;
  for (std::size_t i = 0; i < e.lights.size(); ++i) {
    if (e.is_affordable(i)) {
      if (kept != i) e.lights[kept] = e.lights[i];
      ++kept;
      continue;
    }
    const RadianceSh whole = project_distant_light(e.lights[i], e.light.bands()),
                     upper = project_upper_distant_light(e.lights[i], upper_moments.bands());
    for (int n = 0; n < e.light.size(); ++n) e.light[n] += whole[n];
    for (int n = 0; n < upper_moments.size(); ++n) upper_moments[n] += upper[n];
  }
  if (kept == e.lights.size()) return;
  e.truncation_error.reset();
  e.lights.resize(kept);
  upper_moments = upper_hemisphere_light(upper_moments, upper_moments.bands());
  for (int n = 0; n < upper_moments.size(); ++n) e.upper_hemisphere_light[n] += upper_moments[n];
}

RadianceSh whole_light(const LightEstimate& e) {
  RadianceSh sum = e.light;
  for (const DistantLight& d : e.lights) {
    const RadianceSh own = project_distant_light(d, sum.bands());
    for (int n = 0; n < sum.size(); ++n) sum[n] += own[n];
  }
  return sum;
}

RadianceSh whole_upper_hemisphere_light(const LightEstimate& e) {
  RadianceSh upper_moments(e.upper_hemisphere_light.bands()), sum = e.upper_hemisphere_light;
  for (const DistantLight& d : e.lights) {
    const RadianceSh own = project_upper_distant_light(d, upper_moments.bands());
    for (int n = 0; n < upper_moments.size(); ++n) upper_moments[n] += own[n];
  }
  if (e.lights.empty()) return sum;
  upper_moments = upper_hemisphere_light(upper_moments, upper_moments.bands());
  for (int n = 0; n < sum.size(); ++n) sum[n] += upper_moments[n];
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
