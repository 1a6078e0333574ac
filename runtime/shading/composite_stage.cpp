#include "runtime/shading/composite_stage.h"

#include <algorithm>
#include <cmath>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "capture/hdr/merge.h"
#include "compositor/view_lens.h"
#include "core/io/log.h"
#include "core/threads/background_task.h"
#include "core/threads/parallel.h"
#include "core/threads/scratch.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/bake/bake.h"
#include "prt/clip/light_map.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

namespace {

// Noise of a camera that nobody measured is none of ours to invent.
compositor::SensorEffects sensor_effects_of(const capture::CameraInfo& info,
                                            const capture::Frame& frame) {
  compositor::SensorEffects out;
  out.psf_sigma_px = static_cast<float>(info.psf_sigma_px);
  if (!info.noise_known) return out;
  const double gain = frame.exposure.gain.value();
  out.shot_gain = static_cast<float>(info.noise.variance(1, gain) - info.noise.variance(0, gain));
  out.read_noise = static_cast<float>(std::sqrt(info.noise.variance(0, gain)));
  // By the time, which a recording keeps, and by the eye, whose noise is its own.
  out.frame =
      static_cast<std::uint64_t>(frame.time.value) * 16 + static_cast<std::uint64_t>(frame.camera);
  return out;
}

compositor::Appearance appearance_of(const PreparedObject& o) {
  compositor::Appearance out;
  if (!o.animation) return out;
  const prt::Character& c = o.animation->character;
  const prt::SurfaceLayout& layout = o.animation->layout;
  out.texture = c.texture.get();
  out.texture_coordinates = c.texture_coordinates;
  out.tint = c.tint;
  out.light_width = layout.width;
  out.light_height = layout.height;
  out.light_coordinates = prt::light_coordinates_of(c);
  out.texels = layout.texels;
  return out;
}

// Error of transfer patterns under a small light: as little as with all coefficients. Twice as much
// shows on an object, by 0.1 %.
constexpr double kPatternsError = 5e-4;

// What a plane sends where nothing shades it; 0 where its albedo is not known.
Rgb radiance_of_plane(const PreparedScene& scene, std::size_t plane, std::span<const Rgb> open) {
  return scene.planes[plane].albedo * open[plane] * static_cast<float>(1 / kPi);
}

// Of the only plane, if it is all that is real.
Rgb radiance_of_floor(const PreparedScene& scene, std::span<const Rgb> open) {
  if (scene.planes.size() != 1 || !scene.real_mesh.triangles.empty()) return {};
  return radiance_of_plane(scene, 0, open);
}

// Of the plane that the real mesh stands on, else of the first.
Rgb radiance_below_mesh(const PreparedScene& scene, std::span<const Rgb> open) {
  if (scene.planes.empty()) return {};
  const Pose& pose = scene.real->world_from_bake;
  const int below = plane_at(scene.planes, pose.translation, pose.rotation * glm::dvec3(0, 1, 0));
  return radiance_of_plane(scene, below < 0 ? 0 : static_cast<std::size_t>(below), open);
}

}  // namespace

RelightBases::RelightBases(const prt::BakedObject& baked)
    : surface(baked.transfer, baked.reflected, kPatternsError),
      ground(baked.ground_deficit, baked.ground_reflected, kPatternsError) {}

void drop_coefficients(PreparedScene& scene) {
  using Values = prt::CowVector<std::uint16_t>;
  std::vector<std::pair<Values, Values>> first_channels;  // of copies that share theirs, once
  const auto first_of = [&](const prt::Transfer& t) {
    for (const auto& [all, first] : first_channels)
      if (all.shares(t.values)) return first;
    Values out(t.values.size() / static_cast<std::size_t>(t.channels));
    std::copy_n(t.values.begin(), out.size(), out.begin());
    return first_channels.emplace_back(t.values, out).second;
  };
  for (PreparedObject& o : scene.objects) {
    if (o.animation) continue;
    for (prt::Transfer* t : {&o.baked.transfer, &o.baked.reflected, &o.baked.ground_reflected})
      t->values = {};
    o.baked.ground_deficit.values = first_of(o.baked.ground_deficit);
    o.baked.ground_deficit.channels = 1;
  }
}

