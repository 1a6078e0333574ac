#include "runtime/pipeline/runner.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <deque>
#include <limits>
#include <mutex>
#include <ranges>
#include <thread>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "core/counted.h"
#include "core/exceptions.h"
#include "core/io/log.h"
#include "core/threads/background_task.h"
#include "core/threads/processor_time.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/saturation_recovery.h"
#include "runtime/pipeline/eye_moments.h"
#include "runtime/pipeline/internal/frame_budget.h"
#include "runtime/pipeline/internal/frame_mailbox.h"
#include "runtime/pipeline/internal/view_mailbox.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {

namespace {

using Clock = std::chrono::steady_clock;

double since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// All black and all clipped are states of the scene, not failures of the program.
bool is_ordinary(const Error& e) {
  return e.code == ErrorCode::kUndetermined;
}

// False when the sink has had enough.
bool deliver(const capture::Frame& frame, const lighting::LightEstimate& light,
             Composited composited, const Sink& sink, RunCounts& counts) {
  counts.touched += composited.touched.fraction;
  counts.plan = light.plan;
  counts.lights = std::max(counts.lights, static_cast<int>(light.lights.size()));
  counts.coverage = std::min(counts.coverage.value_or(1), light.coverage);
  return sink({frame, std::make_shared<const FramePixels>(std::move(composited.pixels)), light,
               counts.overtaken});
}

Result<void> compose_one(const capture::Frame& frame, const lighting::LightEstimate& light,
                         CompositeStage& compose, const Sink& sink, RunCounts& counts,
                         bool& go_on) {
  ++counts.frames;
  if (!light.valid) {
    ++counts.without_light;
    go_on = sink({frame, frame.pixels, light, counts.overtaken});
    return {};
  }
  PENUMBRA_ASSIGN(composited, compose.process(frame, light));
  go_on = deliver(frame, light, std::move(composited), sink, counts);
  return {};
}

bool is_view(const capture::FrameSource& source, const capture::Frame& frame) {
  return source.cameras()[static_cast<std::size_t>(frame.camera)].role == capture::Role::kView;
}

bool is_foreground(const capture::FrameSource& source, const capture::Frame& frame) {
  return !capture::sees_light(source.cameras()[static_cast<std::size_t>(frame.camera)].role);
}

AskForDarker darker_of(capture::FrameSource& source, int camera) {
  return [&source, camera](double factor) { return source.take_darker(camera, factor); };
}

// Between view frames, of all cameras together; 0: unknown.
double period_ms(const capture::FrameSource& source) {
  const auto views =
      std::ranges::count(source.cameras(), capture::Role::kView, &capture::CameraInfo::role);
  const double rate = source.view_rate() * static_cast<double>(views);  // all alike
  return rate > 0 ? 1e3 / rate : 0;
}

Result<void> never_any_light(const RunCounts& counts, const std::optional<Error>& last) {
  if (counts.frames == 0) return fail(ErrorCode::kInvalid, "capture", "has no view frame");
  if (counts.without_light < counts.frames) return {};
  return std::unexpected(
      last.value_or(Error{ErrorCode::kUndetermined, "capture",
                          "no environment frame came before the last view frame"}));
}

}  // namespace

namespace {

// A replay in the order of its frames. View frames wait for the first whole light.
class Replay {
 public:
  Replay(capture::FrameSource& source, LightEstimationStage& light, CompositeStage& compose,
         const Sink& sink, RunCounts& counts)
      : source_(source), light_(light), compose_(compose), sink_(sink), counts_(counts) {}

  bool go_on() const { return go_on_; }
  const std::optional<Error>& last_unusable() const { return last_unusable_; }

  Result<void> add_environment(const capture::Frame& frame) {
    const auto measured = light_.process(frame, estimate_);
    if (!measured) {
      if (!is_ordinary(measured.error())) return measured;
      ++counts_.unusable;
      last_unusable_ = measured.error();
    }
    return light_.ready() ? compose_waiting() : Result<void>{};
  }

  // What a floor tells counts at once: a capture of one bracket has no next map.
  Result<void> measure_light(const capture::Frame& view) {
    const auto found = compose_.recover_lights(view, estimate_, darker_of(source_, view.camera));
    if (found.empty()) return {};
    light_.add_recoveries(found);
    return light_.renew(estimate_);
  }

