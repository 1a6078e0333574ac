#include "runtime/scene/depth_mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "calib/camera/camera_model.h"
#include "capture/recording/folder.h"
#include "codec/codec.h"

namespace penumbra::runtime {

namespace {

constexpr float kJump = .05f;    // of the distance: beyond, two surfaces
constexpr double kEdgeOn = .05;  // cosine to the ray

// The known depth nearest to the middle of a block; 0 without any.
float depth_of_block(const Image<float>& depth, int x0, int y0, int step) {
  float best = 0;
  double nearest = 1e30;
  for (int y = y0; y < std::min(y0 + step, depth.height()); ++y)
    for (int x = x0; x < std::min(x0 + step, depth.width()); ++x) {
      const float d = depth.at(x, y);
      if (!(d > 0) || !std::isfinite(d)) continue;
      const double off = std::hypot(x - x0 - .5 * (step - 1), y - y0 - .5 * (step - 1));
      if (off < nearest) nearest = off, best = d;
    }
  return best;
}

bool joined(float a, float b) {
  return a > 0 && b > 0 && std::abs(a - b) < kJump * std::min(a, b);
}

// Mean of the triangles around each vertex; all face the camera.
void set_normals(prt::Mesh& mesh, const glm::vec3& eye) {
  mesh.normals.assign(mesh.positions.size(), glm::vec3(0));
  for (const auto& t : mesh.triangles) {
    const glm::vec3 &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
    const glm::vec3 n = glm::cross(b - a, c - a);
    for (const std::uint32_t v : t) mesh.normals[v] += n;
  }
  for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
    const float length = glm::length(mesh.normals[i]);
    mesh.normals[i] =
        length > 0 ? mesh.normals[i] / length : glm::normalize(eye - mesh.positions[i]);
  }
}

}  // namespace

Result<prt::Mesh> mesh_from_depth(const Image<float>& depth, const DepthRay& ray,
                                  const Pose& world_from_camera, Rgb albedo, int max_vertices) {
  const int step = (std::max(depth.width(), depth.height()) + max_vertices - 1) / max_vertices;
  const int columns = (depth.width() + step - 1) / step, rows = (depth.height() + step - 1) / step;
  prt::Mesh mesh;
  std::vector<float> depths;
  std::vector<std::uint32_t> vertex;  // by block
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i) {
      const float d = depth_of_block(depth, i * step, j * step, step);
      const auto towards =
          d > 0 ? ray({(i + .5) * step, (j + .5) * step}, d) : std::optional<glm::dvec2>();
      depths.push_back(towards ? d : 0);
      vertex.push_back(static_cast<std::uint32_t>(mesh.positions.size()));
      if (!towards) continue;
      mesh.positions.emplace_back(world_from_camera * (double(d) * glm::dvec3(*towards, -1)));
    }
  const glm::vec3 eye(world_from_camera.translation);
  const auto add = [&](std::size_t a, std::size_t b, std::size_t c) {
    if (!joined(depths[a], depths[b]) || !joined(depths[b], depths[c]) ||
        !joined(depths[c], depths[a]))
      return;
    const glm::vec3 &p = mesh.positions[vertex[a]], &q = mesh.positions[vertex[b]],
                    &r = mesh.positions[vertex[c]];
    const glm::vec3 n = glm::cross(q - p, r - p);
    if (glm::dot(n, eye - p) <= kEdgeOn * glm::length(n) * glm::length(eye - p)) return;
    mesh.triangles.push_back({vertex[a], vertex[b], vertex[c]});
  };
  for (int j = 0; j + 1 < rows; ++j)
    for (int i = 0; i + 1 < columns; ++i) {
      const auto a = static_cast<std::size_t>(j * columns + i),
                 c = a + static_cast<std::size_t>(columns);
      add(a, c, a + 1);
      add(a + 1, c, c + 1);
    }
  if (mesh.triangles.empty())
    return fail(ErrorCode::kUndetermined, "depth",
                "shows no surface: every depth is 0 or unknown, or the surface is seen edge-on");
  mesh.albedo.assign(mesh.positions.size(), albedo);
  set_normals(mesh, eye);
  return mesh;
}

Result<prt::Mesh> mesh_from_depth(const Image<float>& depth, const prt::PinholeView& view,
                                  Rgb albedo) {
  if (depth.width() != view.width || depth.height() != view.height)
    return fail(ErrorCode::kInvalid, "depth",
                fmt::format("has {}x{} pixels, but its camera has {}x{}", depth.width(),
                            depth.height(), view.width, view.height));
  const DepthRay ray = [&](const glm::dvec2& pixel, float) -> std::optional<glm::dvec2> {
    const glm::dvec2 off = (pixel - view.principal_px) / view.focal_px;
    return glm::dvec2(off.x, -off.y);
  };
  return mesh_from_depth(depth, ray, view.world_from_camera, albedo, kDepthVertices);
}

Result<prt::Mesh> read_depth_mesh(const std::filesystem::path& depth_file,
                                  const std::filesystem::path& camera_file, Rgb albedo) {
  PENUMBRA_ASSIGN(camera, capture::read_camera_file(camera_file));
  const calib::CameraModel& p = camera.projection;
  if (p.kind != calib::ProjectionKind::kPinhole || p.is_distorted())
    return fail(ErrorCode::kInvalid, camera_file.string(),
                "is not a pinhole without distortion, and depth pictures have to be seen by one");
  PENUMBRA_ASSIGN(frame, codec::read_frame(depth_file));
  Image<float> depth;
  const auto take = [&](const auto& pixels, float metres) {
    depth = Image<float>(pixels.width(), pixels.height());
    std::ranges::transform(pixels.pixels(), depth.pixels().begin(),
                           [&](const auto& c) { return metres * static_cast<float>(c.r); });
  };
  if (const auto* linear = std::get_if<Image<Rgb>>(&frame))
    take(*linear, 1);
  else if (const auto* millimetres = std::get_if<Image<Rgb16>>(&frame))
    take(*millimetres, .001f);
  else
    return fail(ErrorCode::kInvalid, depth_file.string(),
                "has 8 bits; a depth picture is OpenEXR in metres, or has 16 bits in millimetres");
  auto mesh = mesh_from_depth(
      depth, {p.width, p.height, p.focal_px, p.principal_px, camera.world_from_camera}, albedo);
  if (!mesh) return fail(mesh.error().code, depth_file.string(), mesh.error().detail);
  return mesh;
}

}  // namespace penumbra::runtime
