#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "capture/frames.h"
#include "capture/studio/environments.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

namespace {

using glm::dvec3;

constexpr dvec3 kRoomLow(-3.4, -.8, -3.0),
    kRoomHigh(3.6, 2.1, 3.2);  // metres from the capture point

bool inside(double a, double a0, double a1, double b, double b0, double b1) {
  return a > a0 && a < a1 && b > b0 && b < b1;
}

// Light falls off towards corners and edges; a stand-in for interreflection that looks right.
float corner_shade(const dvec3& p) {
  double shade = 1;
  for (int k = 0; k < 3; ++k) {
    const double d = std::min(p[k] - kRoomLow[k], kRoomHigh[k] - p[k]);
    if (d > 1e-6) shade *= 1 - .35 * std::exp(-d / .35);
  }
  return static_cast<float>(shade);
}

Rgb ceiling(const dvec3& p) {
  for (const double x : {-1.5, 1.3})
    if (inside(p.x, x - .6, x + .6, p.z, -.9, .9)) return {46, 44, 40};
  return {.82f, .81f, .79f};
}

Rgb window_wall(const dvec3& p) {  // z low: the window looks out in front
  if (inside(p.x, -1.9, .9, p.y, .0, 1.7)) {
    const double bar = std::min({std::abs(p.x + 1.9), std::abs(p.x + .5), std::abs(p.x - .9),
                                 std::abs(p.y), std::abs(p.y - .95), std::abs(p.y - 1.7)});
    if (bar < .035) return {.5f, .49f, .47f};
    const auto height = static_cast<float>(p.y / 1.7);
    if (p.y < .33 + .12 * std::sin(3.1 * p.x) + .05 * std::sin(11 * p.x))
      return {2.2f, 2.9f, 1.5f};  // trees
    return Rgb{8, 10, 13.5f} * (.75f + .35f * height);
  }
  return {.78f, .76f, .72f};
}

Rgb side_wall(const dvec3& p, bool left) {
  const Rgb paint = left ? Rgb{.74f, .46f, .33f} : Rgb{.63f, .67f, .66f};
  if (left) {  // two pictures
    for (const double z : {-1.3, .6})
      if (inside(p.z, z - .42, z + .42, p.y, .35, 1.2)) {
        const bool frame = !inside(p.z, z - .37, z + .37, p.y, .4, 1.15);
        return frame ? Rgb{.09f, .07f, .06f}
                     : Rgb{.35f + .25f * float(std::sin(9 * p.z)), .4f,
                           .3f + .3f * float(std::cos(7 * p.y))};
      }
  } else if (inside(p.z, -1.6, .9, p.y, kRoomLow.y, 1.3)) {  // shelf with books
    const double cell = std::fmod(p.y - kRoomLow.y, .43);
    if (cell < .04 || std::abs(std::fmod(p.z + 1.6, .85)) < .03) return {.42f, .30f, .2f};
    const double book = std::floor(p.z * 21);
    const auto hue = static_cast<float>(
        std::abs(std::sin(book * 12.9898 + std::floor((p.y - kRoomLow.y) / .43) * 78.233)));
    return cell < .34
               ? Rgb{.12f + .4f * hue, .14f + .25f * (1 - hue), .16f + .2f * std::abs(.5f - hue)}
               : Rgb{.06f, .05f, .05f};
  }
  return paint;
}

Rgb room(const dvec3& d) {
  // A floor lamp's shade on the right before the wall.
  const dvec3 lamp(2.3, .75, -2.2);
  if (glm::dot(d, glm::normalize(lamp)) > std::cos(.19 / glm::length(lamp))) return {62, 44, 24};
  double t = 1e9;
  int axis = 0;
  for (int k = 0; k < 3; ++k) {
    if (d[k] == 0) continue;
    const double s = (d[k] > 0 ? kRoomHigh[k] : kRoomLow[k]) / d[k];
    if (s < t) t = s, axis = k;
  }
  const dvec3 p = d * t;
  Rgb colour;
  if (axis == 1) {
    colour = d.y > 0 ? ceiling(p) : Rgb{.46f, .35f, .25f};
  } else if (axis == 2 && d.z < 0) {
    colour = window_wall(p);
  } else if (axis == 2) {
    colour =
        inside(p.x, -.5, .5, p.y, kRoomLow.y, 1.3) ? Rgb{.36f, .25f, .17f} : Rgb{.78f, .76f, .72f};
  } else {
    colour = side_wall(p, d.x < 0);
  }
  if (axis != 1 && p.y < kRoomLow.y + .09) colour = {.82f, .81f, .79f};  // skirting board
  // Painted surfaces as bright as the room's own lamps and window would make them.
  constexpr float kLitBy = 2.6f;
  return luminance(colour) > 2 ? colour : colour * (kLitBy * corner_shade(p));
}

template <class Radiance>
Image<Rgb> paint(int width, int height, int samples, Radiance radiance) {
  Image<Rgb> map(width, height);
  parallel_for(0, height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      Rgb sum;
      for (int j = 0; j < samples; ++j)
        for (int i = 0; i < samples; ++i)
          sum += radiance(
              latlong_direction(x + (i + .5) / samples, y + (j + .5) / samples, width, height));
      map.at(x, y) = sum * (1.f / static_cast<float>(samples * samples));
    }
  });
  return map;
}

}  // namespace

