#include <fmt/format.h>

#include "tools/penumbra/commands.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/report.h"

namespace penumbra::service {

Result<void> light_estimate(const LightEstimateOptions& o) {
  auto light = read_light(o.environment, o.projection);
  if (!light) return std::unexpected(light.error());
  auto bands = choose_bands(o.bands, light->light);
  if (!bands) return std::unexpected(bands.error());
  auto discs = choose_discs(o.discs);
  if (!discs) return std::unexpected(discs.error());
  auto map = capture::to_latlong(light->file);
  if (!map) return std::unexpected(map.error());
  auto split = lighting::estimate_map(*map, {*bands, *discs});
  if (!split) return std::unexpected(split.error());
  // Measured in the file's own pixels; the split in a lat-long map.
  const lighting::LightEstimate estimate = lighting::make_estimate(light->light, *bands);
  if (o.json) {
    nlohmann::json out = to_json(estimate), parts = to_json(*split);
    out["discs"] = parts["discs"];
    out["rest"] = parts["rest"];
    out["projection"] = calib::projection_name(light->file.projection.kind);
    out["non_finite"] = light->file.non_finite;
    print_json(out);
    return {};
  }
  fmt::print(
      "{}: {}, {} bands, mean radiance {:.4g} {:.4g} {:.4g}, coverage {:.1f} %, truncation error "
      "{}\n",
      o.environment, calib::projection_name(light->file.projection.kind), *bands,
      estimate.mean_radiance.r, estimate.mean_radiance.g, estimate.mean_radiance.b,
      100 * estimate.coverage,
      estimate.truncation_error ? fmt::format("{:.2f} %", 100 * *estimate.truncation_error)
                                : "unknown (nothing beyond is measured)");
  for (int l = 0; l < *bands; ++l)
    for (int m = -l; m <= l; ++m) {
      const Rgb& c = estimate.light[sh_index(l, m)];
      fmt::print("  l {} m {:+d}  {:12.6g} {:12.6g} {:12.6g}\n", l, m, c.r, c.g, c.b);
    }
  for (const lighting::Disc& d : split->discs) {
    const Rgb e = d.irradiance();
    fmt::print(
        "  disc towards {:+.3f} {:+.3f} {:+.3f}, radius {:.2f} degrees, irradiance {:.4g} {:.4g} "
        "{:.4g}\n",
        d.direction.x, d.direction.y, d.direction.z, d.radius.value() * 180 / kPi, e.r, e.g, e.b);
  }
  return {};
}

}  // namespace penumbra::service
