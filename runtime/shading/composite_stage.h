// The way of one frame, in two stages that meet in a LightEstimate: the light at environment-camera
// rate, the composite at view-camera rate. Live and replay call the same two functions.
// threads: each stage is thread-bound; CompositeStage owns the GL context of its thread
#pragma once

#include <array>
#include <functional>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <memory_resource>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "capture/frames.h"
#include "compositor/composite/compositor.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/saturation_recovery.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/transfer/transfer_pca.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/direct/lamp_stage.h"
#include "runtime/direct/open_planes.h"
#include "runtime/direct/real_surface_stage.h"
#include "runtime/direct/scene_light.h"
#include "runtime/foreground/foreground_stage.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composited.h"
#include "runtime/shading/floor_recovery.h"
#include "runtime/shading/free_transfer.h"
#include "runtime/shading/mirrored_objects.h"
#include "runtime/shading/mirrored_surroundings.h"
#include "runtime/shading/object_moves.h"
#include "runtime/surroundings/ground_probes.h"
#include "runtime/surroundings/irradiance_cache.h"
#include "runtime/surroundings/lifted_ground.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "runtime/surroundings/plane_light.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

/// A frame that has been begun, apart from the stage.
class PendingFrame {
 public:
  /// The rest of its composite.
  /// threads: any, while the stage goes on
  Composited finish();

 private:
  friend class CompositeStage;
  compositor::Drawn drawn_;
  std::shared_ptr<const FramePixels> camera_;
  bool relit_ = false;
  float opacity_ = 1;
  double drawing_ms_ = 0;
  StageTimes* times_ = nullptr;
};

/// What a thing that keeps its form is relit by: its transfer and what comes to it by reflection,
/// and both of its receiver.
struct RelightBases {
  prt::TransferPca surface, ground;
  explicit RelightBases(const prt::BakedObject& baked);
  /// own: kSurface or kGround
  const prt::TransferPca& of(PreparedObject::TransferPart own) const {
    return own == PreparedObject::TransferPart::kSurface ? surface : ground;
  }
};

/// Frees what RelightBases stand for once they are made: most of an object's memory. Of the
/// receiver's deficit the first channel stays, for shadows that meet. Clips keep all.
void drop_coefficients(PreparedScene& scene);

/// Asks the camera of a frame for one more, at a factor of the exposure of all others. False where
/// there will be none.
using AskForDarker = std::function<bool(double factor)>;

/// View frames and light in, composited frames out.
class CompositeStage {
 public:
  /// errors: kInvalid (no view camera, view cameras of different sizes, as ViewLens::create),
  ///         kUnavailable
  static Result<std::unique_ptr<CompositeStage>> create(
      const std::vector<capture::CameraInfo>& cameras, const PreparedScene& scene,
      compositor::Compositor::Surface surface, StageTimes& times, int oversampling = 2,
      const ShadowSampling& sampling = {});

  /// Draws once and throws it away: drivers compile shaders at the first draw, which costs a live
  /// run frames.
  void warm_up();
  /// Composites one view frame under `light`.
  /// out:    keeps its memory: once it has had a frame nothing comes from the heap, without real
  ///         meshes, several planes, lamps, materials, clips and turntables (whose shadows grow now
  ///         and then), but for the first time that something keeps a light from an object
  /// errors: as Compositor::composite
  Result<void> process(const capture::Frame& frame, const lighting::LightEstimate& light,
                       Composited& out);
  Result<Composited> process(const capture::Frame& frame, const lighting::LightEstimate& light) {
    Composited out;
    PENUMBRA_TRY(process(frame, light, out));
    return out;
  }
  /// process() but for what needs the stage no more. The stage must outlive the frame.
  /// scene_time: of what moves; both eyes of one moment have the same
  Result<void> draw(const capture::Frame& frame, const lighting::LightEstimate& light,
                    TimestampNs scene_time, PendingFrame& out);
  /// A frame of a depth camera or of a mask: what it shows is in front from the next view frame on,
  /// for a quarter of a second.
  /// errors: as ForegroundStage::add
  Result<void> add_foreground(const capture::Frame& frame) { return foreground_.add(frame); }
  /// Of the same cameras, with another scene: what stands in front of that one's next frame stands
  /// in front of this one's.
  void go_on_from(const CompositeStage& before) { foreground_.go_on_from(before.foreground_); }
  /// What is lifted or leans has its own transfer from the first frame on. Takes a second for each.
  void await_lifted();
  compositor::Compositor& output() { return *compositor_; }
  /// From then on another thread may use it, the only one then.
  void release() { compositor_->release(); }
  /// Where objects are put from the next frame on.
  ObjectMoves& moves() { return moves_; }
  /// What sources of `light` that are saturated in every exposure really send, where this frame can
  /// tell; empty where it cannot. Where it overexposes the floor, a darker one is asked for.
  std::vector<lighting::SaturationRecovery> recover_lights(const capture::Frame& frame,
                                                           const lighting::LightEstimate& light,
                                                           const AskForDarker& ask);
  /// The part of process() that depends on the light: relights objects and renews shadows where
  /// something changed visibly.
  /// camera: of the frame; a second one at the same time sees what the first one does
  bool shade(const lighting::LightEstimate& light, double seconds, int camera = 0);
  /// From now on time counts: what is traced live keeps to its own. Before, results are the same on
  /// every machine.
  void keep_time() {
    keeps_time_ = true;
    mirrored_objects_.keep_time();
  }
  /// As MirroredObjects::vary_rays.
  void vary_rays() { mirrored_objects_.vary_rays(); }

