// Where objects are put while a pipeline runs, by call or by a track over time, and which are there
// at all.
#pragma once

#include <filesystem>
#include <glm/vec3.hpp>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/pose.h"
#include "core/result.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// A place on the plane that an object stands on, or above it, and how it is turned there from how
/// the scene has it.
struct ObjectPlace {
  glm::dvec3 position_m{0, 0, 0};  // as far off the plane as the object is lifted
  double turn_rad = 0;             // about the plane's normal
  /// Then it leans, about its middle: 0 towards its own z, pi/2 towards its x. Its lowest point
  /// stays at its height.
  double lean_rad = 0, lean_towards_rad = 0;
};

/// How an object plays its clip and turns on its turntable, from the next frame on. What is not
/// given stays as it was; at first it plays at speed 1.
struct ObjectPlayback {
  std::optional<double> clip_time_s{};   // where it is then; nothing: where it has come to
  std::optional<double> speed{};         // seconds of the clip a second: 0 rests, below 0 goes back
  std::optional<double> blend_weight{};  // 0..1 of a second clip
};

/// An object as it is now, for who shows and moves it.
struct ObjectState {
  std::string name;
  ObjectPlace place;
  bool visible = true;
  bool on_plane = true;           // it stands on one, or over it
  double height_m = 0;            // of its place over where its bake stands
  bool lifts = true;              // it may be lifted and leaned: it has no clip
  bool plays = false;             // a clip or a turntable
  double speed = 1;               // of that
  glm::dvec3 rest_position_m{0};  // where its scene has it
  glm::dvec3 normal{0, 1, 0};     // of the plane that it stands on
  glm::dvec3 forward{0, 0, 1};    // its own z as turned, before it leans and spins
  Pose world_from_bake;           // with its turntable's turn
  glm::dvec3 centre_m{0};         // of a sphere around it
  double radius_m = 0;
};

/// Places over time of some objects; between two of an object's it glides and turns evenly, before
/// the first and after the last it rests there.
struct ObjectTrack {
  struct TrackKey {
    double time_s = 0;  // as frames count it
    std::string object;
    ObjectPlace place;
  };
  std::vector<TrackKey> keys;  // of each object in order of time
};

/// A CSV file: time_s,object,x_m,y_m,z_m,turn_deg and, where anything leans,
/// lean_deg,lean_towards_deg.
/// errors: kNotFound, kInvalid (file and line: a number, a time out of order)
Result<ObjectTrack> read_object_track(const std::filesystem::path& path);

/// threads: thread-safe
class ObjectMoves {
 public:
  /// The scene must outlive it.
  explicit ObjectMoves(const PreparedScene& scene);
  /// In effect with the next frame, until another place or track comes. A turntable goes on
  /// turning.
  /// Within a centimetre of the plane, or .04 of its radius, an object is lit as on it.
  /// errors: kNotFound (no such object: says which there are), kNonFinite, kInvalid (below the
  ///         plane; over 10,000 m away; an object with a clip that is lifted or leans)
  Result<void> put(std::string_view object, const ObjectPlace& place);
  /// Objects without a key in it stay where they are.
  /// errors: as put(), by the key's time; kInvalid (an object's times are not in order)
  Result<void> follow(const ObjectTrack& track);
  /// Takes an object out of the world, or puts it back to where it would be by now.
  /// errors: kNotFound
  Result<void> show(std::string_view object, bool visible);
  /// errors: kNotFound, kNonFinite, kInvalid (an object without clip or turntable; a weight outside
  ///         0..1, or of an object without a second clip)
  Result<void> play(std::string_view object, const ObjectPlayback& playback);
  struct ObjectNow {
    bool visible;
    // Of one that is not, so far below its plane that it takes part in nothing
    Pose world_from_bake;
    Pose world_from_floor;      // where it would be as its bake has it: on its plane, upright
    bool lifted;                // it leans, or is so high that it is lit as such
    double clip_time_s, speed;  // of its clip and turntable
    std::optional<float> blend_weight;  // nothing: as the scene has it
  };
  /// A playback that was asked for begins with the first time it is asked after.
  ObjectNow at(std::size_t object, double seconds);
  /// The time that at() was last asked for.
  double now_s() const;
  /// As at() last gave them, with what was asked for since.
  std::vector<ObjectState> states() const;
  /// Whether it is lifted or leans where at() last had it.
  bool is_lifted(std::size_t object) const;
  /// Objects that were there before, by name and instance, stay where they are and go on with what
  /// they do. One that stands on another plane now begins as its own scene has it.
  void go_on_from(const ObjectMoves& before);

 private:
  struct TimedPlace {
    double time_s;
    ObjectPlace place;
  };
  // As the scene has it. Others change an object while it plays.
  struct Resting {
    std::string name;
    unsigned instance;
    Pose world_from_bake;
    bool on_plane;
    bool plays, blends, has_clip;
    glm::dvec3 centre_m;  // in the bake frame
    double radius_m;
  };
  struct Playing {
    double since_s = 0, from_s = 0, speed = 1;  // at since_s it was at from_s
    std::optional<float> blend_weight{};
    std::optional<ObjectPlayback> next{};
    double clip_time_at(double seconds) const { return from_s + speed * (seconds - since_s); }
  };
  Result<std::size_t> index_of(std::string_view object) const;
  Result<void> check(std::size_t object, const ObjectPlace& place) const;
  struct ObjectPoses {
    Pose world_from_bake, world_from_floor;
    bool lifted = false;
  };
  ObjectPoses pose_at(std::size_t object, const ObjectPlace& place, double turntable_s) const;
  ObjectPoses placed(std::size_t object, double seconds, double turntable_s) const;
  Pose leaning(std::size_t object, const ObjectPlace& place, const Pose& spun) const;
  ObjectPlace place_at(std::size_t object, double seconds) const;
  std::optional<ObjectPlace> carried(std::size_t object, const Resting& before,
                                     ObjectPlace place) const;
  const Playing& play_on(std::size_t object, double seconds);
  const PreparedScene& scene_;
  std::vector<Resting> resting_;
  mutable std::mutex mutex_;
  std::vector<std::vector<TimedPlace>> places_;  // by object; empty: as the scene has it
  std::vector<char> visible_;                    // by object
  std::vector<Playing> playing_;                 // by object
  double now_s_ = 0;                             // that at() was last asked for
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