Result<std::unique_ptr<CompositeStage>> CompositeStage::create(
    const std::vector<capture::CameraInfo>& cameras, const PreparedScene& given,
    compositor::Compositor::Surface surface, StageTimes& times, int oversampling,
    const ShadowSampling& sampling) {
  // What moves by itself moves in a copy: the caller's scene stays as it is.
  std::unique_ptr<PreparedScene> moving;
  if (std::ranges::any_of(given.objects, [](const auto& o) { return o.animation != nullptr; }))
    moving = std::make_unique<PreparedScene>(given);
  if (moving)
    for (PreparedObject& o : moving->objects) PENUMBRA_TRY(o.begin_live());
  const PreparedScene& scene = moving ? *moving : given;
  const capture::CameraInfo* first = nullptr;
  for (const capture::CameraInfo& c : cameras) {
    if (c.role != capture::Role::kView) continue;
    if (first && (c.projection.width != first->projection.width ||
                  c.projection.height != first->projection.height))
      return fail(ErrorCode::kInvalid, c.name,
                  "has another picture size than the first view camera");
    if (!first) first = &c;
  }
  if (!first) return fail(ErrorCode::kInvalid, "capture", "has no view camera");
  PENUMBRA_ASSIGN(compositor,
                  compositor::Compositor::create(first->projection.width, first->projection.height,
                                                 surface, oversampling));
  PENUMBRA_ASSIGN(lights, DirectLightStage::create(scene, sampling));
  PENUMBRA_ASSIGN(recovery, FloorRecovery::create(scene));
  PENUMBRA_ASSIGN(foreground, ForegroundStage::create(cameras, scene.planes, scene.real_mesh));
  PENUMBRA_ASSIGN(mirrored, MirroredObjects::create(scene, sampling.mirrored_objects));
  if (scene.sun && recovery.idle())
    log_warning(
        "sun: one that no camera sees stays dark: no object stands on a floor of known albedo, or "
        "beside a real mesh that throws a shadow");
  auto stage = std::unique_ptr<CompositeStage>(new CompositeStage(
      std::move(compositor), std::move(lights), std::move(recovery), std::move(foreground),
      std::move(mirrored), scene, std::move(moving), times));
  for (const capture::CameraInfo& c : cameras) PENUMBRA_TRY(stage->add_camera(c));
  if (!scene.real_mesh.triangles.empty()) stage->compositor_->add_occluder(scene.real_mesh);
  if (scene.real && scene.real->baked.receiver)
    stage->compositor_->add_real_receiver(scene.real->baked.receiver->grid,
                                          scene.real->world_from_bake);
  for (const prt::Plane& plane : scene.planes)
    stage->compositor_->add_plane(plane.point, plane.normal);
  for (const PreparedObject& o : scene.objects) {
    const int handle = stage->compositor_->add_object(o.baked, appearance_of(o));
    StageObject& object = stage->objects_.emplace_back();
    object.prepared = &o;
    object.handle = handle;
    stage->handles_.push_back(handle);
    object.relit.resize(3 * o.baked.transfer.stride);
    if (!o.animation) object.bases = stage->bases_of(o.baked);
  }
  stage->mirrored_objects_.begin(stage->handles_, *stage->compositor_);
  if (stage->moving_) drop_coefficients(*stage->moving_);  // shared with the caller's scene
  return stage;
}

CompositeStage::CompositeStage(std::unique_ptr<compositor::Compositor> compositor,
                               DirectLightStage lights, FloorRecovery recovery,
                               ForegroundStage foreground, MirroredObjects mirrored_objects,
                               const PreparedScene& scene, std::unique_ptr<PreparedScene> moving,
                               StageTimes& times)
    : compositor_(std::move(compositor)),
      moving_(std::move(moving)),
      scene_(scene),
      lights_(std::move(lights)),
      recovery_(std::move(recovery)),
      foreground_(std::move(foreground)),
      moves_(scene),
      surroundings_(scene),
      lamps_(scene),
      real_(scene),
      gathered_(scene),
      ground_probes_(scene),
      planes_(scene),
      mirrored_(scene),
      mirrored_objects_(std::move(mirrored_objects)),
      times_(times) {}