 private:
  static constexpr double kDarker = 1. / 8;  // exposure of the first darker frame
  static constexpr int kOwnBounces = 3;      // of a shaded floor's light on an object
  static constexpr double kDeepShade = .4;   // of the light that floor and object send in the open
  // In the bake frame of an object that stands on its floor: of a lifted one, in the floor's.
  struct ObjectLight {
    RadianceSh open, local;  // local: with real things in it as the object's surface sees it
    // By probe: irradiance/pi by what stands around less that by the local light in its place, and
    // what of the local light floor and object send here, by the bake and past what stands around
    std::array<Rgb, OcclusionProbes::kProbes> around{};
    OcclusionProbes::Values reflected{}, reflected_left{};
    float left(std::size_t probe) const {
      return reflected[probe] > 0 ? reflected_left[probe] / reflected[probe] : 1;
    }
    RadianceSh lights{1};  // for the light that object and floor reflect; 1 band without lights
    RadianceSh reaching_lights{1};  // what of them comes to the object past others, as a whole
    Rgb distant_irradiance;         // of the open receiver
  };
  // What stands in for the bake of an object while it is off its floor or leans.
  struct Lifted {
    std::shared_ptr<FreeTransfer> free;  // of all copies that share their transfer
    LiftedGround ground;
    bool used_free = false;                                             // by the last update
    lighting::ShRotation to_bake{glm::dmat3(1), prt::kReflectedBands};  // from the floor's frame
  };
  struct StageObject {
    const PreparedObject* prepared;
    int handle;
    bool lifted_now = false;           // ObjectNow::lifted
    bool other_stance = false;         // over its floor, than it was last lit for
    std::unique_ptr<Lifted> lifted{};  // once it was
    bool visible = true;
    double clip_time_s = 0;
    std::optional<float> blend_weight{};  // nothing: as the scene has it
    bool holds = false;                   // its clip stands still
    std::optional<ObjectLight> light_used{};
    // Of all copies that share their transfer; none of an animation
    std::shared_ptr<const RelightBases> bases{};
    std::vector<float> relit{};                // irradiance/pi of the object's vertices
    std::vector<float> deficit{};              // of the receiver's irradiance/pi
    std::vector<float> more{};                 // scratch: what is added to either
    shadows::PlanarShadow shadow{}, shared{};  // alone, and without what others before it take
    bool shares = false;
    Rgb of_open{1, 1, 1};             // the local light on the floor, over that of the open floor
    std::optional<Pose> pose_used{};  // as last shaded
    // The residual that it was last lit by, and what light_at() last saw around it
    std::optional<RadianceSh> residual_used{};
    std::optional<Pose> pose_seen{};
    std::uint32_t hits_seen = 0;
    bool renewed = false;  // in this update
    bool has_lights() const { return light_used && light_used->lights.bands() > 1; }
    const shadows::PlanarShadow& shown() const { return shares ? shared : shadow; }
  };
  struct ViewCamera {
    capture::CameraInfo info;
    Vignetting vignetting;
    double min_fraction;  // of the light that the lens leaves anywhere
    std::shared_ptr<const compositor::ViewLens> lens{};
    std::optional<ResponseTable> curve8{}, curve16{};
    double darker_factor = kDarker;  // of the next frame for light
  };

