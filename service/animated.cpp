#include "service/animated.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "service/bake_cache.h"

namespace penumbra::service {

namespace {

constexpr float kEdgeShare =
    .03f;                        // of the radius: longest edge where transfer is kept at vertices
constexpr int kGroundSize = 64;  // texels of the shadow basis: renewed in every frame
constexpr int kMostRays = 512;

// The room that a clip takes, as a mesh of corners.
prt::Mesh room_of(const prt::Character& character, const prt::Clip& clip) {
  constexpr int kLooks = 32;
  prt::Mesh mesh, room;
  for (int i = 0; i < (clip.seconds > 0 ? kLooks : 1); ++i) {
    prt::deform(character, prt::sample(character, clip, clip.seconds * i / kLooks), mesh);
    const prt::Bounds b = prt::bounds_of(mesh);
    room.positions.insert(room.positions.end(), {b.low, b.high});
  }
  return room;
}

}  // namespace

Result<prt::Character> load_character(const std::string& asset, Rgb albedo) {
  if (asset == "builtin:walker") return prt::make_walker(albedo);
  if (asset.starts_with("builtin:"))
    return fail(ErrorCode::kNotFound, asset, "does not move; builtin:walker does");
  auto character = prt::import_character(asset, albedo);
  if (!character) return character;
  if (character->degenerate_triangles > 0)
    spdlog::warn("{}: {} degenerate triangles dropped", asset, character->degenerate_triangles);
  if (character->unbound_vertices > 0)
    spdlog::warn("{}: {} vertices hang on no joint and follow the first", asset,
                 character->unbound_vertices);
  return character;
}

Result<StandingCharacter> standing_character(const std::string& asset, Rgb albedo,
                                             const std::string& animation, int map_width,
                                             int map_height) {
  PENUMBRA_ASSIGN(character, load_character(asset, albedo));
  const auto clip = prt::find_clip(character, animation);
  if (!clip) return fail(clip.error().code, asset, clip.error().detail);
  const prt::Bounds room =
      prt::bounds_of(room_of(character, character.clips[static_cast<std::size_t>(*clip)]));
  character.frame = glm::mat4(1);
  character.frame[3] = glm::vec4(-room.centre().x, -room.low.y, -room.centre().z, 1);
  if (map_width > 0) {
    character = prt::for_light_map(std::move(character), map_width, map_height);
  } else {
    // Edges are measured where the vertices are kept, in units of the asset.
    prt::Mesh rest;
    rest.positions = character.positions;
    prt::subdivide(character, kEdgeShare * prt::radius_around(rest, prt::bounds_of(rest).centre()));
  }
  return StandingCharacter{std::move(character), *clip};
}

prt::SequenceOptions sequence_options(const BakeSettings& settings) {
  prt::SequenceOptions o;
  o.bands = settings.bands;
  o.bounces = settings.bounces;
  o.rays = std::min(settings.rays, kMostRays);
  o.ground_rays = std::min(settings.ground_rays, kMostRays);
  return o;
}

namespace {

// Sets the object to the clip's begin.
void start(std::shared_ptr<Animation> animation, PreparedObject& out) {
  animation->layout = prt::lay_out(animation->character, animation->sequence.map_width,
                                   animation->sequence.map_height);
  out.baked.receiver = animation->sequence.receiver;
  out.animation = std::move(animation);
  out.frame = -1;  // none yet
  out.move_to(0, true);
}

// A baked clip stands upright on the plane that it was baked on; transfer has no length, so scaling is all.
Result<PreparedObject> place_baked_clip(const SceneObject& o,
                                        const std::vector<prt::Plane>& planes) {
  PENUMBRA_ASSIGN(size, prt::light_map_size(o.transfer));
  PENUMBRA_ASSIGN(standing,
                  standing_character(o.asset, o.albedo, o.animation, size.width, size.height));
  PENUMBRA_ASSIGN(sequence, prt::read_sequence(o.transfer, standing.character, standing.clip));
  auto animation = std::make_shared<Animation>();
  const glm::mat4 standing_frame = standing.character.frame;
  animation->character = std::move(standing.character);
  animation->clip = standing.clip;
  animation->sequence = std::move(sequence);
  const prt::Bounds room = prt::bounds_of(room_of(
      animation->character, animation->character.clips[static_cast<std::size_t>(animation->clip)]));
  const glm::vec3 extent = room.high - room.low;
  const double scale =
      o.stand ? o.stand_size_m / std::max({extent.x, extent.y, extent.z, 1e-9f}) : o.scale;
  animation->character.frame =
      glm::mat4(glm::mat3(static_cast<float>(scale))) * animation->character.frame;
  const prt::Plane* const plane =
      plane_under(planes, {glm::vec3(o.position), glm::vec3(o.position)});
  PreparedObject out;
  out.name = o.name;
  out.spin_rpm = o.spin_rpm;
  const Pose frame = plane ? frame_on_plane(*plane, o.position) : Pose{{1, 0, 0, 0}, o.position};
  const glm::dvec3 up = glm::conjugate(frame.rotation) * (o.rotation * glm::dvec3(0, 1, 0));
  if (plane && up.y < .9999)
    return fail(
        ErrorCode::kInvalid, o.name,
        "its clip is baked for standing upright and cannot be tilted; leave `transfer` out");
  // Where the scene's own bake would put it: by the asset's origin, unless it is stood in the middle.
  const glm::vec4 middle = -standing_frame[3];
  const glm::dvec3 aside =
      o.stand ? glm::dvec3(0) : o.rotation * (scale * glm::dvec3(middle.x, 0, middle.z));
  out.world_from_bake = {o.rotation, frame.translation + aside};
  if (plane && std::abs(glm::dot(o.position - plane->point, plane->normal)) > 1e-3)
    spdlog::warn("{}: its clip is baked for standing on the floor, and there it stands", o.name);
  if (std::optional<prt::Receiver>& receiver = animation->sequence.receiver) {
    const auto k = static_cast<float>(scale);
    receiver->grid.centre *= k;
    receiver->grid.half_extent *= k;
    receiver->grid.height *= k;
    if (!plane) receiver.reset();  // nothing there to take the shadow
  }
  start(std::move(animation), out);
  return out;
}

}  // namespace

Result<PreparedObject> prepare_animated(const SceneObject& o, const std::vector<prt::Plane>& planes,
                                        const BakeSettings& settings,
                                        const std::function<void(double)>& progress) {
  if (!o.transfer.empty()) return place_baked_clip(o, planes);
  auto standing =
      standing_character(o.asset, o.albedo, o.animation, o.light_map[0], o.light_map[1]);
  if (!standing) return std::unexpected(standing.error());
  auto animation = std::make_shared<Animation>();
  animation->character = std::move(standing->character);
  animation->clip = standing->clip;
  prt::Character& character = animation->character;
  character.frame = glm::mat4(1);  // placed by the scene
  const prt::Clip& played = character.clips[static_cast<std::size_t>(animation->clip)];
  const prt::Mesh room = room_of(character, played);
  character.frame = glm::mat4(world_from_mesh(o, room)) * character.frame;
  const prt::Bounds in_world = prt::bounds_of(room_of(character, played));
  const prt::Plane* const plane = plane_under(planes, in_world);
  PreparedObject out;
  out.name = o.name;
  out.spin_rpm = o.spin_rpm;
  out.world_from_bake = plane ? frame_on_plane(*plane, o.position) : Pose{{1, 0, 0, 0}, o.position};
  character.frame = glm::mat4(out.world_from_bake.inverse().matrix()) * character.frame;
  prt::SequenceOptions options = sequence_options(settings);
  options.map_width = o.light_map[0];
  options.map_height = o.light_map[1];
  if (plane) {
    options.ground_size = kGroundSize;
    options.ground_albedo = plane->albedo;
  }
  options.progress = progress;
  auto sequence = bake_or_recall(o.name, character, animation->clip, options, settings.use_cache);
  if (!sequence) return std::unexpected(sequence.error());
  animation->sequence = std::move(*sequence);
  animation->layout =
      prt::lay_out(character, animation->sequence.map_width, animation->sequence.map_height);
  out.baked.receiver = animation->sequence.receiver;
  out.animation = std::move(animation);
  out.frame = -1;  // none yet
  out.move_to(0, true);
  return out;
}

prt::Mesh PreparedObject::mesh_at(double seconds) const {
  if (!animation) return baked.mesh;
  prt::Mesh mesh;
  const prt::Clip& clip = animation->character.clips[static_cast<std::size_t>(animation->clip)];
  prt::deform(animation->character, prt::sample(animation->character, clip, seconds), mesh);
  return mesh;
}

bool PreparedObject::move_to(double seconds, bool transfer) {
  if (!animation) return false;
  const prt::BakedSequence& s = animation->sequence;
  const prt::Clip& clip = animation->character.clips[static_cast<std::size_t>(animation->clip)];
  const double wanted = s.frame_at(seconds);
  if (wanted == frame) return false;
  frame = wanted;
  const prt::CharacterPose pose = prt::sample(animation->character, clip, seconds);
  prt::deform(animation->character, pose, baked.mesh);
  prt::add_texels(animation->character, animation->layout, baked.mesh);
  turns = prt::bone_turns(animation->character, pose);
  if (!transfer) return true;
  s.surface.decode(frame, turns, baked.transfer);
  s.surface_indirect.decode(frame, turns, baked.indirect);
  if (!s.receiver) return true;
  s.ground_deficit.decode(frame, {}, baked.ground_deficit);
  s.ground_indirect.decode(frame, {}, baked.ground_indirect);
  return true;
}

void PreparedObject::relight(Part part, const RadianceSh& light, std::span<float> out) const {
  if (animation) {
    const prt::BakedSequence& s = animation->sequence;
    switch (part) {
      case Part::kSurface:
        return s.surface.relight(frame, light, turns, out);
      case Part::kReflected:
        return s.surface_indirect.relight(frame, light, turns, out);
      case Part::kGround:
        return s.ground_deficit.relight(frame, light, {}, out);
      case Part::kGroundReflected:
        return s.ground_indirect.relight(frame, light, {}, out);
    }
  }
  switch (part) {
    case Part::kSurface:
      return prt::relight(baked.transfer, light, out);
    case Part::kReflected:
      return prt::relight(baked.indirect, light, out);
    case Part::kGround:
      return prt::relight(baked.ground_deficit, light, out);
    case Part::kGroundReflected:
      return prt::relight(baked.ground_indirect, light, out);
  }
}

}  // namespace penumbra::service