  // View frames that wait are composited with what was in front of them.
  Result<void> add_foreground(const capture::Frame& frame) {
    if (waiting_.empty()) return compose_.add_foreground(frame);
    // Of several before the next view frame each camera's newest counts.
    const auto since = std::ranges::find_if(waiting_ | std::views::reverse, [&](const auto& f) {
                         return is_view(source_, f);
                       }).base();
    const auto older = std::ranges::remove(std::ranges::subrange(since, waiting_.end()),
                                           frame.camera, &capture::Frame::camera);
    waiting_.erase(older.begin(), older.end());
    waiting_.push_back(frame);
    return {};
  }

  Result<void> add_view(const capture::Frame& frame) {
    PENUMBRA_TRY(light_.settle(frame.time, estimate_));
    constexpr std::size_t kMaxWaiting = 16, kMaxPixels = 64'000'000;
    waiting_.push_back(frame);
    std::size_t pixels = 0, views = 0;
    for (const capture::Frame& f : waiting_) {
      pixels += std::visit([](const auto& p) { return p.area(); }, *f.pixels);
      views += is_view(source_, f);
    }
    const bool wait = !light_.ready() && views < kMaxWaiting && pixels < kMaxPixels;
    return wait ? Result<void>{} : compose_waiting();
  }

  /// What waits is composited with what there is.
  Result<void> end() {
    PENUMBRA_TRY(light_.settle(LightEstimationStage::kNoMore, estimate_));
    return compose_waiting();
  }

  Result<void> compose_waiting() {
    for (const capture::Frame& frame : waiting_) {
      if (!go_on_) break;
      if (is_foreground(source_, frame)) {
        PENUMBRA_TRY(compose_.add_foreground(frame));
        continue;
      }
      PENUMBRA_TRY(measure_light(frame));
      PENUMBRA_TRY(compose_one(frame, estimate_, compose_, sink_, counts_, go_on_));
    }
    waiting_.clear();
    return {};
  }

 private:
  capture::FrameSource& source_;
  LightEstimationStage& light_;
  CompositeStage& compose_;
  const Sink& sink_;
  RunCounts& counts_;
  lighting::LightEstimate estimate_;
  std::vector<capture::Frame> waiting_;
  std::optional<Error> last_unusable_;
  bool go_on_ = true;
};

}  // namespace

Result<RunCounts> run_replay(capture::FrameSource& source, LightEstimationStage& light,
                             CompositeStage& compose, const Sink& sink, StageTimes& times) {
  RunCounts counts;
  Replay replay(source, light, compose, sink, counts);
  EyeMoments moments(source.cameras(),
                     Seconds(source.view_rate() > 0 ? 1 / source.view_rate() : 0));
  const auto start = Clock::now();
  while (replay.go_on()) {
    auto frame = [&] {
      const StageTimer timer(times, "source");
      return source.next();
    }();
    if (!frame) return std::unexpected(frame.error());
    if (!*frame) break;
    if ((*frame)->for_light) {
      PENUMBRA_TRY(replay.measure_light(**frame));
      continue;
    }
    if (is_foreground(source, **frame)) PENUMBRA_TRY(replay.add_foreground(**frame));
    if (light.takes((*frame)->camera)) PENUMBRA_TRY(replay.add_environment(**frame));
    if (!is_view(source, **frame)) continue;
    moments.number(**frame);
    PENUMBRA_TRY(replay.add_view(**frame));
  }
  PENUMBRA_TRY(replay.end());
  counts.overtaken.unmatched_eyes = moments.unmatched();
  counts.seconds = since(start);
  counts.exposures = static_cast<int>(light.exposures());
  PENUMBRA_TRY(never_any_light(counts, replay.last_unusable()));
  return counts;
}

namespace {

// What the threads of a live run share. Every queue closes when anyone stops.
struct Live {
  explicit Live(const capture::FrameSource& source)
      : view(source.cameras(), Seconds(source.view_rate() > 0 ? 1 / source.view_rate() : 0)),
        foreground(source.cameras().size()) {}

