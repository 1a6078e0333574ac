#include "service/serve.h"

#include <fmt/ranges.h>
#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <future>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/pipeline.h"
#include "service/head_poses.h"
#include "service/headset/headset.h"
#include "service/http/http_api.h"
#include "service/http/published_state.h"
#include "service/light_page.h"
#include "service/outputs/frame_output.h"
#include "service/outputs/output_set.h"
#include "service/recording/live_recording.h"
#include "service/rig_config.h"
#include "service/rig_reload.h"
#include "service/rig_source.h"
#include "service/scene/scene_control.h"
#include "service/scene/scene_keeper.h"
#include "service/scene/scene_reload.h"
#include "service/system_notify.h"

namespace penumbra::service {

namespace fs = std::filesystem;

namespace {

constexpr std::int64_t kStuck_ns = 30'000'000'000;  // no frame and no wait for one takes so long

std::int64_t now_ns() {
  return std::chrono::steady_clock::now().time_since_epoch().count();
}

void tell_losses(const std::vector<capture::CameraInfo>& cameras,
                 const std::vector<capture::CameraCounts>& counts) {
  for (std::size_t i = 0; i < counts.size(); ++i) {
    const capture::CameraCounts& c = counts[i];
    if (c.lost + c.damaged + c.rejected + c.overrun > 0)
      log_info("{}: {} frames lost, {} damaged, {} rejected, {} overrun", cameras[i].name, c.lost,
               c.damaged, c.rejected, c.overrun);
  }
}

// Clients change the pipeline for as long as it is there.
class AttachedPipeline {
 public:
  AttachedPipeline(SceneControl& control, Pipeline& pipeline, SceneKeeper& keeper)
      : control_(control) {
    control_.attach(&pipeline, &keeper);
  }
  ~AttachedPipeline() { control_.attach(nullptr, nullptr); }
  AttachedPipeline(const AttachedPipeline&) = delete;
  AttachedPipeline& operator=(const AttachedPipeline&) = delete;

 private:
  SceneControl& control_;
};

// And ask the cameras.
class AttachedCameras {
 public:
  AttachedCameras(CameraControl& control, capture::FrameSource& source) : control_(control) {
    control_.attach(&source);
  }
  ~AttachedCameras() { control_.attach(nullptr); }
  AttachedCameras(const AttachedCameras&) = delete;
  AttachedCameras& operator=(const AttachedCameras&) = delete;

 private:
  CameraControl& control_;
};

std::atomic<bool> g_reload = false;  // set by the signal handler alone
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void on_reload(int) {
  g_reload = true;
}

// The folder of this user's, or this system service's, running programs.
std::optional<fs::path> runtime_folder() {
  if (const char* own = std::getenv("RUNTIME_DIRECTORY"); own && *own) return fs::path(own);
  if (const char* user = std::getenv("XDG_RUNTIME_DIR"); user && *user)
    return fs::path(user) / "penumbra";
  return std::nullopt;
}

// Where one was not asked for another service may have it.
template <class Make>
auto make_at(const std::optional<fs::path>& asked, const char* usual, Make make)
    -> decltype(make(fs::path())) {
  const auto folder = runtime_folder();
  const fs::path path = asked ? *asked : folder ? *folder / usual : fs::path();
  if (path.empty()) return {};
  auto made = make(path);
  if (made || asked) return made;
  log_warning("{}: {}: this service goes without it", made.error().where, made.error().detail);
  return {};
}

HttpOptions http_options(const RigConfig& c) {
  HttpOptions out;
  out.address = c.address;
  out.port = c.port;
  out.token = c.token;
  out.socket_for_group = c.socket_for_group;
  out.origins = c.origins;
  out.stale_after_s = c.stale_after_s;
  if (c.scene) out.assets = fs::absolute(*c.scene).parent_path();
  return out;
}

// By OutputSet::kKinds.
OutputSet::Targets targets_of(const RigConfig& c) {
  return {c.pipewire, c.v4l2, c.y4m};
}

// Where the configuration came from, and what it said then.
struct RigFile {
  fs::path path;  // empty: from no file
  std::string text;
};

// Of work that takes long, a line every ten seconds.
class ProgressLog {
 public:
  explicit ProgressLog(std::string work) : work_(std::move(work)) {}
  void tell(double done) {
    constexpr auto kBetween = std::chrono::seconds(10);
    const std::scoped_lock lock(mutex_);
    if (done >= 1 || std::chrono::steady_clock::now() - last_ < kBetween) return;
    last_ = std::chrono::steady_clock::now();
    log_info("{}: {:.0f} % is done", work_, 100 * done);
  }

