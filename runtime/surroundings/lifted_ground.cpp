#include "runtime/surroundings/lifted_ground.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/bake/bake_rules.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"

namespace penumbra::runtime {

namespace {

constexpr float kLowest = .1f;  // place over the floor, radii
constexpr int kTerms = LiftedGround::kBands * LiftedGround::kBands;
constexpr int kLanes = prt::RayWorld::kPacket;
static_assert(kLanes == lighting::kBasisLanes);

// Integrals over the upper hemisphere: of Y_n Y_m, and of Y_n; and transfer of an open floor.
struct HemisphereSums {
  std::array<std::array<float, kMaxCoefficients>, kTerms> products{};
  std::array<float, kTerms> lower{}, open{};  // lower: over the other hemisphere
};

// Products of harmonics of one order are polynomials of the height, so that Gauss-Legendre nodes
// give them exactly; different orders vanish over the circle.
HemisphereSums hemisphere_sums() {
  constexpr int kAround = 36;
  // Nodes and weights of degree 12 on -1..1 (Abramowitz & Stegun 1964, table 25.4).
  constexpr double kNodes[] = {.125233408511469, .367831498998180, .587317954286617,
                               .769902674194305, .904117256370475, .981560634246719};
  constexpr double kWeights[] = {.249147045813403, .233492536538355, .203167426723066,
                                 .160078328543346, .106939325995318, .047175336386512};
  std::array<std::array<double, kMaxCoefficients>, kTerms> products{};
  std::array<double, kTerms> upper{};
  double basis[kMaxCoefficients];
  for (int i = 0; i < 12; ++i) {
    const double y = .5 + .5 * (i % 2 ? 1 : -1) * kNodes[i / 2], across = std::sqrt(1 - y * y);
    const double weight = .5 * kWeights[i / 2] * 2 * kPi / kAround;
    for (int k = 0; k < kAround; ++k) {
      const double phi = 2 * kPi * (k + .5) / kAround;
      lighting::evaluate_basis(kMaxBands, {across * std::cos(phi), y, across * std::sin(phi)},
                               basis);
      for (std::size_t n = 0; n < kTerms; ++n) {
        upper[n] += weight * basis[n];
        for (std::size_t m = 0; m < kMaxCoefficients; ++m)
          products[n][m] += weight * basis[n] * basis[m];
      }
    }
  }
  HemisphereSums out;
  lighting::evaluate_basis(kMaxBands, {0, 1, 0}, basis);
  for (int l = 0; l < LiftedGround::kBands; ++l)
    for (int m = -l; m <= l; ++m) {
      const auto n = static_cast<std::size_t>(sh_index(l, m));
      out.lower[n] = static_cast<float>((n == 0 ? std::sqrt(4 * kPi) : 0) - upper[n]);
      out.open[n] = static_cast<float>(lighting::cosine_coefficient(l) / kPi * basis[n]);
      for (std::size_t k = 0; k < kMaxCoefficients; ++k)
        out.products[n][k] = static_cast<float>(products[n][k]);
    }
  return out;
}

const HemisphereSums& hemisphere() {
  static const HemisphereSums kSums = hemisphere_sums();
  return kSums;
}

const prt::RayPatterns& patterns(bool still) {
  static const prt::RayPatterns kMoving(LiftedGround::kRays), kStill(LiftedGround::kStillRays);
  return still ? kStill : kMoving;
}

Rgb product(const std::array<float, kTerms>& transfer, const RadianceSh& light) {
  Rgb sum;
  for (int n = 0; n < std::min(kTerms, light.size()); ++n)
    sum += light[n] * transfer[static_cast<std::size_t>(n)];
  return sum;
}

// Middle of a point's cell, x and z on the grid's plane.
glm::vec2 place_of(const prt::GroundGrid& grid, std::size_t point, glm::vec2 within = {.5f, .5f}) {
  const glm::vec2 cell(point % LiftedGround::kSize, point / LiftedGround::kSize);
  return grid.position((cell + within) / static_cast<float>(LiftedGround::kSize));
}

}  // namespace

struct LiftedGround::Look {
  const prt::RayWorld& things;
  int object;
  const prt::BakedObject& baked;
  const prt::RayPatterns& patterns;
  glm::mat3 world_turn, bake_turn;  // from the floor's frame
  glm::vec3 world_shift;
  glm::vec3 centre;  // of the object, floor's frame
  float radius;
  std::array<glm::vec3, kPlaces> places;  // floor's frame
};

namespace {

constexpr float kBox = .5f;  // of the object's

glm::vec3 corner_of(const prt::Bounds& object, std::size_t place) {
  const glm::vec3 side(place & 1 ? 1 : -1, place & 2 ? 1 : -1, place & 4 ? 1 : -1);
  return object.centre() + kBox * .5f * side * (object.high - object.low);
}

}  // namespace

std::array<float, LiftedGround::kPlaces> LiftedGround::weights(const prt::Bounds& object,
                                                               const glm::vec3& vertex) {
  const glm::vec3 low = corner_of(object, 0),
                  size = glm::max(corner_of(object, kPlaces - 1) - low, 1e-30f),
                  at = glm::clamp((vertex - low) / size, 0.f, 1.f);
  std::array<float, kPlaces> out{};
  for (std::size_t k = 0; k < kPlaces; ++k)
    out[k] = (k & 1 ? at.x : 1 - at.x) * (k & 2 ? at.y : 1 - at.y) * (k & 4 ? at.z : 1 - at.z);
  return out;
}

bool LiftedGround::look(const prt::RayWorld& things, int object, const prt::BakedObject& baked,
                        const Pose& world_from_bake, const Pose& world_from_floor) {
  constexpr double kSame = 1e-9;
  const Pose now = world_from_floor.inverse() * world_from_bake;
  const bool same = floor_from_bake_ &&
                    glm::length(now.translation - floor_from_bake_->translation) < kSame &&
                    std::abs(glm::dot(now.rotation, floor_from_bake_->rotation)) > 1 - kSame;
  if (same && still_) return false;
  floor_from_bake_ = now;
  still_ = same;
  const prt::Bounds bounds = prt::bounds_of(baked.mesh);
  const glm::vec3 middle = bounds.centre();
  Look in{things,
          object,
          baked,
          patterns(still_),
          world_from_floor.rotation_matrix(),
          glm::transpose(now.rotation_matrix()),
          world_from_floor.translation,
          now * glm::dvec3(middle),
          prt::radius_around(baked.mesh, middle),
          {}};
  for (std::size_t k = 0; k < kPlaces; ++k) in.places[k] = now * glm::dvec3(corner_of(bounds, k));
  points_.resize(kPoints);
  parallel_for(std::size_t{0}, points_.size(), [&](std::size_t p) {
    look_from(in, p);
    see(in, p);
  });
  return true;
}

// Rays from a point of the floor: into the cone that the object fills, near it into all of the
// hemisphere by the cosine.
void LiftedGround::look_from(const Look& in, std::size_t index) {
  FloorPoint& point = points_[index];
  point.blocked = {};
  point.hits.clear();
  const prt::GroundGrid& grid = in.baked.receiver->grid;
  const glm::vec2 at = place_of(grid, index);
  const glm::vec3 from(at.x, grid.height + prt::kRayNear * in.radius, at.y), to = in.centre - from;
  const float distance = glm::length(to) / in.radius;
  const bool cone = distance > prt::kConeFrom;
  const float cos_half = cone ? std::sqrt(1 - 1 / (distance * distance)) : 0;
  const glm::mat3 frame = prt::frame_around(cone ? glm::normalize(to) : glm::vec3(0, 1, 0));
  const auto count = static_cast<float>(in.patterns.rays());
  const glm::vec3 origin = in.world_turn * from + in.world_shift;
  prt::RayScene::RayPacket towards;
  prt::RayWorld::Rays rays;
  std::fill_n(rays.ox, kLanes, origin.x);
  std::fill_n(rays.oy, kLanes, origin.y);
  std::fill_n(rays.oz, kLanes, origin.z);
  alignas(64) float basis[kTerms * kLanes];
  const prt::RayPatterns::Turn turn = prt::RayPatterns::turn_of(index);
  for (int block = 0; block < in.patterns.rays() / kLanes; ++block) {
    if (cone)
      in.patterns.cone_block(turn, block, frame, cos_half, towards);
    else
      in.patterns.cosine_block(turn, block, frame, towards);
    for (int i = 0; i < kLanes; ++i) {
      const glm::vec3 d = in.world_turn * glm::vec3(towards.x[i], towards.y[i], towards.z[i]);
      rays.dx[i] = d.x, rays.dy[i] = d.y, rays.dz[i] = d.z;
    }
    prt::RayWorld::Hits met;
    in.things.intersect(in.object, rays, met);
    if (std::ranges::all_of(met.mesh, [](int mesh) { return mesh < 0; })) continue;
    lighting::evaluate_basis_block(kBands, towards.x, towards.y, towards.z, basis);
    for (int i = 0; i < kLanes; ++i) {
      if (met.mesh[i] < 0) continue;
      const float weight =
          cone ? 2 * (1 - cos_half) / count * std::max(0.f, towards.y[i]) : 1 / count;
      for (std::size_t n = 0; n < kTerms; ++n)
        point.blocked[n] += weight * basis[n * kLanes + static_cast<std::size_t>(i)];
      const std::uint32_t vertex =
          prt::nearest_corner(in.baked.mesh, met.triangle[i], met.u[i], met.v[i]);
      const glm::vec3 d = in.bake_turn * glm::vec3(towards.x[i], towards.y[i], towards.z[i]);
      if (glm::dot(d, in.baked.mesh.normals[vertex]) < 0) point.hits.push_back({vertex, weight});
    }
  }
}

// The floor's cell as each of the object's places sees it.
void LiftedGround::see(const Look& in, std::size_t index) {
  const prt::GroundGrid& grid = in.baked.receiver->grid;
  const glm::vec2 at = place_of(grid, index), low = place_of(grid, index, {0, 0}),
                  high = place_of(grid, index, {1, 1});
  double basis[kTerms];
  for (std::size_t k = 0; k < kPlaces; ++k) {
    glm::vec3 to = glm::vec3(at.x, grid.height, at.y) - in.places[k];
    to.y = std::min(to.y, -kLowest * in.radius);
    const float distance = glm::length(to), angle = (high.x - low.x) * (high.y - low.y) * -to.y /
                                                    (distance * distance * distance);
    lighting::evaluate_basis(kBands, glm::dvec3(to / distance), basis);
    for (std::size_t n = 0; n < kTerms; ++n)
      points_[index].seen[k][n] = angle * static_cast<float>(basis[n]);
  }
}

RadianceSh LiftedGround::from_above(const RadianceSh& light) {
  RadianceSh out(kBands);
  const auto& products = hemisphere().products;
  for (std::size_t n = 0; n < kTerms; ++n)
    for (int m = 0; m < light.size(); ++m)
      out[static_cast<int>(n)] += light[m] * products[n][static_cast<std::size_t>(m)];
  return out;
}

// Diffuse: its radiance is albedo times irradiance/pi.
std::array<RadianceSh, LiftedGround::kPlaces> LiftedGround::from_floor(const RadianceSh& light,
                                                                       const Rgb& albedo) const {
  RadianceSh whole(kBands);
  const Rgb open = albedo * product(hemisphere().open, light);
  for (std::size_t n = 0; n < kTerms; ++n)
    whole[static_cast<int>(n)] = open * hemisphere().lower[n];
  std::array<RadianceSh, kPlaces> out;
  out.fill(whole);
  for (const FloorPoint& p : points_) {
    const Rgb lost = albedo * product(p.blocked, light) * -1.f;
    for (std::size_t k = 0; k < kPlaces; ++k)
      for (std::size_t n = 0; n < kTerms; ++n) out[k][static_cast<int>(n)] += lost * p.seen[k][n];
  }
  return out;
}

void LiftedGround::taken(const RadianceSh& light, std::span<const float> relit,
                         const prt::Mesh& mesh, int size, std::span<float> out) const {
  std::vector<Rgb> of_points(points_.size());
  const std::size_t vertices = relit.size() / 3;
  parallel_for(std::size_t{0}, points_.size(), [&](std::size_t p) {
    Rgb sum = product(points_[p].blocked, light);
    for (const LiftedHit& hit : points_[p].hits)
      sum +=
          mesh.albedo[hit.vertex] *
          Rgb{relit[hit.vertex], relit[vertices + hit.vertex], relit[2 * vertices + hit.vertex]} *
          -hit.weight;
    of_points[p] = sum;
  });
  const std::size_t stride = out.size() / 3;
  parallel_for(0, size, [&](int y) {
    const auto in_points = [size](int texel) {
      return std::clamp((static_cast<float>(texel) + .5f) * kSize / static_cast<float>(size) - .5f,
                        0.f, static_cast<float>(kSize - 1));
    };
    for (int x = 0; x < size; ++x) {
      const float fx = in_points(x), fy = in_points(y);
      const int i = std::min(static_cast<int>(fx), kSize - 2),
                j = std::min(static_cast<int>(fy), kSize - 2);
      const float u = fx - static_cast<float>(i), v = fy - static_cast<float>(j);
      const auto at = [&](int column, int row) {
        return of_points[static_cast<std::size_t>(row * kSize + column)];
      };
      const Rgb here = (at(i, j) * (1 - u) + at(i + 1, j) * u) * (1 - v) +
                       (at(i, j + 1) * (1 - u) + at(i + 1, j + 1) * u) * v;
      for (std::size_t c = 0; c < 3; ++c)
        out[c * stride + static_cast<std::size_t>(y * size + x)] = here[static_cast<int>(c)];
    }
  });
}

}  // namespace penumbra::runtime