std::shared_ptr<const RelightBases> CompositeStage::bases_of(const prt::BakedObject& baked) const {
  for (const StageObject& o : objects_)
    if (o.bases && o.prepared->baked.transfer.values.shares(baked.transfer.values)) return o.bases;
  return std::make_shared<const RelightBases>(baked);
}

// Brings all that moves by itself and is visible to where it is now. Where shadows can meet others
// their coefficients are needed.
bool CompositeStage::move_objects() {
  if (!moving_) return false;
  const StageTimer timer(times_, "animation");
  const bool alone = objects_.size() == 1;
  bool moved = false;
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    PreparedObject& o = moving_->objects[i];
    if (!objects_[i].visible ||
        !o.move_to(objects_[i].clip_time_s, {.all_transfer = !alone,
                                             .keep_time = keeps_time_,
                                             .blend_weight = objects_[i].blend_weight,
                                             .holds = objects_[i].holds}))
      continue;
    compositor_->update_vertices(objects_[i].handle, o.baked.mesh);
    lights_.update_vertices(i);
    mirrored_objects_.update_vertices(i);
    moved = true;
  }
  return moved;
}

void CompositeStage::place_objects(double seconds) {
  std::swap(poses_, poses_before_);
  poses_.clear();
  floors_.clear();
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    const ObjectMoves::ObjectNow now = moves_.at(i, seconds);
    objects_[i].visible = now.visible;
    objects_[i].clip_time_s = now.clip_time_s;
    objects_[i].blend_weight = now.blend_weight;
    objects_[i].holds = now.speed == 0;
    // One that is hidden is lit as when it was last seen.
    if (now.visible) {
      objects_[i].other_stance |= objects_[i].lifted_now != now.lifted;
      objects_[i].lifted_now = now.lifted;
    }
    poses_.push_back(now.world_from_bake);
    floors_.push_back(now.world_from_floor);
    compositor_->show(objects_[i].handle, now.visible);
    compositor_->set_pose(objects_[i].handle, poses_[i], floors_[i]);
    lights_.show(i, now.visible);
    lamps_.show(i, now.visible);
    lights_.set_pose(i, poses_[i], floors_[i]);
  }
}

// What passes between objects and the lights, where new depth tells of it.
void CompositeStage::update_passing(bool any_lights, double seconds) {
  if (!foreground_.any() || !any_lights) return;
  const TimestampNs time{std::llround(1e9 * seconds)};
  const bool old = lights_.any_passing() && !foreground_.tells_of(time);
  if (foreground_.depth_frames() == depth_frames_seen_ && !old) return;
  depth_frames_seen_ = foreground_.depth_frames();
  const StageTimer timer(times_, "foreground");
  if (const auto set = lights_.set_passing(foreground_.surface_near(lights_.spheres(), time)); !set)
    log_warning("{}: {}", set.error().where, set.error().detail);
}

// True where a light changed or what it meets did.
bool CompositeStage::update_distant_lights(const lighting::LightEstimate& light) {
  const StageTimer timer(times_, "lights");
  const std::size_t fine =
      light.plan ? static_cast<std::size_t>(light.plan->fine_lights) : DirectLightStage::kAllLights;
  return lights_.update(light.lights, kPi * luminance(light.mean_radiance), surroundings_,
                        planes_.irradiance(), fine);
}

// True where an object's light changed visibly.
bool CompositeStage::relight_objects(const lighting::LightEstimate& light, bool all_changed,
                                     bool other_form) {
  light_planes();
  bool relit = false;
  for (StageObject& o : objects_) o.renewed = false;
  // What things reflect onto each other is known from the last update, at first from a round of its
  // own.
  const int rounds = !lit_before_ && surroundings_.any() ? 2 : 1;
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t i = 0; i < objects_.size(); ++i)
      relit |= update_object(i, poses_, light, all_changed || round > 0 || lights_.changed(i),
                             other_form);
    if (round + 1 == rounds) break;
    combine_object_shadows(poses_);
    light_planes();
    shade_real_mesh(light, poses_, other_form);
    if (surroundings_.refine(lights_.occluders(), true)) update_distant_lights(light);
  }
  lit_before_ = true;
  return relit;
}

