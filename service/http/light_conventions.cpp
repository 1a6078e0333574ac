#include "service/http/light_conventions.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <vector>

#include "core/conventions.h"
#include "core/io/spelling.h"
#include "lighting/estimate.h"
#include "runtime/pipeline/report.h"
#include "service/client/penumbra_convert.h"

namespace penumbra::service {

using nlohmann::json;

namespace {

constexpr int kBands = 3;

struct Convention {
  std::string_view name;
  penumbra_convention converts;
  bool irradiance;  // over pi, else radiance
};
constexpr Convention kConventions[] = {
    {"three", PENUMBRA_CONVENTION_WEBXR, false},      {"webxr", PENUMBRA_CONVENTION_WEBXR, false},
    {"arcore", PENUMBRA_CONVENTION_ARCORE, false},    {"godot", PENUMBRA_CONVENTION_GODOT, false},
    {"filament", PENUMBRA_CONVENTION_FILAMENT, true}, {"unity", PENUMBRA_CONVENTION_UNITY, true},
    {"unreal", PENUMBRA_CONVENTION_UNREAL, false},
};

json converted(const RadianceSh& light, penumbra_convention convention) {
  float sh[kBands * kBands][3] = {};
  const auto terms = light.with_bands(kBands);
  for (std::size_t n = 0; n < terms.terms().size(); ++n)
    for (int c = 0; c < 3; ++c) sh[n][c] = terms.terms()[n][c];
  (void)penumbra_sh_convert(convention, sh, kBands, sh);  // three bands suit all
  json out = json::array();
  for (const auto& term : sh) out.push_back({term[0], term[1], term[2]});
  return out;
}

json converted(const lighting::DistantLight& light, penumbra_convention convention) {
  float d[3] = {static_cast<float>(light.direction.x), static_cast<float>(light.direction.y),
                static_cast<float>(light.direction.z)};
  (void)penumbra_direction_convert(convention, d, d);
  const Rgb irradiance = light.radiance * static_cast<float>(light.solid_angle_sr());
  return {{"id", light.id},
          {"direction", {d[0], d[1], d[2]}},
          {"irradiance", runtime::to_json(irradiance)},
          {"angular_diameter_deg", 2 * light.radius.value() * 180 / kPi},
          {"lower_bound", light.is_lower_bound()}};
}

}  // namespace

Result<json> light_as(const lighting::LightEstimate& light, const std::string& as) {
  const auto found = std::ranges::find(kConventions, as, &Convention::name);
  if (found == std::end(kConventions)) {
    std::vector<std::string_view> names;
    for (const Convention& c : kConventions) names.push_back(c.name);
    return fail(ErrorCode::kInvalid, "as", fmt::format("is none of {}", fmt::join(names, ", ")));
  }
  json lights = json::array();
  for (const lighting::DistantLight& d : light.lights)
    lights.push_back(converted(d, found->converts));
  return json{{"convention", as},
              {"sh_is", found->irradiance ? "irradiance over pi" : "radiance"},
              {"sh", converted(light.light, found->converts)},
              {"total_sh", converted(lighting::whole_light(light), found->converts)},
              {"lights", lights}};
}

}  // namespace penumbra::service
