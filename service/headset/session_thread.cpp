#include "service/headset/internal/session_thread.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "core/exceptions.h"
#include "core/io/log.h"

namespace penumbra::service {

namespace {

constexpr Seconds kBetweenTries(2), kBetweenEvents(.01), kPatienceAtEnd(.8);
// Runtimes forget older poses of the head; then the samples of the frames tell them.
constexpr Seconds kRuntimeRemembers(.1);

const char* phase_name(HeadsetPhase phase) {
  switch (phase) {
    case HeadsetPhase::kRunning:
      return "shows pictures";
    case HeadsetPhase::kIdle:
      return "is not worn or not ready";
    default:
      return "has gone";
  }
}

}  // namespace

SessionThread::SessionThread(HeadsetOptions options)
    : options_(std::move(options)),
      distance_m_(options_.picture_distance_m),
      floor_height_m_(options_.floor_height_m) {}

void SessionThread::set_floor(std::optional<double> height_m) {
  const std::scoped_lock lock(mutex_);
  floor_height_m_ = height_m;
}

void SessionThread::show(int eye, EyePicture picture) {
  if (const auto fit = check_picture(eye, picture); !fit) {
    ++refused_;
    const std::string line = fmt::format("{}: {}", fit.error().where, fit.error().detail);
    {
      const std::scoped_lock lock(mutex_);
      constexpr std::size_t kMaxTold = 16;
      if (refusals_.size() >= kMaxTold || !refusals_.insert(line).second) return;
    }
    return log_warning("{}", line);
  }
  mailbox_.put(eye, std::move(picture));
}

std::optional<HeadPose> SessionThread::device_at(std::size_t device, TimestampNs time) const {
  const DeviceHistory& history = histories_[device];
  if (const auto known = history.at(time)) return known;
  const auto newest = history.newest();
  // What comes after the last frame the runtime tells, and a little of what is to come.
  if (!newest || time < *newest || time - *newest > kRuntimeRemembers) return std::nullopt;
  const std::shared_lock lock(living_mutex_);
  if (!living_) return std::nullopt;
  const auto at = runtime_->to_xr_time(time);
  if (!at) return std::nullopt;
  return device == kHead ? living_->locate_head(*at) : living_->locate_hand(device, *at);
}

HeadsetState SessionThread::state() const {
  HeadsetState out;
  {
    const std::scoped_lock lock(mutex_);
    out = state_;
  }
  const auto counts = mailbox_.counts();
  out.overtaken = counts.overtaken, out.unmatched = counts.unmatched;
  out.shown = shown_, out.refused = refused_, out.unplaced = unplaced_;
  out.latency = latencies_.summary();
  out.latency_histograms = latencies_.histograms();
  return out;
}

// Each change once, however long it lasts.
void SessionThread::set_phase(HeadsetPhase phase) {
  {
    const std::scoped_lock lock(mutex_);
    if (std::exchange(state_.phase, phase) == phase) return;
  }
  if (phase != HeadsetPhase::kLost) log_info("headset: {}", phase_name(phase));
}

void SessionThread::tell(const std::string& trouble) {
  {
    const std::scoped_lock lock(mutex_);
    if (std::exchange(state_.trouble, trouble) == trouble) return;
  }
  if (trouble.empty())
    log_info("headset: goes on");
  else
    log_warning("headset: {}", trouble);
}

void SessionThread::pause(const std::stop_token& stop, Seconds time) {
  std::unique_lock lock(mutex_);
  woken_.wait_for(lock, stop, time, [] { return false; });
}

void SessionThread::run(const std::stop_token& stop, std::promise<Result<void>>& ready) {
  Result<void> begun;
  try {
    begun = prepare();
  } catch (const std::exception& e) {
    begun = fail(ErrorCode::kUnavailable, "headset", reason_of(e));
  }
  ready.set_value(begun);
  while (begun && !stop.stop_requested()) {
    Result<void> lived;
    try {
      lived = prepare();
      if (lived) lived = live(stop);
    } catch (const std::exception& e) {
      lived = fail(ErrorCode::kUnavailable, "headset", reason_of(e));
    }
    set_phase(HeadsetPhase::kLost);
    if (stop.stop_requested()) break;
    tell(lived ? "the OpenXR runtime has ended the session" : lived.error().detail);
    pause(stop, kBetweenTries);
  }
  renderer_.reset();  // before its context
  graphics_.reset();
}

// Also for another runtime that has come.
Result<void> SessionThread::prepare() {
  if (graphics_ && renderer_ && !graphics_->is_lost() && XrRuntime::takes(*graphics_)) return {};
  renderer_.reset();  // before its context
  graphics_.reset();
  PENUMBRA_ASSIGN(graphics, XrRuntime::make_graphics());
  graphics_ = std::move(graphics);
  PENUMBRA_ASSIGN(renderer, PictureRenderer::make());
  renderer_ = std::move(renderer);
  return {};
}

// From the finding of a runtime to its end.
Result<void> SessionThread::live(const std::stop_token& stop) {
  PENUMBRA_ASSIGN(runtime, XrRuntime::open(options_.application, *graphics_));
  PENUMBRA_ASSIGN(session, HeadSession::open(*runtime, *graphics_));
  {
    const std::scoped_lock lock(mutex_);
    state_.runtime = runtime->name(), state_.headset = runtime->headset();
    state_.on_stage = session->on_stage();
    state_.restarts = sessions_++;
  }
  views_.clear();
  for (DeviceHistory& history : histories_) history.clear();
  {
    const std::unique_lock lock(living_mutex_);
    living_ = session.get(), runtime_ = runtime.get();
  }
  tell("");
  Result<void> lived;
  try {
    lived = live_with(stop, *session, *runtime);
  } catch (const std::exception& e) {
    lived = fail(ErrorCode::kUnavailable, "headset", reason_of(e));
  }
  {
    const std::unique_lock lock(living_mutex_);
    living_ = nullptr, runtime_ = nullptr;
  }
  if (!lived && lived.error().code == ErrorCode::kClosed) session->abandon();
  return lived;
}

Result<void> SessionThread::live_with(const std::stop_token& stop, HeadSession& session,
                                      XrRuntime& runtime) {
  std::optional<Stopwatch> leaving;
  for (;;) {
    if (stop.stop_requested()) {
      if (!leaving && !session.request_exit()) return {};
      if (!leaving) leaving.emplace();
      if (leaving->ms() > 1000 * kPatienceAtEnd.count()) return {};
    }
    PENUMBRA_TRY(session.poll());
    if (session.over()) return {};
    if (session.take_moved_origin())
      for (DeviceHistory& history : histories_) history.clear();
    set_phase(session.is_visible() ? HeadsetPhase::kRunning : HeadsetPhase::kIdle);
    if (session.has_frames())
      PENUMBRA_TRY(frame(session, runtime));
    else if (leaving)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));  // pause() would not
    else
      pause(stop, kBetweenEvents);
  }
}

