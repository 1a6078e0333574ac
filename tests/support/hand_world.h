// A hand over a textured table, as a view camera and a depth camera see it, and the truth.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "calib/camera/camera_model.h"
#include "capture/studio/studio.h"
#include "core/image.h"
#include "core/pose.h"

namespace penumbra::test {

/// A rod with round ends.
struct Rod {
  glm::dvec3 from, to;
  double radius = 0;
};

struct HandHit {
  double distance = 0;  // along a unit direction
  glm::dvec3 normal{0, 0, 0};
};

/// source: closest points of a ray and a segment, then a sphere or a cylinder there
inline std::optional<HandHit> hit(const Rod& rod, const glm::dvec3& eye,
                                  const glm::dvec3& direction) {
  const glm::dvec3 along = rod.to - rod.from, from = eye - rod.from;
  const double aa = glm::dot(along, along), ad = glm::dot(along, direction),
               af = glm::dot(along, from);
  const double a = aa - ad * ad, b = aa * glm::dot(from, direction) - af * ad,
               c = aa * glm::dot(from, from) - af * af - rod.radius * rod.radius * aa;
  const auto ball = [&](const glm::dvec3& centre) -> std::optional<HandHit> {
    const glm::dvec3 o = eye - centre;
    const double half = glm::dot(o, direction),
                 disc = half * half - glm::dot(o, o) + rod.radius * rod.radius;
    if (disc < 0) return std::nullopt;
    const double t = -half - std::sqrt(disc);
    if (t <= 0) return std::nullopt;
    return HandHit{t, glm::normalize(eye + t * direction - centre)};
  };
  const double disc = b * b - a * c;
  if (disc < 0) return std::nullopt;
  const double t = (-b - std::sqrt(disc)) / a, y = af + t * ad;
  if (y > 0 && y < aa && t > 0) {
    const glm::dvec3 at = eye + t * direction;
    return HandHit{t, glm::normalize(at - (rod.from + along * (y / aa)))};
  }
  return ball(y <= 0 ? rod.from : rod.to);
}

struct HandWorld {
  std::vector<Rod> rods;
  Rgb skin{.45f, .27f, .19f};
  float texture = .25f;  // of the floor, as a fraction of its albedo
  Rgb floor{.3f, .31f, .33f};
  bool wall = false;  // close behind the middle of the table, and no plane of the scene

  /// A forearm, a palm and four fingers over the middle of the table, as seen from view().
  static HandWorld usual() {
    HandWorld out;
    const glm::dvec3 wrist(.12, .42, .30), palm(.05, .40, .27);
    out.rods.push_back({{.42, .50, .40}, wrist, .032});
    out.rods.push_back({wrist, palm, .036});
    for (int i = 0; i < 4; ++i) {
      const double side = (i - 1.5) * .021;
      out.rods.push_back(
          {palm + glm::dvec3(-.01, .3 * side, side),
           palm + glm::dvec3(-.105 + std::abs(i - 1.2) * .012, .1 * side, 1.6 * side), .0095});
    }
    return out;
  }
  static Pose view() { return capture::look_at({.05, .75, .75}, {0, .1, 0}); }

