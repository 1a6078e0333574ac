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
  if (image.environment)
    out.attribute = *image.environment == codec::EnvironmentAttribute::kCube
                        ? calib::ProjectionKind::kExrCube
                        : calib::ProjectionKind::kExrLatLong;
  std::optional<calib::ProjectionKind> kind = asked ? asked : out.attribute;
  if (!kind) kind = kind_from_shape(w, h);
  if (!kind)
    return fail(
        ErrorCode::kInvalid, path.string(),
        fmt::format("has {}x{} pixels, which do not tell its projection: it has to be given", w,
                    h));
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

void turn(EnvironmentFile& file, Radians angle) {
  const glm::dquat turned = glm::angleAxis(angle.value(), glm::dvec3(0, 1, 0));
  file.world_from_file = turned * file.world_from_file;
  for (glm::vec3& d : file.table.direction) d = glm::vec3(turned * glm::dvec3(d));
}

Result<Image<Rgb>> to_latlong(const EnvironmentFile& file) {
  const bool whole_turn = file.projection.kind == calib::ProjectionKind::kLatLong;
  if (whole_turn && file.world_from_file == glm::dquat(1, 0, 0, 0)) return file.radiance;
  // As many rows as the source has over half a turn.
  int height = file.projection.height;
  if (file.projection.kind == calib::ProjectionKind::kExrCube) height = 2 * file.projection.width;
  if (file.projection.kind == calib::ProjectionKind::kVerticalCross)
    height = 2 * file.projection.width / 3;
  height = std::max(4, height / 2 * 2);
  Image<Rgb> out(2 * height, height);
  const int w = file.radiance.width(), h = file.radiance.height();
  const glm::dquat file_from_world = glm::conjugate(file.world_from_file);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < 2 * height; ++x) {
      const auto p = calib::pixel_from_direction(
          file.projection, file_from_world * latlong_direction(x + .5, y + .5, 2 * height, height));
      if (!p) continue;
      // A lat-long map goes on behind its edges.
      const double px = whole_turn ? std::max(0., p->x - .5 + (p->x < .5 ? w : 0))
                                   : std::clamp(p->x - .5, 0., w - 1.),
                   py = std::clamp(p->y - .5, 0., h - 1.);
      const int ix = std::min(static_cast<int>(px), whole_turn ? w - 1 : std::max(0, w - 2));
      const int iy = std::min(static_cast<int>(py), std::max(0, h - 2));
      const auto fx = static_cast<float>(px - ix), fy = static_cast<float>(py - iy);
      const int jx = whole_turn ? (ix + 1) % w : std::min(ix + 1, w - 1),
                jy = std::min(iy + 1, h - 1);
      out.at(x, y) =
          (file.radiance.at(ix, iy) * (1 - fx) + file.radiance.at(jx, iy) * fx) * (1 - fy) +
          (file.radiance.at(ix, jy) * (1 - fx) + file.radiance.at(jx, jy) * fx) * fy;
    }
  return out;
}

}  // namespace penumbra::capture
