// Private to capture: a camera that cycles through exposures, and frames that carry what was
// applied to them. Nothing here reads a clock: times come with the frames.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "capture/device/cameras.h"
#include "capture/device/internal/darker_frame.h"
#include "capture/device/internal/exposure_schedule.h"
#include "capture/frames.h"
#include "capture/watch/exposure_labels.h"

namespace penumbra::capture {

/// Numbers the sensor's frames, also those that never arrived: drivers count only what reached
/// them, times tell the rest.
class FrameCounter {
 public:
  /// The frame's number, which grows by one a period. `arrived`: when it could be read first.
  std::uint64_t count(std::uint64_t sequence, TimestampNs time, TimestampNs arrived);
  /// The newest frame that can be read at a time: what a request at that time comes after, however
  /// late frames are read.
  std::uint64_t at(TimestampNs time) const;
  /// How old a frame is that was read soon after it arrived.
  Seconds fresh() const;
  std::uint64_t lost() const { return lost_; }

 private:
  std::optional<std::uint64_t> sequence_;
  TimestampNs time_;
  std::uint64_t number_ = 0, lost_ = 0;
  std::deque<double> periods_;  // seconds
  double period_ = 0;           // their median; 0 while there are too few
  double latency_ = 1e9;        // seconds from a frame's time to its arrival, the least of late
};

/// A camera with its schedule.
/// threads: thread-bound
class BracketedCamera {
 public:
  /// `light_error`: the schedule is chosen, so that the light's error stays below this fraction of
  /// it.
  BracketedCamera(CameraInfo info, std::vector<Exposure> schedule, std::optional<int> delay,
                  std::optional<double> light_error = {}, double fps = 30)
      : info_(std::move(info)),
        configured_(std::move(schedule)),
        light_error_(light_error),
        schedule_(configured_),
        delay_(delay),
        fps_(fps),
        meter_(info_),
        labels_(delay) {
    if (light_error_) auto_schedule_.emplace(info_, *light_error_);
  }

  /// Takes a device over, also a new one after the old one has gone.
  Result<void> connect(std::unique_ptr<CameraDevice> device);
  bool connected() const { return device_ != nullptr; }
  void disconnect() { device_.reset(); }
  /// The next frame whose label holds; nothing when none came in time.
  /// errors: kClosed (the device is gone)
  Result<std::optional<Frame>> next(Seconds timeout);
  /// These from now on; none: those that it was made with. Frames that may still show another
  /// exposure than their label says are left out.
  void set_exposures(const std::vector<Exposure>& exposures);
  /// Whether it can; else the camera stands as somebody has set it.
  /// threads: thread-safe
  bool sets_exposures() const { return !configured_.empty() || light_error_; }
  /// next() gives one more frame, marked for_light, at `factor` of the one exposure of all others;
  /// where that is white all over, at an eighth of that, down to 1/512.
  void take_darker(double factor);
  /// Whether it can: its exposure is set, and one, and pictures have followed what was asked.
  bool can_take_darker() const { return schedule_.size() == 1 && !auto_schedule_ && darkens_; }
  const CameraCounts& counts() const { return counts_; }

 private:
  Result<void> ask();
  void begin_labels(std::optional<int> delay);
  void ask_for_darker();
  std::optional<Frame> pass(Frame frame, const std::optional<Exposure>& applied);
  void end_darker();
  ExposureLabels::Label label_of(TimestampNs time, std::uint64_t number, const FramePixels& pixels);
  void take_reported(std::uint64_t number, Exposure exposure);
  ExposureLimits limits() const;
  void take(std::vector<Exposure> planned);
  bool asks_each_frame() const { return auto_schedule_ || schedule_.size() > 1; }
  CameraInfo info_;
  const std::vector<Exposure> configured_;
  const std::optional<double> light_error_;
  std::vector<Exposure> schedule_;
  std::optional<int> delay_;  // as configured
  double fps_;
  std::optional<AutoSchedule> auto_schedule_;
  BrightnessMeter meter_;
  ExposureLabels labels_;
  FrameCounter counter_;
  std::unique_ptr<CameraDevice> device_;
  std::size_t next_ = 0;  // in the schedule
  std::uint64_t sent_ = 0, lost_before_ = 0;
  std::uint64_t settled_ = 0;       // the first frame that shows its one exposure for certain
  bool reports_exposures_ = false;  // the camera's frames tell their exposures
  // A darker frame that is asked for, from the next frame on, and the frame after it
  std::optional<Exposure> darker_exposure_;
  double darker_factor_ = 1;  // of the usual exposure
  int missed_ = 0;            // that did not come, in a row
  bool darkens_ = true;
  bool back_to_usual_ = false;  // to be asked for
  std::optional<DarkerFrame> darker_;
  std::optional<Frame> next_frame_;
  CameraCounts counts_;
};

}  // namespace penumbra::capture