  std::optional<HandHit> hand(const glm::dvec3& eye, const glm::dvec3& direction) const {
    std::optional<HandHit> nearest;
    for (const Rod& rod : rods)
      if (const auto h = hit(rod, eye, direction);
          h && (!nearest || h->distance < nearest->distance))
        nearest = h;
    return nearest;
  }
  /// Where the wall is nearer than the floor.
  std::optional<double> wall_at(const glm::dvec3& eye, const glm::dvec3& direction) const {
    constexpr double kWallZ = -.45;
    if (!wall || direction.z >= 0) return std::nullopt;
    const double t = (kWallZ - eye.z) / direction.z;
    return eye.y + t * direction.y > 0 ? std::optional(t) : std::nullopt;
  }
  /// Distance to the hand, the wall or the floor; nothing for the sky.
  std::optional<double> distance(const glm::dvec3& eye, const glm::dvec3& direction) const {
    if (const auto h = hand(eye, direction)) return h->distance;
    if (const auto w = wall_at(eye, direction)) return w;
    if (direction.y < 0) return eye.y / -direction.y;
    return std::nullopt;
  }
  Rgb floor_radiance(const glm::dvec3& p) const {
    const double waves =
                     std::sin(31 * p.x + 3 * std::sin(17 * p.z)) * std::sin(27 * p.z + 11 * p.x),
                 fine = std::sin(160 * p.x) * std::sin(140 * p.z + 40 * p.x);
    return floor * static_cast<float>(1 + double(texture) * (.7 * waves + .3 * fine));
  }
  Rgb radiance(const glm::dvec3& eye, const glm::dvec3& direction) const {
    if (const auto h = hand(eye, direction)) return lit(*h);
    return behind(eye, direction);
  }
  Rgb lit(const HandHit& h) const {
    const glm::dvec3 light = glm::normalize(glm::dvec3(.4, 1, .5));
    return skin * static_cast<float>(.45 + .55 * std::max(0., glm::dot(h.normal, light)));
  }
  Rgb behind(const glm::dvec3& eye, const glm::dvec3& direction) const {
    if (wall_at(eye, direction)) return {.35f, .34f, .3f};
    if (direction.y < 0) return floor_radiance(eye + direction * (eye.y / -direction.y));
    return {.5f, .55f, .6f};
  }
};

/// What a view camera sees, and the fraction of each pixel that the hand covers.
struct HandPicture {
  Image<Rgb> signal;
  Image<float> cover;
};

inline HandPicture film(const HandWorld& world, const calib::CameraModel& camera,
                        const Pose& world_from_camera, int samples = 4) {
  HandPicture out{Image<Rgb>(camera.width, camera.height),
                  Image<float>(camera.width, camera.height)};
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      Rgb sum;
      int hits = 0;
      for (int k = 0; k < samples * samples; ++k) {
        const auto ray = calib::direction_from_pixel(
            camera, {x + (k % samples + .5) / samples, y + (k / samples + .5) / samples});
        if (!ray) continue;
        const glm::dvec3 direction = world_from_camera.rotation * glm::normalize(*ray);
        const auto h = world.hand(world_from_camera.translation, direction);
        hits += h.has_value();
        sum += h ? world.lit(*h) : world.behind(world_from_camera.translation, direction);
      }
      out.signal.at(x, y) = sum * (1.f / static_cast<float>(samples * samples));
      out.cover.at(x, y) = static_cast<float>(hits) / static_cast<float>(samples * samples);
    }
  return out;
}

/// How a depth camera errs: as the structured light and stereo cameras that people own.
/// source: Nguyen, Izadi & Lovell 2012 (lateral noise of a pixel, axial growing with the square)
struct DepthErrors {
  double axial_m = .0012;  // standard deviation at one metre; grows with the square
  double lateral_px = .9;  // standard deviation of where a pixel looks
  double holes = .02;      // of all pixels
  double shadow_px = 4;    // no depth beside the left edge of near things
  double flying = .3;      // of pixels on an edge: the mean of both depths
};

/// In millimetres.
inline Image<Rgb16> film_depth(const HandWorld& world, const calib::CameraModel& camera,
                               const Pose& world_from_camera, const DepthErrors& errors,
                               std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const auto depth_at = [&](double x, double y) -> double {
    const auto ray = calib::direction_from_pixel(camera, {x, y});
    if (!ray) return 0;
    const glm::dvec3 unit = glm::normalize(*ray);
    const auto d = world.distance(world_from_camera.translation, world_from_camera.rotation * unit);
    return d ? *d * -unit.z : 0;
  };
  Image<Rgb16> out(camera.width, camera.height, Rgb16{});
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const double u = x + .5 + errors.lateral_px * normal(random),
                   v = y + .5 + errors.lateral_px * normal(random);
      double z = depth_at(u, v);
      const double left = depth_at(x + .5 - 1, y + .5), right = depth_at(x + .5 + 1, y + .5),
                   beside = depth_at(x + .5 + errors.shadow_px, y + .5);
      // Between two surfaces, not between one and the rim.
      const bool is_edge = left > 0 && right > 0 && std::abs(left - right) > .1;
      if (uniform(random) < errors.flying && is_edge) z = .5 * (left + right);
      z += errors.axial_m * z * z * normal(random);
      const bool in_shadow = errors.shadow_px > 0 && beside > 0 && beside < .8 * z;
      if (uniform(random) < errors.holes || in_shadow) z = 0;
      const auto code = static_cast<std::uint16_t>(std::clamp(1000 * z + .5, 0., 65535.));
      out.at(x, y) = {code, code, code};
    }
  return out;
}

}  // namespace penumbra::test
