// What a ring does to a frame before it is merged, and says of its camera.
#pragma once

#include <string>
#include <vector>

#include "capture/watch/mains_bands.h"
#include "capture/watch/picture_history.h"
#include "capture/watch/white_balance_watch.h"

namespace penumbra::capture {

/// threads: thread-bound
class FrameWatch {
 public:
  explicit FrameWatch(const CameraInfo& camera)
      : name_(camera.name), black_level_(camera.black_level), history_(camera) {}
  /// The frame without bands of the mains. Warns once of a white balance that moves.
  /// nominal: its exposure as it came first
  /// shorter: of the next shorter exposure, or null
  Frame steady(const Frame& frame, const Exposure& nominal, const Frame* shorter);

 private:
  void watch_balance(const PictureHistory::Comparison& compared);
  std::string name_;
  double black_level_;
  PictureHistory history_;
  MainsBands bands_;
  WhiteBalanceWatch balance_;
  std::vector<double> rows_;
  bool said_bands_ = false, said_balance_ = false;
};

}  // namespace penumbra::capture