  FrameMailbox environment;
  ViewMailbox view;
  std::deque<Latest<capture::Frame>> foreground;  // by camera
  Latest<capture::Frame> for_light;
  Latest<lighting::LightEstimate> light;
  Latest<std::vector<lighting::SaturationRecovery>> recoveries;
  std::atomic<int> affordable_lights = std::numeric_limits<int>::max();
  // The steady clock's time over the frames': 0 for cameras, which have it, else since the first
  std::atomic<std::int64_t> behind_ns = 0;
  std::mutex mutex;
  std::optional<Error> error, last_unusable;  // guarded by mutex
  std::uint64_t unusable = 0;                 // guarded by mutex

  OvertakenFrames overtaken() const {
    OvertakenFrames out{.view = view.dropped(),
                        .environment = environment.dropped(),
                        .for_light = for_light.dropped(),
                        .unmatched_eyes = view.unmatched()};
    for (const auto& camera : foreground) out.foreground += camera.dropped();
    return out;
  }
  void close() {
    environment.close();
    view.close();
    for (auto& camera : foreground) camera.close();
    for_light.close();
    light.close();
    recoveries.close();
  }
  void stop_with(const Error& e) {
    {
      const std::scoped_lock lock(mutex);
      if (!error) error = e;
    }
    close();
  }
};

// False when the run ends before: a gap between frames must not hold up a stop.
bool wait_until(Clock::time_point due, const Live& live, const std::atomic<bool>& stop) {
  constexpr auto kSlice = std::chrono::milliseconds(50);
  while (Clock::now() < due) {
    if (stop || live.view.closed()) return false;
    std::this_thread::sleep_until(std::min(due, Clock::now() + kSlice));
  }
  return true;
}

void produce(Live& live, capture::FrameSource& source, const LightEstimationStage& light,
             StageTimes& times, const std::atomic<bool>& stop) noexcept {
  try {
    constexpr int kMaxFailures = 8;
    int failures_in_a_row = 0;
    std::optional<Clock::time_point> origin;
    TimestampNs first{};
    while (!stop && !live.view.closed()) {
      auto frame = [&] {
        const SpendingOn spending(ProcessorUse::kCameras);
        const StageTimer timer(times, "source");
        return source.next();
      }();
      if (!frame) {
        // One damaged frame is not the end of a live run; a source that gives nothing else is.
        if (++failures_in_a_row > kMaxFailures) return live.stop_with(frame.error());
        const std::scoped_lock lock(live.mutex);
        ++live.unusable;
        live.last_unusable = frame.error();
        continue;
      }
      failures_in_a_row = 0;
      if (!*frame) break;
      if (!origin) {
        origin = Clock::now(), first = (*frame)->time;
        if (!source.is_live()) live.behind_ns = origin->time_since_epoch().count() - first.value;
      }
      if (!source.is_live() &&
          !wait_until(*origin + std::chrono::duration_cast<Clock::duration>((*frame)->time - first),
                      live, stop))
        break;
      if ((*frame)->for_light) {
        live.for_light.put(std::move(**frame));
        continue;
      }
      if (is_foreground(source, **frame)) {
        live.foreground[static_cast<std::size_t>((*frame)->camera)].put(std::move(**frame));
        continue;
      }
      // A ball in its picture makes a view camera both.
      const bool viewed = is_view(source, **frame);
      if (light.takes((*frame)->camera)) live.environment.put(**frame);
      if (viewed) live.view.put(std::move(**frame));
    }
    live.environment.close();
    live.view.close();
  } catch (const std::exception& e) {
    live.stop_with({ErrorCode::kUnavailable, "source thread", reason_of(e)});
  }
}

void measure(Live& live, LightEstimationStage& light, const LiveChanges& changes) noexcept {
  try {
    // Until the bracket is whole, or nothing more comes
    std::optional<lighting::LightEstimate> held;
    const auto hand_on = [&](lighting::LightEstimate estimate) {
      if (changes.on_light) {
        const SpendingOn other(ProcessorUse::kOther);
        changes.on_light(light, estimate);
      }
      lighting::keep_affordable(estimate);
      live.light.put(std::move(estimate));
    };
    while (true) {
      auto frame = live.environment.wait(Seconds(.5));
      if (!frame) {
        if (held && light.settle(LightEstimationStage::kNoMore, *held))
          hand_on(*std::exchange(held, std::nullopt));
        if (live.environment.closed()) return;
        continue;
      }
      const SpendingOn spending(ProcessorUse::kPipeline);
      if (const auto recoveries = live.recoveries.take()) light.add_recoveries(*recoveries);
      if (changes.take_governor)
        if (const auto governor = changes.take_governor()) light.set_governor(*governor);
      if (changes.take_mirror)
        if (const auto mirrored = changes.take_mirror()) light.mirror(*mirrored);
      light.allow_lights(live.affordable_lights);
      auto estimate = light.process(*frame);
      if (estimate) {
        held.reset();
        light.ready() ? hand_on(std::move(*estimate)) : void(held = std::move(*estimate));
      } else if (is_ordinary(estimate.error())) {
        const std::scoped_lock lock(live.mutex);
        ++live.unusable;
        live.last_unusable = estimate.error();
      } else {
        return live.stop_with(estimate.error());
      }
    }
  } catch (const std::exception& e) {
    live.stop_with({ErrorCode::kUnavailable, "light thread", reason_of(e)});
  }
}

// View frames of a live run. When the next one waits already, the last part of a frame is done
// beside the begin of that one; otherwise at once, so that nothing comes later than it has to.
class LiveFrames {
 public:
  LiveFrames(CompositeStage& compose, const Sink& sink, RunCounts& counts, const Live& live,
             StageTimes& times)
      : compose_(&compose), sink_(sink), counts_(counts), live_(live), times_(times) {}

