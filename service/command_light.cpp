#include <fmt/format.h>

#include "service/commands.h"
#include "service/light_file.h"
#include "service/report.h"

namespace penumbra::service {

Result<void> light_estimate(const LightEstimateOptions& o) {
  auto light = read_light(o.environment, o.projection);
  if (!light) return std::unexpected(light.error());
  auto bands = choose_bands(o.bands, light->light);
  if (!bands) return std::unexpected(bands.error());
  const lighting::LightEstimate estimate = lighting::make_estimate(light->light, *bands);
  if (o.json) {
    nlohmann::json out = to_json(estimate);
    out["projection"] = calib::projection_name(light->file.projection.kind);
    out["non_finite"] = light->file.non_finite;
    print_json(out);
    return {};
  }
  fmt::print(
      "{}: {}, {} bands, mean radiance {:.4g} {:.4g} {:.4g}, coverage {:.1f} %, truncation error "
      "{:.2f} %\n",
      o.environment, calib::projection_name(light->file.projection.kind), *bands,
      estimate.mean_radiance.r, estimate.mean_radiance.g, estimate.mean_radiance.b,
      100 * estimate.coverage, 100 * estimate.truncation_error);
  for (int l = 0; l < *bands; ++l)
    for (int m = -l; m <= l; ++m) {
      const Rgb& c = estimate.light[sh_index(l, m)];
      fmt::print("  l {} m {:+d}  {:12.6g} {:12.6g} {:12.6g}\n", l, m, c.r, c.g, c.b);
    }
  return {};
}

}  // namespace penumbra::service
