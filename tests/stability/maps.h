// Maps of known light for the stability suite, and what can be said about them without harmonics.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <vector>

#include "core/conventions.h"
#include "core/environment.h"
#include "lighting/lighting.h"

namespace penumbra::test {

inline constexpr double kDegree = kPi / 180;
inline constexpr double kSunRadius = .2666 * kDegree;
inline constexpr std::int64_t kMapNs = 33'333'333;  // thirty maps a second

template <class Radiance>
Image<Rgb> painted(int width, int height, Radiance radiance) {
  Image<Rgb> map(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      map.at(x, y) = radiance(latlong_direction(x + .5, y + .5, width, height));
  return map;
}

/// Blue above, grey below.
inline Image<Rgb> sky_over_ground(int width, int height, Rgb sky = {.2f, .35f, .7f},
                                  Rgb ground = {.16f, .15f, .13f}) {
  return painted(width, height, [&](const glm::dvec3& d) { return d.y > 0 ? sky : ground; });
}

inline glm::dvec3 direction_at(double azimuth_rad, double elevation_rad) {
  return {std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad),
          -std::cos(elevation_rad) * std::cos(azimuth_rad)};
}

inline double cap_sr(double radius_rad) {
  return 4 * kPi * std::pow(std::sin(.5 * radius_rad), 2);
}

/// What was added to a map, for a radiance of one.
struct Added {
  double solid_angle = 0;
  glm::dvec3 vector{0};  // integral of the direction: irradiance of a surface that faces all of it
};

/// Adds what `kept` lets through of an even light, every pixel by the fraction that is covered.
template <class Kept>
Added add_distant_light(Image<Rgb>& map, const glm::dvec3& centre, double radius_rad, Rgb radiance,
                        Kept kept) {
  constexpr int kSamples = 16;  // of a pixel, along each axis
  const int w = map.width(), h = map.height();
  const double polar = std::acos(std::clamp(centre.y, -1., 1.)),
               chord = 2 * std::sin(.5 * radius_rad);  // between the centre and the rim
  const int first = std::max(0, static_cast<int>((polar - radius_rad) / kPi * h)),
            last = std::min(h - 1, static_cast<int>((polar + radius_rad) / kPi * h));
  Added sum;
  for (int y = first; y <= last; ++y) {
    const double sine = std::sin(kPi * (y + .5) / h);
    const int across = std::clamp(static_cast<int>(kSamples * sine) + 1, 2, kSamples);
    for (int x = 0; x < w; ++x) {
      if (glm::length(latlong_direction(x + .5, y + .5, w, h) - centre) > chord + 1.5 * kPi / h)
        continue;
      int covered = 0;
      for (int j = 0; j < kSamples; ++j)
        for (int i = 0; i < across; ++i) {
          const glm::dvec3 d =
              latlong_direction(x + (i + .5) / across, y + (j + .5) / kSamples, w, h);
          covered += glm::length(d - centre) < chord && kept(d);
        }
      const double fraction = double(covered) / (across * kSamples);
      map.at(x, y) += radiance * static_cast<float>(fraction);
      const double part = fraction * latlong_solid_angle(y, w, h);
      sum.solid_angle += part;
      sum.vector += part * latlong_direction(x + .5, y + .5, w, h);
    }
  }
  return sum;
}
inline Added add_distant_light(Image<Rgb>& map, const glm::dvec3& centre, double radius_rad,
                               Rgb radiance) {
  return add_distant_light(map, centre, radius_rad, radiance,
                           [](const glm::dvec3&) { return true; });
}

/// Integral over the sphere, channel by channel.
inline glm::dvec3 energy(const Image<Rgb>& map) {
  glm::dvec3 sum(0);
  for (int y = 0; y < map.height(); ++y) {
    glm::dvec3 row(0);
    for (const Rgb& c : map.row(y)) row += glm::dvec3(c.r, c.g, c.b);
    sum += latlong_solid_angle(y, map.width(), map.height()) * row;
  }
  return sum;
}
inline glm::dvec3 energy(const lighting::DistantLight& d) {
  return d.solid_angle_sr() * glm::dvec3(d.radiance.r, d.radiance.g, d.radiance.b);
}

inline double luminance_of(const glm::dvec3& c) {
  return .2126 * c.x + .7152 * c.y + .0722 * c.z;
}

/// Irradiance of an open surface, from every pixel.
inline glm::dvec3 exact_irradiance(const Image<Rgb>& map, const glm::dvec3& normal) {
  glm::dvec3 sum(0);
  for (int y = 0; y < map.height(); ++y) {
    glm::dvec3 row(0);
    for (int x = 0; x < map.width(); ++x) {
      const double c =
          glm::dot(latlong_direction(x + .5, y + .5, map.width(), map.height()), normal);
      if (c > 0) row += c * glm::dvec3(map.at(x, y).r, map.at(x, y).g, map.at(x, y).b);
    }
    sum += latlong_solid_angle(y, map.width(), map.height()) * row;
  }
  return sum;
}

inline double angle_between(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
}

/// Mean over blocks, each pixel by its solid angle: what a smaller environment map holds.
inline Image<Rgb> reduced(const Image<Rgb>& map, int factor) {
  Image<Rgb> out(map.width() / factor, map.height() / factor);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      glm::dvec3 sum(0);
      double weight = 0;
      for (int j = 0; j < factor; ++j) {
        const int row = y * factor + j;
        const double w = latlong_solid_angle(row, map.width(), map.height());
        for (int i = 0; i < factor; ++i) {
          const Rgb& c = map.at(x * factor + i, row);
          sum += w * glm::dvec3(c.r, c.g, c.b);
          weight += w;
        }
      }
      sum = sum / weight;
      out.at(x, y) = {static_cast<float>(sum.x), static_cast<float>(sum.y),
                      static_cast<float>(sum.z)};
    }
  return out;
}

inline Environment environment_at(Image<Rgb> map, std::int64_t time_ns) {
  Environment e;
  e.radiance = std::move(map);
  e.time = TimestampNs{time_ns};
  return e;
}

}  // namespace penumbra::test
