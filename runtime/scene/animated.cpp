#include "runtime/scene/animated.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>

#include "core/io/log.h"
#include "prt/bake/bake.h"
#include "prt/clip/light_map.h"
#include "prt/clip/live_bake.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/ground_grid.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/relight.h"
#include "runtime/scene/bake_cache.h"
#include "runtime/scene/internal/standing.h"

namespace penumbra::runtime {

namespace {

// Where transfer is kept at vertices
constexpr float kEdgeFraction = BakeSettings{}.max_edge_fraction;
constexpr double kUpright = .9999;  // cosine
constexpr int kGroundSize = 64;     // texels of the shadow basis: renewed in every frame
constexpr int kMaxClipRays = 512;
// No frame yet: every time is another
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
// Of live transfer: every point costs time in every frame.
constexpr float kLiveEdgeFraction = .06f;
constexpr int kLiveGroundSize = 32;
constexpr std::size_t kFirstVisits = 16,
                      kVisits = 2;  // a point: before the first frame, and a frame

// What is played by default of a character that has just been loaded.
Animation playing(prt::Character character, int clip) {
  Animation out;
  out.character = std::move(character);
  out.clip = clip;
  return out;
}

// The room that an animation takes, as a mesh of corners. Upright it ends at the height that it
// stands on.
prt::Mesh room_of(const Animation& animation, bool upright = true) {
  constexpr int kLooks = 32;
  prt::Mesh mesh, room;
  std::vector<float> lows;
  const double seconds = animation.longest_clip_s();
  for (int i = 0; i < (seconds > 0 ? kLooks : 1); ++i) {
    prt::deform(animation.character, animation.pose_at(seconds * i / kLooks), mesh);
    const prt::Bounds b = prt::bounds_of(mesh);
    room.positions.insert(room.positions.end(), {b.low, b.high});
    lows.push_back(b.low.y);
  }
  if (!upright) return room;
  const prt::Bounds all = prt::bounds_of(room);
  const float floor = standing_height(std::move(lows), all.high.y - all.low.y);
  for (glm::vec3& corner : room.positions) corner.y = std::max(corner.y, floor);
  return room;
}

}  // namespace

prt::CharacterPose Animation::pose_at(double seconds, float weight) const {
  const auto sampled = [&](int number) {
    return prt::sample(character, character.clips[static_cast<std::size_t>(number)], seconds);
  };
  return blend ? prt::blend(sampled(clip), sampled(*blend), weight) : sampled(clip);
}

double Animation::longest_clip_s() const {
  double seconds = 0;
  for (const int number : {clip, blend.value_or(clip)})
    seconds = std::max(seconds, character.clips[static_cast<std::size_t>(number)].seconds);
  return seconds;
}

Result<prt::Character> load_character(const std::string& asset, Rgb albedo) {
  if (asset == "builtin:walker") return prt::make_walker(albedo);
  if (asset.starts_with("builtin:"))
    return fail(ErrorCode::kNotFound, asset, "has no animation; builtin:walker has");
  auto character = prt::import_character(asset, albedo);
  if (!character) return character;
  if (character->degenerate_triangles > 0)
    log_warning("{}: {} degenerate triangles are left out", asset, character->degenerate_triangles);
  for (const std::string& line : character->left_out) log_warning("{}: {}", asset, line);
  if (character->unbound_vertices > 0)
    log_warning("{}: {} vertices have no skin weights and follow the first joint", asset,
                character->unbound_vertices);
  return character;
}

namespace {

// Edges are measured where the vertices are kept, in units of the asset.
void refine(prt::Character& character, float edge_fraction) {
  prt::Mesh rest;
  rest.positions = character.positions;
  prt::subdivide(character, edge_fraction * prt::radius_of(rest));
}

}  // namespace

Result<StandingCharacter> standing_character(const std::string& asset, Rgb albedo,
                                             const std::string& animation, int map_width,
                                             int map_height) {
  PENUMBRA_ASSIGN(character, load_character(asset, albedo));
  const auto clip = prt::find_clip(character, animation);
  if (!clip) return fail(clip.error().code, asset, clip.error().detail);
  const Animation alone = playing(character, *clip);
  const prt::Bounds room = prt::bounds_of(room_of(alone));
  character.frame = glm::mat4(1);
  character.frame[3] = glm::vec4(-room.centre().x, -room.low.y, -room.centre().z, 1);
  if (map_width > 0) {
    character = prt::for_light_map(std::move(character), map_width, map_height);
  } else {
    refine(character, kEdgeFraction);
  }
  return StandingCharacter{std::move(character), *clip};
}

prt::SequenceOptions sequence_options(const BakeSettings& settings) {
  prt::SequenceOptions o;
  o.bands = settings.bands;
  o.bounces = settings.bounces;
  o.rays = std::min(settings.rays, kMaxClipRays);
  o.ground_rays = std::min(settings.ground_rays, kMaxClipRays);
  return o;
}

namespace {

// What the governor predicts truncation from: the floor under the first pose, which few rays tell
// well enough.
Result<void> add_shadow_probes(PreparedObject& o) {
  if (!o.baked.receiver) return {};
  prt::BakeOptions options;
  options.bands = 1;
  options.bounces = 1;
  options.rays = 64;
  options.ground_rays = 256;
  options.receiver = o.baked.receiver;
  auto baked = prt::bake(o.mesh_at(0), options);
  if (!baked) return fail(baked.error().code, o.name, baked.error().detail);
  o.baked.shadow_probes = std::move(baked->shadow_probes);
  return {};
}

// The texels of a light map are points beyond the vertices, which have no materials.
void take_materials(const Animation& animation, PreparedObject& out) {
  if (!animation.character.surface) return;
  if (animation.layout.texels.empty())
    out.baked.surface = animation.character.surface;
  else
    log_warning("{}: with a light map it is drawn without gloss", out.name);
}

// Sets the object to the clip's begin.
Result<void> start(std::shared_ptr<Animation> animation, PreparedObject& out) {
  animation->layout = prt::lay_out(animation->character, animation->sequence.map_width,
                                   animation->sequence.map_height);
  out.baked.receiver = animation->sequence.receiver;
  take_materials(*animation, out);
  out.animation = std::move(animation);
  out.frame = kNone;
  out.move_to(0, {});
  return add_shadow_probes(out);
}

// In metres from here on. Transfer has no length.
void enlarge(Animation& animation, double scale) {
  const auto k = static_cast<float>(scale);
  animation.character.frame = glm::mat4(glm::mat3(k)) * animation.character.frame;
  if (std::optional<prt::Receiver>& receiver = animation.sequence.receiver) {
    receiver->grid.centre *= k;
    receiver->grid.half_extent *= k;
    receiver->grid.height *= k;
  }
}

// A baked clip stands upright on the plane that it was baked on; transfer has no length, so scaling
// is all.
Result<PreparedObject> place_baked_clip(const SceneObject& o,
                                        const std::vector<prt::Plane>& planes) {
  PENUMBRA_ASSIGN(file, prt::read_sequence_info(o.transfer));
  PENUMBRA_ASSIGN(standing, standing_character(o.asset, o.albedo, o.animation, file.map_width,
                                               file.map_height));
  PENUMBRA_ASSIGN(sequence, prt::read_sequence(o.transfer, standing.character, standing.clip));
  auto animation = std::make_shared<Animation>();
  const glm::mat4 standing_frame = standing.character.frame;
  animation->character = std::move(standing.character);
  animation->clip = standing.clip;
  animation->sequence = std::move(sequence);
  const prt::Bounds room = prt::bounds_of(room_of(*animation));
  const glm::vec3 extent = room.high - room.low;
  const double scale =
      o.place_on_floor ? o.fit_size_m / std::max({extent.x, extent.y, extent.z, 1e-9f}) : o.scale;
  enlarge(*animation, scale);
  const prt::Plane* const plane =
      plane_under(planes, {glm::vec3(o.position), glm::vec3(o.position)});
  PreparedObject out;
  out.name = o.name;
  out.spin_rpm = o.spin_rpm;
  const Pose frame = plane ? frame_on_plane(*plane, o.position) : Pose{{1, 0, 0, 0}, o.position};
  const glm::dvec3 up = glm::conjugate(frame.rotation) * (o.rotation * glm::dvec3(0, 1, 0));
  if (plane && up.y < kUpright)
    return fail(ErrorCode::kInvalid, o.name,
                "has a clip that is baked upright and cannot be tilted: leave transfer out");
  // Where the scene's own bake would put it: by the asset's origin, unless it is stood in the
  // middle.
  const glm::vec4 middle = -standing_frame[3];
  const glm::dvec3 aside =
      o.place_on_floor ? glm::dvec3(0) : o.rotation * (scale * glm::dvec3(middle.x, 0, middle.z));
  out.world_from_bake = {o.rotation, frame.translation + aside};
  if (plane && std::abs(glm::dot(o.position - plane->point, plane->normal)) > 1e-3)
    log_warning("{}: its clip is baked for standing on the floor, so it is placed there", o.name);
  if (!plane) animation->sequence.receiver.reset();  // nothing there to take the shadow
  PENUMBRA_TRY(start(std::move(animation), out));
  return out;
}

}  // namespace

namespace {

struct PlacedCharacter {
  const prt::Plane* plane;  // under it; null: there is none
  double scale;             // metres of its unit
};

// Stands a character in its own units as it stands on its plane: what its bake depends on.
PlacedCharacter place(const SceneObject& o, const std::vector<prt::Plane>& planes,
                      Animation& animation, PreparedObject& out) {
  prt::Character& character = animation.character;
  character.frame = glm::mat4(1);
  const glm::dvec3 up = glm::conjugate(o.rotation) * floor_normal(planes, o.position);
  const prt::Mesh room = room_of(animation, up.y > kUpright);
  prt::Mesh in_world = room;
  prt::transform(in_world, world_from_mesh(o, room, floor_normal(planes, o.position)));
  const prt::Plane* const plane = plane_under(planes, prt::bounds_of(in_world));
  const Standing standing = standing_of(o, room, plane);
  character.frame =
      glm::mat4(glm::translate(glm::dmat4(1), standing.shift) * glm::mat4_cast(standing.tilt));
  out.name = o.name;
  out.spin_rpm = o.spin_rpm;
  out.world_from_bake = standing.world_from_bake;
  return {plane, standing.scale};
}

// Nothing is baked but the first pose, so that there is something to begin with.
Result<PreparedObject> prepare_live(const SceneObject& o, const std::vector<prt::Plane>& planes,
                                    const BakeSettings& settings) {
  PENUMBRA_ASSIGN(character, load_character(o.asset, o.albedo));
  auto animation = std::make_shared<Animation>();
  const auto clip_named = [&](const std::string& key, const std::string& name) -> Result<int> {
    const auto clip = prt::find_clip(character, name);
    if (!clip) return fail(clip.error().code, o.name + ": " + key, clip.error().detail);
    return *clip;
  };
  PENUMBRA_ASSIGN(clip, clip_named("animation", o.animation));
  animation->clip = clip;
  if (!o.blend.empty()) {
    PENUMBRA_ASSIGN(blend, clip_named("blend", o.blend));
    animation->blend = blend;
    animation->blend_weight = static_cast<float>(o.blend_weight);
  }
  refine(character, kLiveEdgeFraction);
  animation->character = std::move(character);
  animation->live = true;
  animation->live_seconds = o.transfer_ms / 1e3;
  animation->bands = settings.bands;
  PreparedObject out;
  const auto [plane, scale] = place(o, planes, *animation, out);
  enlarge(*animation, scale);
  animation->layout = prt::lay_out(animation->character, 0, 0);
  if (plane)
    out.baked.receiver =
        prt::Receiver{prt::fit_ground_grid(room_of(*animation), 0, kLiveGroundSize), plane->albedo};
  log_info(
      "{}: the transfer of {} vertices is traced while the clip plays, for {:g} ms in each frame",
      o.name, animation->layout.points(), o.transfer_ms);
  take_materials(*animation, out);
  out.animation = std::move(animation);
  out.frame = kNone;
  PENUMBRA_TRY(out.begin_live());
  out.move_to(0, {});
  out.live = nullptr;
  PENUMBRA_TRY(add_shadow_probes(out));
  return out;
}

}  // namespace

Result<PreparedObject> prepare_animated(const SceneObject& o, const std::vector<prt::Plane>& planes,
                                        const BakeSettings& settings,
                                        const std::function<void(double)>& progress) {
  if (o.live || !o.blend.empty()) return prepare_live(o, planes, settings);
  if (!o.transfer.empty()) return place_baked_clip(o, planes);
  PENUMBRA_ASSIGN(
      standing, standing_character(o.asset, o.albedo, o.animation, o.light_map[0], o.light_map[1]));
  auto animation =
      std::make_shared<Animation>(playing(std::move(standing.character), standing.clip));
  PreparedObject out;
  const auto [plane, scale] = place(o, planes, *animation, out);
  prt::SequenceOptions options = sequence_options(settings);
  options.map_width = o.light_map[0];
  options.map_height = o.light_map[1];
  if (plane) {
    options.ground_size = kGroundSize;
    options.ground_albedo = plane->albedo;
  }
  options.progress = progress;
  PENUMBRA_ASSIGN(sequence, bake_or_recall(o.name, animation->character, animation->clip, options,
                                           settings.cache));
  animation->sequence = std::move(sequence);
  enlarge(*animation, scale);
  PENUMBRA_TRY(start(std::move(animation), out));
  return out;
}

prt::Mesh PreparedObject::mesh_at(double seconds) const {
  if (!animation) return baked.fine ? baked.fine->mesh : baked.mesh;
  prt::Mesh mesh;
  prt::deform(animation->character, animation->pose_at(seconds), mesh);
  return mesh;
}

Result<void> PreparedObject::begin_live() {
  if (!animation || !animation->live) return {};
  auto bake = prt::LiveBake::create(animation->character, {animation->bands, baked.receiver});
  if (!bake) return fail(bake.error().code, name, bake.error().detail);
  live = std::make_shared<LiveTransfer>(LiveTransfer{std::move(*bake)});
  frame = kNone;
  return {};
}

namespace {

// As many as the time allows after what every frame costs; some at least, or nothing would ever
// change.
std::size_t visits_within(double seconds, const LiveTransfer& live) {
  const auto points = static_cast<double>(live.bake.points());
  const double wanted = live.seconds_a_visit > 0
                            ? (seconds - live.fixed_seconds) / live.seconds_a_visit
                            : .25 * points;
  return static_cast<std::size_t>(std::clamp(wanted, std::max(1., .05 * points), kVisits * points));
}

void trace(const prt::CharacterPose& pose, double seconds, bool keep_time, LiveTransfer& live,
           prt::BakedObject& out) {
  const std::size_t points = live.bake.points();
  const std::size_t visits = !live.begun ? kFirstVisits * points
                             : keep_time ? visits_within(seconds, live)
                                         : kVisits * points;
  const prt::LiveBake::Cost cost = live.bake.update(pose, visits, out);
  const auto running = [&](double mean, double now) {
    return live.seconds_a_visit > 0 ? std::lerp(mean, now, .2) : now;
  };
  live.fixed_seconds = running(live.fixed_seconds, cost.fixed_s);
  live.seconds_a_visit = running(live.seconds_a_visit, cost.rays_s / static_cast<double>(visits));
  live.begun = true;
}

}  // namespace

bool PreparedObject::move_to(double seconds, const MoveOptions& options) {
  if (!animation) return false;
  const prt::BakedSequence& s = animation->sequence;
  const double wanted = animation->live ? seconds : s.frame_at(seconds);
  const float wanted_weight = options.blend_weight.value_or(animation->blend_weight);
  const bool same = wanted == frame && wanted_weight == weight;
  const bool settles = same && options.holds && animation->live && held < kSettling;
  if (same && !settles) return false;
  held = same ? held + 1 : 0;
  frame = wanted, weight = wanted_weight;
  const prt::CharacterPose pose = animation->pose_at(seconds, weight);
  if (animation->live) {
    if (live) trace(pose, animation->live_seconds, options.keep_time, *live, baked);
    return live != nullptr;
  }
  prt::deform(animation->character, pose, baked.mesh);
  prt::add_texels(animation->character, animation->layout, baked.mesh);
  turns = prt::bone_turns(animation->character, pose);
  if (!options.all_transfer) return true;
  s.surface.decode(frame, turns, baked.transfer);
  s.surface_reflected.decode(frame, turns, baked.reflected);
  if (!s.receiver) return true;
  s.ground_deficit.decode(frame, {}, baked.ground_deficit);
  s.ground_reflected.decode(frame, {}, baked.ground_reflected);
  return true;
}

const prt::TransferSequence& PreparedObject::clip_of(TransferPart part) const {
  const prt::BakedSequence& s = animation->sequence;
  switch (part) {
    case TransferPart::kSurface:
      return s.surface;
    case TransferPart::kReflected:
      return s.surface_reflected;
    case TransferPart::kGround:
      return s.ground_deficit;
    case TransferPart::kGroundReflected:
      break;
  }
  return s.ground_reflected;
}

std::span<const glm::mat3> PreparedObject::turns_of(TransferPart part) const {
  const bool on_bones = part == TransferPart::kSurface || part == TransferPart::kReflected;
  return on_bones ? std::span<const glm::mat3>(turns) : std::span<const glm::mat3>();
}

void PreparedObject::relight(TransferPart part, const RadianceSh& light,
                             std::span<float> out) const {
  if (animation && !animation->live)
    return clip_of(part).relight(frame, light, turns_of(part), out);
  switch (part) {
    case TransferPart::kSurface:
      return prt::relight(baked.transfer, light, out);
    case TransferPart::kReflected:
      return prt::relight(baked.reflected, light, out);
    case TransferPart::kGround:
      return prt::relight(baked.ground_deficit, light, out);
    case TransferPart::kGroundReflected:
      return prt::relight(baked.ground_reflected, light, out);
  }
}

}  // namespace penumbra::runtime