Image<Rgb> make_room_environment(int width, int height) {
  return paint(width, height, 2, room);
}

Image<Rgb> make_sky_environment(int width, int height, double sun_elevation_rad) {
  constexpr double kSunRadius = .2666 * kPi / 180;
  const dvec3 sun =
      glm::normalize(dvec3(.55 * std::cos(sun_elevation_rad), std::sin(sun_elevation_rad),
                           -.83 * std::cos(sun_elevation_rad)));
  Image<Rgb> map = paint(width, height, 2, [&](const dvec3& d) {
    if (d.y < 0) return Rgb{.16f, .15f, .13f};
    const auto gamma = static_cast<float>(std::max(0., glm::dot(d, sun)));
    const auto low = static_cast<float>(std::pow(1 - d.y, 3));
    return Rgb{.11f, .21f, .46f} + Rgb{.35f, .33f, .26f} * low +
           Rgb{.5f, .45f, .35f} * std::pow(gamma, 60.f);
  });
  // Points of equal area on the light, each giving its energy to the pixel that it falls on: the
  // energy does not depend on the grid.
  constexpr int kPoints = 20000;
  const Rgb radiance{46000, 43000, 38000};
  const double cap = 1 - std::cos(kSunRadius);
  const dvec3 side = glm::normalize(glm::cross(sun, dvec3(0, 1, .1))), up = glm::cross(side, sun);
  for (int i = 0; i < kPoints; ++i) {
    const double c = 1 - cap * (i + .5) / kPoints, s = std::sqrt(1 - c * c),
                 a = i * 2.39996322972865332;
    const glm::dvec2 p =
        latlong_pixel(c * sun + s * (std::cos(a) * side + std::sin(a) * up), width, height);
    const int x = std::min(static_cast<int>(p.x), width - 1),
              y = std::min(static_cast<int>(p.y), height - 1);
    const double fraction = 2 * kPi * cap / kPoints / latlong_solid_angle(y, width, height);
    map.at(x, y) += radiance * static_cast<float>(fraction);
  }
  return map;
}

namespace {

// A source of one radiance: a light, or a rectangle on the sphere's tangent plane.
struct Source {
  dvec3 axis, side, up;
  double half_width, half_height;  // tangents of the half angles
  bool round;
  Rgb radiance;

  bool covers(const dvec3& d) const {
    const double z = glm::dot(d, axis);
    if (z <= 0) return false;
    const double x = glm::dot(d, side) / z / half_width, y = glm::dot(d, up) / z / half_height;
    return round ? x * x + y * y < 1 : std::abs(x) < 1 && std::abs(y) < 1;
  }
};

}  // namespace

Image<Rgb> make_random_environment(int width, int height, std::uint32_t seed) {
  std::mt19937 rng(seed);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * (static_cast<double>(rng()) / 4294967296.);
  };
  const auto tint = [&](double strength) {
    return Rgb{static_cast<float>(1 + strength * uniform(-1, 1)), 1,
               static_cast<float>(1 + strength * uniform(-1, 1))};
  };
  const Rgb above = tint(.3), horizon = tint(.2) * static_cast<float>(uniform(.4, 1.5)),
            below = tint(.2) * static_cast<float>(uniform(.1, .5));
  std::vector<Source> sources;
  const int count = static_cast<int>(uniform(0, 5));
  for (int i = 0; i < count; ++i) {
    const double y = uniform(.05, 1), a = uniform(-kPi, kPi), r = std::sqrt(1 - y * y);
    Source s;
    s.axis = {r * std::sin(a), y, -r * std::cos(a)};
    s.side =
        glm::normalize(glm::cross(s.axis, std::abs(y) < .95 ? dvec3(0, 1, 0) : dvec3(1, 0, 0)));
    s.up = glm::cross(s.side, s.axis);
    s.half_width = std::tan(std::exp(uniform(std::log(.006), std::log(.5))));
    s.round = uniform(0, 1) < .5;
    s.half_height = s.round ? s.half_width : s.half_width * uniform(.3, 1.5);
    // Its light on a surface that faces it, against that of an even sky: from a glimmer to a sun.
    const double fraction = std::exp(uniform(std::log(.05), std::log(5.)));
    const double solid_angle = (s.round ? kPi : 4) * s.half_width * s.half_height;
    s.radiance = tint(.25) * static_cast<float>(fraction * kPi / solid_angle);
    sources.push_back(s);
  }
  return paint(width, height, 2, [&](const dvec3& d) {
    for (const Source& s : sources)
      if (s.covers(d)) return s.radiance;
    if (d.y < 0) return below;
    const auto t = static_cast<float>(std::sqrt(d.y));
    return above * t + horizon * (1 - t);
  });
}

}  // namespace penumbra::capture