bool CompositeStage::shade(const lighting::LightEstimate& light, double seconds, int camera) {
  const bool another_view = shaded_s_ == seconds && camera != shaded_camera_;
  if (!another_view) shaded_s_ = seconds, shaded_camera_ = camera;
  place_objects(seconds);
  const bool other_form = move_objects();
  // Neighbours' shadows and those on real meshes follow a turn that no light shows.
  const bool moved = (objects_.size() > 1 || real_.any()) && poses_ != poses_before_;
  look_at_lifted();
  catches_up_ = exits_changed_ && !another_view && !moved && !other_form;
  exits_changed_ &= another_view;
  if (surroundings_.any()) {
    const StageTimer timer(times_, "occlusion probes");
    surroundings_.update(lights_.occluders(), poses_, floors_);
    surroundings_.refine(lights_.occluders());
    ground_probes_.update(lights_.occluders(), poses_, floors_, other_form);
  }
  planes_.update(light);
  floor_radiance_ = radiance_of_floor(scene_, planes_.irradiance());
  update_passing(!light.lights.empty(), seconds);
  bool lights_changed = update_distant_lights(light), lamps_changed = false;
  if (mirrored_.any()) {
    const StageTimer timer(times_, "reflections");
    mirrors_others_ |= mirrored_.update(light, lights_, handles_, *compositor_);
  }
  if (lamps_.any()) {
    const StageTimer timer(times_, "lamps");
    lamps_changed = lamps_.update(lights_.occluders(), poses_, other_form, emission_unit(light));
  }
  bool measured = false;
  if (real_.any()) {
    const StageTimer timer(times_, "real mesh");
    measured = real_.measure(light, lights_, lights_changed);
  }
  lights_changed |= lamps_changed;
  lights_.shadows(planes_.irradiance(), on_planes_);
  lamps_.append(planes_.irradiance(), on_planes_);
  const bool first = !lit_before_;  // which has rounds enough of its own
  const bool relit = relight_objects(light, lamps_changed, other_form);
  if (!relit && !lights_changed && !moved && !measured) return false;
  exits_changed_ = surroundings_.any() && !first;
  combine_object_shadows(poses_);
  light_planes();
  compositor_->set_shadow_maps(on_planes_);
  shade_real_mesh(light, poses_, other_form);
  if (real_.any()) {
    compositor_->set_ratios(0, real_ratios_);
    if (measured)
      compositor_->set_weights(
          0, weights_beside(radiance_below_mesh(scene_, planes_.irradiance()), real_.exit()));
    if (real_.shadow()) compositor_->set_real_shadow(*real_.shadow());
  }
  return true;
}

void CompositeStage::light_planes() {
  if (!surroundings_.any_real()) return;
  std::vector<ShadowOnPlane> shadows;
  if (real_.any() && real_.shadow())
    shadows.push_back({real_.shadow(), &scene_.real->baked.receiver->grid,
                       scene_.real->world_from_bake.inverse(), true});
  for (std::size_t k = 0; k < objects_.size(); ++k)
    if (const prt::BakedObject& baked = objects_[k].prepared->baked; baked.receiver)
      shadows.push_back({&objects_[k].shown(), &baked.receiver->grid, floor_of(k).inverse(), false,
                         objects_[k].of_open});
  plane_light_.emplace(scene_.planes, planes_.irradiance(), on_planes_, std::move(shadows));
}

// What virtual things change in the light of the real mesh beside the lights.
void CompositeStage::shade_real_mesh(const lighting::LightEstimate& light,
                                     const std::vector<Pose>& poses, bool other_form) {
  if (!real_.any()) return;
  const StageTimer timer(times_, "real mesh");
  gathered_.update(lights_.occluders(), poses, surroundings_, other_form);
  const RadianceSh& sky =
      residual_for(light, stands_level(scene_.real->baked, scene_.real->world_from_bake));
  of_points_.resize(gathered_.points());
  parallel_for(std::size_t{0}, of_points_.size(),
               [&](std::size_t p) { of_points_[p] = lost_at(p, sky); });
  lost_.resize(scene_.real_mesh.positions.size());
  gathered_.interpolate(of_points_, lost_);
  real_ratios_ = real_.ratios(light, lost_, lamps_);
}

