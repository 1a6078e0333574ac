// Objects that move by themselves: characters with a clip.
// threads: free functions reentrant
#pragma once

#include <functional>
#include <vector>

#include "core/result.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// World frame of a plane's bake frame: y along the normal, at the foot of `position`.
Pose frame_on_plane(const prt::Plane& plane, const glm::dvec3& position);
/// The plane that an object stands on: the nearest one that it is in front of, with a part of it at
/// least; null: none.
const prt::Plane* plane_under(const std::vector<prt::Plane>& planes, const prt::Bounds& bounds);

/// A character by file or "builtin:walker". Log lines tell what was dropped or bound otherwise.
/// errors: as prt::import_character; kNotFound (no such built-in character)
Result<prt::Character> load_character(const std::string& asset, Rgb albedo);

/// A character as baked files know it: it stands on y = 0, in the middle of the room that its clip
/// takes, with vertices dense enough for transfer, or with coordinates for a light map of that
/// size.
/// errors: as load_character; the clip's
struct StandingCharacter {
  prt::Character character;
  int clip = 0;
};
Result<StandingCharacter> standing_character(const std::string& asset, Rgb albedo,
                                             const std::string& animation, int map_width,
                                             int map_height);

/// Frames a second, rays and the like that a clip is baked with for a scene.
prt::SequenceOptions sequence_options(const BakeSettings& settings);

/// Places a character by the room that its clip takes, bakes the clip or recalls it, and sets it to
/// time 0.
/// errors: of the asset, the clip (names those that there are) and the bake
Result<PreparedObject> prepare_animated(const SceneObject& object,
                                        const std::vector<prt::Plane>& planes,
                                        const BakeSettings& settings,
                                        const std::function<void(double)>& progress);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
