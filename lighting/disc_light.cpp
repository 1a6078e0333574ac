// What a disc sends: in harmonics, and to a surface.
#include <algorithm>
#include <cmath>

#include "lighting/basis.h"
#include "lighting/disc.h"
#include "lighting/irradiance.h"


namespace penumbra::lighting {

double Disc::solid_angle_sr() const {
  return 4 * kPi * std::pow(std::sin(.5 * radius.value()), 2);
}

Rgb Disc::irradiance() const {
  return radiance * static_cast<float>(kPi * std::pow(std::sin(radius.value()), 2));
}

namespace {

// Points of equal solid angle over the disc: f(direction, solid angle of the point).
template <class F>
void over_disc(const Disc& disc, F f) {
  for (const glm::dvec3& d : disc.shape)
    f(d, disc.solid_angle_sr() / static_cast<double>(disc.shape.size()));
  if (!disc.shape.empty()) return;
  constexpr int kPoints = 256;
  const glm::dvec3 axis = disc.direction,
                   side = glm::normalize(glm::cross(
                       axis, std::abs(axis.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0))),
                   up = glm::cross(side, axis);
  const double height = 2 * std::pow(std::sin(.5 * disc.radius.value()), 2);
  for (int k = 0; k < kPoints; ++k) {
    const double c = 1 - height * (k + .5) / kPoints, s = std::sqrt(1 - c * c),
                 a = k * 2.399963229728653;
    f(c * axis + s * (std::cos(a) * side + std::sin(a) * up), 2 * kPi * height / kPoints);
  }
}

// A round disc is a zonal function.
RadianceSh project_round(const Disc& disc, int bands) {
  RadianceSh out(bands);
  double basis[kMaxCoefficients];
  evaluate_basis(bands, disc.direction, basis);
  const double c = std::cos(disc.radius.value());
  double before = 1, here = c;  // P_{l-1}, P_l at l = 1
  for (int l = 0; l < bands; ++l) {
    double zonal = std::sqrt(kPi) * 2 * std::pow(std::sin(.5 * disc.radius.value()), 2);
    if (l > 0) {
      const double after = ((2 * l + 1) * c * here - l * before) / (l + 1);
      zonal = std::sqrt(kPi / (2 * l + 1)) * (before - after);
      before = here, here = after;
    }
    const double k = zonal * std::sqrt(4 * kPi / (2 * l + 1));
    for (int m = -l; m <= l; ++m) {
      const int n = sh_index(l, m);
      out[n] = disc.radiance * static_cast<float>(k * basis[n]);
    }
  }
  return out;
}

RadianceSh project_points(const Disc& disc, int bands, bool above) {
  double sum[kMaxCoefficients] = {}, basis[kMaxCoefficients];
  over_disc(disc, [&](const glm::dvec3& d, double solid_angle) {
    if (above && d.y <= 0) return;
    evaluate_basis(bands, d, basis);
    for (int n = 0; n < coefficient_count(bands); ++n) sum[n] += solid_angle * basis[n];
  });
  RadianceSh out(bands);
  for (int n = 0; n < out.size(); ++n) out[n] = disc.radiance * static_cast<float>(sum[n]);
  return out;
}

// In front of a surface with that normal, all of it.
bool is_in_front(const Disc& disc, const glm::dvec3& normal) {
  return disc.shape.empty() && disc.radius.value() < kPi / 2 &&
         glm::dot(disc.direction, normal) >= std::sin(disc.radius.value());
}

}  // namespace

RadianceSh project_disc(const Disc& disc, int bands) {
  return disc.shape.empty() ? project_round(disc, bands) : project_points(disc, bands, false);
}

RadianceSh project_disc_above(const Disc& disc, int bands) {
  return is_in_front(disc, {0, 1, 0}) ? project_round(disc, bands)
                                      : project_points(disc, bands, true);
}

Rgb irradiance(const Disc& disc, const glm::dvec3& normal) {
  if (is_in_front(disc, normal))
    return disc.irradiance() * static_cast<float>(glm::dot(disc.direction, normal));
  double sum = 0;
  over_disc(disc, [&](const glm::dvec3& d, double solid_angle) {
    sum += solid_angle * std::max(0., glm::dot(d, normal));
  });
  return disc.radiance * static_cast<float>(sum);
}

}  // namespace penumbra::lighting
