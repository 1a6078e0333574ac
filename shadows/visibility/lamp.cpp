#include "shadows/visibility/lamp.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtx/quaternion.hpp>

#include "core/conventions.h"
#include "core/threads/background_task.h"
#include "core/threads/parallel.h"
#include "core/threads/scratch.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"

namespace penumbra::shadows {

namespace {

constexpr int kMapNodes = 129;
constexpr double kReach = 5;  // lamp heights
constexpr float kFade = .2f;  // of the half extent

// Points of the lamp's face as a surface point sees it: a light across the line of visibility.
class LampFace {
 public:
  LampFace(const Lamp& lamp, int samples)
      : centre_(lamp.position), radius_(static_cast<float>(lamp.radius_m)), samples_(samples) {
    for (int k = 0; k < samples; ++k) {
      const double r = std::sqrt((k + .5) / samples), a = k * 2.399963229728653;  // Vogel spiral
      offsets_[static_cast<std::size_t>(k)] = {r * std::cos(a), r * std::sin(a)};
    }
  }

  template <class Answer>
  void add(Packets<Answer>& packets, std::size_t index, const glm::vec3& from,
           const glm::vec3& normal) const {
    const glm::vec3 to = centre_ - from;
    const float apart = glm::length(to), distance = std::max({apart, radius_, 1e-6f});
    const glm::vec3 axis = apart > 1e-6f ? to / apart : normal;
    const glm::vec3 side = glm::normalize(
        glm::cross(axis, std::abs(axis.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0)));
    const glm::vec3 up = glm::cross(side, axis);
    for (int k = 0; k < samples_; ++k) {
      const glm::vec2& o = offsets_[static_cast<std::size_t>(k)];
      const glm::vec3 way = to + radius_ * (o.x * side + o.y * up);
      const float length = std::max(glm::length(way), 1e-6f);
      const glm::vec3 d = way / length;
      const float cosine = glm::dot(normal, d);
      if (cosine <= 0) continue;
      packets.add(index, cosine / (distance * distance * static_cast<float>(samples_)), from, d,
                  length);
    }
  }

 private:
  glm::vec3 centre_;
  float radius_;
  int samples_;
  std::array<glm::vec2, kMaxSamples> offsets_{};
};

// at(i) gives position and normal of point i.
template <class At>
void trace(const RayOccluders& occluders, std::size_t count, const Lamp& lamp, int samples, At at,
           std::span<float> out) {
  const LampFace face(lamp, samples);
  std::ranges::fill(out.first(count), 0.f);
  parallel_for(std::size_t{0}, count, 512, [&](const auto& part) {
    Packets packets(occluders, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
      if (!by_virtual && !by_real) out[i] += weight;
    });
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const auto [position, normal] = at(i);
      face.add(packets, i, position + occluders.near_m * normal, normal);
    }
  });
}

using Point = std::pair<glm::vec3, glm::vec3>;

}  // namespace

void trace_lamp_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                       std::span<const glm::vec3> normals, const Lamp& lamp, int samples,
                       std::span<float> out) {
  trace(
      occluders, positions.size(), lamp, samples,
      [&](std::size_t i) { return Point(positions[i], normals[i]); }, out);
}

void trace_lamp_light(const RayOccluders& occluders, const prt::Mesh& mesh,
                      const Pose& world_from_mesh, const Lamp& lamp, int samples,
                      std::span<float> out) {
  const glm::mat3 turn(world_from_mesh.rotation_matrix());
  const glm::vec3 shift(world_from_mesh.translation);
  trace(
      occluders, mesh.positions.size(), lamp, samples,
      [&](std::size_t i) {
        return Point(turn * mesh.positions[i] + shift, turn * mesh.normals[i]);
      },
      out);
}

float trace_lamp_map(const RayOccluders& occluders, const prt::Plane& plane, const Lamp& lamp,
                     int samples, ShadowMap& out) {
  out.virtual_occlusion.reset(0, 0);
  out.real_occlusion.reset(0, 0);
  const double height = glm::dot(lamp.position - plane.point, plane.normal);
  if (!(height > lamp.radius_m)) return 0;
  const glm::dquat frame = glm::rotation(glm::dvec3(0, 1, 0), plane.normal);
  const double half = kReach * height, cell = 2 * half / (kMapNodes - 1);
  out.cell_m = static_cast<float>(cell);
  out.world_from_map =
      Pose{frame, lamp.position - height * plane.normal} * Pose{{1, 0, 0, 0}, {-half, 0, -half}};
  out.virtual_occlusion.reset(kMapNodes, kMapNodes);
  const glm::vec3 normal(plane.normal), origin(out.world_from_map.translation),
      x = glm::vec3(frame * glm::dvec3(cell, 0, 0)), z = glm::vec3(frame * glm::dvec3(0, 0, cell));
  trace(
      occluders, out.virtual_occlusion.area(), lamp, samples,
      [&](std::size_t i) {
        return Point(
            origin + static_cast<float>(i % kMapNodes) * x + static_cast<float>(i / kMapNodes) * z,
            normal);
      },
      out.virtual_occlusion.pixels());
  const float largest = std::ranges::max(out.virtual_occlusion.pixels());
  if (!(largest > 0)) {
    out.virtual_occlusion.reset(0, 0);
    return 0;
  }
  constexpr float kMiddle = (kMapNodes - 1) / 2.f;
  for (int j = 0; j < kMapNodes; ++j)
    for (int i = 0; i < kMapNodes; ++i) {
      const float r = std::hypot(static_cast<float>(i) - kMiddle, static_cast<float>(j) - kMiddle) /
                      kMiddle,
                  t = std::clamp((1 - r) / kFade, 0.f, 1.f);
      out.virtual_occlusion.at(i, j) *= t * t * (3 - 2 * t) / largest;
    }
  return largest;
}

}  // namespace penumbra::shadows
