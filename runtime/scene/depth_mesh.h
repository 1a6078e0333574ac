// Real surfaces as a depth camera saw them.
// threads: reentrant
#pragma once

#include <filesystem>
#include <functional>
#include <glm/vec2.hpp>
#include <optional>

#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"

namespace penumbra::runtime {

/// Where a pixel of a depth picture looks: (x, y, -1), finite; nothing where its depth does not
/// count.
using DepthRay = std::function<std::optional<glm::dvec2>(const glm::dvec2& pixel, float depth_m)>;

/// The surface behind a depth picture, in the world frame: one vertex for every few pixels, so that
/// the longer side has at most `max_vertices`. Each lies at the nearest depth around it that is
/// known. There is no triangle where neighbours lie further apart than 5 % of their distance, where
/// a depth is not positive and finite, or where the surface is seen edge-on.
/// in:     depth along the camera's axis, metres
/// errors: kUndetermined (no surface)
Result<prt::Mesh> mesh_from_depth(const Image<float>& depth, const DepthRay& ray,
                                  const Pose& world_from_camera, Rgb albedo, int max_vertices);
/// The same of a pinhole, with kDepthVertices.
/// errors: kInvalid (another size than the view's), kUndetermined
Result<prt::Mesh> mesh_from_depth(const Image<float>& depth, const prt::PinholeView& view,
                                  Rgb albedo);
inline constexpr int kDepthVertices = 320;

/// A linear .exr in metres (one channel, or the first of three) or a 16 bit picture in millimetres,
/// seen by the pinhole of `camera_file`.
/// errors: of the two readers, kInvalid (8 bit, another size, no pinhole)
Result<prt::Mesh> read_depth_mesh(const std::filesystem::path& depth_file,
                                  const std::filesystem::path& camera_file, Rgb albedo);

}  // namespace penumbra::runtime