Rgb CompositeStage::lost_at(std::size_t point, const RadianceSh& sky) const {
  Rgb out;
  for (const GatherHit& hit : gathered_.hits(point)) {
    PlaneLight::Radiance seen;
    if (!hit.real)
      seen.before = lighting::evaluate(sky, glm::dvec3(hit.direction));
    else if (hit.behind.plane != RealPoint::kMesh)
      seen = exit_of_real(hit.behind);
    else  // what the mesh loses to virtual things counts at its own vertices
      seen.before = exit_of_real(hit.behind).before;
    if (hit.object != GatherHit::kNone)
      seen.now = exit_of_object(static_cast<std::size_t>(hit.object), hit.vertex);
    out += seen.before - seen.now;
  }
  return out * (1.f / IrradianceCache::kRays);
}

namespace {

// Two objects on one plane whose shadows can meet.
bool may_meet(const prt::BakedObject& a, const Pose& at_a, const prt::BakedObject& b,
              const Pose& at_b) {
  if (!a.receiver || !b.receiver) return false;
  const glm::dvec3 up = at_a.rotation * glm::dvec3(0, 1, 0);
  const glm::dvec3 apart = at_b.translation - at_a.translation;
  return glm::dot(up, at_b.rotation * glm::dvec3(0, 1, 0)) > kLevel &&
         std::abs(glm::dot(apart, up)) < 1e-4 &&
         glm::length(apart) < double(a.receiver->grid.half_extent + b.receiver->grid.half_extent);
}

}  // namespace

// What objects take of each other's light. What real things take is not in their own: they were
// shaded by light past those (ObjectLight::local).
void CompositeStage::combine_object_shadows(const std::vector<Pose>& poses) {
  const StageTimer timer(times_, "combine shadows");
  // What two that are lifted block in common is not known.
  const auto meet = [&](std::size_t a, std::size_t b) {
    return !objects_[a].lifted_now && !objects_[b].lifted_now &&
           may_meet(objects_[a].prepared->baked, poses[a], objects_[b].prepared->baked, poses[b]);
  };
  const auto is_other = [&](std::size_t k) {
    return objects_[k].renewed || poses_before_.size() != poses.size() ||
           poses_before_[k] != poses[k];
  };
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    StageObject& o = objects_[k];
    bool same = !is_other(k);
    for (std::size_t i = 0; i < k && same; ++i) same = !is_other(i) || !(o.shares || meet(i, k));
    if (same) continue;
    o.shares = false;
    for (std::size_t i = 0; i < k; ++i) {
      const StageObject& other = objects_[i];
      if (!meet(i, k)) continue;
      if (!std::exchange(o.shares, true)) o.shared = o.shadow;
      shadows::combine_shadows({&other.prepared->baked, poses[i], &other.shadow},
                               {&o.prepared->baked, poses[k], &o.shadow}, o.shared);
    }
    const auto edged = o.has_lights() ? lights_.edged_light(k) : std::nullopt;
    compositor_->set_light(o.handle, o.relit, o.shown(), o.of_open, edged ? &*edged : nullptr);
  }
}

// Whether light_at() can come out otherwise than it last did.
bool CompositeStage::may_differ(std::size_t index, const RadianceSh& residual,
                                const Pose& pose) const {
  const StageObject& o = objects_[index];
  return !o.light_used || !o.residual_used || o.pose_seen != pose ||
         (surroundings_.any() && o.hits_seen != surroundings_.hits_version(index)) ||
         differs_visibly(*o.residual_used, residual);
}

