// The front door: cameras, a scene and options in; then environment frames and view frames in,
// light and composited pictures out.
// threads: thread-bound, parallel inside
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/frames.h"
#include "core/environment.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "runtime/pipeline/runs.h"
#include "runtime/scene/scene.h"
#include "runtime/scene/shadow_sampling.h"
#include "runtime/shading/composited.h"
#include "runtime/shading/object_moves.h"

#pragma GCC visibility push(default)
namespace penumbra {

namespace compositor {
class Compositor;
}
namespace runtime {
struct StageAccess;
}

struct PipelineOptions {
  int bands = 5;                  // of spherical harmonics, 1..9; the governor may take fewer
  int max_lights = 8;             // distant lights beside them, 0..64; the governor may take fewer
  double max_shadow_error = .05;  // RMS of the shadow ratio s, which the governor keeps to
  /// The governor's costs are measured on this machine. Else they are fixed, so that a replay makes
  /// the same choices everywhere.
  bool measure_costs = false;
  bool window = false;       // where there is a display
  int oversampling = 2;      // samples of a pixel along each axis, where one does not do
  bool varies_rays = false;  // the mean of successive pictures counts, as of a still's passes
  runtime::ShadowSampling sampling{};
  /// Where stages add their durations, for who shows them from the start; null: the pipeline's own.
  std::shared_ptr<StageTimes> timings;
  runtime::BakeSettings bake{};  // bands: as above
  /// Of long work, by name: is given the fraction that is done, 0..1.
  std::function<std::function<void(double)>(const std::string&)> progress = [](const std::string&) {
    return [](double) {};
  };
};

class Pipeline {
 public:
  /// Whether these cameras give an environment that light can be measured from: before long work
  /// that would be lost.
  /// errors: kInvalid (says what is wrong with them)
  static Result<void> check(const std::vector<capture::CameraInfo>& cameras);

  /// Loads the scene and bakes what the cache does not hold. Without a camera that shows the
  /// surroundings the light is set by set_light().
  /// in: at least one view camera; all of one size, pinholes
  /// errors: kInvalid, kNotFound, kUnreadable (what the cameras and the assets say), kUnavailable
  ///         (no OpenGL ES, no Embree)
  static Result<Pipeline> create(const std::vector<capture::CameraInfo>& cameras,
                                 const runtime::Scene& scene, const PipelineOptions& options = {});
  /// For a scene that is loaded and baked already; several pipelines may share it.
  static Result<Pipeline> create(const std::vector<capture::CameraInfo>& cameras,
                                 std::shared_ptr<const runtime::PreparedScene> scene,
                                 const PipelineOptions& options = {});
  ~Pipeline();
  Pipeline(Pipeline&&) noexcept;
  Pipeline& operator=(Pipeline&&) noexcept;

  /// Whether frames of this camera go to add_environment(). A mirror ball in its picture makes a
  /// view camera both.
  bool shows_surroundings(int camera) const;
  /// Merges an exposure into the environment and measures its light anew.
  /// out: false where the frame tells nothing yet (all black, all saturated)
  /// errors: kInvalid (size or camera of the frame), kNonFinite
  Result<bool> add_environment(const capture::Frame& frame);
  /// The light to composite under, from elsewhere; the next add_environment() replaces it.
  void set_light(const lighting::LightEstimate& light);
  /// Real things in front of what is virtual, from a camera with the role depth or mask: for view
  /// frames at most a quarter of a second away.
  /// errors: kInvalid (size or camera of the frame, depth that is not of 16 bits)
  Result<void> add_foreground(const capture::Frame& frame);
  /// Puts the objects into a view frame. Before there is light the frame comes back as it is, and
  /// so does one that was taken for its light: see Composited::darker_view.
  /// errors: kInvalid (size or camera of the frame), kUnavailable (OpenGL ES)
  Result<runtime::Composited> composite(const capture::Frame& view);