  /// in: the last frame of the one before is finished
  void go_on_with(CompositeStage& compose) { compose_ = &compose; }
  CompositeStage& stage() { return *compose_; }
  bool go_on() const { return go_on_; }
  /// The last add() took so long, without the sink.
  double busy_ms() const { return busy_ms_; }

  /// scene_time: of what moves; that of the first eye for both
  /// more: another frame waits already
  Result<void> add(const capture::Frame& frame, const lighting::LightEstimate& light,
                   TimestampNs scene_time, bool more) {
    const Stopwatch watch;
    in_sink_ms_ = busy_ms_ = 0;
    if (!light.valid) {
      finish_last();
      if (!go_on_) return {};
      ++counts_.frames;
      ++counts_.without_light;
      const SpendingOn spending(ProcessorUse::kOther);
      go_on_ = sink_({frame, frame.pixels, light, counts_.overtaken});
      return {};
    }
    UnderWay& now = last_ == &slots_[0] ? slots_[1] : slots_[0];
    now.frame = frame;
    now.light = light;
    // The loops in there must not take up the other frame's end, which what is traced live would
    // count as its own time.
    const auto begun = isolate([&] { return compose_->draw(frame, light, scene_time, now.begun); });
    finish_last();
    if (!begun) return begun;
    if (!go_on_) return {};
    ++counts_.frames;
    if (more) {
      last_ = &now;
      aside_.run([&now] { now.done = now.begun.finish(); });
    } else {
      now.done = now.begun.finish();
      hand_out(now);
    }
    busy_ms_ = watch.ms() - in_sink_ms_;
    return {};
  }

  void finish_last() {
    if (!last_) return;
    aside_.wait();
    hand_out(*std::exchange(last_, nullptr));
  }

 private:
  struct UnderWay {
    capture::Frame frame;
    lighting::LightEstimate light;
    PendingFrame begun;
    Composited done;
  };

  void hand_out(UnderWay& frame) {
    if (!go_on_) return;
    tell_age("capture to picture", frame.frame.time);
    tell_age("light to picture", frame.light.time);
    const SpendingOn spending(ProcessorUse::kOther);
    const Stopwatch watch;
    go_on_ = deliver(frame.frame, frame.light, std::move(frame.done), sink_, counts_);
    in_sink_ms_ += watch.ms();
  }

  // What motion and light wait for until whoever shows the picture has it.
  void tell_age(std::string_view name, TimestampNs time) {
    const std::int64_t now = Clock::now().time_since_epoch().count();
    times_.add(name, 1e-6 * static_cast<double>(now - live_.behind_ns - time.value));
  }

