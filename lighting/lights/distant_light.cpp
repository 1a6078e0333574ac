// What a light sends: in harmonics, and to a surface.
#include <algorithm>
#include <cmath>

#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"

namespace penumbra::lighting {

double DistantLight::solid_angle_sr() const {
  return 4 * kPi * std::pow(std::sin(.5 * radius.value()), 2);
}

Rgb DistantLight::irradiance() const {
  return radiance * static_cast<float>(kPi * std::pow(std::sin(radius.value()), 2));
}

namespace {

// Points of equal solid angle over the light: f(direction, solid angle of the point).
template <class F>
void over_light(const DistantLight& source, F f) {
  for (const glm::dvec3& d : source.shape)
    f(d, source.solid_angle_sr() / static_cast<double>(source.shape.size()));
  if (!source.shape.empty()) return;
  constexpr int kPoints = 256;
  const glm::dvec3 axis = source.direction,
                   side = glm::normalize(glm::cross(
                       axis, std::abs(axis.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0))),
                   up = glm::cross(side, axis);
  const double height = 2 * std::pow(std::sin(.5 * source.radius.value()), 2);
  for (int k = 0; k < kPoints; ++k) {
    const double c = 1 - height * (k + .5) / kPoints, s = std::sqrt(1 - c * c),
                 a = k * 2.399963229728653;
    f(c * axis + s * (std::cos(a) * side + std::sin(a) * up), 2 * kPi * height / kPoints);
  }
}

// A round light is a zonal function.
RadianceSh project_round(const DistantLight& source, int bands) {
  RadianceSh out(bands);
  double basis[kMaxCoefficients];
  evaluate_basis(bands, source.direction, basis);
  const double c = std::cos(source.radius.value());
  double before = 1, here = c;  // P_{l-1}, P_l at l = 1
  for (int l = 0; l < bands; ++l) {
    double zonal = std::sqrt(kPi) * 2 * std::pow(std::sin(.5 * source.radius.value()), 2);
    if (l > 0) {
      const double after = ((2 * l + 1) * c * here - l * before) / (l + 1);
      zonal = std::sqrt(kPi / (2 * l + 1)) * (before - after);
      before = here, here = after;
    }
    const double k = zonal * std::sqrt(4 * kPi / (2 * l + 1));
    for (int m = -l; m <= l; ++m) {
      const int n = sh_index(l, m);
      out[n] = source.radiance * static_cast<float>(k * basis[n]);
    }
  }
  return out;
}

RadianceSh project_points(const DistantLight& source, int bands, bool upper_moments) {
  double sum[kMaxCoefficients] = {}, basis[kMaxCoefficients];
  over_light(source, [&](const glm::dvec3& d, double solid_angle) {
    if (upper_moments && d.y <= 0) return;
    evaluate_basis(bands, d, basis);
    for (int n = 0; n < coefficient_count(bands); ++n) sum[n] += solid_angle * basis[n];
  });
  RadianceSh out(bands);
  for (int n = 0; n < out.size(); ++n) out[n] = source.radiance * static_cast<float>(sum[n]);
  return out;
}

// In front of a surface with that normal, all of it.
bool is_in_front(const DistantLight& source, const glm::dvec3& normal) {
  return source.shape.empty() && source.radius.value() < kPi / 2 &&
         glm::dot(source.direction, normal) >= std::sin(source.radius.value());
}

}  // namespace

RadianceSh project_distant_light(const DistantLight& source, int bands) {
  return source.shape.empty() ? project_round(source, bands) : project_points(source, bands, false);
}

RadianceSh project_upper_distant_light(const DistantLight& source, int bands) {
  return is_in_front(source, {0, 1, 0}) ? project_round(source, bands)
                                        : project_points(source, bands, true);
}

Rgb irradiance(const DistantLight& source, const glm::dvec3& normal) {
  if (is_in_front(source, normal))
    return source.irradiance() * static_cast<float>(glm::dot(source.direction, normal));
  double sum = 0;
  over_light(source, [&](const glm::dvec3& d, double solid_angle) {
    sum += solid_angle * std::max(0., glm::dot(d, normal));
  });
  return source.radiance * static_cast<float>(sum);
}

}  // namespace penumbra::lighting
