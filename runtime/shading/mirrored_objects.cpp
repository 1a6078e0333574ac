#include "runtime/shading/mirrored_objects.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "core/threads/stage_times.h"
#include "lighting/reflections/ggx.h"
#include "lighting/reflections/octahedral_map.h"
#include "lighting/reflections/reflection_map.h"
#include "prt/geometry/receiver.h"

namespace penumbra::runtime {

namespace {

// As half precision holds it, with room for a factor.
constexpr float kBrightest = 60'000;

Rgb mirrored_towards(const lighting::ReflectionMap& map, const glm::vec3& direction, float alpha) {
  const float place = map.place_of(std::sqrt(alpha));
  const auto i = std::min(static_cast<std::size_t>(place), map.levels.size() - 1);
  const float t = place - static_cast<float>(i);
  const Rgb one = lighting::sample_octahedral(map.levels[i].picture, direction);
  if (t < .01f || i + 1 == map.levels.size()) return one;
  return one * (1 - t) + lighting::sample_octahedral(map.levels[i + 1].picture, direction) * t;
}

// Of values of vertices.
template <class Values>
float at_place(const MetPlace& p, const Values& values) {
  return (1 - p.u - p.v) * values(p.corners[0]) + p.u * values(p.corners[1]) +
         p.v * values(p.corners[2]);
}

Rgb light_at(const MetPlace& place, const MirroredObjects::LightOnObjects& light) {
  const std::span<const float> relit = light.relit[place.object];
  const std::size_t stride = relit.size() / 3;
  Rgb out;
  for (int c = 0; c < 3; ++c) {
    const auto plane = relit.subspan(static_cast<std::size_t>(c) * stride, stride);
    out[c] = at_place(place, [&](std::uint32_t v) { return plane[v]; });
  }
  return place.weight * out;
}

Rgb within(const Rgb& c, float largest) {
  const auto one = [&](float v) { return std::clamp(v, 0.f, largest); };
  return {one(c.r), one(c.g), one(c.b)};
}

// Texels that no ray told of get the mean of their neighbours: the pixels at the contour ask them.
void fill_beside(Image<Rgb>& light, Image<Rgb>& open, Image<std::uint8_t>& known) {
  constexpr int kTimes = 2;
  for (int time = 0; time < kTimes; ++time) {
    const Image<std::uint8_t> before = known;
    for (int y = 0; y < light.height(); ++y)
      for (int x = 0; x < light.width(); ++x) {
        if (before.at(x, y)) continue;
        Rgb sum, sum_open;
        float count = 0;
        for (int v = std::max(y - 1, 0); v <= std::min(y + 1, light.height() - 1); ++v)
          for (int u = std::max(x - 1, 0); u <= std::min(x + 1, light.width() - 1); ++u)
            if (before.at(u, v)) sum += light.at(u, v), sum_open += open.at(u, v), ++count;
        if (count == 0) continue;
        light.at(x, y) = sum * (1 / count), open.at(x, y) = sum_open * (1 / count);
        known.at(x, y) = 1;
      }
  }
}

}  // namespace

Result<MirroredObjects> MirroredObjects::create(const PreparedScene& scene, bool wanted) {
  MirroredObjects out(scene);
  if (!wanted) return out;
  for (std::size_t i = 0; i < scene.objects.size(); ++i)
    if (const int samples = mirror_samples_of(scene.objects[i].baked); samples > 0)
      out.mirroring_.push_back({.object = i, .least_samples = samples, .samples = samples});
  if (!out.any()) return out;
  PENUMBRA_ASSIGN(rays, MirrorRays::create(scene));
  out.rays_ = std::move(rays);
  return out;
}

void MirroredObjects::begin(const std::vector<int>& handles,
                            compositor::Compositor& compositor) const {
  compositor::MirroredPicture nothing;
  nothing.light = Image<Rgb>(1, 1);
  nothing.open = Image<Rgb>(1, 1, {1, 1, 1});
  for (const MirroredByObject& o : mirroring_) compositor.set_mirrored(handles[o.object], nothing);
}

void MirroredObjects::update_vertices(std::size_t object) {
  if (!any()) return;
  rays_->update_vertices(object);
  for (CameraView& view : views_) view.traced.reset();
}

// What comes from the surroundings, less what the floor lacks of them.
Rgb MirroredObjects::surroundings_from(const glm::vec3& at, const glm::vec3& towards, float alpha,
                                       const MirrorLighting& l) const {
  const Rgb all = mirrored_towards(*l.light.surroundings.reflections, towards, alpha);
  const auto& receiver = scene_->objects[l.o.object].baked.receiver;
  if (!l.floor || !receiver) return all;
  const prt::GroundGrid& grid = receiver->grid;
  const glm::vec3 from = l.floor_from_world * glm::vec4(at, 1),
                  d = glm::mat3(l.floor_from_world) * towards;
  if (d.y > -.01f || from.y < grid.height) return all;
  const float far = (from.y - grid.height) / -d.y;
  const glm::vec2 uv = grid.uv({from.x + far * d.x, from.z + far * d.z});
  if (!(uv.x >= 0 && uv.x < 1 && uv.y >= 0 && uv.y < 1)) return all;
  return all * l.floor->at(static_cast<int>(uv.x * static_cast<float>(l.floor->width())),
                           static_cast<int>(uv.y * static_cast<float>(l.floor->height())));
}

// Along the last ray: the surroundings, and the lights apart as one direction before a lobe that is
// wider by them.
Rgb MirroredObjects::end_of(const MirrorChain& chain, const MirrorLighting& l) const {
  Rgb out = surroundings_from(chain.end_at, chain.end_towards, chain.end_alpha, l);
  const auto& lights = l.light.surroundings.lights;
  const MetPlace& last = chain.place[static_cast<std::size_t>(chain.places - 1)];
  const auto& fractions = l.light.fractions[last.object];
  for (std::size_t k = 0; k < std::min(lights.size(), compositor::Surroundings::kMaxLights); ++k) {
    const float cosine = glm::dot(chain.end_towards, glm::vec3(lights[k].direction));
    if (cosine <= 0) continue;
    const float seen =
        fractions.empty() ? 1 : at_place(last, [&](std::uint32_t v) { return fractions[v][k]; });
    const auto sine = static_cast<float>(std::sin(std::min(lights[k].radius_rad, kPi / 2)));
    const float alpha = std::hypot(chain.end_alpha, .5f * sine);
    // A facet turns what it mirrors by twice its angle: a quarter of its density.
    out += lights[k].irradiance *
           (.25f * seen * lighting::ggx_density(alpha, std::sqrt(.5f + .5f * cosine)));
  }
  return out;
}

Rgb MirroredObjects::light_along(const MirrorChain& chain, const MirrorLighting& l) const {
  Rgb sum = chain.emitted * l.light.surroundings.emission_unit;
  for (int k = 0; k < chain.places; ++k)
    sum += light_at(chain.place[static_cast<std::size_t>(k)], l.light);
  if (luminance(chain.end_weight) > 0) sum += chain.end_weight * end_of(chain, l);
  return sum;
}

void MirroredObjects::light_row(const MirrorLighting& l, int y, compositor::MirroredPicture& out,
                                Image<std::uint8_t>& known) const {
  const MirrorRow& row = l.o.rows[static_cast<std::size_t>(y)];
  for (const MirrorChain& chain : row.chains)
    out.light.at(static_cast<int>(chain.column), y) += light_along(chain, l);
  for (int x = 0; x < out.light.width(); ++x) {
    const auto i = static_cast<std::size_t>(x);
    if (row.weights[i] <= 0) continue;
    out.light.at(x, y) = within(out.light.at(x, y) * (1 / row.weights[i]), kBrightest);
    const float open = row.open[i] / row.weights[i];
    out.open.at(x, y) = within({open, open, open}, 1);
    known.at(x, y) = 1;
  }
  // Where a lobe is open in part it matters which: the ray to a window or those beside it.
  for (std::size_t i = 0; i < row.samples.size();) {
    const std::uint32_t column = row.samples[i].column;
    Rgb all, seen;
    for (; i < row.samples.size() && row.samples[i].column == column; ++i) {
      const MirrorSample& s = row.samples[i];
      const Rgb from = s.weight * surroundings_from(s.at, s.towards, s.alpha, l);
      all += from;
      if (s.open) seen += from;
    }
    Rgb& open = out.open.at(static_cast<int>(column), y);
    for (int c = 0; c < 3; ++c)
      if (all[c] > 0) open[c] = std::min(seen[c] / all[c], 1.f);
  }
}

compositor::MirroredPicture MirroredObjects::picture_of(const MirrorLighting& l) const {
  compositor::MirroredPicture out;
  const int width = l.o.columns, height = static_cast<int>(l.o.rows.size());
  out.x0 = l.o.x0, out.y0 = l.o.y0, out.step = l.o.step;
  out.light = Image<Rgb>(width, height);
  out.open = Image<Rgb>(width, height, {1, 1, 1});
  Image<std::uint8_t> known(width, height);
  parallel_for(0, height, [&](int y) { light_row(l, y, out, known); });
  fill_beside(out.light, out.open, known);
  return out;
}

bool MirroredObjects::TracedFor::shows(const ViewOfObjects& seen) const {
  return camera == seen.view.camera && lens == seen.view.lens.get() &&
         std::ranges::equal(poses, seen.poses) && std::ranges::equal(visible, seen.visible);
}

void MirroredObjects::trace(CameraView& view, const ViewOfObjects& seen) {
  constexpr double kTarget_ms = 7;
  constexpr int kPasses = 1 << 10;  // that differ
  const Stopwatch watch;
  rays_->set_poses(seen.poses);
  const auto shown = std::ranges::count_if(
      view.objects, [&](const MirroredByObject& o) { return seen.visible[o.object] != 0; });
  const double share = max_rays_ / static_cast<double>(std::max<std::ptrdiff_t>(1, shown));
  for (MirroredByObject& o : view.objects) {
    o.pass = next_pass_;
    rays_->trace(o, seen, share);
  }
  if (next_pass_) next_pass_ = (*next_pass_ + 1) % kPasses;
  view.traced = {seen.view.camera,
                 seen.view.lens.get(),
                 {seen.poses.begin(), seen.poses.end()},
                 {seen.visible.begin(), seen.visible.end()}};
  if (keeps_time_)
    max_rays_ = std::clamp(max_rays_ * std::clamp(kTarget_ms / watch.ms(), .7, 1.1), kMinRays,
                           kMaxLiveRays);
}

void MirroredObjects::update(std::size_t camera, const ViewOfObjects& seen,
                             const LightOnObjects& light, bool relit,
                             const std::vector<int>& handles, compositor::Compositor& compositor) {
  if (!any() || !light.surroundings.reflections) return;
  if (relit) ++light_;
  if (views_.size() <= camera) views_.resize(camera + 1, {mirroring_});
  CameraView& view = views_[camera];
  const bool same = view.traced && view.traced->shows(seen);
  if (same && view.light == light_ && shown_camera_ == camera) return;
  if (!same) trace(view, seen);
  for (const MirroredByObject& o : view.objects) {
    if (o.rows.empty()) continue;  // not in the picture
    const int handle = handles[o.object];
    compositor.set_mirrored(handle,
                            picture_of({o, light, compositor.mirrored_floor(handle),
                                        glm::mat4(seen.floors[o.object].inverse().matrix())}));
  }
  view.light = light_;
  shown_camera_ = camera;
}

}  // namespace penumbra::runtime
