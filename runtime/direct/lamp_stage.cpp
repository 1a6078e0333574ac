#include "runtime/direct/lamp_stage.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>

#include "core/conventions.h"
#include "prt/geometry/mesh.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::runtime {

namespace {

constexpr int kVertexSamples = 4, kMapSamples = 8;
constexpr float kVisible = .005f;  // change of what an emission of 1 sends

shadows::Emitter emitter_of(const prt::LuminousPart& part, const prt::Mesh& mesh,
                            const Pose& world_from_mesh) {
  const glm::mat3 turn(world_from_mesh.rotation_matrix());
  const glm::vec3 shift(world_from_mesh.translation);
  shadows::Emitter out{{}, {}, part.point_m2, part.double_sided};
  for (const prt::TrianglePlace& place : part.points) {
    const glm::vec3 &a = mesh.positions[place.corners[0]], &b = mesh.positions[place.corners[1]],
                    &c = mesh.positions[place.corners[2]];
    const glm::vec3 across = glm::cross(b - a, c - a);
    const float length = glm::length(across);
    out.positions.push_back(turn * (a + place.u * (b - a) + place.v * (c - a)) + shift);
    out.normals.push_back(length > 0 ? turn * (across / length) : glm::vec3(0));
  }
  return out;
}

}  // namespace

LampStage::LampStage(const PreparedScene& scene)
    : scene_(&scene), visible_(scene.objects.size(), 1) {
  for (const shadows::Lamp& lamp : scene.lamps) traced_.push_back({&lamp, 0, nullptr});
  for (std::size_t i = 0; i < scene.objects.size(); ++i)
    for (const prt::LuminousPart& part : scene.objects[i].luminous)
      traced_.push_back({nullptr, i, &part}), luminous_ = true;
}

// What the traced fractions are times to be an irradiance.
Rgb LampStage::power(const TracedLamp& t) const {
  return t.lamp ? t.lamp->irradiance_at_1m : t.part->emission_m2 * emission_unit_;
}

void LampStage::trace(const shadows::RayOccluders& occluders, TracedLamp& t) const {
  std::optional<shadows::Emitter> emitter;
  if (t.part && !visible_[t.object]) {
    t.on_object.assign(poses_.size(), {});
    t.on_plane.assign(scene_->planes.size(), {});
    t.on_real.clear();
    return;
  }
  if (t.part) emitter = emitter_of(*t.part, scene_->objects[t.object].baked.mesh, poses_[t.object]);
  t.on_object.resize(poses_.size());
  for (std::size_t i = 0; i < poses_.size(); ++i) {
    const prt::Mesh& mesh = scene_->objects[i].baked.mesh;
    t.on_object[i].resize(mesh.positions.size());
    if (emitter)
      shadows::trace_emitter_light(occluders, mesh, poses_[i], *emitter, t.on_object[i]);
    else
      shadows::trace_lamp_light(occluders, mesh, poses_[i], *t.lamp, kVertexSamples,
                                t.on_object[i]);
  }
  t.on_plane.resize(scene_->planes.size());
  t.brightest.resize(scene_->planes.size());
  for (std::size_t p = 0; p < scene_->planes.size(); ++p) {
    const prt::Plane& plane = scene_->planes[p];
    t.brightest[p] =
        emitter ? shadows::trace_emitter_map(occluders, plane, *emitter, t.on_plane[p])
                : shadows::trace_lamp_map(occluders, plane, *t.lamp, kMapSamples, t.on_plane[p]);
  }
  const prt::Mesh& real = scene_->real_mesh;
  t.on_real.resize(real.positions.size());
  if (emitter)
    shadows::trace_emitter_points(occluders, real.positions, real.normals, *emitter, t.on_real);
  else
    shadows::trace_lamp_points(occluders, real.positions, real.normals, *t.lamp, kVertexSamples,
                               t.on_real);
}

void LampStage::sum_on_real_mesh() {
  on_real_mesh_.assign(scene_->real_mesh.positions.size(), Rgb{});
  for (const TracedLamp& t : traced_) {
    const Rgb all = power(t);
    for (std::size_t i = 0; i < t.on_real.size(); ++i) on_real_mesh_[i] += all * t.on_real[i];
  }
}

bool LampStage::update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
                       bool other_form, float emission_unit) {
  if (!any()) return false;
  const bool moved = !known_ || other_form || !std::ranges::equal(poses, poses_),
             brighter = luminous_ && std::abs(emission_unit - emission_unit_) >
                                         kVisible * std::max(emission_unit, emission_unit_);
  if (!moved && !brighter) return false;
  known_ = true;
  poses_.assign(poses.begin(), poses.end());
  if (brighter) emission_unit_ = emission_unit;
  if (moved)
    for (TracedLamp& t : traced_) trace(occluders, t);
  sum_on_real_mesh();
  return true;
}

void LampStage::add_light(std::size_t object, std::span<float> relit) const {
  const std::size_t stride = relit.size() / 3;
  for (const TracedLamp& t : traced_) {
    const std::vector<float>& fraction = t.on_object[object];
    const Rgb scale = power(t) * static_cast<float>(1 / kPi);
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t v = 0; v < fraction.size(); ++v)
        relit[c * stride + v] += scale[static_cast<int>(c)] * fraction[v];
  }
}

void LampStage::append(std::span<const Rgb> open_irradiance,
                       std::vector<compositor::ShadowMapOnPlane>& out) const {
  for (const TracedLamp& t : traced_)
    for (std::size_t p = 0; p < t.on_plane.size(); ++p) {
      if (t.on_plane[p].empty()) continue;
      const Rgb e = power(t) * t.brightest[p];
      Rgb fraction;
      for (int c = 0; c < 3; ++c)
        fraction[c] = open_irradiance[p][c] > 0 ? -e[c] / open_irradiance[p][c] : 0;
      out.push_back({&t.on_plane[p], fraction});
    }
}

}  // namespace penumbra::runtime