  CompositeStage(std::unique_ptr<compositor::Compositor> compositor, DirectLightStage lights,
                 FloorRecovery recovery, ForegroundStage foreground,
                 MirroredObjects mirrored_objects, const PreparedScene& scene,
                 std::unique_ptr<PreparedScene> moving, StageTimes& times);
  Result<void> add_camera(const capture::CameraInfo& info);
  std::shared_ptr<const RelightBases> bases_of(const prt::BakedObject& baked) const;
  static bool differs_visibly(const RadianceSh& before, const RadianceSh& now);
  static bool differs_visibly(const ObjectLight& before, const ObjectLight& now);
  bool may_differ(std::size_t index, const RadianceSh& residual, const Pose& pose) const;
  ObjectLight light_at(std::size_t index, const lighting::LightEstimate& light,
                       const std::vector<Pose>& poses) const;
  void see_surroundings(std::size_t index, const lighting::LightEstimate& light,
                        const std::vector<Pose>& poses, const lighting::ShRotation& turn,
                        ObjectLight& out) const;
  struct FloorLight {     // of the open floor's residual
    float counted, left;  // by the bake, and past what stands around
  };
  struct FloorShadow {
    const shadows::PlanarShadow* shadow;
    const prt::GroundGrid* grid;
    glm::dmat3 turn;  // and shift: the bake frame from the world's
    glm::dvec3 shift;
    float of_open;  // as Compositor::set_light
    bool real = false;
    // Of the object that is looked from: what its bake counts on
    const shadows::PlanarShadow* counted = nullptr;
  };
  void find_floor_shadows(std::size_t index, std::pmr::vector<FloorShadow>& out) const;
  static FloorLight floor_at(const glm::vec3& point, std::span<const FloorShadow> floor_shadows,
                             float local, float open, float all);
  glm::dvec3 lit_centre(std::size_t index, const Pose& pose) const;
  static lighting::DistantLight lamp_as_distant(const shadows::Lamp& lamp,
                                                const glm::dvec3& centre);
  float lit_fraction(std::size_t source, std::size_t index, const Pose& pose) const;
  void add_distant_lights(std::size_t index, const lighting::LightEstimate& light, const Pose& pose,
                          ObjectLight& out) const;
  const Pose& floor_of(std::size_t object) const { return floors_[object]; }
  Rgb exit_of(const ProbeHit& hit) const;
  // Without, and with what virtual things do
  PlaneLight::Radiance exit_of_real(const RealPoint& at) const;
  Rgb exit_of_object(std::size_t object, std::uint32_t vertex) const;
  RadianceSh with_real_things(const RadianceSh& light, std::size_t index) const;
  void relight(StageObject& object, const ObjectLight& light, std::size_t index,
               const lighting::LightEstimate& estimate, const Pose& pose);
  struct SentLight;
  SentLight sent_at_probes(std::size_t light_index, std::size_t index,
                           const lighting::DistantLight& source, const Pose& pose) const;
  void correct_reflected(StageObject& object, const ObjectLight& light, std::size_t index,
                         const lighting::LightEstimate& estimate, const Pose& pose);
  void relight_parts(StageObject& object, PreparedObject::TransferPart own, const RadianceSh& light,
                     const RadianceSh* reflected, std::span<float> out) const;
  void look_at_lifted();
  void begin_lifted(StageObject& object);
  void relight_lifted(StageObject& object, const RadianceSh& light, const RadianceSh* reflected,
                      std::span<float> out) const;
  void relight_lifted_reflected(const StageObject& object, const RadianceSh& light,
                                std::span<float> out) const;
  void relight_from_places(const StageObject& object,
                           const std::array<RadianceSh, LiftedGround::kPlaces>& around,
                           std::span<float> out) const;
  static void add_own_reflection(const StageObject& object, const RadianceSh& light,
                                 std::span<float> out);
  void relight_reflected(const StageObject& object, PreparedObject::TransferPart own,
                         const RadianceSh& light, std::span<float> out) const;
  void compose_shadow(std::size_t index, const lighting::LightEstimate& estimate, const Pose& pose,
                      const ObjectLight& light);
  void take_by_bake(std::size_t index, const lighting::LightEstimate& estimate, const Pose& pose,
                    const ObjectLight& light);
  void take_what_is_behind(std::size_t index, const RadianceSh& sky, const Pose& pose,
                           const RadianceSh& local, std::span<float> deficit) const;
  std::array<Rgb, OcclusionProbes::kProbes> lit_probes(std::size_t source, std::size_t index) const;
  void find_lit(std::size_t index, const lighting::LightEstimate& estimate, const Pose& pose,
                const ObjectLight& light, std::pmr::vector<float>& out);
  void add_ground_reflected(const StageObject& object, const RadianceSh& lights,
                            std::span<const float> lit, std::span<float> out) const;
  void correct_reflections(std::size_t index, const ObjectLight& light, std::span<const float> lit);
  bool is_nearest(std::size_t index, const glm::dvec3& place) const;
  void combine_object_shadows(const std::vector<Pose>& poses);
  void shade_real_mesh(const lighting::LightEstimate& light, const std::vector<Pose>& poses,
                       bool other_form);
  void light_planes();
  Rgb lost_at(std::size_t point, const RadianceSh& sky) const;
  bool move_objects();
  void place_objects(double seconds);
  void update_passing(bool any_lights, double seconds);
  bool update_distant_lights(const lighting::LightEstimate& light);
  bool relight_objects(const lighting::LightEstimate& light, bool all_changed, bool other_form);
  bool update_object(std::size_t index, const std::vector<Pose>& poses,
                     const lighting::LightEstimate& light, bool changed, bool moved);
  static bool ask_for_darker(ViewCamera& camera, const capture::Frame& frame,
                             const AskForDarker& ask);
  const ResponseTable* curve_for(ViewCamera& camera, const FramePixels& pixels);
  std::shared_ptr<const compositor::Foreground> foreground_of(const capture::Frame& frame,
                                                              const ViewCamera& camera,
                                                              const ResponseTable* curve);
  compositor::View view_of(const capture::Frame& frame);
  void mirror_objects(const compositor::View& view, const capture::Frame& frame, bool relit);

