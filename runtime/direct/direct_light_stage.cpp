#include "runtime/direct/direct_light_stage.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <utility>

#include "lighting/lights/distant_light.h"
#include "lighting/sh/irradiance.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"
#include "shadows/visibility/direct_light.h"

namespace penumbra::runtime {

namespace {

// A light is traced anew when it moved by this much, half a millimetre of shadow from half a
// metre's height, and by a tenth of its radius; a wide one by no more than what changes its cosine
// on a surface by kVisibleFraction.
constexpr double kMinMove = 1e-3, kMaxMove = 5e-3;  // radians
constexpr double kVisibleFraction = .005;
constexpr double kGoodDeal = .7;  // what does not change back and forth
// Of an object's radius, for shadows on planes: of a cell of its shadow's map a fifteenth, an
// eighth under light from above. As much of the larger cells, about, for wide lights.
constexpr std::array<float, 2> kCoarse = {1e-3f, 2e-3f};
// Radii of an object within which it matters what real things leave: as far as its planar shadow
// goes.
constexpr double kAround = 5;
// Updates without a move until what was hurried is traced well; from then on it is due.
constexpr std::uint8_t kPatience = 8, kDue = 1;
const shadows::ShadowMap kNoShadow;

double angle_between(const glm::dvec3& a, const glm::dvec3& b) {
  return std::acos(std::clamp(glm::dot(a, b), -1., 1.));
}

// Where a light lies and how far it spreads, whatever the order of its points: of a window as high
// as wide any noise changes that.
struct LightForm {
  glm::dvec3 mean{0};
  glm::dmat3 spread{0};  // second moments about the mean
};
LightForm form_of(const lighting::DistantLight& source) {
  LightForm out;
  const auto points = static_cast<double>(source.shape.size());
  if (source.shape.empty()) {  // an even disc
    const glm::dvec3& d = source.direction;
    const double r = source.radius.value();
    out.mean = .5 * (1 + std::cos(r)) * d;
    out.spread = .25 * std::pow(std::sin(r), 2) * (glm::dmat3(1) - glm::outerProduct(d, d));
    return out;
  }
  for (const glm::dvec3& p : source.shape) out.mean += p / points;
  for (const glm::dvec3& p : source.shape)
    out.spread += glm::outerProduct(p - out.mean, p - out.mean) / points;
  return out;
}

// How far the light of one form lies from that of the other, radians.
double move_of(const LightForm& before, const LightForm& now) {
  double square = 0, trace = 0;
  for (int i = 0; i < 3; ++i) {
    square += glm::dot(now.spread[i] - before.spread[i], now.spread[i] - before.spread[i]);
    trace += before.spread[i][i];
  }
  return glm::distance(before.mean, now.mean) + std::sqrt(square / std::max(4 * trace, 1e-12));
}

// Of an open plane's light, what the light brings.
Rgb fraction_of(const lighting::DistantLight& source, const prt::Plane& plane,
                const Rgb& open_irradiance) {
  const Rgb e = lighting::irradiance(source, plane.normal);
  Rgb fraction;
  for (int c = 0; c < 3; ++c)
    fraction[c] = open_irradiance[c] > 0 ? std::clamp(e[c] / open_irradiance[c], 0.f, 1.f) : 0;
  return fraction;
}

// Radiance of a white surface that faces the light.
Rgb white_under(const lighting::DistantLight& source) {
  return source.radiance * static_cast<float>(source.solid_angle_sr() / kPi);
}

// By id; none: no light is narrow. The one before stays while it is not much weaker.
std::optional<int> strongest_narrow(std::span<const lighting::DistantLight> lights,
                                    std::optional<int> before) {
  const auto weight = [&](const lighting::DistantLight& source) {
    const float irradiance = luminance(source.irradiance());
    return source.id == before ? irradiance / kGoodDeal : irradiance;
  };
  const lighting::DistantLight* strongest = nullptr;
  for (const lighting::DistantLight& source : lights)
    if (!shadows::is_wide(source) && (!strongest || weight(source) > weight(*strongest)))
      strongest = &source;
  return strongest ? std::optional(strongest->id) : std::nullopt;
}

// Otherwise its light is in a picture.
bool drawn_by_vertices(const PreparedObject& o) {
  return !o.animation || o.animation->layout.texels.empty();
}

// As much of a plane as a shadow can come from, and where it lies: its own frame has the normal as
// its y axis, so that its bounds are as flat as it is.
prt::Mesh far_quad(const Rgb& albedo) {
  constexpr float kHalf = 100;  // metres
  prt::Mesh quad;
  for (const glm::vec2 c : {glm::vec2(-1, -1), {-1, 1}, {1, 1}, {1, -1}})
    quad.positions.emplace_back(kHalf * c.x, 0, kHalf * c.y);
  quad.normals.assign(4, {0, 1, 0});
  quad.albedo.assign(4, albedo);
  quad.triangles = {{0, 1, 2}, {0, 2, 3}};
  return quad;
}
Pose pose_of(const prt::Plane& plane) {
  return {glm::rotation(glm::dvec3(0, 1, 0), plane.normal), plane.point};
}

}  // namespace

Result<DirectLightStage> DirectLightStage::create(const PreparedScene& scene,
                                                  const ShadowSampling& sampling) {
  PENUMBRA_ASSIGN(virtual_things, prt::RayWorld::create());
  PENUMBRA_ASSIGN(real_things, prt::RayWorld::create());
  DirectLightStage stage(scene, sampling, std::move(virtual_things), std::move(real_things));
  // ShadowCasters point into them.
  stage.quads_.reserve(scene.planes.size());
  stage.silhouettes_.reserve(scene.objects.size() + 1 + scene.planes.size());
  stage.coarse_.reserve(kCoarse.size() * scene.objects.size() + 1);
  stage.visibilities_.reserve(scene.objects.size());
  stage.real_on_.resize(scene.planes.size());
  for (const PreparedObject& o : scene.objects) PENUMBRA_TRY(stage.add_object(o));
  if (!scene.real_mesh.triangles.empty()) PENUMBRA_TRY(stage.add_real_mesh());
  // One plane blocks only what comes from behind it, which nobody counts anyway.
  for (std::size_t p = 0; p < scene.planes.size() && scene.planes.size() > 1; ++p) {
    const prt::Mesh& quad = stage.quads_.emplace_back(far_quad(scene.planes[p].albedo));
    const Pose place = pose_of(scene.planes[p]);
    const auto index = stage.real_.add(quad);
    if (!index) return fail(index.error().code, "real plane", index.error().detail);
    stage.real_.set_pose(*index, place);
    stage.add_caster(quad, place, stage.real_casters_);
    for (std::size_t other = 0; other < scene.planes.size(); ++other)
      if (other != p) stage.real_on_[other].push_back(stage.real_casters_.back());
  }
  if (!scene.objects.empty())
    stage.near_m_ = shadows::SilhouetteMesh::kNear * stage.smallest_radius();
  return stage;
}

Result<void> DirectLightStage::add_object(const PreparedObject& o) {
  auto index = virtual_.add(o.baked.mesh);
  if (!index) return fail(index.error().code, o.name, index.error().detail);
  poses_.push_back(o.world_from_bake);
  floors_.push_back(o.world_from_bake);
  moved_from_.emplace_back();
  visible_.push_back(1);
  other_form_.push_back(0);
  add_caster(o.baked.mesh, o.world_from_bake, virtual_casters_);
  for (auto& casters : virtual_on_planes_) casters.push_back(virtual_casters_.back());
  const glm::vec3 centre = prt::bounds_of(o.baked.mesh).centre();
  const float radius = prt::radius_around(o.baked.mesh, centre);
  spheres_.push_back({glm::dvec3(centre), double(radius)});
  if (!o.animation) {
    if (!o.baked.visibility.empty())
      virtual_casters_.back().visibility =
          &visibilities_.emplace_back(o.baked.visibility, o.baked.mesh);
    for (std::size_t k = 0; k < kCoarse.size(); ++k)
      virtual_on_planes_[k].back().silhouette =
          &coarse_.emplace_back(o.baked.mesh, kCoarse[k] * radius);
  }
  virtual_.set_pose(*index, o.world_from_bake);
  return {};
}

Result<void> DirectLightStage::add_real_mesh() {
  const prt::Mesh& mesh = scene_->real_mesh;
  auto index = real_.add(mesh);
  if (!index) return fail(index.error().code, "real geometry", index.error().detail);
  add_caster(mesh, {}, real_casters_);
  shadows::Caster on_planes = real_casters_.back();
  if (!scene_->objects.empty())  // else nobody looks
    on_planes.silhouette = &coarse_.emplace_back(mesh, kCoarse[0] * smallest_radius());
  real_on_.assign(scene_->planes.size(), {on_planes});
  return {};
}

float DirectLightStage::smallest_radius() const {
  return static_cast<float>(
      std::ranges::min(spheres_, {}, &shadows::BoundingSphere::radius).radius);
}

void DirectLightStage::add_caster(const prt::Mesh& mesh, const Pose& pose,
                                  std::vector<shadows::Caster>& to) {
  to.push_back({&mesh, &silhouettes_.emplace_back(mesh), pose});
}

void DirectLightStage::set_pose(std::size_t object, const Pose& world_from_bake,
                                const Pose& world_from_floor) {
  floors_[object] = world_from_floor;
  if (poses_[object] == world_from_bake) return;
  if (!moved_from_[object]) moved_from_[object] = poses_[object];
  poses_[object] = world_from_bake;
  virtual_.set_pose(static_cast<int>(object), world_from_bake);
  for (auto* casters : {&virtual_casters_, &virtual_on_planes_[0], &virtual_on_planes_[1]})
    (*casters)[object].world_from_mesh = world_from_bake;
}

// It is always the last of the real casters.
void DirectLightStage::keep_passing_out() {
  if (!any_passing()) return;
  real_casters_.pop_back();
  for (auto& casters : real_on_) casters.pop_back();
}

Result<void> DirectLightStage::set_passing(prt::Mesh mesh) {
  if (mesh.triangles.empty() && !any_passing()) return {};
  const auto note_place = [&] {
    if (!any_passing()) return;
    const glm::vec3 centre = prt::bounds_of(passing_mesh_).centre();
    passed_.push_back({glm::dvec3(centre), double(prt::radius_around(passing_mesh_, centre))});
  };
  note_place();
  keep_passing_out();
  if (passing_) passing_->clear();
  passing_mesh_ = {};
  if (mesh.triangles.empty()) return {};
  if (!passing_) {
    PENUMBRA_ASSIGN(world, prt::RayWorld::create());
    passing_.emplace(std::move(world));
  }
  passing_mesh_ = std::move(mesh);
  if (const auto added = passing_->add(passing_mesh_); !added) {
    passing_mesh_ = {};
    return fail(added.error().code, "what passes by", added.error().detail);
  }
  passing_silhouette_ = shadows::SilhouetteMesh(passing_mesh_);
  const shadows::Caster caster{&passing_mesh_, &passing_silhouette_, {}};
  real_casters_.push_back(caster);
  for (auto& casters : real_on_) casters.push_back(caster);
  note_place();
  return {};
}

std::vector<shadows::BoundingSphere> DirectLightStage::spheres() const {
  std::vector<shadows::BoundingSphere> out;
  for (std::size_t i = 0; i < spheres_.size(); ++i)
    if (visible_[i]) out.push_back({poses_[i] * spheres_[i].centre, spheres_[i].radius});
  return out;
}

void DirectLightStage::update_vertices(std::size_t object) {
  const prt::Mesh& mesh = scene_->objects[object].baked.mesh;
  other_form_[object] = 1;
  const glm::vec3 centre = prt::bounds_of(mesh).centre();
  spheres_[object] = {glm::dvec3(centre), double(prt::radius_around(mesh, centre))};
  if (!moved_from_[object]) moved_from_[object] = poses_[object];
}

void DirectLightStage::follow_forms() {
  for (std::size_t i = 0; i < other_form_.size(); ++i)
    if (std::exchange(other_form_[i], 0)) {
      virtual_.update_vertices(static_cast<int>(i), scene_->objects[i].baked.mesh);
      silhouettes_[i].update_vertices(scene_->objects[i].baked.mesh);
    }
}

// Where the object or the floor may send a light on. What the object shades itself is in its bake;
// the rest is not.
void DirectLightStage::shade_hits(std::size_t object, const lighting::DistantLight& source,
                                  const OcclusionProbes& around,
                                  std::vector<std::uint8_t>& out) const {
  const std::span<const ProbeHit> hits = around.hits(object);
  out.reserve(OcclusionProbes::kMaxHits);
  out.assign(hits.size(), kNone);
  const int own = static_cast<int>(object);
  const prt::Mesh& mesh = scene_->objects[object].baked.mesh;
  const glm::mat3 turn = poses_[object].rotation_matrix();
  const glm::vec3 up(floors_[object].rotation * glm::dvec3(0, 1, 0)),
      shift = poses_[object].translation;
  constexpr int kPacket = prt::RayWorld::kPacket;
  prt::RayWorld::Rays rays;
  std::array<std::size_t, kPacket> index;
  int count = 0;
  const auto trace_packet = [&] {
    std::uint32_t by_others = virtual_.occluded(rays, count, own);
    if (!real_.empty()) by_others |= real_.occluded(rays, count);
    if (any_passing()) by_others |= passing_->occluded(rays, count);
    const std::uint32_t by_itself = virtual_.occluded_by(own, rays, count);
    for (int i = 0; i < count; ++i)
      out[index[static_cast<std::size_t>(i)]] = static_cast<std::uint8_t>(
          (by_itself >> i & 1 ? kByItself : kNone) | (by_others >> i & 1 ? kByOthers : kNone));
    count = 0;
  };
  for (std::size_t k = 0; k < hits.size(); ++k) {
    const bool itself = hits[k].thing == ProbeHit::kItself || hits[k].thing == ProbeHit::kProbe;
    if (!hits[k].above_floor && !itself) continue;
    const glm::vec3 normal = itself ? turn * mesh.normals[hits[k].vertex] : up;
    const glm::vec3 at = itself ? turn * mesh.positions[hits[k].vertex] + shift : hits[k].point;
    const glm::vec3 o = at + near_m_ * normal;
    // Each point looks for another part of a wide light.
    const glm::vec3 d(source.shape.empty() ? source.direction
                                           : source.shape[5 * k % source.shape.size()]);
    if (glm::dot(d, normal) <= 0) {
      out[k] = kByItself;
      continue;
    }
    rays.ox[count] = o.x, rays.oy[count] = o.y, rays.oz[count] = o.z;
    rays.dx[count] = d.x, rays.dy[count] = d.y, rays.dz[count] = d.z;
    index[static_cast<std::size_t>(count)] = k;
    if (++count == kPacket) trace_packet();
  }
  if (count > 0) trace_packet();
}

// Whether an object moved, or another thing that stands or stood between it and the light.
bool DirectLightStage::may_have_changed(std::size_t object,
                                        const lighting::DistantLight& source) const {
  if (moved_from_[object]) return true;
  const auto at = [&](std::size_t i, const Pose& pose) {
    return shadows::BoundingSphere{pose * spheres_[i].centre, spheres_[i].radius};
  };
  const shadows::BoundingSphere here = at(object, poses_[object]);
  for (std::size_t i = 0; i < poses_.size(); ++i)
    if (moved_from_[i] && (shadows::may_occlude(at(i, *moved_from_[i]), here, source) ||
                           shadows::may_occlude(at(i, poses_[i]), here, source)))
      return true;
  return std::ranges::any_of(passed_, [&](const shadows::BoundingSphere& thing) {
    return shadows::may_occlude(thing, here, source);
  });
}

// True where there were any.
bool DirectLightStage::shade_new_hits(TracedLight& t, const OcclusionProbes& around, bool all) {
  t.hit_shade.resize(scene_->objects.size());
  t.hits_version.resize(scene_->objects.size());
  bool any = false;
  for (std::size_t i = 0; i < scene_->objects.size(); ++i) {
    const bool others = t.hits_version[i] != around.hits_version(i);
    if (!visible_[i] || (!all && !others && !may_have_changed(i, t.source))) continue;
    changed_[i] = 1;
    t.hits_version[i] = around.hits_version(i);
    shade_hits(i, t.source, around, t.hit_shade[i]);
    any = true;
  }
  return any;
}

// What was hurried is traced well once nothing has moved for some updates: two eyes of a moment,
// and views that come faster than poses, are no rest.
bool DirectLightStage::settle(TracedLight& t) const {
  bool any = false;
  for (std::size_t i = 0; i < t.hurried.size(); ++i) {
    std::uint8_t& left = t.hurried[i];
    if (left > kDue && !may_have_changed(i, t.source)) --left;
    any |= left == kDue;
  }
  return any;
}

void DirectLightStage::trace(TracedLight& t, bool all) {
  if (all) t.as_traced = t.source;  // else some of it stays as it was traced for that light
  around_.clear();
  memo_.clear();
  const bool known = !t.cosine.empty();
  t.hurried.resize(scene_->objects.size());
  t.cosine.resize(scene_->objects.size());
  t.edged.resize(scene_->objects.size());
  for (std::size_t i = 0; i < scene_->objects.size(); ++i) {
    if (!visible_[i]) {
      t.hurried[i] = 0;
      continue;
    }
    const PreparedObject& o = scene_->objects[i];
    around_.push_back({poses_[i] * spheres_[i].centre, kAround * spheres_[i].radius});
    const bool moves = may_have_changed(i, t.source);
    if (!all && !moves && t.hurried[i] != kDue) continue;
    changed_[i] = 1;
    t.cosine[i].resize(o.baked.mesh.positions.size());
    const prt::Plane own{floors_[i].translation, floors_[i].rotation * glm::dvec3(0, 1, 0), {}, {}};
    // What knows nothing of its own visibility asks rays everywhere, and texels do not share them:
    // half would show (walker: 3.2 %).
    const int sampling =
        virtual_casters_[i].visibility ? t.detail.object_samples : sampling_.object;
    const bool with_edges = t.source.id == with_edges_ && drawn_by_vertices(o);
    shadows::Caster lit = virtual_casters_[i];
    lit.hurried = moves && known && lit.visibility && shadows::is_wide(t.source);
    t.hurried[i] = lit.hurried ? kPatience : 0;
    shadows::trace_direct_light(all_rays(), casters(), lit, o.baked.receiver ? &own : nullptr,
                                t.source, sampling, t.cosine[i],
                                with_edges ? &t.edged[i] : nullptr);
    if (!with_edges) t.edged[i].open.clear(), t.edged[i].lit.clear();
  }
}

// More at once, less only when a good deal less would do: a light at the limit must not change back
// and forth.
DirectLightStage::TracedDetail DirectLightStage::detail_for(const lighting::DistantLight& source,
                                                            bool fine, const OpenLight& open,
                                                            const TracedDetail& before) const {
  const auto of_plane = [](double fraction) {
    return fraction >= .5 ? 1 : fraction >= .25 ? .5 : .25;
  };
  double fraction = open.on_planes.empty() ? 1 : 0;
  for (std::size_t p = 0; p < open.on_planes.size(); ++p) {
    const Rgb here = fraction_of(source, scene_->planes[p], open.on_planes[p]);
    fraction = std::max({fraction, double(here.r), double(here.g), double(here.b)});
  }
  TracedDetail out{sampling_.object, of_plane(fraction), fine};
  if (before.plane > out.plane) out.plane = std::min(before.plane, of_plane(fraction / kGoodDeal));
  // Two rays are the fewest that are soft. (Under immenstadter's sun the knot is 1.91 instead of
  // 1.86 % off.)
  const bool was_strong = before.object_samples == sampling_.object;
  const double limit = (was_strong ? kGoodDeal : 1) * open.mean_irradiance;
  if (luminance(source.irradiance()) < limit && sampling_.object > 2)
    out.object_samples = (sampling_.object + 1) / 2;
  return out;
}

void DirectLightStage::trace_planes(TracedLight& t) {
  t.on_plane.resize(scene_->planes.size());
  t.real_on_plane.resize(scene_->planes.size());
  for (std::size_t p = 0; p < scene_->planes.size(); ++p) {
    const std::vector<shadows::Caster>& real = real_on_[p];
    const shadows::ShadowCasters casters{virtual_on_planes_[shadows::is_wide(t.source) ? 1 : 0],
                                         real, near_m_, &memo_};
    shadows::ShadowMapOptions options = sampling_.plane;
    options.resolution_scale = std::min(options.resolution_scale, t.detail.plane);
    if (!t.detail.fine && !shadows::is_wide(t.source)) options = options.coarse();
    shadows::render_shadow_maps(casters, scene_->planes[p], t.source, options, t.on_plane[p]);
    options.size /= 2;
    if (real.empty())
      t.real_on_plane[p] = {};
    else
      shadows::render_real_shadow_map(casters, around_, scene_->planes[p], t.source, options,
                                      t.real_on_plane[p]);
  }
}

bool DirectLightStage::update(std::span<const lighting::DistantLight> lights,
                              double mean_irradiance, const OcclusionProbes& around,
                              std::span<const Rgb> open_irradiance, std::size_t fine_lights) {
  if (!lights.empty()) follow_forms();
  const bool poses_changed =
      !passed_.empty() ||
      std::ranges::any_of(moved_from_, [](const auto& p) { return p.has_value(); });
  with_edges_ = strongest_narrow(lights, with_edges_);
  std::swap(traced_, before_);
  traced_.clear();
  changed_.assign(scene_->objects.size(), 0);
  bool changed = false, all_changed = false;
  for (const lighting::DistantLight& source : lights) {
    const auto known =
        std::ranges::find(before_, source.id, [](const TracedLight& t) { return t.source.id; });
    TracedLight t = known == before_.end() ? TracedLight{} : std::move(*known);
    const double move = std::max(angle_between(t.as_traced.direction, source.direction),
                                 move_of(form_of(t.as_traced), form_of(source)));
    const double change =
        std::abs(luminance(source.irradiance()) - luminance(t.source.irradiance()));
    all_changed |= known == before_.end() || change > kVisibleFraction * mean_irradiance;
    const lighting::DistantLight before = t.source;
    t.source = source;
    const bool fine = traced_.size() < fine_lights;
    const TracedDetail detail =
        detail_for(source, fine, {mean_irradiance, open_irradiance}, t.detail);
    const bool anew =
        t.cosine.empty() || move > kMinMove + std::min(.1 * source.radius.value(), kMaxMove) ||
        std::abs((t.as_traced.radius - source.radius).value()) > .1 * source.radius.value() ||
        detail.object_samples > t.detail.object_samples || detail.plane > t.detail.plane ||
        detail.fine > t.detail.fine;
    if (anew)
      t.detail = detail;
    else  // what moves is traced in the form that all else was traced for
      t.source.shape = t.as_traced.shape;
    const bool rests = settle(t);
    if (anew || poses_changed || rests) {
      trace(t, anew);
      if (anew || poses_changed) trace_planes(t);
      changed = true;
    }
    if (!anew && change <= kVisibleFraction * mean_irradiance) {
      t.source.radiance = before.radiance;  // small changes add up until they are seen
      t.source.radius = before.radius;
    }
    changed |= shade_new_hits(t, around, anew);
    traced_.push_back(std::move(t));
  }
  all_changed |= traced_.size() != before_.size();
  if (all_changed) std::ranges::fill(changed_, 1);
  std::ranges::fill(moved_from_, std::nullopt);
  passed_.clear();
  return changed || all_changed;
}

void DirectLightStage::add_light(std::size_t object, std::span<float> relit) const {
  const std::size_t stride = relit.size() / 3;
  for (const TracedLight& t : traced_) {
    const std::vector<float>& cosine = t.cosine[object];
    const Rgb scale = white_under(t.source);
    for (std::size_t c = 0; c < 3; ++c) {
      float* const out = &relit[c * stride];
      const float k = scale[static_cast<int>(c)];
      for (std::size_t v = 0; v < cosine.size(); ++v) out[v] += k * cosine[v];
    }
  }
}

std::optional<compositor::EdgedLight> DirectLightStage::edged_light(std::size_t object) const {
  // Another one may have become the strongest since it was traced.
  const auto known = std::ranges::find_if(
      traced_, [&](const TracedLight& t) { return !t.edged[object].lit.empty(); });
  if (known == traced_.end()) return std::nullopt;
  const auto& [open, lit] = known->edged[object];
  return compositor::EdgedLight{white_under(known->source), known->cosine[object], open, lit,
                                known->source.direction};
}

void DirectLightStage::visible_fractions(std::size_t source, std::size_t object,
                                         std::span<float> out) const {
  constexpr float kGrazing = .02f;  // of a surface that looks away there is nothing to compare
  const TracedLight& t = traced_[source];
  const std::vector<float>&cosine = t.cosine[object], &lit = t.edged[object].lit;
  const std::vector<glm::vec3>& normals = scene_->objects[object].baked.mesh.normals;
  const glm::vec3 towards(glm::conjugate(poses_[object].rotation) * t.source.direction);
  for (std::size_t v = 0; v < std::min(out.size(), cosine.size()); ++v) {
    const float open = glm::dot(normals[v], towards);
    const float fraction = lit.empty() ? cosine[v] / open : lit[v];
    out[v] = open > kGrazing ? std::clamp(fraction, 0.f, 1.f) : 1;
  }
  if (!scene_->objects[object].animation) fractions_of_backs(t.source, object, kGrazing, out);
}

// Of the sides that its normals do not show, where they are seen: sheets.
void DirectLightStage::fractions_of_backs(const lighting::DistantLight& source, std::size_t object,
                                          float grazing, std::span<float> out) const {
  const prt::BakedObject& baked = scene_->objects[object].baked;
  if (!baked.surface) return;
  const prt::SurfaceMaterials& surface = *baked.surface;
  const glm::mat3 turn(poses_[object].rotation_matrix());
  const glm::vec3 towards(source.direction);
  prt::Mesh backs;
  std::vector<std::size_t> vertices;
  for (std::size_t v = 0; v < std::min(out.size(), baked.mesh.normals.size()); ++v) {
    const glm::vec3 normal = turn * baked.mesh.normals[v];
    if (!surface.materials[surface.material[v]].double_sided || glm::dot(normal, towards) > grazing)
      continue;
    backs.positions.emplace_back(poses_[object] * glm::dvec3(baked.mesh.positions[v]));
    backs.normals.push_back(-normal);
    vertices.push_back(v);
  }
  if (vertices.empty()) return;
  shadows::DirectLightAtVertices light;
  shadows::trace_direct_light_at_vertices(rays(), backs, source, sampling_.object, light);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const float taken = light.virtual_occlusion[i] + light.real_occlusion[i];
    out[vertices[i]] = light.open[i] > 0 ? std::clamp(1 - taken / light.open[i], 0.f, 1.f) : 1;
  }
}

