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
constexpr double kFade = .2;  // of what the map reaches beyond the light
constexpr std::size_t kStrideAtVertices = 4;

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

// The points of a luminous surface; each receiver asks every `stride`-th of them.
class EmitterFace {
 public:
  EmitterFace(const Emitter& emitter, float near, std::size_t stride)
      : emitter_(emitter), near_(near), stride_(std::min(stride, emitter.positions.size())) {}

  template <class Answer>
  void add(Packets<Answer>& packets, std::size_t index, const glm::vec3& from,
           const glm::vec3& normal) const {
    const std::size_t points = emitter_.positions.size(), first = index % stride_,
                      asked = (points - first + stride_ - 1) / stride_;
    const float point_m2 =
        emitter_.point_m2 * static_cast<float>(points) / static_cast<float>(asked);
    for (std::size_t k = first; k < points; k += stride_) {
      const glm::vec3 way = emitter_.positions[k] - from;
      const float length = std::max(glm::length(way), 1e-6f);
      const glm::vec3 d = way / length;
      const float cosine = glm::dot(normal, d), along = -glm::dot(emitter_.normals[k], d),
                  sent = emitter_.double_sided ? std::abs(along) : along;
      const float far = length - 2 * near_;  // short of the surface itself
      if (cosine <= 0 || sent <= 0 || far <= 0) continue;
      const float apart = length * length + point_m2 / static_cast<float>(kPi);
      packets.add(index, cosine * sent / (apart * static_cast<float>(asked)), from, d, far);
    }
  }

 private:
  const Emitter& emitter_;
  float near_;
  std::size_t stride_;
};

// at(i) gives position and normal of point i.
template <class Face, class At>
void trace(const RayOccluders& occluders, std::size_t count, const Face& face, At at,
           std::span<float> out) {
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

template <class Face>
void trace_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                  std::span<const glm::vec3> normals, const Face& face, std::span<float> out) {
  trace(
      occluders, positions.size(), face,
      [&](std::size_t i) { return Point(positions[i], normals[i]); }, out);
}

template <class Face>
void trace_vertices(const RayOccluders& occluders, const prt::Mesh& mesh,
                    const Pose& world_from_mesh, const Face& face, std::span<float> out) {
  const glm::mat3 turn(world_from_mesh.rotation_matrix());
  const glm::vec3 shift(world_from_mesh.translation);
  trace(
      occluders, mesh.positions.size(), face,
      [&](std::size_t i) {
        return Point(turn * mesh.positions[i] + shift, turn * mesh.normals[i]);
      },
      out);
}

// The square below `centre` that reaches `half` metres, `inner` of them below the light itself;
// faded to 0 at its rim, and 0..1.
template <class Face>
float trace_map(const RayOccluders& occluders, const prt::Plane& plane, const glm::dvec3& centre,
                double half, double inner, const Face& face, ShadowMap& out) {
  const double height = glm::dot(centre - plane.point, plane.normal);
  const glm::dquat frame = glm::rotation(glm::dvec3(0, 1, 0), plane.normal);
  const double cell = 2 * half / (kMapNodes - 1);
  out.cell_m = static_cast<float>(cell);
  out.world_from_map =
      Pose{frame, centre - height * plane.normal} * Pose{{1, 0, 0, 0}, {-half, 0, -half}};
  out.virtual_occlusion.reset(kMapNodes, kMapNodes);
  const glm::vec3 normal(plane.normal), origin(out.world_from_map.translation),
      x = glm::vec3(frame * glm::dvec3(cell, 0, 0)), z = glm::vec3(frame * glm::dvec3(0, 0, cell));
  trace(
      occluders, out.virtual_occlusion.area(), face,
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
  const auto fade = static_cast<float>(kFade * (1 - inner / half));
  for (int j = 0; j < kMapNodes; ++j)
    for (int i = 0; i < kMapNodes; ++i) {
      const float r = std::hypot(static_cast<float>(i) - kMiddle, static_cast<float>(j) - kMiddle) /
                      kMiddle,
                  t = std::clamp((1 - r) / fade, 0.f, 1.f);
      out.virtual_occlusion.at(i, j) *= t * t * (3 - 2 * t) / largest;
    }
  return largest;
}

void clear(ShadowMap& map) {
  map.virtual_occlusion.reset(0, 0);
  map.real_occlusion.reset(0, 0);
}

// Of a surface's points: their middle, and how far up the highest lies.
struct EmitterPlace {
  glm::dvec3 centre{0};
  double top = 0, radius = 0;  // metres; above the plane, about the centre
};
EmitterPlace place_of(const Emitter& emitter, const prt::Plane& plane) {
  EmitterPlace out;
  const auto count = static_cast<double>(emitter.positions.size());
  for (const glm::vec3& p : emitter.positions) {
    out.centre += glm::dvec3(p) / count;
    out.top = std::max(out.top, glm::dot(glm::dvec3(p) - plane.point, plane.normal));
  }
  for (const glm::vec3& p : emitter.positions)
    out.radius = std::max(out.radius, glm::distance(glm::dvec3(p), out.centre));
  return out;
}

}  // namespace

void trace_lamp_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                       std::span<const glm::vec3> normals, const Lamp& lamp, int samples,
                       std::span<float> out) {
  trace_points(occluders, positions, normals, LampFace(lamp, samples), out);
}

void trace_lamp_light(const RayOccluders& occluders, const prt::Mesh& mesh,
                      const Pose& world_from_mesh, const Lamp& lamp, int samples,
                      std::span<float> out) {
  trace_vertices(occluders, mesh, world_from_mesh, LampFace(lamp, samples), out);
}

float trace_lamp_map(const RayOccluders& occluders, const prt::Plane& plane, const Lamp& lamp,
                     int samples, ShadowMap& out) {
  clear(out);
  const double height = glm::dot(lamp.position - plane.point, plane.normal);
  if (!(height > lamp.radius_m)) return 0;
  return trace_map(occluders, plane, lamp.position, kReach * height, 0, LampFace(lamp, samples),
                   out);
}

void trace_emitter_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                          std::span<const glm::vec3> normals, const Emitter& emitter,
                          std::span<float> out) {
  trace_points(occluders, positions, normals, EmitterFace(emitter, occluders.near_m, 1), out);
}

void trace_emitter_light(const RayOccluders& occluders, const prt::Mesh& mesh,
                         const Pose& world_from_mesh, const Emitter& emitter,
                         std::span<float> out) {
  trace_vertices(occluders, mesh, world_from_mesh,
                 EmitterFace(emitter, occluders.near_m, kStrideAtVertices), out);
}

float trace_emitter_map(const RayOccluders& occluders, const prt::Plane& plane,
                        const Emitter& emitter, ShadowMap& out) {
  clear(out);
  const EmitterPlace place = place_of(emitter, plane);
  if (!(place.top > 0)) return 0;
  return trace_map(occluders, plane, place.centre, kReach * place.top + place.radius, place.radius,
                   EmitterFace(emitter, occluders.near_m, 1), out);
}

}  // namespace penumbra::shadows