  std::unique_ptr<compositor::Compositor> compositor_;
  std::unique_ptr<PreparedScene> moving_;  // the scene itself where something in it moves by itself
  const PreparedScene& scene_;
  DirectLightStage lights_;
  FloorRecovery recovery_;
  ForegroundStage foreground_;
  ObjectMoves moves_;
  OcclusionProbes surroundings_;
  LampStage lamps_;
  RealSurfaceStage real_;
  IrradianceCache gathered_;
  GroundProbes ground_probes_;
  OpenPlanes planes_;
  MirroredSurroundings mirrored_;
  MirroredObjects mirrored_objects_;
  bool mirrors_others_ = true;                 // other surroundings than in the frame before
  std::vector<char> visible_;                  // scratch, by object
  std::vector<std::span<const float>> relit_;  // "
  std::vector<int> handles_;                   // of the objects, in the compositor
  std::optional<PlaneLight> plane_light_;      // of this update
  std::vector<Rgb> of_points_, lost_;          // scratch
  std::vector<Rgb> real_ratios_;               // at its vertices, as last shown
  bool could_not_complete_ = false;            // was said
  bool keeps_time_ = false;
  StageTimes& times_;
  std::vector<ViewCamera> views_;  // by camera index; unused entries for environment cameras
  std::vector<StageObject> objects_;
  std::vector<Pose> poses_, poses_before_;  // of this update, of the last one
  std::vector<Pose> floors_;                // ObjectNow::world_from_floor
  Rgb floor_radiance_;                      // in the open; 0: unknown, or not all that is real
  std::vector<compositor::ShadowMapOnPlane> on_planes_;
  bool lit_before_ = false;
  std::uint64_t depth_frames_seen_ = 0;  // by the lights
  // In the last update something changed in what things send to each other; in this one nothing
  // moves, so that all can see it as it is now.
  bool exits_changed_ = false, catches_up_ = false;
  std::optional<double> shaded_s_;  // the last moment, and the camera that came first in it
  int shaded_camera_ = 0;
};

}  // namespace penumbra::runtime
