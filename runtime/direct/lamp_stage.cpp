#include "runtime/direct/lamp_stage.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "prt/geometry/mesh.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::runtime {

namespace {
constexpr int kVertexSamples = 4, kMapSamples = 8;
}

bool LampStage::update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
                       bool other_form) {
  if (!any() || (known_ && !other_form && std::ranges::equal(poses, poses_))) return false;
  known_ = true;
  poses_.assign(poses.begin(), poses.end());
  const prt::Mesh& real = scene_->real_mesh;
  on_real_mesh_.assign(real.positions.size(), Rgb{});
  std::vector<float> one(real.positions.size());
  for (std::size_t l = 0; l < traced_.size(); ++l) {
    const shadows::Lamp& lamp = scene_->lamps[l];
    TracedLamp& t = traced_[l];
    t.on_object.resize(poses.size());
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const prt::Mesh& mesh = scene_->objects[i].baked.mesh;
      t.on_object[i].resize(mesh.positions.size());
      shadows::trace_lamp_light(occluders, mesh, poses[i], lamp, kVertexSamples, t.on_object[i]);
    }
    t.on_plane.resize(scene_->planes.size());
    t.brightest.resize(scene_->planes.size());
    for (std::size_t p = 0; p < scene_->planes.size(); ++p)
      t.brightest[p] =
          shadows::trace_lamp_map(occluders, scene_->planes[p], lamp, kMapSamples, t.on_plane[p]);
    shadows::trace_lamp_points(occluders, real.positions, real.normals, lamp, kVertexSamples, one);
    for (std::size_t i = 0; i < one.size(); ++i) on_real_mesh_[i] += lamp.irradiance_at_1m * one[i];
  }
  return true;
}

void LampStage::add_light(std::size_t object, std::span<float> relit) const {
  const std::size_t stride = relit.size() / 3;
  for (std::size_t l = 0; l < traced_.size(); ++l) {
    const std::vector<float>& fraction = traced_[l].on_object[object];
    const Rgb scale = scene_->lamps[l].irradiance_at_1m * static_cast<float>(1 / kPi);
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t v = 0; v < fraction.size(); ++v)
        relit[c * stride + v] += scale[static_cast<int>(c)] * fraction[v];
  }
}

void LampStage::append(std::span<const Rgb> open_irradiance,
                       std::vector<compositor::ShadowMapOnPlane>& out) const {
  for (std::size_t l = 0; l < traced_.size(); ++l)
    for (std::size_t p = 0; p < traced_[l].on_plane.size(); ++p) {
      if (traced_[l].on_plane[p].empty()) continue;
      const Rgb e = scene_->lamps[l].irradiance_at_1m * traced_[l].brightest[p];
      Rgb fraction;
      for (int c = 0; c < 3; ++c)
        fraction[c] = open_irradiance[p][c] > 0 ? -e[c] / open_irradiance[p][c] : 0;
      out.push_back({&traced_[l].on_plane[p], fraction});
    }
}

}  // namespace penumbra::runtime
