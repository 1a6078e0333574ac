// Private to capture: one frame at a shorter exposure, out of a stream at a fixed one.
#pragma once

#include <optional>

#include "capture/frames.h"

namespace penumbra::capture {

/// Tells the one frame that shows a shorter exposure from those around it. A driver says neither
/// how late it follows nor that it did, so the picture has to: the frame is darker than the one
/// before it and the one after it.
/// threads: thread-bound
class DarkerFrame {
 public:
  /// To be asked for with `exposure`, of a camera with this response.
  DarkerFrame(const calib::Response& response, Exposure exposure);

  /// What is to be handed on once a frame came.
  struct Passed {
    std::optional<Frame> frame;   // as it came; nothing while it may be the darker one
    std::optional<Frame> darker;  // the one that was asked for, taken before `frame`
  };
  /// Frames in their order; the first is one from before the request.
  /// in: what the frame itself says of its exposure, where it does
  Passed pass(Frame frame, const std::optional<Exposure>& applied);
  /// It was found, or so many frames have passed that it will not come.
  bool over() const { return over_; }

 private:
  double brightness(const FramePixels& pixels) const;
  bool is_darker(double brightness, const std::optional<Exposure>& applied, Exposure usual) const;

  calib::Response response_;
  Exposure exposure_;
  std::optional<double> before_;  // brightness of the last frame that was none
  std::optional<Frame> held_;
  int passed_ = 0, dark_in_a_row_ = 0;
  bool over_ = false;
};

}  // namespace penumbra::capture