bool CompositeStage::update_object(std::size_t index, const std::vector<Pose>& poses,
                                   const lighting::LightEstimate& estimate, bool changed,
                                   bool moved) {
  StageObject& o = objects_[index];
  if (!o.visible) {
    surroundings_.want_fine(index, false);
    return false;
  }
  const RadianceSh& residual =
      residual_for(estimate, stands_level(o.prepared->baked, floor_of(index)));
  const bool other_form = (moved && o.prepared->animation) || o.other_stance;
  if (!changed && !other_form && !catches_up_ && !may_differ(index, residual, poses[index]))
    return false;
  ObjectLight light = light_at(index, estimate, poses);
  o.pose_seen = poses[index];
  o.hits_seen = surroundings_.hits_version(index);
  // Its shadow depends on what is behind it, too.
  const bool other_place = surroundings_.any_real() && o.pose_used != poses[index];
  if (!changed && !other_form && !other_place && o.light_used &&
      !differs_visibly(*o.light_used, light))
    return false;
  o.pose_used = poses[index];
  if (!estimate.lights.empty() || lamps_.any())
    add_distant_lights(index, estimate, poses[index], light);
  {
    const StageTimer timer(times_, "relight");
    relight(o, light, index, estimate, poses[index]);
  }
  if (o.prepared->baked.receiver) {
    const StageTimer timer(times_, "shadow");
    compose_shadow(index, estimate, poses[index], light);
  }
  o.light_used = light;
  o.residual_used = residual;
  o.other_stance = false;
  o.renewed = true;
  return true;
}

void CompositeStage::compose_shadow(std::size_t index, const lighting::LightEstimate& estimate,
                                    const Pose& pose, const ObjectLight& light) {
  StageObject& o = objects_[index];
  const prt::BakedObject& baked = o.prepared->baked;
  shadows::ReceiverLight on_receiver(light.local);
  on_receiver.lights = light.reaching_lights;
  on_receiver.distant_irradiance = light.distant_irradiance;
  o.deficit.resize(3 * baked.ground_deficit.stride);
  if (o.lifted_now)
    o.lifted->ground.taken(light.local, o.relit, baked.mesh, baked.receiver->grid.size, o.deficit);
  else
    take_by_bake(index, estimate, pose, light);
  shadows::compose_planar_shadow(
      {baked.receiver->grid, baked.ground_deficit.bands, baked.ground_deficit.stride, o.deficit},
      on_receiver, o.shadow);
  // The compositor knows what real things leave of the open floor's light at each place.
  const auto open_floor_irradiance = [&](const RadianceSh& residual) {
    return lighting::evaluate(lighting::irradiance(residual.with_bands(baked.ground_deficit.bands)),
                              {0, 1, 0}) +
           light.distant_irradiance;
  };
  const Rgb local = open_floor_irradiance(light.local),
            open = open_floor_irradiance(light.open) + planes_.change_under(baked, floor_of(index));
  for (int c = 0; c < 3; ++c) o.of_open[c] = open[c] > 0 ? std::max(0.f, local[c] / open[c]) : 1;
}

// The deficit of an object that stands as it was baked.
void CompositeStage::take_by_bake(std::size_t index, const lighting::LightEstimate& estimate,
                                  const Pose& pose, const ObjectLight& light) {
  StageObject& o = objects_[index];
  const Scratch::Scope scope;
  std::pmr::vector<float> lit(scope.memory());
  find_lit(index, estimate, pose, light, lit);
  // What is taken is what is lost less what comes back by reflection.
  const bool lights = luminance(light.distant_irradiance) > 0;
  RadianceSh given_back = light.lights;
  for (Rgb& term : given_back.terms()) term = term * -1.f;
  relight_parts(o, PreparedObject::TransferPart::kGround, light.local,
                lights && lit.empty() ? &given_back : nullptr, o.deficit);
  if (lights && !lit.empty()) add_ground_reflected(o, given_back, lit, o.deficit);
  if (!ground_probes_.any()) return;
  take_what_is_behind(index, residual_for(estimate, stands_level(o.prepared->baked, pose)), pose,
                      light.local, o.deficit);
  correct_reflections(index, light, lit);
}

