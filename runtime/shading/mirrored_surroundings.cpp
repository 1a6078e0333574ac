#include "runtime/shading/mirrored_surroundings.h"

#include <algorithm>
#include <cstddef>

#include "lighting/estimate.h"
#include "runtime/direct/scene_light.h"

namespace penumbra::runtime {

MirroredSurroundings::MirroredSurroundings(const PreparedScene& scene)
    : scene_(scene), asked_(mirrored_roughness(scene)), fractions_(scene.objects.size()) {}

std::shared_ptr<const lighting::ReflectionMap> MirroredSurroundings::from_harmonics(
    const RadianceSh& light) {
  constexpr int kRows = 64;
  if (!own_filter_) own_filter_.emplace(asked_);
  const Image<Rgb> nothing(2 * kRows, kRows);
  const Image<float> unseen(2 * kRows, kRows);
  auto out = std::make_shared<lighting::ReflectionMap>();
  own_filter_->filter(nothing, unseen, light, *out);
  return out;
}

compositor::Surroundings MirroredSurroundings::surroundings_of(
    const lighting::LightEstimate& light) {
  compositor::Surroundings out;
  out.reflections = light.reflections ? light.reflections : from_harmonics(light.light);
  out.light = lighting::whole_light(light);
  for (const std::size_t i : lighting::lights_apart(light)) {
    const lighting::DistantLight& source = light.lights[i];
    out.lights.push_back({source.direction, source.radius.value(), source.irradiance()});
    const RadianceSh own = lighting::project_distant_light(source, out.light.bands());
    for (int n = 0; n < own.size(); ++n) out.light[n] += own[n] * -1.f;
  }
  out.emission_unit = emission_unit(light);
  return out;
}

bool MirroredSurroundings::is_shown(const lighting::LightEstimate& light) const {
  if (!shown_ || shown_->reflections != light.reflections ||
      shown_->lights.size() != light.lights.size() || !(shown_->light == light.light))
    return false;
  return std::ranges::equal(shown_->lights, light.lights, [](const auto& a, const auto& b) {
    return a.direction == b.direction && a.radiance == b.radiance;
  });
}

bool MirroredSurroundings::update(const lighting::LightEstimate& light,
                                  const DirectLightStage& lights, const std::vector<int>& handles,
                                  compositor::Compositor& compositor) {
  if (!any()) return false;
  const bool renewed = !is_shown(light);
  if (renewed) {
    now_ = surroundings_of(light);
    compositor.set_surroundings(now_);
    shown_ = light;
  }
  const std::vector<std::size_t> apart = lighting::lights_apart(light);
  if (apart.empty()) {
    if (renewed) std::ranges::fill(fractions_, std::vector<std::array<float, 4>>());
    return renewed;
  }
  bool changed = renewed;
  for (std::size_t o = 0; o < scene_.objects.size(); ++o) {
    if (!scene_.objects[o].baked.surface || !(renewed || lights.changed(o))) continue;
    const std::size_t vertices = scene_.objects[o].baked.mesh.positions.size();
    fractions_[o].assign(vertices, {1, 1, 1, 1});
    changed = true;
    one_.resize(vertices);
    for (std::size_t k = 0; k < apart.size(); ++k) {
      std::ranges::fill(one_, 1.f);
      lights.visible_fractions(apart[k], o, one_);
      for (std::size_t v = 0; v < vertices; ++v) fractions_[o][v][k] = one_[v];
    }
    compositor.set_light_fractions(handles[o], fractions_[o]);
  }
  return changed;
}

}  // namespace penumbra::runtime
