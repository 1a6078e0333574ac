#include <spdlog/spdlog.h>

#include "service/serve.h"
#include "compositor/compositor.h"
#include "runtime/pipeline/governance.h"
#include "runtime/pipeline/light_stage.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/compose_stage.h"
#include "service/rig_config.h"
#include "service/http_api.h"
#include "runtime/pipeline/light_file.h"
#include "service/rig_source.h"
#include "runtime/pipeline/runner.h"
#include "core/stop_signal.h"

namespace penumbra::service {

Result<void> serve(const ServeOptions& o, const ProgressOf& progress) {
  auto config = read_rig_config(o.config);
  if (!config) return std::unexpected(config.error());
  // The port first: whether it is free should not be learnt after the bake, and clients see "starting".
  StageTimes times;
  PublishedState state;
  auto api = HttpApi::start(config->address, config->port, state, times, config->stale_after_s);
  if (!api) return std::unexpected(api.error());
  auto rig = open_rig(*config, progress);
  if (!rig) return std::unexpected(rig.error());
  runtime::BakeSettings settings;
  settings.bands = config->bands;
  auto prepared = runtime::prepare(rig->scene, settings, progress);
  if (!prepared) return std::unexpected(prepared.error());
  const auto& cameras = rig->source->cameras();
  auto light = runtime::LightStage::create(cameras, {config->bands, {config->discs, .02}}, times);
  if (!light) return std::unexpected(light.error());
  auto governance = runtime::make_governance(*prepared, config->budget, true);
  if (!governance) return std::unexpected(governance.error());
  light->govern(*governance);
  auto compose =
      runtime::ComposeStage::create(cameras, *prepared, compositor::Compositor::Surface::kOffscreen, times);
  if (!compose) return std::unexpected(compose.error());

  const std::atomic<bool>& stop = catch_stop_signals();
  spdlog::info("listening on http://{}:{}", config->address, (*api)->port());
  auto counts = runtime::run_live(
      *rig->source, *light, **compose,
      [&](const runtime::Output& out) {
        state.publish(out.light, out.source.time, out.pixels);
        state.publish_cameras(cameras, rig->source->counts());
        return true;
      },
      times, stop);
  if (!counts) return std::unexpected(counts.error());
  spdlog::info("stopped after {} frames in {:.1f} s, {} dropped", counts->frames, counts->seconds,
               counts->dropped);
  return {};
}

}  // namespace penumbra::service
