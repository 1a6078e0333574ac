#include "service/animated.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "service/bake_cache.h"

namespace penumbra::service {

namespace {

constexpr float kEdgeShare =
    .06f;                        // of the radius: longest edge where transfer is kept at vertices
constexpr int kGroundSize = 64;  // texels of the shadow basis: renewed in every frame
constexpr int kMostRays = 512, kMostBounces = 2;

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

prt::SequenceOptions sequence_options(const BakeSettings& settings) {
  prt::SequenceOptions o;
  o.bands = settings.bands;
  o.bounces = std::min(settings.bounces, kMostBounces);
  o.rays = std::min(settings.rays, kMostRays);
  o.ground_rays = std::min(settings.ground_rays, kMostRays);
  return o;
}

Result<PreparedObject> prepare_animated(const SceneObject& o, const std::vector<prt::Plane>& planes,
                                        const BakeSettings& settings,
                                        const std::function<void(double)>& progress) {
  auto loaded = load_character(o.asset, o.albedo);
  if (!loaded) return std::unexpected(loaded.error());
  auto animation = std::make_shared<Animation>();
  animation->character = std::move(*loaded);
  prt::Character& character = animation->character;
  const auto clip = prt::find_clip(character, o.animation);
  if (!clip) return fail(clip.error().code, o.asset, clip.error().detail);
  animation->clip = *clip;
  const prt::Clip& played = character.clips[static_cast<std::size_t>(*clip)];
  const prt::Mesh room = room_of(character, played);
  character.frame = glm::mat4(world_from_mesh(o, room)) * character.frame;
  const prt::Bounds in_world = prt::bounds_of(room_of(character, played));
  const prt::Plane* const plane = plane_under(planes, in_world);
  PreparedObject out;
  out.name = o.name;
  out.spin_rpm = o.spin_rpm;
  out.world_from_bake = plane ? frame_on_plane(*plane, o.position) : Pose{{1, 0, 0, 0}, o.position};
  character.frame = glm::mat4(out.world_from_bake.inverse().matrix()) * character.frame;
  // Edges are measured where the vertices are kept, in units of the asset.
  prt::Mesh rest;
  rest.positions = character.positions;
  prt::subdivide(character, kEdgeShare * prt::radius_around(rest, prt::bounds_of(rest).centre()));
  prt::SequenceOptions options = sequence_options(settings);
  if (plane) {
    options.ground_size = kGroundSize;
    options.ground_albedo = plane->albedo;
  }
  options.progress = progress;
  auto sequence = bake_or_recall(o.name, character, *clip, options, settings.use_cache);
  if (!sequence) return std::unexpected(sequence.error());
  animation->sequence = std::move(*sequence);
  out.baked.receiver = animation->sequence.receiver;
  out.animation = std::move(animation);
  out.frame = -1;  // none yet
  out.move_to(0, true);
  return out;
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
