#include "service/headset/internal/lens_mesh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>

namespace penumbra::service {

namespace {

constexpr int kCellsAcross = 48, kDeepest = 4;
constexpr double kTolerance_px = .05;  // within triangles of cells that may still be divided
// Neighbouring corners of a cell look less far apart than this, unless faces of a cube meet there.
constexpr double kTurnCosine = .9;

class LensMeshMaker {
 public:
  explicit LensMeshMaker(const calib::CameraModel& camera) : camera_(camera) {}

  void add_cell(const glm::dvec2& low, const glm::dvec2& high, int depth) {
    const std::array<glm::dvec2, 4> corners = {low, glm::dvec2(high.x, low.y), high,
                                               glm::dvec2(low.x, high.y)};
    std::array<glm::dvec3, 4> directions;
    int seen = 0;
    for (std::size_t i = 0; i < 4; ++i)
      if (const auto d = calib::direction_from_pixel(camera_, corners[i])) {
        directions[i] = *d;
        ++seen;
      }
    if (seen == 0) return;
    const bool whole = seen == 4 && hangs_together(directions);
    if (whole) scale(directions);
    if (whole && (depth == kDeepest || is_met(corners, directions)))
      return add_triangles(corners, directions);
    if (depth == kDeepest) return;
    const glm::dvec2 middle = (low + high) / 2.;
    add_cell(low, middle, depth + 1);
    add_cell({middle.x, low.y}, {high.x, middle.y}, depth + 1);
    add_cell({low.x, middle.y}, {middle.x, high.y}, depth + 1);
    add_cell(middle, high, depth + 1);
  }
  std::vector<LensVertex> take() { return std::move(out_); }

 private:
  static bool hangs_together(const std::array<glm::dvec3, 4>& d) {
    for (std::size_t i = 0; i < 4; ++i)
      if (glm::dot(d[i], d[(i + 1) % 4]) < kTurnCosine) return false;
    return true;
  }

  // With -z of 1 a pinhole's place is linear over a triangle. Fisheyes are nearly so with unit
  // directions.
  void scale(std::array<glm::dvec3, 4>& d) const {
    if (camera_.kind != calib::ProjectionKind::kPinhole) return;
    for (glm::dvec3& one : d) one /= -one.z;
  }

  // In the middle of both triangles and of the edge between them.
  bool is_met(const std::array<glm::dvec2, 4>& corners, const std::array<glm::dvec3, 4>& d) const {
    const auto near = [&](const glm::dvec3& direction, const glm::dvec2& place) {
      const auto at = calib::pixel_from_direction(camera_, direction);
      return at && glm::length(*at - place) < kTolerance_px;
    };
    return near(d[0] + d[2], (corners[0] + corners[2]) / 2.) &&
           near(d[0] + d[1] + d[2], (corners[0] + corners[1] + corners[2]) / 3.) &&
           near(d[0] + d[2] + d[3], (corners[0] + corners[2] + corners[3]) / 3.);
  }

  void add_triangles(const std::array<glm::dvec2, 4>& corners, const std::array<glm::dvec3, 4>& d) {
    for (const std::size_t i : {0, 1, 2, 0, 2, 3}) {
      const glm::dvec2 place = corners[i] / glm::dvec2(camera_.width, camera_.height);
      out_.push_back(
          {{static_cast<float>(d[i].x), static_cast<float>(d[i].y), static_cast<float>(d[i].z)},
           {static_cast<float>(place.x), static_cast<float>(place.y)}});
    }
  }

  const calib::CameraModel& camera_;
  std::vector<LensVertex> out_;
};

}  // namespace

std::vector<LensVertex> make_lens_mesh(const calib::CameraModel& camera) {
  const double longer = std::max(camera.width, camera.height);
  const auto count = [&](int side) {
    return std::max(2, static_cast<int>(std::ceil(kCellsAcross * side / longer)));
  };
  const int columns = count(camera.width), rows = count(camera.height);
  const glm::dvec2 cell(camera.width / double(columns), camera.height / double(rows));
  LensMeshMaker maker(camera);
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x)
      maker.add_cell(cell * glm::dvec2(x, y), cell * glm::dvec2(x + 1, y + 1), 0);
  return maker.take();
}

}  // namespace penumbra::service