 private:
  const std::string work_;
  std::mutex mutex_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

// The camera's picture and the light at once, objects as they are baked.
class Service {
 public:
  Service(const RigConfig& config, RigFile file, const ProgressOf& progress)
      : config_(config),
        file_(std::move(file)),
        error_limit_(config.max_shadow_error),
        recording_(config.recordings),
        progress_([this, progress](const std::string& work) {
          return [this, work, shown = progress(work),
                  log = std::make_shared<ProgressLog>(work)](double done) {
            if (shown) shown(done);
            state_.publish_progress(work, done);
            log->tell(done);
          };
        }) {}
  Result<void> run();

 private:
  Result<void> listen();
  Result<void> compose(capture::FrameSource& source, const std::atomic<bool>& stop);
  [[noreturn]] void end_at_once(const std::optional<Error>& failed);
  void reload();
  Result<void> reload_rig();
  void reload_scene();
  void publish(const runtime::Output& out, const capture::FrameSource& source,
               const Pipeline& pipeline);
  void publish_pose(const capture::Frame& frame);
  void show_in_headset(const runtime::Output& out, const capture::FrameSource& source);

  const RigConfig& config_;
  const RigFile file_;
  double error_limit_;  // as rig.toml last had it
  PublishedState state_;
  LiveRecording recording_;
  SceneControl objects_;
  CameraControl cameras_;
  ProgressOf progress_;
  std::shared_ptr<StageTimes> times_ = std::make_shared<StageTimes>();
  std::unique_ptr<HttpApi> tcp_, socket_;
  std::unique_ptr<LightPage> page_;
  OutputSet outputs_;
  std::shared_ptr<Headset> headset_;
  RigSource rig_;
  int reloads_ = 0;  // so far; numbered, no answer is held back as said already
  std::mutex scenes_mutex_;
  runtime::Scene shown_;  // what the pipeline was last given; guarded by scenes_mutex_
};

void Service::reload() {
  ++reloads_;
  notify_system("RELOADING=1");
  if (const auto done = reload_rig(); !done)
    log_warning("reload {}: the rig stays as it is: {}: {}", reloads_, done.error().where,
                done.error().detail);
  reload_scene();
  notify_system("READY=1");
}

// The limit of the errors and the outputs as rig.toml has them now; of the rest it says that it
// waits.
Result<void> Service::reload_rig() {
  if (file_.path.empty()) return {};
  PENUMBRA_ASSIGN(now, read_rig_config(file_.path));
  PENUMBRA_ASSIGN(text, read_text(file_.path));
  PENUMBRA_ASSIGN(keys, changed_keys(file_.text, text, file_.path));
  if (now.token != config_.token) keys.emplace_back("http.token_file");
  // What clients asked for stays where the file says what it said.
  if (now.max_shadow_error != error_limit_) {
    PENUMBRA_TRY(objects_.set_max_shadow_error(now.max_shadow_error));
    error_limit_ = now.max_shadow_error;
    log_info("reload {}: light.max_shadow_error is {:g}", reloads_, error_limit_);
  }
  outputs_.change(targets_of(now));
  std::erase_if(keys, [](const std::string& key) {
    return key == "light.max_shadow_error" ||
           std::ranges::any_of(OutputSet::kKinds, [&](std::string_view output) {
             return key == fmt::format("output.{}", output);
           });
  });
  if (!keys.empty())
    log_warning("reload {}: {} of {} counts from the next start", reloads_, fmt::join(keys, ", "),
                file_.path.string());
  return {};
}

// Of what the scene file says now.
void Service::reload_scene() {
  const SceneFile file = objects_.file();
  if (file.path.empty()) return log_info("reload {}: the studio's own scene has no file", reloads_);
  const auto now = runtime::read_scene(file.path);
  if (now) {
    const runtime::Scene shown = [&] {
      const std::scoped_lock lock(scenes_mutex_);
      return shown_;
    }();
    const bool bakes = apply_scene(shown, file.scene, *now, objects_);
    objects_.follow_file(file, *now, bakes);
    log_info("reload {}: {} is read anew", reloads_, file.path.string());
  } else {
    log_warning("reload {}: the scene stays as it is: {}: {}", reloads_, now.error().where,
                now.error().detail);
  }
}

void Service::publish(const runtime::Output& out, const capture::FrameSource& source,
                      const Pipeline& pipeline) {
  state_.publish(out.source.time, out.pixels, out.overtaken);
  state_.publish_cameras(source.cameras(), source.counts());
  if (page_) page_->write(pipeline.objects(), out.source.time);
  publish_pose(out.source);
  if (config_.openxr) show_in_headset(out, source);
  outputs_.show(out.pixels, out.source.time);
  std::vector<PublishedState::OutputState> states;
  for (OutputSet::State& o : outputs_.states())
    states.push_back({std::move(o.name), o.counts.shown, o.counts.overtaken, std::move(o.trouble)});
  state_.publish_outputs(std::move(states));
}

void Service::publish_pose(const capture::Frame& frame) {
  if (!rig_.posed) return;
  const capture::PoseSourceState now = rig_.posed->pose_state();
  PublishedState::PoseState state{
      now.name, {}, now.taken, now.refused, rig_.posed->left_out(), frame.opacity, now.trouble};
  if (now.age) state.age_s = now.age->count();
  if (const auto pose = rig_.posed->last_pose()) {
    state.sigma_mm = 1000 * pose->sigma_m, state.sigma_deg = pose->sigma_rad * 180 / kPi;
    state.extrapolated_ms = 1000 * pose->extrapolated.count();
  }
  state_.publish_pose(std::move(state));
}

// With one view camera both eyes see its picture.
void Service::show_in_headset(const runtime::Output& out, const capture::FrameSource& source) {
  const capture::CameraInfo& camera = source.cameras()[static_cast<std::size_t>(out.source.camera)];
  const int eye = camera.eye == "left" ? 0 : camera.eye == "right" ? 1 : -1;
  headset_->show(eye, {.pixels = out.pixels,
                       .camera = camera.projection,
                       .world_from_camera = out.source.world_from_camera,
                       .captured = out.source.time,
                       .lit = out.light.valid ? std::optional(out.light.time) : std::nullopt,
                       .composited = TimestampNs{now_ns()}});
  const HeadsetState now = headset_->state();
  const char* const phase = now.phase == HeadsetPhase::kRunning ? "running"
                            : now.phase == HeadsetPhase::kIdle  ? "idle"
                                                                : "lost";
  state_.publish_headset({phase, now.runtime, now.headset, now.rate_hz, now.shown, now.overtaken,
                          now.unmatched, now.unplaced, now.refused, now.restarts, now.trouble,
                          now.latency});
}

Result<void> Service::listen() {
  const HttpSources sources{state_, *times_, objects_, recording_, cameras_};
  if (config_.port) {
    PENUMBRA_ASSIGN(api, HttpApi::start(http_options(config_), sources));
    tcp_ = std::move(api);
  }
  const auto on_socket = [&](const fs::path& path) {
    HttpOptions options = http_options(config_);
    options.port.reset();
    options.socket = path;
    return HttpApi::start(options, sources);
  };
  PENUMBRA_ASSIGN(socket, make_at(config_.socket, "http.sock", on_socket));
  socket_ = std::move(socket);
  if (!tcp_ && !socket_)
    return fail(ErrorCode::kInvalid, "http",
                "has neither a port nor a socket: nobody could ask for anything");
  PENUMBRA_ASSIGN(page, make_at(config_.light_page, "light", LightPage::create));
  page_ = std::move(page);
  return {};
}

Result<void> Service::compose(capture::FrameSource& source, const std::atomic<bool>& stop) {
  PipelineOptions options;
  options.bands = config_.bands;
  options.max_lights = config_.max_lights;
  options.max_shadow_error = config_.max_shadow_error;
  options.timings = times_;
  options.measure_costs = true;
  runtime::Scene bare = rig_.scene;
  bare.objects.clear();
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(source.cameras(), bare, options));
  pipeline.watch_light([this](const Environment& map, const lighting::LightEstimate& light) {
    if (page_) page_->write(light);
    if (page_) page_->write(map);
    state_.publish_light(light);
    state_.publish_environment(map);
  });
  runtime::BakeSettings settings;
  settings.bands = config_.bands;
  const auto ready = [&](const runtime::Scene& scene,
                         runtime::PreparedScene prepared) -> Result<void> {
    PENUMBRA_TRY(pipeline.change_scene(std::move(prepared)));
    ::malloc_trim(0);  // what a bake and the scene before took
    const std::scoped_lock lock(scenes_mutex_);
    shown_ = scene;
    return {};
  };
  SceneKeeper keeper(settings, progress_, ready,
                     [&](const std::string& object) { objects_.forget(object); });
  objects_.set_scene(rig_.scene, config_.scene.value_or(""));
  keeper.want(rig_.scene);
  auto attached = std::make_optional<AttachedPipeline>(objects_, pipeline, keeper);
  std::signal(SIGHUP, on_reload);
  std::atomic<std::int64_t> turned_ns = now_ns();
  const Watchdog watchdog([&] { return now_ns() - turned_ns < kStuck_ns; });
  std::optional<Error> failed;
  pipeline.watch_turns([&] {
    turned_ns = now_ns();
    if (g_reload.exchange(false)) reload();
  });
  const auto sink = [&](const runtime::Output& out) {
    publish(out, source, pipeline);
    // A scene that cannot be loaded at the start is a mistake that its author wants to hear of.
    if (const auto first = keeper.first_outcome(); first && !*first) failed = first->error();
    return !failed;
  };
  const auto counts = pipeline.run_live(source, sink, stop);
  notify_system("STOPPING=1");
  attached.reset();  // nobody asks for another bake
  if (!failed && !counts) failed = counts.error();
  if (!failed) {
    log_info(
        "stopped after {} frames in {:.1f} s; {} view, {} environment and {} foreground frames "
        "dropped",
        counts->frames, counts->seconds, counts->overtaken.view, counts->overtaken.environment,
        counts->overtaken.foreground);
    tell_losses(source.cameras(), source.counts());
  }
  if (keeper.is_busy()) end_at_once(failed);
  if (failed) return std::unexpected(*failed);
  return {};
}

// Neither a bake nor a source that is opened can be told to stop. They leave nothing half-written.
void Service::end_at_once(const std::optional<Error>& failed) {
  notify_system("STOPPING=1");
  (void)recording_.stop();
  if (failed)
    log_warning("{}: {}: the service ends", failed->where, failed->detail);
  else
    log_info("stopped while its scene was prepared");
  page_.reset(), socket_.reset(), tcp_.reset(), headset_.reset();
  std::_Exit(failed ? 2 : 0);
}

Result<void> Service::run() {
  // Who sees the socket may send a stop.
  const std::atomic<bool>& stop = catch_stop_signals();
  // The port first: whether it is free should not be learnt after long work, and clients see
  // "starting".
  PENUMBRA_TRY(listen());
  const bool follows_head = config_.pose && config_.pose->source == "openxr";
  if (config_.openxr || follows_head) {
    PENUMBRA_ASSIGN(headset, Headset::create(config_.headset));
    headset_ = std::move(headset);
  }
  // A studio takes seconds to render its room, and a stop does not wait for it.
  std::optional<Hand> hand;
  if (follows_head && config_.pose->device != "head")
    hand = config_.pose->device == "left" ? Hand::kLeft : Hand::kRight;
  auto head = follows_head ? std::make_unique<HeadPoses>(headset_, hand) : nullptr;
  auto opening = std::async(std::launch::async, [&] {
    return open_rig(config_, progress_, PlayedTimes::kOfNow, std::move(head));
  });
  while (opening.wait_for(std::chrono::milliseconds(50)) != std::future_status::ready)
    if (stop) end_at_once(std::nullopt);
  PENUMBRA_ASSIGN(rig, opening.get());
  rig_ = std::move(rig);
  shown_ = rig_.scene;
  PENUMBRA_TRY(Pipeline::check(rig_.source->cameras()));
  PENUMBRA_TRY(outputs_.open(targets_of(config_), rig_.source->view_rate()));
  state_.describe_source(rig_.source->cameras(), rig_.source->view_rate());
  if (tcp_) log_info("listening on http://{}:{}", config_.address, tcp_->port());
  if (socket_) log_info("listening on the socket {}", socket_->socket().string());
  notify_system("READY=1");
  const auto source = recording_.tap(*rig_.source);
  const AttachedCameras attached(cameras_, *source);
  return compose(*source, stop);
}

}  // namespace

Result<void> serve(const ServeOptions& o, const ProgressOf& progress) {
  constexpr double kBetweenSameLines_s = 10;
  // What a bake takes goes back to the system; pictures of a frame do not, each time.
  constexpr int kLarge_bytes = 16 << 20, kArenas = 4;
  ::mallopt(M_MMAP_THRESHOLD, kLarge_bytes);
  ::mallopt(M_ARENA_MAX, kArenas);
  limit_log_rate(kBetweenSameLines_s);
  PENUMBRA_ASSIGN(config, o.quick ? quick_rig(*o.quick) : read_rig_config(o.config));
  RigFile file;
  if (!o.quick) {
    PENUMBRA_ASSIGN(text, read_text(o.config));
    file = {o.config, std::move(text)};
  }
  std::signal(SIGHUP, SIG_IGN);  // until there is something to reload
  std::signal(SIGUSR1, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);  // a client or a reader that left, and
  std::signal(SIGXFSZ, SIG_IGN);  // a file that may not grow, are errors where they are met
  return Service(config, std::move(file), progress).run();
}

}  // namespace penumbra::service
