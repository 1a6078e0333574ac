#include "service/recording/live_recording.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <ctime>
#include <utility>

#include "core/exceptions.h"
#include "core/io/log.h"
#include "core/threads/queues.h"

namespace penumbra::service {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t kWaiting = 32;  // frames of all cameras

bool is_plain_name(const std::string& name) {
  constexpr std::size_t kLongest = 100;
  const auto plain = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || c == '-' || c == '.';
  };
  return !name.empty() && name.size() <= kLongest && name[0] != '.' &&
         std::ranges::all_of(name, plain) && name.ends_with(".mkv");
}

}  // namespace

// The frames of a run once more, as far as they are taken in time.
class LiveRecording::Branch : public capture::FrameSource {
 public:
  explicit Branch(capture::FrameSource& source)
      : source_(source), cameras_(source.cameras()), rate_(source.view_rate()) {}
  void add(const capture::Frame& frame) { (void)frames_.try_push(frame); }

  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<capture::Frame>> next() override { return frames_.pop(); }
  double view_rate() const override { return rate_; }
  bool is_live() const override { return true; }
  void close() override { frames_.close(); }
  std::vector<capture::CameraCounts> counts() const override { return source_.counts(); }
  std::uint64_t dropped() const { return frames_.dropped(); }

 private:
  capture::FrameSource& source_;
  const std::vector<capture::CameraInfo> cameras_;
  const double rate_;
  Bounded<capture::Frame> frames_{kWaiting};
};

class LiveRecording::Tap : public capture::FrameSource {
 public:
  Tap(LiveRecording& recording, capture::FrameSource& source)
      : recording_(recording), source_(source) {}
  ~Tap() override {
    recording_.end_thread();
    const std::scoped_lock lock(recording_.mutex_);
    recording_.source_ = nullptr;
  }
  Tap(const Tap&) = delete;
  Tap& operator=(const Tap&) = delete;

  const std::vector<capture::CameraInfo>& cameras() const override { return source_.cameras(); }
  Result<std::optional<capture::Frame>> next() override {
    auto frame = source_.next();
    // What was taken for the light alone is no frame of the recording's tracks.
    if (!frame || !*frame || (*frame)->for_light) return frame;
    const auto branch = [&] {
      const std::scoped_lock lock(recording_.mutex_);
      return recording_.branch_;
    }();
    if (branch) branch->add(**frame);
    return frame;
  }
  double view_rate() const override { return source_.view_rate(); }
  bool is_live() const override { return source_.is_live(); }
  void close() override { source_.close(); }
  bool take_darker(int camera, double factor) override {
    return source_.take_darker(camera, factor);
  }
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override {
    return source_.set_exposures(camera, exposures);
  }
  std::vector<capture::CameraCounts> counts() const override { return source_.counts(); }

 private:
  LiveRecording& recording_;
  capture::FrameSource& source_;
};

LiveRecording::~LiveRecording() {
  end_thread();
}

std::unique_ptr<capture::FrameSource> LiveRecording::tap(capture::FrameSource& source) {
  const std::scoped_lock lock(mutex_);
  source_ = &source;
  return std::make_unique<Tap>(*this, source);
}

void LiveRecording::end_thread() {
  std::jthread ended;
  {
    const std::scoped_lock lock(mutex_);
    stop_ = true;
    if (branch_) branch_->close();
    ended = std::move(thread_);
  }
  if (ended.joinable()) ended.join();
}

Result<fs::path> LiveRecording::new_file(const std::string& stem, const std::string& extension) {
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) return fail(ErrorCode::kUnwritable, folder_.string(), error.message());
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  const std::string dated =
      fmt::format("{}_{:%Y%m%d_%H%M%S}_{:03}", stem,
                  fmt::localtime(static_cast<std::time_t>(ms / 1000)), ms % 1000);
  fs::path out = folder_ / (dated + extension);
  for (int i = 2; fs::exists(out, error); ++i)
    out = folder_ / fmt::format("{}_{}{}", dated, i, extension);
  return out;
}

Result<std::string> LiveRecording::start(const std::string& name, runtime::KeptLight light) {
  if (!name.empty() && !is_plain_name(name))
    return fail(ErrorCode::kInvalid, "file",
                "is no name of letters, digits, '_', '-' and '.' that ends in .mkv");
  const std::scoped_lock control(control_mutex_);
  PENUMBRA_ASSIGN(file, new_file("recording", ".mkv"));
  if (!name.empty()) file = folder_ / name;
  std::error_code error;
  if (fs::exists(file, error)) return fail(ErrorCode::kInvalid, name, "is there already");
  if (const auto before = state(); before && !before->active) end_thread();
  std::shared_ptr<Branch> made;
  const capture::FrameSource* tapped = nullptr;
  {
    const std::scoped_lock lock(mutex_);
    if (!source_) return fail(ErrorCode::kUnavailable, "the service", "is still starting");
    if (branch_)
      return fail(ErrorCode::kUnavailable, state_->file, "is being recorded: stop it first");
    made = std::make_shared<Branch>(*source_);
    tapped = source_;
  }
  // Outside the lock, as the frames of the run go through it.
  std::shared_ptr<capture::FrameSource> frames = made;
  if (light != runtime::KeptLight::kCameras) {
    PENUMBRA_ASSIGN(tracked, runtime::with_light_track(*made, light));
    frames = std::move(tracked);
  }
  const std::scoped_lock lock(mutex_);
  if (source_ != tapped)
    return fail(ErrorCode::kUnavailable, "the service", "starts again: ask once more");
  stop_ = false;
  branch_ = made;
  state_.emplace();
  state_->file = file.filename().string();
  thread_ = std::jthread([this, file, branch = std::move(made), frames = std::move(frames)] {
    const auto tell = [&](const RecordCounts& counts) {
      const std::scoped_lock told(mutex_);
      state_->counts = counts;
      state_->overrun = branch->dropped();
    };
    Result<RecordCounts> done = fail(ErrorCode::kUnavailable, file.string(), "");
    try {
      done = record_frames(*frames, file, {}, stop_, tell);
      if (done && done->frames.empty())
        done = fail(ErrorCode::kNotFound, file.filename().string(),
                    "was stopped before each camera had sent a frame: nothing is kept");
    } catch (const std::exception& e) {
      done = fail(ErrorCode::kUnavailable, file.string(), reason_of(e));
    }
    const std::scoped_lock told(mutex_);
    state_->active = false;
    state_->overrun = branch->dropped();
    if (done)
      state_->counts = *done;
    else
      state_->error = done.error().where + " " + done.error().detail;
    if (!done) log_warning("recording: {}", state_->error);
    branch_.reset();
  });
  return state_->file;
}

Result<RecordingState> LiveRecording::stop() {
  const std::scoped_lock control(control_mutex_);
  {
    const std::scoped_lock lock(mutex_);
    if (!branch_) return fail(ErrorCode::kNotFound, "recording", "none is running");
  }
  end_thread();
  const std::scoped_lock lock(mutex_);
  return *state_;
}

std::optional<RecordingState> LiveRecording::state() const {
  const std::scoped_lock lock(mutex_);
  return state_;
}

}  // namespace penumbra::service
