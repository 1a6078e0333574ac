// A camera that lives in memory: a still scene through the sensor model, with a real sensor's delay
// and faults.
#pragma once

#include <functional>
#include <thread>
#include <vector>

#include "calib/calib.h"
#include "capture/capture.h"

namespace penumbra::test {

struct FakeCameraBehaviour {
  int delay = 2;  // frames between a request and the first frame that shows it
  double fps = 30;
  std::function<int(std::uint64_t)> delay_at;  // instead of `delay`
  std::function<bool(std::uint64_t)> lost;     // never arrives; the driver's count does not tell
  std::function<bool(std::uint64_t)> slips;    // shows the request before
  std::function<bool(std::uint64_t)> damaged;
  std::function<double(double)> light;                  // factor on the scene at a time in seconds
  std::function<bool(std::uint64_t)> ignores_controls;  // keeps its first exposure
  std::function<bool(int)> refuses;                     // the request of that number, from 0
  std::function<void(std::uint64_t, Image<Rgb>&)> covers;  // a part of a frame's scene
  std::function<Exposure(Exposure)> really;      // applied instead of the one that was asked for
  std::function<Exposure(Exposure)> tells;       // frames say so of the exposure that was applied
  std::uint64_t gone_after = ~std::uint64_t{0};  // frames
  double begins_s = 0;                           // its clock at the first frame
  bool paced = false;                            // frames take their time; else they come at once
};

class FakeCamera : public capture::CameraDevice {
 public:
  FakeCamera(Image<Rgb> scene, FakeCameraBehaviour behaviour)
      : scene_(std::move(scene)), behaviour_(std::move(behaviour)) {
    sensor_.response = calib::Response::srgb();
  }
  const std::string& name() const override { return name_; }
  Exposure nearest(Exposure wanted) const override { return wanted; }
  Result<void> request(Exposure wanted) override {
    if (behaviour_.refuses && behaviour_.refuses(asked_++))
      return fail(ErrorCode::kUnavailable, "fake", "refused a control");
    requests_.push_back({sensor_frame_, wanted});
    return {};
  }
  Result<std::optional<capture::CameraFrame>> wait(Seconds, Seconds) override {
    if (behaviour_.paced) std::this_thread::sleep_for(Seconds(1 / behaviour_.fps));
    const auto yes = [&](const auto& when) { return when && when(sensor_frame_); };
    capture::CameraFrame out;
    do {
      ++sensor_frame_;
      out.damaged_before += yes(behaviour_.damaged);
      delivered_ += yes(behaviour_.damaged);
    } while (yes(behaviour_.lost) || yes(behaviour_.damaged));
    if (sensor_frame_ > behaviour_.gone_after)
      return fail(ErrorCode::kClosed, "fake", "was unplugged");
    out.sequence = ++delivered_;
    out.time = clock_at(static_cast<double>(sensor_frame_));
    shown_ = in_force(yes(behaviour_.slips) ? 1 : 0);
    if (behaviour_.really) shown_ = behaviour_.really(shown_);
    if (behaviour_.tells) out.applied = behaviour_.tells(shown_);
    light_ = behaviour_.light ? behaviour_.light((out.time - TimestampNs{}).count()) : 1;
    return out;
  }
  Result<FramePixels> pixels() override {
    Image<Rgb> radiance = scene_;
    for (Rgb& p : radiance.pixels()) p = p * static_cast<float>(light_);
    if (behaviour_.covers) behaviour_.covers(sensor_frame_, radiance);
    FramePixels out = Image<Rgb8>(scene_.width(), scene_.height());
    capture::expose(sensor_, radiance, shown_, sensor_frame_, out);
    return out;
  }
  TimestampNs now() const override { return clock_at(static_cast<double>(sensor_frame_) + .01); }
  /// What the last frame was really exposed with.
  Exposure shown() const { return shown_; }
  std::uint64_t sensor_frame() const { return sensor_frame_; }

 private:
  TimestampNs clock_at(double frame) const {
    return TimestampNs{} + Seconds(behaviour_.begins_s + frame / behaviour_.fps);
  }
  Exposure in_force(int earlier) const {
    if (requests_.empty()) return {Seconds(.01), Gain(1)};
    if (behaviour_.ignores_controls && behaviour_.ignores_controls(sensor_frame_))
      return requests_.front().exposure;
    const int delay = behaviour_.delay_at ? behaviour_.delay_at(sensor_frame_) : behaviour_.delay;
    std::size_t newest = 0;
    for (std::size_t i = 0; i < requests_.size(); ++i)
      if (requests_[i].after + static_cast<std::uint64_t>(delay) <= sensor_frame_) newest = i;
    const auto back = static_cast<std::size_t>(earlier);
    return requests_[newest >= back ? newest - back : 0].exposure;
  }
  struct Request {
    std::uint64_t after;
    Exposure exposure;
  };
  Image<Rgb> scene_;
  FakeCameraBehaviour behaviour_;
  capture::Sensor sensor_;
  std::string name_ = "fake camera";
  std::vector<Request> requests_;
  std::uint64_t sensor_frame_ = 0, delivered_ = 0;
  int asked_ = 0;
  Exposure shown_;
  double light_ = 1;
};

}  // namespace penumbra::test
