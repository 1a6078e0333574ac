#include "runtime/pipeline/light_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "calib/camera/camera_model.h"
#include "calib/camera/projection_table.h"
#include "core/conventions.h"
#include "core/io/log.h"
#include "lighting/estimate.h"
#include "lighting/sh/basis.h"

namespace penumbra::runtime {

namespace {

// A lens has numbers of its own, which no map tells.
Result<calib::ProjectionKind> kind_of_map(const std::string& name) {
  const auto kind = calib::projection_kind(name);
  if (!kind || *kind == calib::ProjectionKind::kKannalaBrandt ||
      *kind == calib::ProjectionKind::kDoubleSphere)
    return fail(ErrorCode::kInvalid, "--projection",
                fmt::format("{} is none of latlong, angular, mirror-ball, equidistant, pinhole, "
                            "vertical-cross, exr-latlong and exr-cube",
                            name));
  return *kind;
}

// Of the sphere: a few pixels that are not finite are no hole.
constexpr double kWhole = .99;

// In the file's own pixels or, where it does not show all, by way of lat-long.
Result<void> project(const std::string& path, const capture::EnvironmentFile& file,
                     FileLight& out) {
  const calib::ProjectionTable& t = file.table;
  const double seen_sr = std::reduce(t.solid_angle_sr.begin(), t.solid_angle_sr.end(), 0.);
  const bool plain = file.projection.kind == calib::ProjectionKind::kLatLong &&
                     file.world_from_file == glm::dquat(1, 0, 0, 0);
  const auto projected = [&]() -> Result<lighting::SeenLight> {
    if (seen_sr < kWhole * 4 * kPi) {
      PENUMBRA_ASSIGN(map, capture::to_latlong(file));
      return lighting::project_seen(map);
    }
    PENUMBRA_ASSIGN(
        light, plain && file.non_finite + file.unseen == 0
                   ? lighting::project_latlong(file.radiance, kMaxBands)
                   : lighting::project_samples(
                         {t.direction, t.solid_angle_sr, {}, file.radiance.pixels()}, kMaxBands));
    return lighting::SeenLight{light, light.light};
  }();
  if (!projected) return fail(projected.error().code, path, projected.error().detail);
  out.light = projected->whole;
  out.residual = projected->residual;
  return {};
}

}  // namespace

Result<FileLight> read_light(const std::string& path, const EnvironmentOrientation& orientation) {
  if (!(std::abs(orientation.rotation_deg) <= 360))
    return fail(ErrorCode::kInvalid, "--rotate-environment", "is not within -360..360 degrees");
  std::optional<calib::ProjectionKind> kind;
  if (orientation.projection) {
    PENUMBRA_ASSIGN(parsed, kind_of_map(*orientation.projection));
    kind = parsed;
  }
  PENUMBRA_ASSIGN(file, capture::read_environment(path, kind));
  if (file.attribute && *file.attribute != file.projection.kind)
    log_info("{}: read as {}, as asked; its OpenEXR attribute says {}", path,
             calib::projection_name(file.projection.kind), calib::projection_name(*file.attribute));
  if (orientation.rotation_deg != 0)
    capture::turn(file, Radians(orientation.rotation_deg * kPi / 180));
  FileLight out;
  if (file.non_finite > 0)
    log_warning("{}: {} pixels are NaN or infinite and are left out of the light", path,
                file.non_finite);
  PENUMBRA_TRY(project(path, file, out));
  out.file = std::move(file);
  if (out.light.coverage < kWhole)
    log_warning("{}: shows {:.0f} % of the sphere; the rest of the light is continued from it",
                path, 100 * out.light.coverage);
  return out;
}

Result<Image<Rgb>> whole_latlong(const FileLight& light) {
  constexpr int kBands = 3;
  PENUMBRA_ASSIGN(map, capture::to_latlong(light.file));
  if (map.confidence.empty()) return std::move(map.radiance);
  const RadianceSh smooth = light.residual.with_bands(kBands);
  const int w = map.radiance.width(), h = map.radiance.height();
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      if (map.confidence.at(x, y) > 0) continue;
      const Rgb filled = lighting::evaluate(smooth, latlong_direction(x + .5, y + .5, w, h));
      map.radiance.at(x, y) = {std::max(0.f, filled.r), std::max(0.f, filled.g),
                               std::max(0.f, filled.b)};
    }
  return std::move(map.radiance);
}

}  // namespace penumbra::runtime
