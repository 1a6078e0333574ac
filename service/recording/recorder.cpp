#include "service/recording/recorder.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <deque>
#include <memory>
#include <optional>
#include <thread>

#include "capture/recording/recording.h"
#include "core/threads/processor_time.h"
#include "core/threads/queues.h"

namespace penumbra::service {

namespace {

using capture::Frame;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kQueued = 8;  // frames a camera: an eighth of a second at 60 a second
constexpr std::size_t kMaxEarly = 64;
constexpr Seconds kPatience(10);

// What ends a live recording while next() waits for a camera: a signal, or a camera that stays
// silent.
class Watch {
 public:
  Watch(capture::FrameSource& source, const std::atomic<bool>& stop, double seconds)
      : thread_([this, &source, &stop, seconds](const std::stop_token& done) {
          const auto start = Clock::now();
          while (!done.stop_requested() && !stop && !late_) {
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
            const Seconds since = Clock::now() - start;
            late_ = source.is_live() && ((!begun_ && since > kPatience) ||
                                         (seconds > 0 && since > Seconds(seconds) + 2 * kPatience));
          }
          if (!done.stop_requested()) source.close();
        }) {}
  void begun() { begun_ = true; }
  [[nodiscard]] bool late() const { return late_; }

 private:
  std::atomic<bool> begun_ = false, late_ = false;
  std::jthread thread_;
};

// The first frames, one of each camera at least: they tell how each camera's pictures are coded.
struct Beginning {
  std::deque<Frame> frames;
  std::vector<std::uint64_t> dropped;    // one a camera: came long before the last camera's first
  std::vector<capture::Coding> codings;  // one a camera; none when stopped
};

Result<Beginning> begin(capture::FrameSource& source, const Watch& watch,
                        const std::atomic<bool>& stop) {
  const auto& cameras = source.cameras();
  std::vector<std::optional<capture::Coding>> found(cameras.size());
  // A track may be silent for long: the night, a cap on the lens.
  for (std::size_t i = 0; i < cameras.size(); ++i)
    if (cameras[i].gives_maps) found[i] = capture::Coding::kMap;
  Beginning out;
  out.dropped.resize(cameras.size());
  for (;;) {
    const auto silent = std::ranges::find_if(found, [](const auto& coding) { return !coding; });
    if (silent == found.end()) break;
    const std::string& name = cameras[static_cast<std::size_t>(silent - found.begin())].name;
    PENUMBRA_ASSIGN(frame, source.next());
    if (stop) return Beginning{};
    if (watch.late())
      return fail(ErrorCode::kUnavailable, name,
                  fmt::format("delivers no frame within {:.0f} s", kPatience.count()));
    if (!frame) return fail(ErrorCode::kUnavailable, name, "has no frame in the source");
    PENUMBRA_ASSIGN(coding, capture::coding_of(*frame));
    found[static_cast<std::size_t>(frame->camera)] = coding;
    if (out.frames.size() == kMaxEarly) {
      ++out.dropped[static_cast<std::size_t>(out.frames.front().camera)];
      out.frames.pop_front();
    }
    out.frames.push_back(std::move(*frame));
  }
  for (const auto& coding : found) out.codings.push_back(*coding);
  return out;
}

class Recorder {
 public:
  Recorder(capture::RecordingWriter writer, const capture::FrameSource& source,
           std::vector<std::uint64_t> dropped_before)
      : writer_(std::move(writer)),
        source_(source),
        dropped_before_(std::move(dropped_before)),
        live_(source.is_live()),
        stations_(source.cameras().size()) {
    for (auto& station : stations_) {
      station = std::make_unique<Station>();
      station->thread = std::jthread([this, s = station.get()] { code(*s); });
    }
  }
  ~Recorder() { drain(); }

  // False once a frame could not be written.
  bool add(Frame frame) {
    if (!first_) first_ = frame.time;
    last_ = std::max(last_, frame.time);
    Bounded<Frame>& queue = stations_[static_cast<std::size_t>(frame.camera)]->queue;
    if (live_)
      queue.try_push(std::move(frame));
    else
      queue.push(std::move(frame));
    return !failed_;
  }

