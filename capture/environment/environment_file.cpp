#include <fmt/format.h>

#include <algorithm>
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
  out.clipped = std::move(image.clipped);
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
  for (std::size_t i = 0; i < out.radiance.area(); ++i) {
    Rgb& pixel = out.radiance.pixels()[i];
    const bool unseen = !image.alpha.empty() && image.alpha.pixels()[i] == 0 && pixel == Rgb{};
    if (is_finite(pixel) && !unseen) continue;
    pixel = {};
    out.table.confidence[i] = 0;
    out.table.solid_angle_sr[i] = 0;
    out.unseen += unseen;
  }
  return out;
}

void turn(EnvironmentFile& file, Radians angle) {
  const glm::dquat turned = glm::angleAxis(angle.value(), glm::dvec3(0, 1, 0));
  file.world_from_file = turned * file.world_from_file;
  for (glm::vec3& d : file.table.direction) d = glm::vec3(turned * glm::dvec3(d));
}

namespace {

// As many rows as the source has over half a turn.
int latlong_rows(const EnvironmentFile& file) {
  int rows = file.projection.height;
  if (file.projection.kind == calib::ProjectionKind::kExrCube) rows = 2 * file.projection.width;
  if (file.projection.kind == calib::ProjectionKind::kVerticalCross)
    rows = 2 * file.projection.width / 3;
  return std::max(4, rows / 2 * 2);
}

// Between four pixels, without those that show nothing.
class SeenPixels {
 public:
  explicit SeenPixels(const EnvironmentFile& file)
      : file_(file), whole_turn_(file.projection.kind == calib::ProjectionKind::kLatLong) {}

  /// Nothing where none of the four is seen.
  std::optional<Rgb> at(const glm::dvec2& p) const {
    const int w = file_.radiance.width(), h = file_.radiance.height();
    // A lat-long map goes on behind its edges.
    const double px = whole_turn_ ? std::max(0., p.x - .5 + (p.x < .5 ? w : 0))
                                  : std::clamp(p.x - .5, 0., w - 1.),
                 py = std::clamp(p.y - .5, 0., h - 1.);
    const int x0 = std::min(static_cast<int>(px), whole_turn_ ? w - 1 : std::max(0, w - 2));
    const int y0 = std::min(static_cast<int>(py), std::max(0, h - 2));
    const int x1 = whole_turn_ ? (x0 + 1) % w : std::min(x0 + 1, w - 1),
              y1 = std::min(y0 + 1, h - 1);
    const auto fx = static_cast<float>(px - x0), fy = static_cast<float>(py - y0);
    Rgb sum;
    float seen = 0;
    const auto add = [&](int x, int y, float weight) {
      if (file_.table.confidence[static_cast<std::size_t>(y * w + x)] <= 0) return;
      sum += file_.radiance.at(x, y) * weight;
      seen += weight;
    };
    add(x0, y0, (1 - fx) * (1 - fy)), add(x1, y0, fx * (1 - fy));
    add(x0, y1, (1 - fx) * fy), add(x1, y1, fx * fy);
    if (seen <= 0) return std::nullopt;
    return seen < 1 ? sum * (1 / seen) : sum;
  }

 private:
  const EnvironmentFile& file_;
  bool whole_turn_;
};

// By the nearest pixels of the file.
void mark_clipped(const EnvironmentFile& file, Environment& out) {
  if (file.clipped.empty()) return;
  const int w = out.radiance.width(), h = out.radiance.height();
  const glm::dquat file_from_world = glm::conjugate(file.world_from_file);
  double all = 0;
  for (int y = 0; y < h; ++y) {
    const double area = latlong_solid_angle(y, w, h);
    for (int x = 0; x < w; ++x) {
      all += area;
      const auto p = calib::pixel_from_direction(
          file.projection, file_from_world * latlong_direction(x + .5, y + .5, w, h));
      if (!p) continue;
      const auto at = [](double v, int size) {
        return std::clamp(static_cast<int>(std::floor(v)), 0, size - 1);
      };
      if (!(file.clipped.at(at(p->x, file.clipped.width()), at(p->y, file.clipped.height())) > 0))
        continue;
      out.clipped.push_back(static_cast<std::uint32_t>(y * w + x));
      out.clipped_fraction += area;
    }
  }
  out.clipped_fraction /= all;
}

}  // namespace

Result<Environment> to_latlong(const EnvironmentFile& file) {
  Environment out;
  const bool kept = file.projection.kind == calib::ProjectionKind::kLatLong &&
                    file.world_from_file == glm::dquat(1, 0, 0, 0);
  if (kept) {
    out.radiance = file.radiance;
    out.confidence = Image<float>(out.radiance.width(), out.radiance.height());
    std::ranges::copy(file.table.confidence, out.confidence.pixels().begin());
  } else {
    const int rows = latlong_rows(file);
    out.radiance = Image<Rgb>(2 * rows, rows);
    out.confidence = Image<float>(2 * rows, rows);
    const SeenPixels pixels(file);
    const glm::dquat file_from_world = glm::conjugate(file.world_from_file);
    for (int y = 0; y < rows; ++y)
      for (int x = 0; x < 2 * rows; ++x) {
        const auto p = calib::pixel_from_direction(
            file.projection, file_from_world * latlong_direction(x + .5, y + .5, 2 * rows, rows));
        const auto seen = p ? pixels.at(*p) : std::nullopt;
        if (!seen) continue;
        out.radiance.at(x, y) = *seen;
        out.confidence.at(x, y) = 1;
      }
  }
  if (std::ranges::all_of(out.confidence.pixels(), [](float c) { return c > 0; }))
    out.confidence = {};
  mark_clipped(file, out);
  return out;
}

}  // namespace penumbra::capture
