#include "service/disc_stage.h"

#include <algorithm>
#include <cmath>

namespace penumbra::service {

namespace {

// A disc is traced anew when it moved by a tenth of its radius and this much: half a millimetre of shadow from half a
// metre's height.
constexpr double kLeastMove = 1e-3;
constexpr double kVisibleShare = .005;

double angle_between(const glm::dvec3& a, const glm::dvec3& b) {
  return std::acos(std::clamp(glm::dot(a, b), -1., 1.));
}

// Largest move of the points of two forms; a form that came or went moved as far as can be.
double move_of(const std::vector<glm::dvec3>& before, const std::vector<glm::dvec3>& now) {
  if (before.size() != now.size()) return kPi;
  double largest = 0;
  for (std::size_t i = 0; i < now.size(); ++i)
    largest = std::max(largest, angle_between(before[i], now[i]));
  return largest;
}

}  // namespace

Result<DiscStage> DiscStage::create(const PreparedScene& scene, const DiscTaps& taps) {
  auto virtual_things = prt::RayWorld::create();
  if (!virtual_things) return std::unexpected(virtual_things.error());
  auto real_things = prt::RayWorld::create();
  if (!real_things) return std::unexpected(real_things.error());
  DiscStage stage(scene, taps, std::move(*virtual_things), std::move(*real_things));
  float smallest = 1e30f;
  for (const PreparedObject& o : scene.objects) {
    auto index = stage.virtual_.add(o.baked.mesh);
    if (!index) return fail(index.error().code, o.name, index.error().detail);
    stage.poses_.push_back(o.world_from_bake);
    stage.virtual_.set_pose(*index, o.world_from_bake);
    smallest =
        std::min(smallest, prt::radius_around(o.baked.mesh, prt::bounds_of(o.baked.mesh).centre()));
  }
  if (!scene.real_mesh.triangles.empty()) {
    auto index = stage.real_.add(scene.real_mesh);
    if (!index) return fail(index.error().code, "real geometry", index.error().detail);
  }
  if (!scene.objects.empty()) stage.near_m_ = 1e-4f * smallest;
  return stage;
}

void DiscStage::set_pose(std::size_t object, const Pose& world_from_bake) {
  if (poses_[object] == world_from_bake) return;
  poses_[object] = world_from_bake;
  virtual_.set_pose(static_cast<int>(object), world_from_bake);
  moved_ = true;
}

void DiscStage::trace(Traced& t) {
  t.direction = t.disc.direction;
  t.shape = t.disc.shape;
  t.radius = t.disc.radius.value();
  const shadows::Blockers blockers{&virtual_, &real_, near_m_};
  casters_.clear();
  t.cosine.resize(scene_->objects.size());
  for (std::size_t i = 0; i < scene_->objects.size(); ++i) {
    const PreparedObject& o = scene_->objects[i];
    casters_.push_back({&o.baked.mesh, poses_[i]});
    t.cosine[i].resize(o.baked.mesh.positions.size());
    const prt::Plane own{poses_[i].translation, poses_[i].rotation * glm::dvec3(0, 1, 0), {}, {}};
    shadows::trace_disc_light(blockers, o.baked.mesh, poses_[i], o.baked.receiver ? &own : nullptr,
                              t.disc, taps_.object, t.cosine[i]);
  }
  t.on_plane.resize(scene_->planes.size());
  for (std::size_t p = 0; p < scene_->planes.size(); ++p)
    shadows::trace_disc_shadow(blockers, casters_, scene_->planes[p], t.disc, taps_.plane,
                               t.on_plane[p]);
}

bool DiscStage::update(std::span<const lighting::Disc> discs, double mean_irradiance) {
  const bool poses_changed = std::exchange(moved_, false);
  std::swap(traced_, before_);
  traced_.clear();
  bool changed = false;
  for (const lighting::Disc& disc : discs) {
    const auto known =
        std::ranges::find(before_, disc.id, [](const Traced& t) { return t.disc.id; });
    Traced t = known == before_.end() ? Traced{} : std::move(*known);
    const double move =
        std::max(angle_between(t.direction, disc.direction), move_of(t.shape, disc.shape));
    const double change = std::abs(luminance(disc.irradiance()) - luminance(t.disc.irradiance()));
    changed |= known == before_.end() || change > kVisibleShare * mean_irradiance;
    const lighting::Disc before = t.disc;
    t.disc = disc;
    if (poses_changed || t.cosine.empty() || move > kLeastMove + .1 * disc.radius.value() ||
        std::abs(t.radius - disc.radius.value()) > .1 * disc.radius.value()) {
      trace(t);
      changed = true;
    } else if (change <= kVisibleShare * mean_irradiance) {
      t.disc.radiance = before.radiance;  // small changes add up until they are seen
      t.disc.radius = before.radius;
    }
    traced_.push_back(std::move(t));
  }
  changed |= traced_.size() != before_.size();
  return changed;
}

void DiscStage::add_light(std::size_t object, std::span<float> relit) const {
  const std::size_t stride = relit.size() / 3;
  for (const Traced& t : traced_) {
    const std::vector<float>& cosine = t.cosine[object];
    const Rgb scale = t.disc.radiance * static_cast<float>(t.disc.solid_angle_sr() / kPi);
    for (std::size_t c = 0; c < 3; ++c) {
      float* const out = &relit[c * stride];
      const float k = scale[static_cast<int>(c)];
      for (std::size_t v = 0; v < cosine.size(); ++v) out[v] += k * cosine[v];
    }
  }
}

DiscStage::AtPoints DiscStage::at_points(std::span<const glm::vec3> positions,
                                         std::span<const glm::vec3> normals) const {
  const std::size_t count = positions.size();
  AtPoints out{std::vector<Rgb>(count), std::vector<Rgb>(count), std::vector<Rgb>(count)};
  shadows::DiscAtPoints one;
  for (const Traced& t : traced_) {
    shadows::trace_disc_points({&virtual_, &real_, near_m_}, positions, normals, t.disc,
                               taps_.object, one);
    const Rgb scale = t.disc.radiance * static_cast<float>(t.disc.solid_angle_sr());
    for (std::size_t i = 0; i < count; ++i) {
      out.open[i] += scale * one.open[i];
      out.taken[i] += scale * one.taken[i];
      out.missing[i] += scale * one.missing[i];
    }
  }
  return out;
}

std::vector<compositor::DiscShadowOnPlane> DiscStage::shadows(
    std::span<const Rgb> open_irradiance) const {
  std::vector<compositor::DiscShadowOnPlane> out;
  for (const Traced& t : traced_)
    for (std::size_t p = 0; p < t.on_plane.size(); ++p) {
      if (t.on_plane[p].empty()) continue;
      const Rgb e = lighting::irradiance(t.disc, scene_->planes[p].normal);
      Rgb share;
      for (int c = 0; c < 3; ++c)
        share[c] =
            open_irradiance[p][c] > 0 ? std::clamp(e[c] / open_irradiance[p][c], 0.f, 1.f) : 0;
      out.push_back({&t.on_plane[p], share});
    }
  return out;
}

}  // namespace penumbra::service
