// What an environment camera and a view camera both see, for the calibration of their colours.
// threads: reentrant
#pragma once

#include <vector>

#include "calib/camera/colour.h"
#include "capture/frames.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// A camera's light, merged from all the exposures of its still scene.
struct StillPicture {
  CameraInfo camera;  // with the pose of its longest exposure's last frame
  Image<Rgb> radiance;
  Image<std::uint8_t> clipped;  // 1 where clipped in every exposure
};
/// The newest frame of each exposure (of 16, the longest) of cameras of a capture, merged; the
/// scene must stand still.
/// errors: kNotFound (no such camera), kUndetermined (no frame), as FrameSource::next and merge()
Result<std::vector<StillPicture>> merge_still(FrameSource& source,
                                              const std::vector<std::string>& cameras);

struct CommonSurface {
  glm::dvec2 at_px;           // of the view camera's picture
  calib::ColourPair colours;  // environment camera, view camera
};
/// Even patches of the view camera's picture, each large enough for the environment camera's
/// pixels, where neither clips or is near black. The cameras' places do not count: what is near one
/// of them shows another surface. With the environment camera turned about its own y axis by
/// `turned_rad` no surface is shared, which tells what chance would find.
std::vector<CommonSurface> common_surfaces(const StillPicture& environment,
                                           const StillPicture& view, double turned_rad = 0);

}  // namespace penumbra::capture
#pragma GCC visibility pop
