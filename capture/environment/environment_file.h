// Environment maps from files.
// threads: reentrant
#pragma once

#include <cstddef>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>
#include <optional>

#include "calib/camera/camera_model.h"
#include "calib/camera/projection_table.h"
#include "core/environment.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// An environment file in any supported projection as directions, solid angles and radiance. The
/// mapping is `projection` where it is given, else that of the OpenEXR attribute, else it follows
/// from the shape: 2:1 lat-long, 3:4 vertical cross, 1:1 angular. Non-finite pixels, and black ones
/// whose alpha is 0 (`hdr environment` writes them where no camera saw), get no solid angle and no
/// confidence.
struct EnvironmentFile {
  calib::CameraModel projection;
  std::optional<calib::ProjectionKind> attribute;  // what the file says itself
  glm::dquat world_from_file{1, 0, 0, 0};
  calib::ProjectionTable table;  // directions of the world
  Image<Rgb> radiance;
  std::size_t non_finite = 0;
  std::size_t unseen = 0;  // pixels that the file itself marks, by its alpha
  Image<float> clipped{};  // likewise, above 0 where the radiance is a lower bound; empty: nowhere
};
Result<EnvironmentFile> read_environment(const std::filesystem::path& path,
                                         std::optional<calib::ProjectionKind> projection);
/// Turns the light about the vertical, counter-clockwise seen from above.
void turn(EnvironmentFile& file, Radians angle);
/// Any of them resampled to lat-long (a plain lat-long file that is not turned keeps its pixels),
/// with the confidence of what was seen, 0 or 1, and what is clipped.
Result<Environment> to_latlong(const EnvironmentFile& file);

}  // namespace penumbra::capture
#pragma GCC visibility pop
