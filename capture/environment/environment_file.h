// Environment maps from files.
// threads: reentrant
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>

#include "calib/camera/camera_model.h"
#include "calib/camera/projection_table.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// An environment file in any supported projection as directions, solid angles and radiance. The
/// mapping comes from the OpenEXR attribute where there is one, else from `projection`, else from
/// the shape: 2:1 lat-long, 3:4 vertical cross, 1:1 angular. Non-finite pixels get no solid angle.
struct EnvironmentFile {
  calib::CameraModel projection;
  calib::ProjectionTable table;
  Image<Rgb> radiance;
  std::size_t non_finite = 0;
};
Result<EnvironmentFile> read_environment(const std::filesystem::path& path,
                                         std::optional<calib::ProjectionKind> projection);
/// Any of them resampled to lat-long (a plain lat-long file keeps its pixels).
Result<Image<Rgb>> to_latlong(const EnvironmentFile& file);

}  // namespace penumbra::capture
#pragma GCC visibility pop
