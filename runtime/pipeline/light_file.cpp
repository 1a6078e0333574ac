#include "runtime/pipeline/light_file.h"

#include <algorithm>
#include <charconv>

#include "calib/camera/camera_model.h"
#include "calib/camera/projection_table.h"
#include "core/log.h"

namespace penumbra::runtime {

Result<FileLight> read_light(const std::string& path,
                             const std::optional<std::string>& projection) {
  std::optional<calib::ProjectionKind> kind;
  if (projection) {
    PENUMBRA_ASSIGN(parsed, calib::projection_kind(*projection));
    kind = parsed;
  }
  PENUMBRA_ASSIGN(file, capture::read_environment(path, kind));
  FileLight out;
  if (file.non_finite > 0)
    log_warning("{}: {} pixels are NaN or infinite and are left out of the light", path,
                file.non_finite);
  const calib::ProjectionTable& t = file.table;
  const bool plain =
      file.projection.kind == calib::ProjectionKind::kLatLong && file.non_finite == 0;
  auto light = plain ? lighting::project_latlong(file.radiance, kMaxBands)
                     : lighting::project_samples(
                           {t.direction, t.solid_angle_sr, {}, file.radiance.pixels()}, kMaxBands);
  if (!light) return fail(light.error().code, path, light.error().detail);
  out.light = *light;
  out.file = std::move(file);
  return out;
}

}  // namespace penumbra::runtime
