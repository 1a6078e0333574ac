// A synthetic studio: a world seen by an environment camera and a view camera.
// threads: classes are thread-bound
#pragma once

#include <atomic>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "capture/frames.h"
#include "capture/studio/sensor.h"
#include "capture/studio/world.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/threads/queues.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct StudioOptions {
  int environment_width = 1024, environment_height = 512;
  int view_width = 1280, view_height = 720;
  Pose world_from_view;  // where the view camera stands
  double view_focal_px = 1100;
  /// Instead of a pinhole of that size and focal length. Its principal point is in the middle.
  std::optional<calib::CameraModel> view_lens;
  double environment_fps = 30, view_fps = 30;
  std::vector<Exposure> schedule;  // of the environment camera; empty: chosen from the light
  // Nothing: chosen so that the floor is at 30 % of full scale
  std::optional<Exposure> view_exposure;
  /// Light under which the view camera shows white as white. It then also exposes as a person with
  /// a
  /// camera would: of the picture's lower half at most 2 % are clipped. Its response carries the
  /// gains.
  std::optional<Rgb> white;
  Sensor sensor;  // of both cameras; blur and vignetting are the view camera's alone
  /// Frames between a requested exposure and its effect; labels always say what was applied.
  int control_delay_frames = 0;
  int drop_every = 0;  // every n-th frame of each camera never arrives; 0 = none
  int view_frames = 120;
  std::uint64_t seed = 1;
  /// Distinct noise patterns of either camera (of every exposure), filmed before the first frame;
  /// 0: each frame new.
  int clip = 0;
};

/// The world seen by an environment camera (lat-long, at (0, 1, 0)) and a view camera.
class Studio : public FrameSource {
 public:
  /// world: is filmed here, and not kept
  Studio(const std::shared_ptr<const RadianceWorld>& world, StudioOptions options);
  const std::vector<CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<Frame>> next() override;
  double view_rate() const override { return options_.view_fps; }
  bool take_darker(int camera, double factor) override;
  /// Of the environment camera alone.
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override;

  std::span<const Exposure> schedule() const { return options_.schedule; }
  Exposure view_exposure() const { return *options_.view_exposure; }
  /// The view camera's linear picture, blurred, without noise: the truth behind every view frame.
  const Image<Rgb>& view_radiance() const { return view_radiance_; }

 private:
  std::shared_ptr<const FramePixels> film(int camera, const Exposure& exposure,
                                          std::uint64_t seed) const;
  std::uint64_t clip_seed(int i) const;
  void film_environment_clip();
  Frame environment_frame(std::uint64_t index);
  Frame view_frame(std::uint64_t index);
  Frame darker_frame(double factor) const;
  void expose_view();

  StudioOptions options_;
  Sensor view_sensor_;  // of the options, with the white balance of the view camera
  std::vector<CameraInfo> cameras_;
  Image<Rgb> environment_radiance_, view_radiance_;  // with the blur of their cameras
  std::vector<std::shared_ptr<const FramePixels>> environment_clip_, view_clip_;
  std::uint64_t next_environment_ = 0, next_view_ = 0;
  std::atomic<double> darker_ = 0;  // factor of a darker view frame that is wanted; 0: none
  std::vector<Exposure> first_schedule_;
  Latest<std::vector<Exposure>> wanted_;  // of the environment camera
};

/// The fewest exposures that cover the light's range (docs/methods/exposures.md), longest first,
/// times within `shortest`, at most 1/30 s, and 1/30 s, at gain 1.
std::vector<Exposure> choose_schedule(const Image<Rgb>& environment, const Sensor& sensor,
                                      Seconds shortest = Seconds(1. / 64000));

/// A camera at `eye` that looks at `target`, +y up.
Pose look_at(const glm::dvec3& eye, const glm::dvec3& target);

}  // namespace penumbra::capture
#pragma GCC visibility pop