DirectLightStage::AtVertices DirectLightStage::at_vertices(const prt::Mesh& mesh) const {
  const std::size_t count = mesh.positions.size();
  AtVertices out{std::vector<Rgb>(count), std::vector<Rgb>(count), std::vector<Rgb>(count)};
  shadows::DirectLightAtVertices one;
  for (const TracedLight& t : traced_) {
    shadows::trace_direct_light_at_vertices(rays(), mesh, t.source, sampling_.object, one);
    const Rgb scale = t.source.radiance * static_cast<float>(t.source.solid_angle_sr());
    for (std::size_t i = 0; i < count; ++i) {
      out.open[i] += scale * one.open[i];
      out.virtual_occlusion[i] += scale * one.virtual_occlusion[i];
      out.real_occlusion[i] += scale * one.real_occlusion[i];
    }
  }
  return out;
}

void DirectLightStage::shadows(std::span<const Rgb> open_irradiance,
                               std::vector<compositor::ShadowMapOnPlane>& out) const {
  out.clear();
  for (const TracedLight& t : traced_)
    for (std::size_t p = 0; p < t.on_plane.size(); ++p) {
      const Rgb fraction = fraction_of(t.source, scene_->planes[p], open_irradiance[p]);
      const shadows::ShadowMap* const real =
          t.real_on_plane[p].empty() ? nullptr : &t.real_on_plane[p];
      bool any = false;
      for (const shadows::ShadowMap& shadow : t.on_plane[p])
        if (!shadow.empty()) out.push_back({&shadow, fraction, real}), any = true;
      // What is left of this light counts for the others' shadows too.
      if (real && !any) out.push_back({&kNoShadow, fraction, real});
    }
}

}  // namespace penumbra::runtime
