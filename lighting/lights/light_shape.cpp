#include "lighting/lights/internal/light_shape.h"

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <bit>
#include <glm/geometric.hpp>

namespace penumbra::lighting {

namespace {

glm::dvec3 longest_axis(std::span<const EnergyPiece> pieces, const glm::dvec3& mean) {
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const EnergyPiece& s : pieces) {
    const glm::dvec3 d = s.direction - mean;
    const Eigen::Vector3d v(d.x, d.y, d.z);
    spread += s.weight * v * v.transpose();
  }
  const Eigen::Vector3d axis =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>().computeDirect(spread).eigenvectors().col(2);
  return {axis.x(), axis.y(), axis.z()};
}

// Puts those of the lower half of the weight first and returns how many they are: not none, not
// all. By halving the number again and again, of which each part is looked at once: sorting takes
// three times as long.
std::size_t halve(std::span<EnergyPiece> pieces, double weight) {
  std::size_t first = 0, last = pieces.size();
  double before = 0;  // weight of those ahead of `first`
  while (first < last) {
    const std::size_t middle = first + (last - first) / 2;
    const auto at = [&](std::size_t i) { return pieces.begin() + static_cast<std::ptrdiff_t>(i); };
    std::ranges::nth_element(at(first), at(middle), at(last), {}, &EnergyPiece::along);
    double below = 0;
    for (std::size_t i = first; i < middle; ++i) below += pieces[i].weight;
    if (before + below + .5 * pieces[middle].weight < .5 * weight) {
      before += below + pieces[middle].weight;
      first = middle + 1;
    } else {
      last = middle;
    }
  }
  return std::clamp<std::size_t>(first, 1, pieces.size() - 1);
}

void add_points(std::span<EnergyPiece> pieces, int depth, DistantLight::Shape& out) {
  double weight = 0;
  glm::dvec3 mean(0);
  for (const EnergyPiece& s : pieces) weight += s.weight, mean += s.weight * s.direction;
  mean = mean / weight;
  if (depth == 0 || pieces.size() < 2) {
    for (int i = 0; i < 1 << depth; ++i) out.push_back(glm::normalize(mean));
    return;
  }
  const glm::dvec3 axis = longest_axis(pieces, mean);
  for (EnergyPiece& s : pieces) s.along = glm::dot(axis, s.direction);
  const std::size_t lower = halve(pieces, weight);
  add_points(pieces.first(lower), depth - 1, out);
  add_points(pieces.subspan(lower), depth - 1, out);
}

}  // namespace

DistantLight::Shape shape_points(std::span<EnergyPiece> pieces) {
  constexpr int kDepth = std::countr_zero(static_cast<unsigned>(DistantLight::kShapePoints));
  static_assert(1 << kDepth == DistantLight::kShapePoints);
  DistantLight::Shape out;
  add_points(pieces, kDepth, out);
  return out;
}

}  // namespace penumbra::lighting
