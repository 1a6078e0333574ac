// Draws a camera's picture, through its own lens, as an eye beside the camera sees it on the plane
// and the floor on which the picture stands.
// threads: thread-bound, to the GL context's thread
#pragma once

#include <array>
#include <memory>
#include <optional>

#include "calib/camera/camera_model.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"

namespace penumbra::service {

/// Where the picture stands, in the world.
struct PictureSurface {
  Pose world_from_head;  // the plane is across its -z
  double distance_m = 2;
  std::optional<double> floor_height_m;
};

/// What an eye sees; angles in radians from its -z, left and down negative.
struct EyeOptics {
  Pose world_from_eye;
  double left = 0, right = 0, up = 0, down = 0;
  double near_m = .05, far_m = 1000;
};

/// A texture of the runtime that is drawn into.
struct EyeTarget {
  unsigned texture = 0;
  int width = 0, height = 0;
};

class PictureRenderer {
 public:
  /// errors: kUnavailable (GL's log)
  static Result<std::unique_ptr<PictureRenderer>> make();
  ~PictureRenderer();
  PictureRenderer(const PictureRenderer&) = delete;
  PictureRenderer& operator=(const PictureRenderer&) = delete;

  /// The picture of one eye. The lens's mesh is made anew when the camera is another.
  void set_picture(std::size_t eye, const FramePixels& pixels, const calib::CameraModel& camera);
  /// Black where the camera sees nothing. Codes of the picture come out as they are where the
  /// target encodes sRGB, else as linear light.
  /// errors: kUnavailable (the target cannot be drawn into)
  Result<void> draw(std::size_t eye, const Pose& world_from_camera, const EyeOptics& optics,
                    const PictureSurface& surface, const EyeTarget& target);

 private:
  struct Parts;
  explicit PictureRenderer(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace penumbra::service