  /// Puts an object elsewhere on the plane that it stands on, or above it, turned and leaning, from
  /// the next frame on. Nothing is baked for it. In a live run an object that was not lifted before
  /// is lit as on its plane for about a second.
  /// threads: any, also during a run
  /// errors: as runtime::ObjectMoves::put
  Result<void> move_object(std::string_view object, const runtime::ObjectPlace& place);
  /// Takes an object and all that it does to the light out of the picture, or puts it back, from
  /// the next frame on.
  /// threads: any, also during a run
  /// errors: kNotFound (no such object)
  Result<void> show_object(std::string_view object, bool visible);
  /// From the next frame on a clip goes on from another time, at another speed, backwards or not at
  /// all, and two clips blend by another weight. So does a turntable.
  /// threads: any, also during a run
  /// errors: kNotFound (no such object), kNonFinite, kInvalid (it plays nothing; a bad weight)
  Result<void> play_object(std::string_view object, const runtime::ObjectPlayback& playback);
  /// As move_object() over time, by the times of the view frames.
  Result<void> follow(const runtime::ObjectTrack& track);
  /// The scene's objects as they are now.
  /// threads: any, also during a run
  std::vector<runtime::ObjectState> objects() const;
  /// Another scene in the place of this one, from one of the next frames on: objects are added,
  /// taken away, or baked more finely. Those that stay, by name, stay where they are and go on with
  /// what they do, and so does the light. All that is slow is done here, on the caller's thread,
  /// while the pipeline goes on. Of two that come between two frames the newer one counts.
  /// in: loaded by runtime::prepare and no other pipeline's; the sun is that of the first scene
  /// threads: any, also during a run
  /// errors: kUnavailable (a pipeline with a window keeps its scene; OpenGL ES, Embree); the scene
  ///         before it stays
  Result<void> change_scene(runtime::PreparedScene scene);

  /// The error that the governor keeps to, from the next light on.
  /// threads: any, also during a run
  /// errors: kInvalid (not above 0 and at most 1)
  Result<void> set_max_shadow_error(double error);
  double max_shadow_error() const;
  /// Is given each light of a live run and the map that it comes from, on the light's own thread,
  /// which waits for it. The light holds all that it needs, also where frames have the time for
  /// fewer lights (lighting::keep_affordable). Set before the run.
  using LightWatch = std::function<void(const Environment&, const lighting::LightEstimate&)>;
  void watch_light(LightWatch watch);
  /// Is called during a live run on its own thread at least twice a second, also while no frame
  /// comes. Set before the run.
  void watch_turns(std::function<void()> turn);

  /// All frames of a source in order of time on this thread: with a new pipeline the same input
  /// gives the same bytes. light() stays as it was before.
  /// errors: as runtime::run_replay, kInvalid (no camera shows the surroundings, a sun without the
  ///         time at which it was filmed)
  Result<runtime::RunCounts> replay(capture::FrameSource& source, const runtime::Sink& sink);
  /// The source at its own pace and the light on threads of their own, compositing on this one,
  /// until the source ends, the sink returns false or `stop` is set. light() stays as it was
  /// before.
  /// errors: as runtime::run_live, kInvalid (no camera shows the surroundings)
  Result<runtime::RunCounts> run_live(capture::FrameSource& source, const runtime::Sink& sink,
                                      const std::atomic<bool>& stop);

  const lighting::LightEstimate& light() const;
  std::optional<lighting::Plan> plan() const { return light().plan; }
  const StageTimes& timings() const;
  /// For stages of the caller's own, beside the pipeline's.
  /// threads: thread-safe
  StageTimes& timings();
  /// Of one that the pipeline has loaded itself still objects keep no transfer, which the pipeline
  /// holds in another form.
  /// threads: not during a run that changes it
  const runtime::PreparedScene& scene() const;
  /// What draws; it shows pictures where has_window().
  compositor::Compositor& output();

 private:
  friend struct runtime::StageAccess;
  struct Impl;
  explicit Pipeline(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
#pragma GCC visibility pop
