// Whether frames show the exposures that they are said to have.
// threads: thread-bound
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "capture/frames.h"
#include "capture/watch/picture_cells.h"

namespace penumbra::capture {

/// Mean linear signal on a coarse grid; 0 where something is clipped or dark.
struct Brightness {
  static constexpr int kColumns = 16, kRows = 9;
  std::array<float, std::size_t{kColumns} * kRows> blocks{};
};
class BrightnessMeter {
 public:
  explicit BrightnessMeter(const CameraInfo& camera) : meter_(camera) {}
  Brightness measure(const FramePixels& pixels);

 private:
  CellMeter meter_;
  std::vector<Rgb> cells_;
};

/// The exposure in force at each frame, from the requests and the camera's delay, checked against
/// what frames show.
class ExposureLabels {
 public:
  /// No camera shows a request later, frames.
  static constexpr int kMaxDelay = 10;
  /// `delay`: frames between a request and the first frame that shows it; nothing: measured first;
  /// 0: frames tell their own.
  explicit ExposureLabels(std::optional<int> delay);

  void requested(std::uint64_t after_frame, Exposure exposure);
  enum class Verdict {
    kGood,
    kMeasuring,  // not yet known how late the camera follows
    kRefused,    // the frame contradicts its label
  };
  struct Label {
    Verdict verdict = Verdict::kMeasuring;
    Exposure exposure;
  };
  /// Frames in their order.
  Label judge(std::uint64_t frame, TimestampNs time, const Brightness& seen);

  std::optional<int> delay() const { return delay_; }
  /// True while no delay explains what is seen: the camera does not follow.
  bool ignores_controls() const { return ignores_controls_; }

 private:
  struct Request {
    std::uint64_t after_frame;
    Exposure exposure;
  };
  struct LabelledFrame {
    std::uint64_t frame;
    Brightness brightness;
  };
  std::optional<Exposure> in_force(std::uint64_t frame, int delay) const;
  double disagreement(int delay) const;
  void find_delay();
  void begin_with_history();
  Label accept(const Exposure& exposure, TimestampNs time, const Brightness& seen, double offset);

  bool reported_;  // by the frames themselves, so that none may be late
  std::optional<int> delay_;
  // Newest last; a frame that is judged allocates nothing.
  std::vector<Request> requests_;
  std::vector<LabelledFrame> seen_;
  std::vector<float> radiance_;  // of the blocks; 0: unknown
  double drift_ = 0;             // slow part of the offsets, natural logarithm
  TimestampNs last_;
  double suspicion_ = 0;  // refusals of late
  double changes_ = 0;    // of all light, of late
  int refused_in_a_row_ = 0, good_in_a_row_ = 0;
  bool ignores_controls_ = false;
};

}  // namespace penumbra::capture
