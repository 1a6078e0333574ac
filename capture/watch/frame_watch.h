// What a ring does to a frame before it is merged, and says of its camera.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/watch/exposure_labels.h"
#include "capture/watch/mains_bands.h"
#include "capture/watch/picture_history.h"
#include "capture/watch/white_balance_watch.h"

namespace penumbra::capture {

/// threads: thread-bound
class FrameWatch {
 public:
  explicit FrameWatch(const CameraInfo& camera)
      : name_(camera.name),
        black_level_(camera.black_level),
        brightness_(camera),
        history_(camera) {}
  /// The exposure that a frame shows: its own, or that of a neighbour where the frames turned out
  /// to be labelled late. Nothing where it contradicts its label. In the order of the frames.
  std::optional<Exposure> exposure_of(const Frame& frame);
  /// The frame without bands of the mains. Warns once of a white balance that moves.
  /// nominal: its exposure as it came first
  /// shorter: of the next shorter exposure, or null
  Frame steady(const Frame& frame, const Exposure& nominal, const Frame* shorter);

 private:
  void watch_balance(const PictureHistory::Comparison& compared);
  std::string name_;
  double black_level_;
  BrightnessMeter brightness_;
  ExposureLabels labels_{0};
  std::uint64_t labelled_ = 0;  // frames
  PictureHistory history_;
  MainsBands bands_;
  WhiteBalanceWatch balance_;
  std::vector<double> rows_;
  bool said_bands_ = false, said_balance_ = false, said_label_ = false, said_delay_ = false;
};

}  // namespace penumbra::capture
