// Finds a camera whose white balance follows its pictures.
#pragma once

#include <optional>
#include <vector>

#include "capture/watch/picture_history.h"

namespace penumbra::capture {

/// A white balance that moves changes all of a picture's red or blue by one factor and leaves its
/// green as it is. Light that changes its colour does so by another factor in each place, or
/// becomes brighter; one lamp alone that changes its colour looks the same.
/// threads: thread-bound
class WhiteBalanceWatch {
 public:
  struct Shift {
    double red = 0, blue = 0;  // against green, natural logarithm
  };
  /// A shift that has been there for several frames.
  std::optional<Shift> see(const PictureHistory::Comparison& compared);

 private:
  int shifted_ = 0;  // frames in a row
  std::vector<double> red_, green_, blue_;
};

}  // namespace penumbra::capture
