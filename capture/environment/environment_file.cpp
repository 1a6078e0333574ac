#include <fmt/format.h>

#include <cmath>

#include "capture/environment/environment_file.h"
#include "capture/frames.h"
#include "codec/codec.h"
#include "core/conventions.h"

namespace penumbra::capture {

namespace {

std::optional<calib::ProjectionKind> kind_from_shape(int width, int height) {
  if (width == 2 * height) return calib::ProjectionKind::kLatLong;
  if (4 * width == 3 * height) return calib::ProjectionKind::kVerticalCross;
  if (width == height) return calib::ProjectionKind::kAngular;
  return std::nullopt;
}

}  // namespace

Result<EnvironmentFile> read_environment(const std::filesystem::path& path,
                                         std::optional<calib::ProjectionKind> asked) {
  PENUMBRA_ASSIGN(image, codec::read_hdr(path));
  EnvironmentFile out;
  out.radiance = std::move(image.pixels);
  out.non_finite = image.non_finite;
  const int w = out.radiance.width(), h = out.radiance.height();
  std::optional<calib::ProjectionKind> kind = asked;
  if (image.environment)
    kind = *image.environment == codec::EnvironmentAttribute::kCube
               ? calib::ProjectionKind::kExrCube
               : calib::ProjectionKind::kExrLatLong;
  if (!kind) kind = kind_from_shape(w, h);
  if (!kind)
    return fail(
        ErrorCode::kInvalid, path.string(),
        fmt::format("has {}x{} pixels, which do not tell its projection: give --projection", w, h));
  auto projection = calib::make_projection(*kind, w, h);
  if (!projection) return fail(projection.error().code, path.string(), projection.error().detail);
  out.projection = *projection;
  out.table = calib::make_projection_table(out.projection);
  for (std::size_t i = 0; i < out.radiance.area(); ++i)
    if (!is_finite(out.radiance.pixels()[i])) {
      out.radiance.pixels()[i] = {};
      out.table.confidence[i] = 0;
      out.table.solid_angle_sr[i] = 0;
    }
  return out;
}

Result<Image<Rgb>> to_latlong(const EnvironmentFile& file) {
  if (file.projection.kind == calib::ProjectionKind::kLatLong) return file.radiance;
  // As many rows as the source has over half a turn.
  int height = file.projection.height;
  if (file.projection.kind == calib::ProjectionKind::kExrCube) height = 2 * file.projection.width;
  if (file.projection.kind == calib::ProjectionKind::kVerticalCross)
    height = 2 * file.projection.width / 3;
  height = std::max(4, height / 2 * 2);
  Image<Rgb> out(2 * height, height);
  const int w = file.radiance.width(), h = file.radiance.height();
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < 2 * height; ++x) {
      const auto p = calib::pixel_from_direction(
          file.projection, latlong_direction(x + .5, y + .5, 2 * height, height));
      if (!p) continue;
      const double px = std::clamp(p->x - .5, 0., w - 1.), py = std::clamp(p->y - .5, 0., h - 1.);
      const int ix = std::min(static_cast<int>(px), std::max(0, w - 2));
      const int iy = std::min(static_cast<int>(py), std::max(0, h - 2));
      const auto fx = static_cast<float>(px - ix), fy = static_cast<float>(py - iy);
      const int jx = std::min(ix + 1, w - 1), jy = std::min(iy + 1, h - 1);
      out.at(x, y) =
          (file.radiance.at(ix, iy) * (1 - fx) + file.radiance.at(jx, iy) * fx) * (1 - fy) +
          (file.radiance.at(ix, jy) * (1 - fx) + file.radiance.at(jx, jy) * fx) * fy;
    }
  return out;
}

}  // namespace penumbra::capture
