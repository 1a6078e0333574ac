#include "service/serve.h"

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdlib>

#include "capture/frames.h"
#include "core/io/log.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/shading/composite_stage.h"
#include "service/background_scene.h"
#include "service/http_api.h"
#include "service/rig_config.h"
#include "service/rig_source.h"
#include "service/scene_control.h"
#include "service/scene_reload.h"

namespace penumbra::service {

namespace {

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
  AttachedPipeline(SceneControl& control, Pipeline& pipeline) : control_(control) {
    control_.attach(&pipeline);
  }
  ~AttachedPipeline() { control_.attach(nullptr); }
  AttachedPipeline(const AttachedPipeline&) = delete;
  AttachedPipeline& operator=(const AttachedPipeline&) = delete;

 private:
  SceneControl& control_;
};

std::atomic<bool> g_reload = false;  // set by the signal handler alone
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void on_reload(int) {
  g_reload = true;
}

// Of what the scene file says now, as far as a running pipeline can follow.
void reload(const RigConfig& config, const runtime::Scene& at_first, runtime::Scene& last,
            SceneControl& objects) {
  if (!config.scene) return log_info("reload: the studio's own scene has no file");
  const auto now = runtime::read_scene(*config.scene);
  if (!now)
    return log_warning("reload: the scene stays as it is: {}: {}", now.error().where,
                       now.error().detail);
  apply_scene(at_first, last, *now, objects);
  last = *now;
  log_info("reload: {} is read anew", *config.scene);
}

}  // namespace

namespace {

// One after the other: until its objects are baked a scene has none.
class Service {
 public:
  Service(const RigConfig& config, const ProgressOf& progress)
      : config_(config), progress_([this, progress](const std::string& work) {
          return [this, work, shown = progress(work)](double done) {
            if (shown) shown(done);
            state_.publish_progress(work, done);
          };
        }) {
    options_.bands = config.bands;
    options_.max_lights = config.max_lights;
    options_.max_shadow_error = config.max_shadow_error;
    options_.progress = progress_;
    options_.timings = std::make_shared<StageTimes>();
  }
  Result<void> run();

 private:
  Result<void> run_without_objects(const BackgroundScene& scene, const std::atomic<bool>& stop);
  Result<void> run_with(runtime::PreparedScene scene, const std::atomic<bool>& stop);
  void publish(const runtime::Output& out) {
    state_.publish(out.light, out.source.time, out.pixels, out.overtaken);
    state_.publish_cameras(rig_.source->cameras(), rig_.source->counts());
  }

  const RigConfig& config_;
  PublishedState state_;
  SceneControl objects_;
  ProgressOf progress_;
  PipelineOptions options_;
  RigSource rig_;
  runtime::Scene scene_now_;  // as its file was last read
};

// The camera's picture and the light, while objects are baked.
Result<void> Service::run_without_objects(const BackgroundScene& scene,
                                          const std::atomic<bool>& stop) {
  runtime::Scene bare = rig_.scene;
  bare.objects.clear();
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(rig_.source->cameras(), bare, options_));
  const auto sink = [&](const runtime::Output& out) {
    publish(out);
    return !scene.is_ready();
  };
  const auto shown = pipeline.run_live(*rig_.source, sink, stop);
  // Before there is light the scene may be ready already.
  if (!shown && shown.error().code != ErrorCode::kUndetermined)
    return std::unexpected(shown.error());
  return {};
}

Result<void> Service::run_with(runtime::PreparedScene prepared, const std::atomic<bool>& stop) {
  const auto scene = std::make_shared<runtime::PreparedScene>(std::move(prepared));
  options_.measure_costs = true;
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(rig_.source->cameras(), scene, options_));
  runtime::drop_coefficients(*scene);
  const AttachedPipeline attached(objects_, pipeline);
  std::signal(SIGHUP, on_reload);
  const auto sink = [&](const runtime::Output& out) {
    if (g_reload.exchange(false)) reload(config_, rig_.scene, scene_now_, objects_);
    publish(out);
    return true;
  };
  PENUMBRA_ASSIGN(counts, pipeline.run_live(*rig_.source, sink, stop));
  log_info("stopped after {} frames in {:.1f} s; {} view and {} environment frames dropped",
           counts.frames, counts.seconds, counts.overtaken.view, counts.overtaken.environment);
  tell_losses(rig_.source->cameras(), rig_.source->counts());
  return {};
}

Result<void> Service::run() {
  constexpr std::chrono::seconds kFromCache(2);  // takes no longer
  // The port first: whether it is free should not be learnt after long work, and clients see
  // "starting".
  PENUMBRA_ASSIGN(api, HttpApi::start(config_.address, config_.port, state_, *options_.timings,
                                      config_.stale_after_s, &objects_));
  PENUMBRA_ASSIGN(rig, open_rig(config_, progress_));
  rig_ = std::move(rig);
  scene_now_ = rig_.scene;
  PENUMBRA_TRY(Pipeline::check(rig_.source->cameras()));
  const std::atomic<bool>& stop = catch_stop_signals();
  runtime::BakeSettings settings;
  settings.bands = config_.bands;
  BackgroundScene scene(rig_.scene, settings, progress_);
  // A run closes its source, and real cameras open once.
  const bool at_once = rig_.source->is_live() || scene.is_ready(kFromCache);
  log_info("listening on http://{}:{}", config_.address, api->port());
  if (!at_once) {
    log_info("the scene's objects are baked first: until then the camera's picture is shown");
    PENUMBRA_TRY(run_without_objects(scene, stop));
  }
  while (!stop && !scene.is_ready(std::chrono::milliseconds(100))) {
  }
  if (stop) {
    // A bake cannot be told to stop. It leaves nothing half-written.
    log_info("stopped before the objects were baked");
    std::_Exit(0);
  }
  PENUMBRA_ASSIGN(prepared, scene.take());
  return run_with(std::move(prepared), stop);
}

}  // namespace

Result<void> serve(const ServeOptions& o, const ProgressOf& progress) {
  PENUMBRA_ASSIGN(config, read_rig_config(o.config));
  std::signal(SIGHUP, SIG_IGN);  // until there is something to reload
  std::signal(SIGUSR1, SIG_IGN);
  return Service(config, progress).run();
}

}  // namespace penumbra::service
