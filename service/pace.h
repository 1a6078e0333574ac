// How many discs a live run has the time for. A disc that follows a moving character costs as much as everything else in a
// frame; a frame that comes too late is lost, a disc that is missing is a shadow a little too soft.
// threads: thread-bound
#pragma once

#include <limits>
#include <optional>

namespace penumbra::service {

class Pace {
 public:
  static constexpr int kAll = std::numeric_limits<int>::max();

  /// in: period_ms between frames; 0: unknown, every disc is affordable
  explicit Pace(double period_ms) : period_ms_(period_ms) {}

  /// A frame that kept this thread busy for so long, with so many discs traced.
  void add(double busy_ms, int discs);
  /// One fewer as soon as a window of frames took longer than they may; one more when the last one that went would fit
  /// again by what it cost then, after a while that doubles with every disc that goes.
  int most_discs() const { return allowed_; }

 private:
  static constexpr int kWindow = 20;         // frames
  static constexpr double kRoom = .85;       // of the period, before a disc comes back
  static constexpr int kLongestWait = 1024;  // windows

  void decide(double mean_ms, int discs);

  double period_ms_;
  int allowed_ = kAll;
  double sum_ms_ = 0;
  int frames_ = 0, discs_ = -1;         // of the window, all with as many
  std::optional<double> with_ms_;       // what a frame took with the disc that went
  std::optional<double> disc_cost_ms_;  // of that disc, once known
  int wait_ = 0, next_wait_ = 4;        // windows before one may come back
};

}  // namespace penumbra::service
