#include "runtime/studio/internal/real_mesh_world.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "core/conventions.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/ground_grid.h"
#include "prt/reference/environment_light.h"
#include "prt/reference/reference.h"

namespace penumbra::runtime {

namespace {

constexpr std::size_t kPaths = 12'000'000;  // ten seconds on two cores
constexpr int kFewest = 32, kMax = 1024;    // a point

// Texels beneath a thing see nothing; what stands beside them must not be drawn darker by it.
void fill_from_neighbours(Image<Rgb>& fraction, const std::vector<bool>& covered) {
  const Image<Rgb> before = fraction;
  const int n = fraction.width();
  const auto is_covered = [&](int x, int y) {
    return covered[static_cast<std::size_t>(y) * static_cast<std::size_t>(n) +
                   static_cast<std::size_t>(x)];
  };
  for (int y = 1; y + 1 < n; ++y)
    for (int x = 1; x + 1 < n; ++x) {
      if (!is_covered(x, y)) continue;
      Rgb sum;
      int count = 0;
      for (int k = 0; k < 9; ++k) {
        const int i = x + k % 3 - 1, j = y + k / 3 - 1;
        if (!is_covered(i, j)) sum += before.at(i, j), ++count;
      }
      if (count > 0) fraction.at(x, y) = sum * (1.f / static_cast<float>(count));
    }
}

}  // namespace

RealMeshWorld::RealMeshWorld(std::shared_ptr<const capture::FloorWorld> floor, prt::Mesh things,
                             prt::RayScene rays)
    : floor_(std::move(floor)),
      things_(std::move(things)),
      rays_(std::move(rays)),
      grid_(prt::fit_ground_grid(things_, 0)),
      irradiance_(things_.positions.size()),
      left_(grid_.size, grid_.size) {}

Result<std::shared_ptr<RealMeshWorld>> RealMeshWorld::make(
    std::shared_ptr<const capture::FloorWorld> floor, prt::Mesh things,
    const std::function<void(double)>& progress) {
  constexpr float kEdge = .05f;  // of the radius: holds the penumbra of a window
  prt::subdivide(things, kEdge * prt::radius_of(things));
  PENUMBRA_ASSIGN(rays, prt::RayScene::build(things));
  auto world = std::shared_ptr<RealMeshWorld>(
      new RealMeshWorld(std::move(floor), std::move(things), std::move(rays)));
  PENUMBRA_TRY(world->light(progress));
  return world;
}

Result<void> RealMeshWorld::light(const std::function<void(double)>& progress) {
  PENUMBRA_ASSIGN(far, prt::EnvironmentLight::from_map(floor_->environment()));
  const prt::ReferenceWorld world{
      things_, {{{0, 0, 0}, {0, 1, 0}, floor_->mean_floor_albedo(), {}}}, &far, {}};
  std::vector<prt::IrradiancePoint> points;
  // A point on the floor itself would look past it; what lies below goes on as it is at the floor
  // line.
  constexpr double kOverFloor_m = 1e-3;
  for (std::size_t i = 0; i < things_.positions.size(); ++i) {
    glm::dvec3 at(things_.positions[i]);
    at.y = std::max(at.y, kOverFloor_m);
    points.push_back({at, things_.normals[i]});
  }
  for (int y = 0; y < grid_.size; ++y)
    for (int x = 0; x < grid_.size; ++x) {
      const glm::vec2 p = grid_.position(glm::vec2(x + .5f, y + .5f) / float(grid_.size));
      points.push_back({{p.x, 0, p.y}, {0, 1, 0}});
    }
  const int samples = std::clamp(static_cast<int>(kPaths / points.size()), kFewest, kMax);
  std::vector<Rgb> found;
  constexpr std::size_t kSlices = 20;
  for (std::size_t slice = 0; slice < kSlices; ++slice) {
    const std::size_t first = points.size() * slice / kSlices,
                      last = points.size() * (slice + 1) / kSlices;
    PENUMBRA_ASSIGN(part,
                    prt::reference_irradiance(world, std::span(points).subspan(first, last - first),
                                              samples, slice));
    found.insert(found.end(), part.begin(), part.end());
    if (progress) progress(double(slice + 1) / kSlices);
  }
  const auto on_floor = found.begin() + static_cast<std::ptrdiff_t>(irradiance_.size());
  std::copy(found.begin(), on_floor, irradiance_.begin());
  std::vector<bool> covered;
  const Rgb open = floor_->floor_irradiance();
  for (std::size_t i = 0; i < left_.area(); ++i) {
    const Rgb e = on_floor[static_cast<std::ptrdiff_t>(i)];
    for (int c = 0; c < 3; ++c) left_.pixels()[i][c] = open[c] > 0 ? e[c] / open[c] : 1;
    covered.push_back(luminance(e) <= 0);
  }
  fill_from_neighbours(left_, covered);
  return {};
}

Rgb RealMeshWorld::floor_fraction(const glm::dvec3& position) const {
  const glm::vec2 uv = grid_.uv({position.x, position.z});
  const float last = static_cast<float>(grid_.size - 1);
  const glm::vec2 p = uv * float(grid_.size) - .5f;
  if (!(p.x >= 0 && p.y >= 0 && p.x < last && p.y < last)) return {1, 1, 1};
  const int x = static_cast<int>(p.x), y = static_cast<int>(p.y);
  const float u = p.x - static_cast<float>(x), v = p.y - static_cast<float>(y);
  return (left_.at(x, y) * (1 - u) + left_.at(x + 1, y) * u) * (1 - v) +
         (left_.at(x, y + 1) * (1 - u) + left_.at(x + 1, y + 1) * u) * v;
}

Rgb RealMeshWorld::exit_radiance(const prt::Hit& hit) const {
  if (!hit.front) return {};
  const auto& t = things_.triangles[hit.triangle];
  const auto at = [&](const std::vector<Rgb>& values) {
    return values[t[0]] * (1 - hit.u - hit.v) + values[t[1]] * hit.u + values[t[2]] * hit.v;
  };
  return at(things_.albedo) * at(irradiance_) * static_cast<float>(1 / kPi);
}

Rgb RealMeshWorld::radiance(const glm::dvec3& origin, const glm::dvec3& direction) const {
  const bool down = direction.y < 0 && origin.y > 0;
  const double to_floor = down ? -origin.y / direction.y : 1e30;
  if (const auto hit = rays_.intersect(glm::vec3(origin), glm::vec3(direction), 1e-4f,
                                       static_cast<float>(to_floor)))
    return exit_radiance(*hit);
  const Rgb open = floor_->radiance(origin, direction);
  return down ? open * floor_fraction(origin + direction * to_floor) : open;
}

}  // namespace penumbra::runtime
