// The composited picture in a headset over OpenXR, turned with the head by the headset's runtime.
// threads: thread-safe
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/camera/camera_model.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "core/units.h"

namespace penumbra::service {

/// The world of a headset is the runtime's stage, with its origin on the floor, or the runtime's
/// local space where it has no stage. Both have y up.
struct HeadsetOptions {
  std::string application = "Penumbra";  // as the runtime shows it, 1 to 127 bytes
  // The camera sits beside the eye. So its picture is right at one distance only: on a plane across
  // the way that the head looks.
  double picture_distance_m = 2;
  // Below the horizon the picture stands on the floor, where that is nearer than the plane.
  std::optional<double> floor_height_m;  // in the world
  double near_m = .05, far_m = 1000;     // what is drawn lies between
};

/// What one eye is to see.
struct EyePicture {
  std::shared_ptr<const FramePixels> pixels;
  calib::CameraModel camera;  // of any lens; its size is that of the pixels
  Pose world_from_camera;     // when the picture was captured
  TimestampNs captured;       // by CLOCK_MONOTONIC, as are all times here
  // For the latencies alone: when the light was captured, and when the picture was composited.
  std::optional<TimestampNs> lit, composited;
};

/// Where the head or a hand was.
struct HeadPose {
  Pose world_from_device;  // head: looks along -z; hand: the grip pose of OpenXR
  // False where the runtime inferred it, as behind an obstacle.
  bool position_tracked = false, rotation_tracked = false;
};

enum class Hand { kLeft, kRight };

enum class HeadsetPhase {
  kLost,     // no runtime or no headset: looked for every two seconds
  kIdle,     // there, but nothing is shown: not ready yet, or put down
  kRunning,  // shows pictures
};

struct HeadsetState {
  HeadsetPhase phase = HeadsetPhase::kLost;
  std::string runtime, headset;  // their names; empty until they were found
  bool on_stage = false;         // else the world is the local space
  double rate_hz = 0;            // of the display; 0 until the first frame
  std::uint64_t shown = 0;       // pictures handed to the runtime, a pair counts once
  std::uint64_t overtaken = 0;   // by newer ones before they were shown
  std::uint64_t unmatched = 0;   // the other eye's picture of that time never came
  std::uint64_t refused = 0;     // not finite, of another size; show() tells
  std::uint64_t unplaced = 0;    // the head's pose of that time is not known
  std::uint64_t restarts = 0;    // sessions after the first
  std::string trouble;           // why nothing is shown; empty while all is well
  // Milliseconds of each picture when it is first handed over: capture_to_submit,
  // capture_to_display, light_age_at_display, composite_to_submit.
  std::vector<std::pair<std::string, StageTimes::Percentiles>> latency;
  std::vector<std::pair<std::string, StageTimes::Histogram>> latency_histograms;
};

class Headset {
 public:
  /// Starts the session's thread, which waits for a runtime that is not there yet.
  /// errors: kInvalid (an option, by name), kUnavailable (no OpenGL ES here, or a runtime that
  ///         takes no EGL context or does not tell its clock)
  static Result<std::unique_ptr<Headset>> create(const HeadsetOptions& options);
  /// Leaves the session in order, within a second as far as the runtime answers.
  ~Headset();
  Headset(const Headset&) = delete;
  Headset& operator=(const Headset&) = delete;

  /// Never waits; the newest picture wins. Pictures of the two eyes that were captured within a
  /// millisecond are shown together. A picture that is not fit to be shown is counted, and the
  /// reason is told once in the log.
  /// eye: 0 left, 1 right, -1 both
  void show(int eye, EyePicture picture);

  /// errors: kInvalid (not between near and far)
  Result<void> set_picture_distance(double distance_m);
  /// Nothing: the picture stands on its plane everywhere.
  /// errors: kInvalid (not within -100..100 m)
  Result<void> set_floor_height(std::optional<double> height_m);

  /// Where the head was, within the last two seconds; between the samples of two frames by
  /// interpolation, and after the last one as the runtime tells it. Nothing where that is unknown.
  std::optional<HeadPose> head_at(TimestampNs time) const;
  /// The same for the grip of a controller.
  std::optional<HeadPose> controller_at(Hand hand, TimestampNs time) const;

  HeadsetState state() const;

 private:
  class Impl;
  explicit Headset(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::service
