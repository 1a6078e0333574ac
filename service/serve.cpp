#include "service/serve.h"

#include <atomic>
#include <csignal>

#include "capture/frames.h"
#include "core/io/log.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/pipeline.h"
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
void reload(const RigConfig& config, const runtime::Scene& before, SceneControl& objects) {
  if (!config.scene) return log_info("reload: the studio's own scene has no file");
  const auto now = runtime::read_scene(*config.scene);
  if (!now)
    return log_warning("reload: the scene stays as it is: {}: {}", now.error().where,
                       now.error().detail);
  apply_scene(before, *now, objects);
  log_info("reload: {} is read anew", *config.scene);
}

}  // namespace

Result<void> serve(const ServeOptions& o, const ProgressOf& progress) {
  PENUMBRA_ASSIGN(config, read_rig_config(o.config));
  std::signal(SIGHUP, SIG_IGN);  // until there is something to reload
  std::signal(SIGUSR1, SIG_IGN);
  // The port first: whether it is free should not be learnt after the bake, and clients see
  // "starting".
  PipelineOptions options;
  options.bands = config.bands;
  options.max_lights = config.max_lights;
  options.max_shadow_error = config.max_shadow_error;
  options.measure_costs = true;
  options.progress = progress;
  options.timings = std::make_shared<StageTimes>();
  PublishedState state;
  SceneControl objects;
  PENUMBRA_ASSIGN(api, HttpApi::start(config.address, config.port, state, *options.timings,
                                      config.stale_after_s, &objects));
  PENUMBRA_ASSIGN(rig, open_rig(config, progress));
  const auto& cameras = rig.source->cameras();
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(cameras, rig.scene, options));

  const AttachedPipeline attached(objects, pipeline);
  std::signal(SIGHUP, on_reload);
  const std::atomic<bool>& stop = catch_stop_signals();
  log_info("listening on http://{}:{}", config.address, api->port());
  const auto publish = [&](const runtime::Output& out) {
    if (g_reload.exchange(false)) reload(config, rig.scene, objects);
    state.publish(out.light, out.source.time, out.pixels, out.overtaken);
    state.publish_cameras(cameras, rig.source->counts());
    return true;
  };
  PENUMBRA_ASSIGN(counts, pipeline.run_live(*rig.source, publish, stop));
  log_info("stopped after {} frames in {:.1f} s; {} view and {} environment frames dropped",
           counts.frames, counts.seconds, counts.overtaken.view, counts.overtaken.environment);
  tell_losses(cameras, rig.source->counts());
  return {};
}

}  // namespace penumbra::service
