#include <spdlog/spdlog.h>

#include "service/commands.h"
#include "service/http_api.h"
#include "service/light_file.h"
#include "service/progress.h"
#include "service/rig_config.h"
#include "service/runner.h"
#include "service/stop_signal.h"
#include "service/studio_setup.h"

namespace penumbra::service {

namespace {

// A capture folder played again and again, its times running on.
class LoopingFolder : public capture::FrameSource {
 public:
  static Result<std::unique_ptr<LoopingFolder>> open(const std::string& folder) {
    auto first = capture::open_capture_folder(folder);
    if (!first) return std::unexpected(first.error());
    auto out = std::unique_ptr<LoopingFolder>(new LoopingFolder);
    out->folder_ = folder;
    out->cameras_ = (*first)->cameras();
    out->source_ = std::move(*first);
    return out;
  }
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return source_->view_rate(); }
  Result<std::optional<capture::Frame>> next() override {
    auto frame = source_->next();
    if (!frame) return frame;
    if (!*frame) {
      auto again = capture::open_capture_folder(folder_);
      if (!again) return std::unexpected(again.error());
      source_ = std::move(*again);
      frame = source_->next();
      if (!frame || !*frame) return frame;
      offset_ns_ = last_ns_ + 33'000'000 - (*frame)->time.value;
    }
    (*frame)->time.value += offset_ns_;
    last_ns_ = (*frame)->time.value;
    return frame;
  }

 private:
  LoopingFolder() = default;
  std::string folder_;
  std::vector<capture::CameraInfo> cameras_;
  std::unique_ptr<capture::FrameSource> source_;
  std::int64_t offset_ns_ = 0, last_ns_ = 0;
};

struct Rig {
  std::unique_ptr<capture::FrameSource> source;
  Scene scene;
};

Result<Rig> open_rig(const RigConfig& c) {
  Rig rig;
  if (c.source == "studio") {
    const StudioRequest request{.environment = c.environment,
                                .asset = c.asset,
                                .prop = c.prop,
                                .width = c.width,
                                .height = c.height,
                                .fps = c.fps,
                                .frames = 1 << 30,
                                .view_clip = 16};
    auto setup = set_up_studio(request, progress_bar);
    if (!setup) return std::unexpected(setup.error());
    rig.scene = std::move(setup->scene);
    rig.source = std::make_unique<capture::Studio>(setup->world, setup->options);
  } else if (c.source == "cameras") {
    auto source = capture::Rig::open(c.cameras);
    if (!source) return std::unexpected(source.error());
    rig.source = std::move(*source);
  } else {
    auto source = LoopingFolder::open(c.source);
    if (!source) return std::unexpected(source.error());
    rig.source = std::move(*source);
  }
  if (c.scene) {
    auto scene = read_scene(*c.scene);
    if (!scene) return std::unexpected(scene.error());
    rig.scene = std::move(*scene);
  }
  return rig;
}

}  // namespace

Result<void> serve(const ServeOptions& o) {
  auto config = read_rig_config(o.config);
  if (!config) return std::unexpected(config.error());
  // The port first: whether it is free should not be learnt after the bake, and clients see "starting".
  StageTimes times;
  PublishedState state;
  auto api = HttpApi::start(config->address, config->port, state, times, config->stale_after_s);
  if (!api) return std::unexpected(api.error());
  auto rig = open_rig(*config);
  if (!rig) return std::unexpected(rig.error());
  BakeSettings settings;
  settings.bands = config->bands;
  auto prepared = prepare(rig->scene, settings, progress_bar);
  if (!prepared) return std::unexpected(prepared.error());
  const auto& cameras = rig->source->cameras();
  auto light = LightStage::create(cameras, {config->bands, {config->discs, .02}}, times);
  if (!light) return std::unexpected(light.error());
  auto governance = make_governance(*prepared, config->budget, true);
  if (!governance) return std::unexpected(governance.error());
  light->govern(*governance);
  auto compose =
      ComposeStage::create(cameras, *prepared, compositor::Compositor::Surface::kOffscreen, times);
  if (!compose) return std::unexpected(compose.error());

  const std::atomic<bool>& stop = catch_stop_signals();
  spdlog::info("listening on http://{}:{}", config->address, (*api)->port());
  auto counts = run_live(
      *rig->source, *light, **compose,
      [&](const Output& out) {
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
