// Bracketed frames of all cameras that show the surroundings in, light out.
// threads: thread-bound
#pragma once

#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "capture/camera_regions.h"
#include "capture/environment/assembler.h"
#include "capture/environment/environment_blend.h"
#include "capture/frames.h"
#include "capture/ring/hdr_ring.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "lighting/estimate.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/saturation_recovery.h"

namespace penumbra::runtime {

class LightEstimationStage {
 public:
  /// errors: kInvalid (no camera shows the surroundings), as capture::camera_regions
  static Result<LightEstimationStage> create(const std::vector<capture::CameraInfo>& cameras,
                                             const lighting::EstimateOptions& options,
                                             StageTimes& times);

  /// Whether a camera's frames are for process().
  /// threads: thread-safe
  bool takes(int camera) const { return takes_[static_cast<std::size_t>(camera)]; }
  /// Whether the light may be shown: false while exposures that the bracket still owes could
  /// resolve what is saturated so far, or a camera has shown nothing yet, for a few frames at the
  /// start. Half a bracket's light is too dim, and the picture would jump when it is whole.
  bool ready() const;
  /// Different exposures that the light comes from.
  std::size_t exposures() const;
  void set_governor(const lighting::GovernorConfig& governor_config) {
    estimator_.set_governor(governor_config);
  }
  /// As LightEstimator::mirror.
  void mirror(const lighting::SurfaceRoughness& surfaces) { estimator_.mirror(surfaces); }
  void allow_lights(int max_count) { estimator_.allow_lights(max_count); }
  /// The time of the light is that of its stalest camera.
  /// errors: as HdrRing::add and capture::camera_regions (kUndetermined is an ordinary state: all
  /// black or all clipped, a ball out of the picture)
  /// out: keeps its memory; as it was after an error
  Result<void> process(const capture::Frame& frame, lighting::LightEstimate& out);
  /// Later than all frames.
  static constexpr TimestampNs kNoMore{std::int64_t{1} << 62};
  /// Once no exposure has come for a while before `now` the bracket is taken for whole: what was
  /// held back for want of a shorter one counts, and the light is measured anew.
  /// out: as it was where nothing changes
  Result<void> settle(TimestampNs now, lighting::LightEstimate& out);
  /// The light of environment() once more, with recoveries that came since.
  /// out: as it was where there is no map
  Result<void> renew(lighting::LightEstimate& out);
  /// As process() without an estimate: into environment() alone.
  Result<void> assemble(const capture::Frame& frame);
  /// Makes all maps of so many rows, whatever the cameras resolve.
  /// in: before the first frame; even, 16..1024
  void fix_rows(int rows);
  Result<lighting::LightEstimate> process(const capture::Frame& frame) {
    lighting::LightEstimate out;
    PENUMBRA_TRY(process(frame, out));
    return out;
  }
  /// The map that the newest light came from, lat-long in world directions; as process() left it,
  /// also when it failed.
  const Environment& environment() const { return blend_ ? environment_ : views_[0].map; }
  struct ViewGain {
    std::string camera;
    Rgb gain;
    bool known;  // by an overlap
  };
  std::vector<ViewGain> gains() const;
  /// From the next map on.
  void add_recoveries(std::span<const lighting::SaturationRecovery> recoveries);

 private:
  // One region of one camera; of a ball also while it is out of the picture.
  struct RegionView {
    int camera = 0;
    std::optional<capture::CameraRegion> region{};
    std::optional<capture::HdrRing> ring{};
    std::optional<capture::EnvironmentAssembler> assembler{};  // made with the map's size
    Environment map{};
    bool fresh = false;   // `map` shows something
    bool is_map = false;  // comes as a whole, assembled before
    bool bracket_complete() const { return is_map ? fresh : ring && ring->bracket_complete(); }
  };
  LightEstimationStage(const std::vector<capture::CameraInfo>& cameras,
                       const lighting::EstimateOptions& options, StageTimes& times);
  Result<void> set_pose(int camera, const Pose& world_from_camera);
  void lay_out();
  Result<void> follow(const capture::Frame& frame);
  Result<void> merge(RegionView& view, const capture::Frame& frame);
  Environment& whole();
  bool is_complete(const RegionView& view) const { return settled_ || view.bracket_complete(); }
  Result<void> estimate(lighting::LightEstimate& out);
  void warn_once(const lighting::LightEstimate& estimate);
  enum class Told { kKnown, kGuess, kRefused };
  bool is_news(int source, Told told);

  std::vector<bool> takes_;                         // by camera, never changed
  std::vector<capture::CameraInfo> cameras_;        // with their newest poses
  std::vector<RegionView> views_;                   // by camera
  std::optional<capture::EnvironmentBlend> blend_;  // of more than one
  int rows_ = 0;
  bool rows_fixed_ = false;
  Environment environment_;  // blended
  lighting::LightEstimator estimator_;
  StageTimes& times_;
  std::uint64_t frames_ = 0;
  bool warned_ = false;                  // that a source is clipped
  std::set<std::pair<int, Told>> told_;  // of recovered lights
  bool awaits_shorter_ = false;          // an exposure that may resolve what is clipped
  std::vector<std::uint32_t> awaited_;   // clipped pixels of the newest map, until then
  std::optional<TimestampNs> last_{};    // frame
  Seconds gap_{0};                       // between two of them, at most
  bool settled_ = false;                 // no more exposures are waited for
  bool said_gains_ = false, said_sun_ = false;
};

}  // namespace penumbra::runtime