  CompositeStage* compose_;
  const Sink& sink_;
  RunCounts& counts_;
  const Live& live_;
  StageTimes& times_;
  bool go_on_ = true;
  double busy_ms_ = 0, in_sink_ms_ = 0;
  std::array<UnderWay, 2> slots_;
  UnderWay* last_ = nullptr;  // whose end is done aside
  BackgroundTask aside_;      // ends before what it works on
};

// Clipped sources stay lights whatever they cost.
void update_frame_budget(FrameBudget& budget, double busy_ms, const lighting::LightEstimate& light,
                         Live& live) {
  const int before = budget.max_lights();
  budget.add(busy_ms, static_cast<int>(std::ranges::count(light.lights, false,
                                                          &lighting::DistantLight::clipped)));
  if (budget.max_lights() == before) return;
  if (budget.max_lights() == FrameBudget::kAll)
    log_info("light: the frame budget allows all distant lights");
  else
    log_info("light: the frame budget allows {}", counted(budget.max_lights(), "distant light"));
  live.affordable_lights = budget.max_lights();
}

}  // namespace

Result<RunCounts> run_live(capture::FrameSource& source, LightEstimationStage& light,
                           CompositeStage& compose, const Sink& sink, StageTimes& times,
                           const std::atomic<bool>& stop, const LiveChanges& changes) {
  Live live(source);
  RunCounts counts;
  Result<void> composed;
  LiveFrames frames(compose, sink, counts, live, times);
  compose.warm_up();
  compose.keep_time();
  const auto start = Clock::now();
  const ProcessorTimes spent_before = processor_times();
  {
    const std::jthread producer([&] { produce(live, source, light, times, stop); });
    const std::jthread measurer([&] { measure(live, light, changes); });
    // Also when something throws here: the threads are released before they are joined.
    const auto close_all = [&](Live* l) {
      source.close();
      l->close();
    };
    const std::unique_ptr<Live, decltype(close_all)> release(&live, close_all);
    lighting::LightEstimate estimate;
    FrameBudget budget(period_ms(source));
    const auto recover = [&](const capture::Frame& view) {
      if (auto found =
              frames.stage().recover_lights(view, estimate, darker_of(source, view.camera));
          !found.empty())
        live.recoveries.put(std::move(found));
    };
    while (frames.go_on() && !stop) {
      if (changes.turn) changes.turn();
      const std::vector<capture::Frame> eyes = live.view.wait(Seconds(.5));
      if (eyes.empty()) {
        if (live.view.closed()) break;
        continue;
      }
      const SpendingOn spending(ProcessorUse::kPipeline);
      counts.overtaken = live.overtaken();
      if (changes.stage_waits && changes.stage_waits()) {
        frames.finish_last();
        if (CompositeStage* const newer = changes.take_stage()) {
          frames.go_on_with(*newer);
          budget.start_over();
          live.affordable_lights = budget.max_lights();
        }
      }
      if (auto newer = live.light.take()) estimate = std::move(*newer);
      if (const auto darker = live.for_light.take()) recover(*darker);
      for (auto& camera : live.foreground)
        if (const auto newest = camera.take(); newest && composed)
          composed = frames.stage().add_foreground(*newest);
      for (std::size_t i = 0; i < eyes.size() && composed && frames.go_on(); ++i) {
        recover(eyes[i]);
        composed =
            frames.add(eyes[i], estimate, eyes[0].time, i + 1 < eyes.size() || live.view.waiting());
        if (composed) update_frame_budget(budget, frames.busy_ms(), estimate, live);
      }
      if (!composed) break;
    }
    if (composed) frames.finish_last();
  }
  counts.seconds = since(start);
  counts.processor = processor_times() - spent_before;
  counts.overtaken = live.overtaken();
  counts.unusable = live.unusable;
  counts.exposures = static_cast<int>(light.exposures());
  if (live.error) return std::unexpected(*live.error);
  PENUMBRA_TRY(composed);
  if (!stop) PENUMBRA_TRY(never_any_light(counts, live.last_unusable));
  return counts;
}

}  // namespace penumbra::runtime