const ResponseTable* CompositeStage::curve_for(ViewCamera& camera, const FramePixels& pixels) {
  const auto make = [&](std::optional<ResponseTable>& curve, int bits) {
    if (!curve)
      curve = capture::make_response_table(camera.info.response, bits, camera.info.black_level);
    return &*curve;
  };
  if (std::holds_alternative<Image<Rgb8>>(pixels)) return make(camera.curve8, 8);
  if (std::holds_alternative<Image<Rgb16>>(pixels)) return make(camera.curve16, 16);
  return nullptr;
}

std::vector<lighting::SaturationRecovery> CompositeStage::recover_lights(
    const capture::Frame& frame, const lighting::LightEstimate& light, const AskForDarker& ask) {
  ViewCamera& camera = views_[static_cast<std::size_t>(frame.camera)];
  auto found = recovery_.observe(frame, camera.info, curve_for(camera, *frame.pixels), light);
  const bool usual_tells = !frame.for_light && recovery_.looked() && !recovery_.overexposed();
  if (usual_tells) camera.darker_factor = kDarker;
  if (found) return std::move(*found);
  if (recovery_.overexposed() && ask_for_darker(camera, frame, ask)) return {};
  if (!std::exchange(could_not_complete_, true))
    log_warning("a saturated light's power stays a lower bound: {} {}", found.error().where,
                found.error().detail);
  return {};
}

// A darker frame that is overexposed, too, asks for the next darker one.
bool CompositeStage::ask_for_darker(ViewCamera& camera, const capture::Frame& frame,
                                    const AskForDarker& ask) {
  constexpr double kDarkest =
      kDarker * kDarker * kDarker;  // from there on noise and codes tell all
  if (frame.for_light) camera.darker_factor *= kDarker;
  if (camera.darker_factor >= kDarkest) return ask(camera.darker_factor);
  camera.darker_factor = kDarker;
  return false;
}

void CompositeStage::warm_up() {
  move_objects();  // live transfer begins with many rays
  const auto camera = std::ranges::find(views_, capture::Role::kView,
                                        [](const ViewCamera& v) { return v.info.role; });
  const calib::CameraModel& p = camera->info.projection;
  FramePixels black = Image<Rgb>(p.width, p.height);
  // What fails here fails again at the first frame, which says so.
  compositor::View view{
      {p.width, p.height, p.focal_px, p.principal_px, camera->info.world_from_camera}};
  view.lens = camera->lens;
  if (foreground_.any()) {
    auto nowhere = std::make_shared<compositor::Foreground>();
    nowhere->area = {0, 0, 1, 1};
    nowhere->distance_m = {0};
    nowhere->cover = {{0, 0, 0, 0}};
    view.foreground = std::move(nowhere);
  }
  (void)compositor_->composite(view, black);
  view.foreground.reset();
  if (foreground_.any()) (void)compositor_->composite(view, black);
}

Result<void> CompositeStage::add_camera(const capture::CameraInfo& info) {
  const Vignetting vignetting = calib::vignetting_of(info.projection, info.vignetting);
  ViewCamera camera{info, vignetting, calib::min_fraction(vignetting, info.projection)};
  if (info.role == capture::Role::kView) {
    PENUMBRA_ASSIGN(lens, compositor::ViewLens::create(info.projection, info.name));
    if (lens) compositor_->use_lens(*lens);
    camera.lens = std::move(lens);
  }
  views_.push_back(std::move(camera));
  return {};
}

namespace {

// Between what the camera saw and the composited picture, in codes: nobody looks long enough at a
// fade to tell how even it is.
template <class Pixel>
void fade_rows(const Image<Pixel>& camera, float opacity, Image<Pixel>& out) {
  using Code = decltype(Pixel::r);
  constexpr float kRound = std::is_integral_v<Code> ? .5f : 0;
  const auto mix = [&](Code from, Code to) {
    const float a = static_cast<float>(from);
    return static_cast<Code>(a + opacity * (static_cast<float>(to) - a) + kRound);
  };
  parallel_for(0, out.height(), 16, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < out.width(); ++x) {
        const Pixel &from = camera.at(x, y), &to = out.at(x, y);
        if (from == to) continue;
        out.at(x, y) = {mix(from.r, to.r), mix(from.g, to.g), mix(from.b, to.b)};
      }
  });
}

