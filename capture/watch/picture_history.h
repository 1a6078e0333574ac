// What each exposure of a camera shows in the mean of late, beside what a frame shows.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "capture/watch/picture_cells.h"

namespace penumbra::capture {

/// threads: thread-bound
class PictureHistory {
 public:
  static constexpr CellGrid kGrid{32, 48, 2, 4};

  explicit PictureHistory(const CameraInfo& camera) : meter_(camera) {}

  struct Comparison {
    int exposure = 0;  // a number of its own, until it is forgotten
    int frames = 0;    // in the mean; 0: nothing to compare with, and no cells
    TimestampNs time;  // of the frame
    /// Row by row, signal of the frame and of the mean before it, in fractions of full scale at
    /// this exposure; NaN where one is clipped.
    std::vector<Rgb> now{}, usual{};
  };
  /// nominal: the exposure as it came first; flicker moves the frames' own
  const Comparison& compare(const Frame& frame, const Exposure& nominal);
  /// Takes the frame that was compared last into the mean.
  /// row_logs: natural logarithm of what each row of cells is too bright by; empty: 0
  void keep(std::span<const double> row_logs = {});
  /// Begins the mean of that exposure anew with it: the scene has changed.
  void begin_anew();
  /// All of its light has changed at once: scales the mean to it, channel by channel.
  void scale_to_now();
  CellMeter& meter() { return meter_; }

 private:
  struct Usual {
    Exposure nominal;
    int number = 0;
    std::vector<Rgb> signal{};  // of the cells, as if exposed as `nominal`; NaN: clipped
    int frames = 0;
    glm::dquat rotation{1, 0, 0, 0};
    std::uint64_t last = 0;
  };
  std::size_t usual_of(const Exposure& nominal);

  CellMeter meter_;
  std::vector<Usual> usual_;
  std::uint64_t taken_ = 0;
  int numbers_ = 0;
  std::size_t compared_ = 0;  // in usual_
  Comparison comparison_;
};

}  // namespace penumbra::capture
