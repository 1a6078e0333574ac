// Light, plans and timings as JSON, as the commands and the HTTP interface give them.
// threads: reentrant
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "core/image.h"
#include "core/threads/stage_times.h"
#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "runtime/pipeline/runs.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

inline nlohmann::json to_json(const Rgb& c) {
  return nlohmann::json::array({c.r, c.g, c.b});
}

inline nlohmann::json to_json(const RadianceSh& light) {
  nlohmann::json out = nlohmann::json::array();
  for (const Rgb& c : light.terms()) out.push_back(to_json(c));
  return out;
}

inline nlohmann::json to_json(const lighting::DistantLight& d) {
  return {{"id", d.id},
          {"direction", {d.direction.x, d.direction.y, d.direction.z}},
          {"radius_rad", d.radius.value()},
          {"solid_angle_sr", d.solid_angle_sr()},
          {"radiance", to_json(d.radiance)},
          {"clipped", d.clipped},
          {"recovered", d.recovered},
          {"lower_bound", d.is_lower_bound()}};
}

inline const char* reason_of(const lighting::Plan& p) {
  if (p.lower_bound)
    return "a light is saturated in every exposure and not recovered: it sends at least what was "
           "measured, and the error is unknown";
  if (p.unseen)
    return "a part of the surroundings that no camera sees may change the shadow by more than the "
           "limit";
  if (p.within_budget) return "the cheapest whose predicted errors are within the limit";
  if (p.time_limited) return "the most accurate that a frame's time allows";
  return "the most accurate there is; none is within the limit";
}

/// What the governor picked and why.
inline nlohmann::json to_json(const lighting::Plan& p) {
  const auto unless_unknown = [&](double error) {
    return p.lower_bound ? nlohmann::json() : nlohmann::json(error);
  };
  return {{"bands", p.bands},
          {"lights", p.lights},
          {"fine_lights", p.fine_lights},
          {"map_step", p.map_step},
          {"predicted_error", unless_unknown(p.error)},
          {"predicted_object_error", unless_unknown(p.object_error)},
          {"predicted_ms", p.ms},
          {"reading_ms", p.cost.reading_ms},
          {"relighting_ms", p.cost.relighting_ms},
          {"lights_ms", p.cost.lights_ms},
          {"within_budget", p.within_budget},
          {"time_limited", p.time_limited},
          {"lower_bound", p.lower_bound},
          {"unseen", p.unseen},
          {"why", reason_of(p)}};
}

inline nlohmann::json to_json(const lighting::LightUncertainty& u) {
  const auto known = [](const std::optional<double>& v) {
    return v ? nlohmann::json(*v) : nlohmann::json();
  };
  return {{"irradiance", known(u.total)}, {"noise", known(u.noise)}, {"unseen", u.unseen}};
}

/// The whole light in harmonics, and beside it the split for engines with lights of their own:
/// `residual` plus `lights` is all.
inline nlohmann::json to_json(const lighting::LightEstimate& e) {
  nlohmann::json lights = nlohmann::json::array();
  for (const lighting::DistantLight& d : e.lights) lights.push_back(to_json(d));
  return {{"bands", e.light.bands()},
          {"coefficients", to_json(lighting::whole_light(e))},
          {"upper_hemisphere_coefficients", to_json(lighting::whole_upper_hemisphere_light(e))},
          {"lights", lights},
          {"residual",
           {{"coefficients", to_json(e.light)},
            {"upper_hemisphere_coefficients", to_json(e.upper_hemisphere_light)}}},
          {"mean_radiance", to_json(e.mean_radiance)},
          {"coverage", e.coverage},
          {"clipped_fraction", e.clipped_fraction},
          {"truncation_error",
           e.truncation_error ? nlohmann::json(*e.truncation_error) : nlohmann::json()},
          {"uncertainty", to_json(e.uncertainty)},
          {"plan", e.plan ? to_json(*e.plan) : nlohmann::json()}};
}

/// By the queue in which they waited.
inline nlohmann::json to_json(const OvertakenFrames& frames) {
  return {{"view", frames.view},
          {"environment", frames.environment},
          {"foreground", frames.foreground},
          {"for_light", frames.for_light},
          {"unmatched_eyes", frames.unmatched_eyes}};
}

/// Of all cores, a frame.
inline nlohmann::json to_json(const ProcessorTimes& times, double frames) {
  return {{"pipeline_ms", times.pipeline_ms / frames},
          {"drawing_ms", times.drawing_ms / frames},
          {"cameras_ms", times.cameras_ms / frames},
          {"encoding_ms", times.encoding_ms / frames},
          {"other_ms", times.other_ms / frames}};
}

inline nlohmann::json to_json(const StageTimes& times) {
  nlohmann::json stages = nlohmann::json::object();
  for (const auto& [name, p] : times.summary())
    stages[name] = {{"p50_ms", p.p50_ms}, {"p99_ms", p.p99_ms}, {"count", p.count}};
  return stages;
}

}  // namespace penumbra::runtime
#pragma GCC visibility pop
