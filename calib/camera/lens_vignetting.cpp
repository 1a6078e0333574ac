#include "calib/camera/lens_vignetting.h"

#include <algorithm>
#include <glm/geometric.hpp>
#include <ranges>

namespace penumbra::calib {

Vignetting vignetting_of(const CameraModel& camera, const std::array<double, 3>& terms) {
  const glm::dvec2 size(camera.width, camera.height);
  return {terms, has_intrinsics(camera.kind) ? camera.principal_px : size / 2.,
          glm::length(size) / 2};
}

namespace {

// Fractions from the middle out to the farthest corner.
auto fractions_of(const Vignetting& v, const CameraModel& camera) {
  constexpr int kSteps = 64;
  const glm::dvec2 size(camera.width, camera.height);
  const glm::dvec2 farthest = glm::max(v.centre_px, size - v.centre_px);
  return std::views::iota(0, kSteps + 1) | std::views::transform([&v, farthest](int i) {
           return v.at(v.centre_px + farthest * (double(i) / kSteps));
         });
}

}  // namespace

bool is_plausible(const Vignetting& v, const CameraModel& camera) {
  return std::ranges::all_of(fractions_of(v, camera),
                             [](double left) { return left >= .02 && left <= 1.5; });
}

double min_fraction(const Vignetting& v, const CameraModel& camera) {
  return v.none() ? 1 : std::ranges::min(fractions_of(v, camera));
}

}  // namespace penumbra::calib
