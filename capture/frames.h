// What all sources of frames share: cameras as they are known, frames with their own truth.
// threads: plain values; a FrameSource is thread-bound but for close(), counts(), take_darker() and
// set_exposures()
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/noise.h"
#include "calib/camera/response.h"
#include "core/environment.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// kDepth: codes of 16 bits are distances along its axis; kMask: its codes, of 8 or 16 bits, are
/// how much of the view's picture is in front of all that is virtual.
enum class Role { kEnvironment, kView, kDepth, kMask };

/// As files and answers have it: "environment", "view", "depth", "mask".
std::string_view role_name(Role role);
std::optional<Role> role_from(std::string_view name);
/// Whether its pictures are of light.
inline bool sees_light(Role role) {
  return role == Role::kEnvironment || role == Role::kView;
}

/// A part of a picture that has a lens of its own, as 360-degree cameras have two.
struct Lens {
  int x_px = 0, y_px = 0;         // of the part in the picture
  calib::CameraModel projection;  // of the part, whose size it has
  glm::dquat camera_from_lens{1, 0, 0, 0};
  double half_field_of_view_rad = 0;  // what is further off the lens's axis shows nothing
};

/// A mirror ball that stands in a camera's picture.
struct Ball {
  struct OutlinePixels {
    glm::dvec2 centre;
    double radius;
  };
  // In the camera's picture, which does not move; else by its place:
  std::optional<OutlinePixels> outline_px;
  glm::dvec3 centre_m{0, 0, 0};  // in the world
  double radius_m = 0;
};

/// The largest blur that a camera may have.
inline constexpr double kLargestPsfSigma = 20;

/// A camera as it is known before its frames: what it is for, where it stands and looks, and how
/// its codes follow from light. A frame tells its own exposure and pose.
struct CameraInfo {
  std::string name;
  Role role = Role::kEnvironment;
  std::string eye;  // "", "left" or "right"
  calib::CameraModel projection;
  calib::Response response;
  calib::NoiseModel noise;
  bool noise_known = false;  // of this camera; else `noise` only weighs exposures in a merge
  double psf_sigma_px = 0;   // Gaussian blur of the picture, pixels; 0 = sharp or unknown
  double black_level = 0;    // fraction of full scale
  std::array<double, 3> vignetting{};  // terms of Vignetting, of each lens's own picture
  Pose world_from_camera;
  glm::dmat3 colour{1};  // of an environment camera: radiance of the view camera = colour * its own
  // Parts of the picture that count; empty: all of it. `projection` is then the first one's
  std::vector<Lens> lenses;
  std::optional<Ball> ball;  // shows the surroundings in a view camera's picture
  Rgb ball_reflectance{1, 1, 1};
  double depth_unit_m = .001;  // of a depth camera: metres a code; code 0 is no depth
  // No camera, but the light that others measured: its frames are maps of `projection`'s size.
  bool gives_maps = false;
};

/// One frame with its own truth. Pixels are shared and never changed after capture.
struct Frame {
  int camera = 0;  // index into Capture::cameras
  std::uint64_t sequence = 0;
  TimestampNs time;
  Exposure exposure;  // APPLIED, not requested
  Pose world_from_camera;
  std::shared_ptr<const FramePixels> pixels;  // null: a map
  // The same as the camera coded it, if it did
  std::shared_ptr<const std::vector<std::byte>> jpeg{};
  // Taken darker than the camera's others, for what those overexpose: measured, never shown
  bool for_light = false;
  float opacity = 1;  // of what is virtual, 0..1: below 1 while its pose is old
  std::shared_ptr<const Environment> map{};  // lat-long in world directions, where gives_maps
};

int width(const FramePixels& pixels);
int height(const FramePixels& pixels);

/// What became of a camera's frames.
struct CameraCounts {
  std::uint64_t arrived = 0;        // whole, whatever their labels
  std::uint64_t frames = 0;         // handed on
  std::uint64_t lost = 0;           // never arrived
  std::uint64_t damaged = 0;        // arrived in part
  std::uint64_t rejected = 0;       // showed another exposure than their label said
  std::uint64_t overrun = 0;        // came while the program's queue was full
  std::uint64_t reconnected = 0;    // times that the camera came back
  std::optional<int> delay_frames;  // between a request and the first frame that shows it
  bool ignores_controls = false;    // its pictures do not follow the exposures that it is asked for
  std::vector<Exposure> exposures;  // that it is asked for in turn
  // That they leave, of an irradiance; nothing: they were not chosen
  std::optional<double> light_error;
};

/// What may be asked of a camera: times_s[i] seconds, each with gains[i] (none: 1).
/// errors: kInvalid ("exposures_s": none, more than 16, a time not above 0 and at most 60 s;
///         "gains": of another number, one that is not above 0 and at most 10,000)
Result<std::vector<Exposure>> exposures_of(std::span<const double> times_s,
                                           std::span<const double> gains);

/// A stream of frames of several cameras in order of time.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const std::vector<CameraInfo>& cameras() const = 0;
  /// The next frame, or nothing at the end.
  virtual Result<std::optional<Frame>> next() = 0;
  /// Mean rate of the first view camera, frames a second; 0 when it has fewer than two frames.
  virtual double view_rate() const = 0;
  /// True when next() returns as frames are taken; else a live run waits for each frame's time.
  virtual bool is_live() const { return false; }
  /// Ends a next() under way, and all later ones.
  /// threads: thread-safe
  virtual void close() {}
  /// Asks a view camera that has one fixed exposure for one more frame, at `factor` (below 1) of
  /// it. The frame comes with for_light set, beside the others, some frames later; where the camera
  /// does not follow none comes.
  /// out: false where this source cannot be asked
  /// threads: thread-safe
  virtual bool take_darker(int /*camera*/, double /*factor*/) { return false; }
  /// Asks a camera for exposures, taken in turn, instead of those that it has; none: for those that
  /// it began with. Its frames tell from when on they have them.
  /// errors: kInvalid (a source or a camera whose exposures are not set)
  /// threads: thread-safe
  virtual Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures);
  /// What became of the frames of real cameras, in the order of cameras(); empty for other sources.
  /// threads: thread-safe
  virtual std::vector<CameraCounts> counts() const { return {}; }
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