// ---- A frame. ----

Result<void> SessionThread::frame(HeadSession& session, XrRuntime& runtime) {
  PENUMBRA_ASSIGN(timing, session.wait_frame());
  if (timing.predictedDisplayPeriod > 0) {
    const std::scoped_lock lock(mutex_);
    state_.rate_hz = 1e9 / static_cast<double>(timing.predictedDisplayPeriod);
  }
  PENUMBRA_TRY(session.begin_frame());
  PENUMBRA_TRY(sample_poses(session, runtime));
  just_drawn_.reset();
  if (timing.shouldRender)
    PENUMBRA_TRY(take_picture(session, runtime, timing.predictedDisplayTime));
  // Between two pictures the last one is shown again, and the runtime turns it further.
  static const std::vector<XrCompositionLayerProjectionView> kNothing;
  PENUMBRA_TRY(
      session.end_frame(timing.predictedDisplayTime, timing.shouldRender ? views_ : kNothing));
  if (!just_drawn_) return {};
  ++shown_;
  PENUMBRA_ASSIGN(display, runtime.from_xr_time(timing.predictedDisplayTime));
  add_latencies(*just_drawn_, monotonic_now(), display);
  return {};
}

// Now, and half way back to the last frame, so that a turning head lies well between samples.
Result<void> SessionThread::sample_poses(HeadSession& session, XrRuntime& runtime) {
  PENUMBRA_TRY(session.sync_hands());
  const TimestampNs now = monotonic_now();
  for (std::size_t device = 0; device < histories_.size(); ++device) {
    DeviceHistory& history = histories_[device];
    const auto sample = [&](TimestampNs time) -> Result<void> {
      PENUMBRA_ASSIGN(at, runtime.to_xr_time(time));
      const auto pose = device == kHead ? session.locate_head(at) : session.locate_hand(device, at);
      if (pose) history.put(time, *pose);
      return {};
    };
    if (const auto last = history.newest(); last && now - *last < kRuntimeRemembers)
      PENUMBRA_TRY(sample(*last + (now - *last) * .5));
    PENUMBRA_TRY(sample(now));
  }
  return {};
}

