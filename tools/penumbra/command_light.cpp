#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "calib/camera/camera_model.h"
#include "capture/environment/environment_file.h"
#include "core/io/log.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/report.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"
#include "tools/runs/light_options.h"

namespace penumbra::tools {

namespace {

struct LightEstimateOptions {
  std::string environment;
  runtime::EnvironmentOrientation orientation;
  std::string bands = "auto", lights = "auto";
  bool json = false;
};

}  // namespace

Result<void> light_estimate(const LightEstimateOptions& o) {
  PENUMBRA_ASSIGN(light, runtime::read_light(o.environment, o.orientation));
  PENUMBRA_ASSIGN(bands, choose_bands(o.bands, light.light));
  PENUMBRA_ASSIGN(lights, choose_max_lights(o.lights));
  PENUMBRA_ASSIGN(map, capture::to_latlong(light.file));
  PENUMBRA_ASSIGN(split, lighting::LightEstimator({bands, lights}).estimate(map));
  // Measured in the file's own pixels; the split in a lat-long map.
  const lighting::LightEstimate estimate = lighting::make_estimate(light.light, bands);
  if (!map.clipped.empty())
    log_warning(
        "{}: {:.3f} % of the sphere is saturated in every exposure: its light is a lower bound",
        o.environment, 100 * map.clipped_fraction);
  if (o.json) {
    nlohmann::json out = runtime::to_json(estimate), parts = runtime::to_json(split);
    out["lights"] = parts["lights"];
    out["residual"] = parts["residual"];
    out["uncertainty"] = parts["uncertainty"];
    out["clipped_fraction"] = map.clipped_fraction;
    out["projection"] = calib::projection_name(light.file.projection.kind);
    out["non_finite"] = light.file.non_finite;
    print_json(out);
    return {};
  }
  fmt::print(
      "{}: {}, {} bands, mean radiance {:.4g} {:.4g} {:.4g}, coverage {:.1f} %, irradiance "
      "uncertain "
      "by {}, truncation error {}\n",
      o.environment, calib::projection_name(light.file.projection.kind), bands,
      estimate.mean_radiance.r, estimate.mean_radiance.g, estimate.mean_radiance.b,
      100 * estimate.coverage,
      split.uncertainty.total ? fmt::format("{:.1f} %", 100 * *split.uncertainty.total)
                              : "more than is known",
      estimate.truncation_error ? fmt::format("{:.2f} %", 100 * *estimate.truncation_error)
                                : "unknown (nothing beyond is measured)");
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m) {
      const Rgb& c = estimate.light[sh_index(l, m)];
      fmt::print("  l {} m {:+d}  {:12.6g} {:12.6g} {:12.6g}\n", l, m, c.r, c.g, c.b);
    }
  for (const lighting::DistantLight& d : split.lights) {
    const Rgb e = d.irradiance();
    fmt::print(
        "  light towards {:+.3f} {:+.3f} {:+.3f}, radius {:.2f} degrees, irradiance {}{:.4g} "
        "{:.4g} {:.4g}\n",
        d.direction.x, d.direction.y, d.direction.z, d.radius.value() * 180 / kPi,
        d.is_lower_bound() ? "at least " : "", e.r, e.g, e.b);
  }
  return {};
}

void add_light_estimate(CLI::App& parent, Action& action) {
  static LightEstimateOptions estimate;
  auto* c = parent.add_subcommand(
      "estimate", "Estimate spherical harmonics and distant lights of an HDR environment map");
  c->add_option("environment", estimate.environment,
                "HDR environment map: .exr, .hdr, .jph, .jp2, .pnr, or .jpg with a gain map")
      ->required();
  add_orientation(*c, estimate.orientation);
  c->add_option("--bands", estimate.bands, kBandsOfMapHelp)->capture_default_str();
  c->add_option("--max-lights", estimate.lights, kMaxLightsHelp)->capture_default_str();
  add_json(c, estimate.json);
  c->callback([&] { action = [] { return light_estimate(estimate); }; });
}

}  // namespace penumbra::tools
