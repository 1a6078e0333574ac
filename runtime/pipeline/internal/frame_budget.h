// How many lights a live run has the time for. A light that follows a moving character costs as
// much as everything else in a frame. A frame that comes too late is lost; a light that is missing
// is a shadow a little too soft.
// threads: thread-bound
#pragma once

#include <array>
#include <limits>
#include <optional>

namespace penumbra::runtime {

class FrameBudget {
 public:
  static constexpr int kAll = std::numeric_limits<int>::max();

  /// in: period_ms between frames; 0: unknown, every light is affordable
  explicit FrameBudget(double period_ms) : period_ms_(period_ms) {}

  /// A frame that took so long, waiting for others not counted, with so many lights that could go.
  void add(double busy_ms, int lights);
  /// Another scene: all lights again, as what the last one took says nothing.
  void start_over();
  /// 0..kAll. One fewer as soon as a window's median frame took longer than it may. The window is
  /// short when their number has just changed, and frames of a light that does not follow yet do
  /// not count. One more when the last one that went would fit again by what it cost then, after a
  /// wait that doubles with every light that goes. All again where there are fewer for a while.
  int max_lights() const { return allowed_; }

 private:
  static constexpr int kWindow = 20, kTrial = 8;  // frames
  static constexpr double kRoom = .85;            // of the period, before a light comes back
  static constexpr int kShortestWait = 4, kLongestWait = 1024;  // windows
  static constexpr int kQuietWaits = 16;    // waits without a loss: the next one is shorter
  static constexpr int kUnused = 8;         // windows with fewer lights than it allows
  static constexpr double kCostDecay = .8;  // of a cost, after each wait that it forbade

  void decide(double median_ms);
  void give_one_up(double median_ms);
  void take_one_back(double median_ms);
  void allow_all();

  double period_ms_;
  int allowed_ = kAll;
  std::array<double, kWindow> busy_ms_{};
  int frames_ = 0, window_ = kTrial;
  int lights_ = 0;  // most in a frame of the window
  int last_lights_ = 0;
  bool even_ = true;                     // as many lights in all frames of the window
  std::optional<double> with_ms_;        // what a frame took with the light that went
  std::optional<double> light_cost_ms_;  // of that light, once known
  int wait_ = 0, next_wait_ = kShortestWait, quiet_ = 0, unused_ = 0;  // windows
};

}  // namespace penumbra::runtime
