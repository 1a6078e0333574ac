// Shared by the commands: JSON on standard output, tables for people.
#pragma once

#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>

#include "core/image.h"
#include "lighting/lighting.h"
#include "service/stage_times.h"

namespace penumbra::service {

inline nlohmann::json to_json(const Rgb& c) {
  return nlohmann::json::array({c.r, c.g, c.b});
}

inline nlohmann::json to_json(const lighting::LightEstimate& e) {
  nlohmann::json coefficients = nlohmann::json::array(), floor = nlohmann::json::array();
  for (const Rgb& c : e.light.terms()) coefficients.push_back(to_json(c));
  for (const Rgb& c : e.floor_light.terms()) floor.push_back(to_json(c));
  return {{"bands", e.light.bands()},
          {"coefficients", coefficients},
          {"floor_coefficients", floor},
          {"discs", nlohmann::json::array()},
          {"mean_radiance", to_json(e.mean_radiance)},
          {"coverage", e.coverage},
          {"clipped_fraction", e.clipped_fraction},
          {"truncation_error", e.truncation_error}};
}

inline nlohmann::json to_json(const StageTimes& times) {
  nlohmann::json stages = nlohmann::json::object();
  for (const auto& [name, p] : times.summary())
    stages[name] = {{"p50_ms", p.p50_ms}, {"p99_ms", p.p99_ms}, {"count", p.count}};
  return stages;
}

inline void print_json(const nlohmann::json& value) {
  std::printf("%s\n", value.dump(2).c_str());
}

}  // namespace penumbra::service
