#include "runtime/pipeline/light_file.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <charconv>

#include "tools/chart/governor_bench.h"

namespace penumbra::service {

Result<FileLight> read_light(const std::string& path,
                             const std::optional<std::string>& projection) {
  std::optional<calib::ProjectionKind> kind;
  if (projection) {
    auto parsed = calib::projection_kind(*projection);
    if (!parsed) return std::unexpected(parsed.error());
    kind = *parsed;
  }
  auto file = capture::read_environment(path, kind);
  if (!file) return std::unexpected(file.error());
  FileLight out;
  if (file->non_finite > 0)
    spdlog::warn("{}: {} pixels are NaN or infinite and are left out of the light", path,
                 file->non_finite);
  const calib::ProjectionTable& t = file->table;
  const bool plain =
      file->projection.kind == calib::ProjectionKind::kLatLong && file->non_finite == 0;
  auto light = plain ? lighting::project_latlong(file->radiance, kMaxBands)
                     : lighting::project_samples(
                           {t.direction, t.solid_angle_sr, {}, file->radiance.pixels()}, kMaxBands);
  if (!light) return fail(light.error().code, path, light.error().detail);
  out.light = *light;
  out.file = std::move(*file);
  return out;
}

Result<lighting::DiscOptions> choose_discs(const std::string& text) {
  lighting::DiscOptions options;
  if (text == "auto") return options;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), options.most);
  if (error != std::errc() || end != text.data() + text.size() || options.most < 0 ||
      options.most > 64)
    return fail(ErrorCode::kInvalid, "--discs",
                "\"" + text + "\" is neither auto nor within 0..64");
  return options;
}

Result<void> check_budget(double budget) {
  if (budget > 0 && budget <= 1) return {};
  return fail(ErrorCode::kInvalid, "--budget", "not within 0..1 (RMS error of the shadow ratio)");
}

Result<lighting::Governance> make_governance(const PreparedScene& scene, double budget,
                                             bool fitted) {
  lighting::Governance out;
  out.limits.budget = budget;
  out.probes = shadow_probes(scene);
  if (!fitted) return out;
  auto costs = fit_costs(scene);
  if (!costs) return std::unexpected(costs.error());
  out.costs = *costs;
  return out;
}

Result<int> choose_bands(const std::string& text, const lighting::Projection& nine_bands) {
  if (text == "auto") {
    for (int bands = 1; bands < kMaxBands; ++bands)
      if (lighting::make_estimate(nine_bands, bands).truncation_error.value_or(0) <= .005)
        return bands;
    return kMaxBands;
  }
  int bands = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), bands);
  if (error != std::errc() || end != text.data() + text.size() || bands < 1 || bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", "\"" + text + "\" is neither auto nor within 1..9");
  return bands;
}

}  // namespace penumbra::service
