// Private to capture: one frame at a shorter exposure, out of a stream at a fixed one.
#pragma once

#include <optional>
#include <vector>

#include "capture/frames.h"

namespace penumbra::capture {

/// Tells the one frame that shows a shorter exposure from those around it. A driver says neither
/// how late it follows nor that it did, so the picture has to: all of it is darker by what the
/// exposures differ, and the frame after it is as bright as the one before.
/// threads: thread-bound
class DarkerFrame {
 public:
  /// To be asked for with `exposure`, of a camera with this response and else the `usual` exposure.
  DarkerFrame(const calib::Response& response, Exposure exposure, Exposure usual);

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
  bool found() const { return found_; }
  /// Nothing could tell it: pictures are white all over. A still darker one may not be.
  bool is_white() const { return white_; }

 private:
  std::vector<float> sample(const FramePixels& pixels) const;
  bool is_darker(const std::vector<float>& now, const std::optional<Exposure>& applied) const;

  calib::Response response_;
  Exposure exposure_, usual_;
  std::vector<float> before_;  // signals of the last frame that was none; empty: there was none yet
  std::optional<Frame> held_;
  int passed_ = 0, dark_in_a_row_ = 0;
  bool over_ = false, found_ = false, white_ = false;
};

}  // namespace penumbra::capture
