// A camera before a sphere on a floor: what compositor tests look at.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <glm/gtc/quaternion.hpp>
#include <initializer_list>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "compositor/composite/compositor.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"
#include "tests/support/lights.h"

namespace penumbra::test {

inline constexpr int kSceneWidth = 160, kSceneHeight = 120;

inline Pose looking_at(const glm::dvec3& eye, const glm::dvec3& target) {
  const glm::dvec3 back = glm::normalize(eye - target),
                   right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back));
  return {glm::normalize(glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back))), eye};
}

inline prt::PinholeView scene_camera(const glm::dvec3& eye = {.3, 1.3, 2.6},
                                     const glm::dvec3& target = {0, .3, 0}) {
  return {kSceneWidth, kSceneHeight, {150, 150}, {80.5, 59.25}, looking_at(eye, target)};
}

inline prt::BakedObject baked_sphere(bool with_receiver, Rgb albedo = {1, 1, 1},
                                     float centre_height = .4f) {
  const prt::Mesh mesh = prt::make_sphere({0, centre_height, 0}, .4f, 3, albedo);
  prt::BakeOptions options;
  options.bands = 3;
  options.bounces = 0;
  options.rays = 64;
  options.ground_rays = 256;
  if (with_receiver) options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 64), {0, 0, 0}};
  auto object = prt::bake(mesh, options);
  EXPECT_TRUE(object);
  return object ? std::move(*object) : prt::BakedObject{};
}

/// An object relit and its shadow, ready for a compositor.
struct Lit {
  std::vector<float> relit;
  shadows::PlanarShadow shadow;
};
inline Lit lit(const prt::BakedObject& object, const RadianceSh& light) {
  Lit out{std::vector<float>(3 * object.transfer.stride), {}};
  prt::relight(object.transfer, light, out.relit);
  if (object.receiver) {
    EXPECT_TRUE(shadows::compose_planar_shadow(object, light, out.shadow));
  }
  return out;
}

inline int add_lit(compositor::Compositor& c, const prt::BakedObject& object,
                   const RadianceSh& light, const Pose& pose = {}) {
  const int handle = c.add_object(object);
  c.set_pose(handle, pose);
  const Lit l = lit(object, light);
  c.set_light(handle, l.relit, l.shadow);
  return handle;
}

/// Vertical rectangles beside each other at z, that face the camera, with corners of their own.
inline prt::Mesh walls(float z, std::initializer_list<std::pair<float, float>> sides) {
  prt::Mesh m;
  for (const auto& [left, right] : sides) {
    const auto first = static_cast<std::uint32_t>(m.positions.size());
    m.positions.insert(m.positions.end(),
                       {{left, -5, z}, {right, -5, z}, {right, 5, z}, {left, 5, z}});
    m.triangles.push_back({first, first + 1, first + 2});
    m.triangles.push_back({first, first + 2, first + 3});
  }
  m.normals.assign(m.positions.size(), {0, 0, 1});
  m.albedo.assign(m.positions.size(), {.5f, .5f, .5f});
  return m;
}

/// Unit direction through a continuous pixel, world frame.
inline glm::dvec3 pixel_ray(const prt::PinholeView& v, double px, double py) {
  return glm::normalize(v.world_from_camera.rotation *
                        glm::dvec3((px - v.principal_px.x) / v.focal_px.x,
                                   -(py - v.principal_px.y) / v.focal_px.y, -1));
}

/// Where a ray from the camera meets the floor y = 0.
inline std::optional<glm::dvec2> floor_hit(const prt::PinholeView& v, double px, double py) {
  const glm::dvec3 o = v.world_from_camera.translation, d = pixel_ray(v, px, py);
  if (!(d.y * o.y < 0)) return std::nullopt;
  const glm::dvec3 p = o + d * (-o.y / d.y);
  return glm::dvec2(p.x, p.z);
}

inline double distance_to_ray(const prt::PinholeView& v, double px, double py,
                              const glm::dvec3& point) {
  const glm::dvec3 d = pixel_ray(v, px, py), to = point - v.world_from_camera.translation;
  const double along = std::max(0., glm::dot(to, d));
  return glm::length(to - along * d);
}

template <class Pixel>
Image<Pixel> noise_frame(unsigned seed, int width = kSceneWidth, int height = kSceneHeight) {
  std::mt19937 rng(seed);
  Image<Pixel> frame(width, height);
  for (Pixel& p : frame.pixels()) {
    using Code = decltype(p.r);
    const auto value = [&] {
      if constexpr (std::is_same_v<Code, float>)
        return static_cast<float>(rng()) * 0x1p-32f;
      else
        return static_cast<Code>(rng());
    };
    p.r = value(), p.g = value(), p.b = value();
  }
  return frame;
}

/// The sRGB curve of 8 or 16 bits.
inline ResponseTable srgb_curve(int bits, float black_level = 0) {
  const int last = (1 << bits) - 1;
  std::vector<float> decode;
  for (int code = 0; code <= last; ++code) {
    const double z = double(code) / last;
    decode.push_back(
        static_cast<float>(z <= .04045 ? z / 12.92 : std::pow((z + .055) / 1.055, 2.4)));
  }
  return ResponseTable({decode, decode, decode}, black_level);
}

}  // namespace penumbra::test