void fade(const FramePixels& camera, float opacity, FramePixels& out) {
  if (opacity >= 1) return;
  std::visit(
      [&]<class Pixel>(Image<Pixel>& pixels) {
        fade_rows(std::get<Image<Pixel>>(camera), std::max(opacity, 0.f), pixels);
      },
      out);
}

}  // namespace

std::shared_ptr<const compositor::Foreground> CompositeStage::foreground_of(
    const capture::Frame& frame, const ViewCamera& camera, const ResponseTable* curve) {
  if (!foreground_.any()) return nullptr;
  const calib::CameraModel& p = camera.info.projection;
  // The compositor refuses it.
  if (capture::width(*frame.pixels) != p.width || capture::height(*frame.pixels) != p.height)
    return nullptr;
  const StageTimer timer(times_, "foreground");
  return foreground_.in_front_of(frame, {p, camera.lens.get(), curve, camera.vignetting},
                                 lights_.spheres());
}

compositor::View CompositeStage::view_of(const capture::Frame& frame) {
  ViewCamera& camera = views_[static_cast<std::size_t>(frame.camera)];
  const calib::CameraModel& p = camera.info.projection;
  const ResponseTable* const curve = curve_for(camera, *frame.pixels);
  return {{p.width, p.height, p.focal_px, p.principal_px, frame.world_from_camera},
          curve,
          static_cast<float>(frame.exposure.product()),
          sensor_effects_of(camera.info, frame),
          camera.vignetting,
          floor_radiance_ * static_cast<float>(frame.exposure.product() * camera.min_fraction),
          camera.lens,
          foreground_of(frame, camera, curve)};
}

void CompositeStage::mirror_objects(const compositor::View& view, const capture::Frame& frame,
                                    bool relit) {
  if (!mirrored_objects_.any()) return;
  const StageTimer timer(times_, "mirrored objects");
  const bool others = std::exchange(mirrors_others_, false);
  visible_.clear(), relit_.clear();
  for (const StageObject& o : objects_) visible_.push_back(o.visible), relit_.push_back(o.relit);
  const ViewCamera& camera = views_[static_cast<std::size_t>(frame.camera)];
  mirrored_objects_.update(static_cast<std::size_t>(frame.camera),
                           {view, camera.info.projection, poses_, floors_, visible_},
                           {mirrored_.now(), relit_, mirrored_.fractions()}, relit || others,
                           handles_, *compositor_);
}

Result<void> CompositeStage::process(const capture::Frame& frame,
                                     const lighting::LightEstimate& light, Composited& out) {
  const bool relit = shade(light, (frame.time - TimestampNs{0}).count(), frame.camera);
  const compositor::View view = view_of(frame);
  mirror_objects(view, frame, relit);
  const StageTimer timer(times_, "composite");
  PENUMBRA_ASSIGN(touched, compositor_->composite(view, *frame.pixels, out.pixels));
  out.touched = touched;
  out.relit = relit;
  fade(*frame.pixels, frame.opacity, out.pixels);
  return {};
}

Result<void> CompositeStage::draw(const capture::Frame& frame, const lighting::LightEstimate& light,
                                  TimestampNs scene_time, PendingFrame& out) {
  out.relit_ = shade(light, (scene_time - TimestampNs{0}).count(), frame.camera);
  out.camera_ = frame.pixels;
  out.opacity_ = frame.opacity;
  out.times_ = &times_;
  const compositor::View view = view_of(frame);
  mirror_objects(view, frame, out.relit_);
  const Stopwatch watch;
  PENUMBRA_TRY(compositor_->draw(view, *frame.pixels, out.drawn_));
  out.drawing_ms_ = watch.ms();
  return {};
}

Composited PendingFrame::finish() {
  const Stopwatch watch;
  Composited out;
  out.relit = relit_;
  out.pixels = *camera_;
  out.touched = drawn_.composite_into(out.pixels);
  fade(*camera_, opacity_, out.pixels);
  camera_.reset();
  times_->add("composite", drawing_ms_ + watch.ms());
  return out;
}

}  // namespace penumbra::runtime