Result<void> SessionThread::take_picture(HeadSession& session, XrRuntime& runtime, XrTime display) {
  auto pair = mailbox_.take();
  if (!pair) return {};
  EyeViews eyes{};
  for (std::size_t i = 0; i < 2; ++i) {
    // Mostly both have one time, and the second answer is the first one's.
    if (i > 0 && (*pair)[1].captured == (*pair)[0].captured) break;
    PENUMBRA_ASSIGN(found, eyes_at(session, runtime, (*pair)[i].captured, display));
    if (!found) {
      ++unplaced_;
      return {};
    }
    if (i == 0)
      eyes = *found;
    else
      eyes.eyes[1] = found->eyes[1];
  }
  PENUMBRA_TRY(draw(session, *pair, eyes));
  just_drawn_ = std::move(pair);
  return {};
}

// Where the eyes were when the picture was captured.
Result<std::optional<EyeViews>> SessionThread::eyes_at(HeadSession& session, XrRuntime& runtime,
                                                       TimestampNs captured, XrTime display) const {
  if (monotonic_now() - captured <= kRuntimeRemembers) {
    PENUMBRA_ASSIGN(at, runtime.to_xr_time(captured));
    PENUMBRA_ASSIGN(eyes, session.eyes_in_world(at));
    if (eyes) return eyes;
  }
  const auto head = histories_[kHead].at(captured);
  if (!head) return std::nullopt;
  PENUMBRA_ASSIGN(eyes, session.eyes_in_head(display));
  if (!eyes) return std::nullopt;
  for (XrView& eye : eyes->eyes) eye.pose = to_xr(head->world_from_device * from_xr(eye.pose));
  return eyes;
}

Result<void> SessionThread::draw(HeadSession& session, const EyePair& pair, const EyeViews& eyes) {
  const std::size_t count = session.view_count();
  PictureSurface surface;
  const Pose first = from_xr(eyes.eyes[0].pose), last = from_xr(eyes.eyes[count - 1].pose);
  surface.world_from_head = {glm::slerp(first.rotation, last.rotation, .5),
                             (first.translation + last.translation) / 2.};
  surface.distance_m = distance_m_;
  {
    const std::scoped_lock lock(mutex_);
    surface.floor_height_m = floor_height_m_;
  }
  std::vector<XrCompositionLayerProjectionView> views;
  for (std::size_t i = 0; i < count; ++i) {
    const XrView& eye = eyes.eyes[i];
    const EyeSwapchain& chain = session.swapchain(i);
    const EyeOptics optics = {from_xr(eye.pose), eye.fov.angleLeft, eye.fov.angleRight,
                              eye.fov.angleUp,   eye.fov.angleDown, options_.near_m,
                              options_.far_m};
    renderer_->set_picture(i, *pair[i].pixels, pair[i].camera);
    PENUMBRA_ASSIGN(image, session.acquire_image(i));
    const auto drawn = renderer_->draw(i, pair[i].world_from_camera, optics, surface,
                                       {chain.images[image], chain.width, chain.height});
    PENUMBRA_TRY(session.release_image(i));
    PENUMBRA_TRY(drawn);
    XrCompositionLayerProjectionView view{};
    view.type = XR_TYPE_COMPOSITION_LAYER_PROJECTION_VIEW;
    view.pose = eye.pose, view.fov = eye.fov;
    view.subImage = {chain.handle, {{0, 0}, {chain.width, chain.height}}, 0};
    views.push_back(view);
  }
  views_ = std::move(views);
  return {};
}

void SessionThread::add_latencies(const EyePair& pair, TimestampNs submitted, TimestampNs display) {
  const EyePicture& p = pair[0];
  const auto add = [&](const char* name, TimestampNs from, TimestampNs to) {
    latencies_.add(name, 1000 * (to - from).count());
  };
  add("capture_to_submit", p.captured, submitted);
  add("capture_to_display", p.captured, display);
  if (p.lit) add("light_age_at_display", *p.lit, display);
  if (p.composited) add("composite_to_submit", *p.composited, submitted);
}

}  // namespace penumbra::service