  [[nodiscard]] double seconds() const { return first_ ? (last_ - *first_).count() : 0; }
  [[nodiscard]] RecordCounts counts() const {
    RecordCounts out;
    for (std::size_t i = 0; i < stations_.size(); ++i) {
      out.frames.push_back(stations_[i]->written);
      out.faded.push_back(stations_[i]->faded);
      out.dropped.push_back(dropped_before_[i] + stations_[i]->queue.dropped());
    }
    out.cameras = source_.counts();
    out.seconds = seconds();
    out.bytes = writer_.bytes();
    return out;
  }

  Result<void> finish() {
    drain();
    if (auto error = error_.take()) {
      std::uint64_t kept = 0;
      for (const auto& station : stations_) kept += station->written;
      return fail(error->code, error->where,
                  fmt::format("{}; the first {} frames are kept", error->detail, kept));
    }
    return writer_.finish();
  }

 private:
  struct Station {
    Bounded<Frame> queue{kQueued};
    std::atomic<std::uint64_t> written = 0, faded = 0;
    std::jthread thread;
  };

  void code(Station& station) {
    const SpendingOn spending(ProcessorUse::kEncoding);
    while (auto frame = station.queue.pop()) {
      if (failed_) continue;  // takes what is left, so that nobody waits for room
      if (auto written = writer_.write(*frame); !written) {
        error_.put(written.error());
        failed_ = true;
      } else {
        ++station.written;
        station.faded += frame->opacity < 1;
      }
    }
  }
  void drain() {
    for (auto& station : stations_) station->queue.close();
    for (auto& station : stations_)
      if (station->thread.joinable()) station->thread.join();
  }

  capture::RecordingWriter writer_;
  const capture::FrameSource& source_;
  std::vector<std::uint64_t> dropped_before_;  // one a camera
  bool live_;
  std::optional<TimestampNs> first_;
  TimestampNs last_{std::numeric_limits<std::int64_t>::min()};
  Latest<Error> error_;
  std::atomic<bool> failed_ = false;
  std::vector<std::unique_ptr<Station>> stations_;
};

}  // namespace

Result<RecordCounts> record_frames(capture::FrameSource& source, const std::filesystem::path& path,
                                   RecordLimits limits, const std::atomic<bool>& stop,
                                   const std::function<void(const RecordCounts&)>& on_progress) {
  Watch watch(source, stop, limits.seconds);
  PENUMBRA_ASSIGN(beginning, begin(source, watch, stop));
  if (!beginning.frames.empty()) watch.begun();
  if (beginning.codings.empty()) return RecordCounts{};  // stopped before anything came
  const auto& cameras = source.cameras();
  PENUMBRA_ASSIGN(writer, capture::RecordingWriter::create(path, cameras, beginning.codings,
                                                           source.view_rate()));
  Recorder recorder(std::move(writer), source, std::move(beginning.dropped));
  std::optional<Error> failed;
  auto told = Clock::now();
  std::uint64_t taken = 0;
  while (!stop) {
    std::optional<Frame> frame;
    if (!beginning.frames.empty()) {
      frame = std::move(beginning.frames.front());
      beginning.frames.pop_front();
    } else {
      auto next = source.next();
      if (!next) failed = next.error();
      if (!next || !*next) break;
      frame = std::move(*next);
      watch.begun();
    }
    ++taken;
    if (!recorder.add(std::move(*frame))) break;
    const bool enough = (limits.frames && taken >= limits.frames) ||
                        (limits.seconds > 0 && recorder.seconds() >= limits.seconds);
    if (enough) break;
    if (Clock::now() - told < std::chrono::seconds(1)) continue;
    told = Clock::now();
    if (on_progress) on_progress(recorder.counts());
  }
  const auto finished = recorder.finish();
  if (on_progress) on_progress(recorder.counts());
  PENUMBRA_TRY(finished);
  if (!failed && taken == 0 && watch.late())
    failed = Error{ErrorCode::kUnavailable, cameras.front().name,
                   fmt::format("delivers nothing within {:.0f} s", kPatience.count())};
  if (failed) return std::unexpected(std::move(*failed));
  return recorder.counts();
}

}  // namespace penumbra::service
