#include "runtime/pipeline/pipeline.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <mutex>
#include <utility>

#include "capture/camera_regions.h"
#include "core/io/log.h"
#include "core/threads/queues.h"
#include "runtime/governor/governor_config.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/pipeline/runner.h"
#include "runtime/pipeline/stage_access.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra {

namespace {

using compositor::Compositor;

bool has_display() {
  const auto set = [](const char* name) {
    const char* value = std::getenv(name);
    return value && *value;
  };
  return set("DISPLAY") || set("WAYLAND_DISPLAY");
}

lighting::EstimateOptions estimate_options(const PipelineOptions& options,
                                           const runtime::PreparedScene& scene) {
  return {.bands = options.bands, .lights = {.max_count = options.max_lights}, .sun = scene.sun};
}

Result<void> check(const PipelineOptions& options) {
  if (options.bands < 1 || options.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "bands", fmt::format("is not within 1..{}", kMaxBands));
  if (options.max_lights < 0 || options.max_lights > 64)
    return fail(ErrorCode::kInvalid, "max_lights", "is not within 0..64");
  if (!(options.max_shadow_error > 0 && options.max_shadow_error <= 1))
    return fail(ErrorCode::kInvalid, "max_shadow_error", "is not above 0 and at most 1");
  if (!options.progress) return fail(ErrorCode::kInvalid, "progress", "is empty");
  return {};
}

Error no_environment_camera() {
  return {ErrorCode::kInvalid, "capture", "has no environment camera"};
}

bool any_shows_surroundings(const std::vector<capture::CameraInfo>& cameras) {
  return std::ranges::any_of(cameras, capture::shows_surroundings);
}

}  // namespace

// The stages refer to the times and the scene, which stay where they are.
struct Pipeline::Impl {
  std::vector<capture::CameraInfo> cameras;
  PipelineOptions options;
  std::shared_ptr<StageTimes> times;
  std::shared_ptr<const runtime::PreparedScene> scene;
  std::optional<runtime::LightEstimationStage> light;  // none: set_light()
  std::mutex stage_mutex;  // of `composite` itself, for who moves objects from other threads
  std::unique_ptr<runtime::CompositeStage> composite;
  lighting::LightEstimate estimate;
  LightWatch watch;
  std::function<void()> turn;
  struct NextStage {
    std::shared_ptr<const runtime::PreparedScene> scene;
    std::unique_ptr<runtime::CompositeStage> stage;
  };
  Latest<NextStage> next_stage;
  std::atomic<bool> live = false;
  std::mutex light_mutex;
  lighting::LightEstimate newest_light;  // guarded by light_mutex
  Latest<lighting::GovernorConfig> next_governor;
  Latest<lighting::SurfaceRoughness> next_mirror;  // of the scene that comes next
  std::mutex governor_mutex;
  lighting::GovernorConfig governor;  // the newest; guarded by governor_mutex

  Result<std::unique_ptr<runtime::CompositeStage>> make_stage(const runtime::PreparedScene& of,
                                                              Compositor::Surface surface) const {
    PENUMBRA_ASSIGN(stage, runtime::CompositeStage::create(cameras, of, surface, *times,
                                                           options.oversampling, options.sampling));
    if (options.varies_rays) stage->vary_rays();
    return std::move(stage);
  }
  Result<lighting::GovernorConfig> make_governor(const runtime::PreparedScene& of) const;
  Result<NextStage> prepare_next(std::shared_ptr<runtime::PreparedScene> next);
  // On the compositing thread.
  runtime::CompositeStage* take_next_stage();

  // A frame of a camera that the pipeline was made for; its size is the stages' business.
  Result<void> check(const capture::Frame& frame) const {
    if (frame.camera < 0 || static_cast<std::size_t>(frame.camera) >= cameras.size())
      return fail(
          ErrorCode::kInvalid, "frame",
          fmt::format("belongs to camera {}, but there are {}", frame.camera, cameras.size()));
    const bool is_map = cameras[static_cast<std::size_t>(frame.camera)].gives_maps;
    if (is_map ? !frame.map : !frame.pixels)
      return fail(ErrorCode::kInvalid, "frame", is_map ? "has no map" : "has no pixels");
    return {};
  }
  Result<void> check(const capture::FrameSource& source) const {
    if (!light) return std::unexpected(no_environment_camera());
    const bool same =
        std::ranges::equal(source.cameras(), cameras, [](const auto& a, const auto& b) {
          return a.role == b.role && a.projection.width == b.projection.width &&
                 a.projection.height == b.projection.height;
        });
    if (same) return {};
    return fail(ErrorCode::kInvalid, "source", "has other cameras than the pipeline");
  }
};

Result<lighting::GovernorConfig> Pipeline::Impl::make_governor(
    const runtime::PreparedScene& of) const {
  const auto costs = !options.measure_costs ? runtime::CostSource::kFixed
                     : options.bake.cache == runtime::BakeCache::kNotUsed
                         ? runtime::CostSource::kFitted
                         : runtime::CostSource::kKept;
  return runtime::make_governor_config(
      of, {options.max_shadow_error, options.bands, options.max_lights}, costs);
}

// Up to the first picture: what is drawn and shaded first takes longest.
Result<Pipeline::Impl::NextStage> Pipeline::Impl::prepare_next(
    std::shared_ptr<runtime::PreparedScene> next) {
  PENUMBRA_ASSIGN(stage, make_stage(*next, Compositor::Surface::kOffscreen));
  runtime::drop_coefficients(*next);
  double now_s = 0;
  {
    const std::scoped_lock lock(stage_mutex);
    stage->moves().go_on_from(composite->moves());
    now_s = composite->moves().now_s();
  }
  stage->await_lifted();
  stage->warm_up();
  if (live) stage->keep_time();
  const lighting::LightEstimate newest = [&] {
    const std::scoped_lock lock(light_mutex);
    return newest_light;
  }();
  if (newest.valid) stage->shade(newest, now_s);
  stage->release();
  return NextStage{std::move(next), std::move(stage)};
}

runtime::CompositeStage* Pipeline::Impl::take_next_stage() {
  auto next = next_stage.take();
  if (!next) return nullptr;
  {
    // A move that comes now goes to either, but to neither in vain.
    const std::scoped_lock lock(stage_mutex);
    next->stage->moves().go_on_from(composite->moves());
    next->stage->go_on_from(*composite);
    std::swap(composite, next->stage);
  }
  next->stage.reset();  // refers to the scene before
  scene = next->scene;
  return composite.get();
}

Pipeline::Pipeline(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Pipeline::~Pipeline() = default;
Pipeline::Pipeline(Pipeline&&) noexcept = default;
Pipeline& Pipeline::operator=(Pipeline&&) noexcept = default;

Result<void> Pipeline::check(const std::vector<capture::CameraInfo>& cameras) {
  StageTimes times;
  PENUMBRA_TRY(runtime::LightEstimationStage::create(cameras, {}, times));
  return {};
}

Result<Pipeline> Pipeline::create(const std::vector<capture::CameraInfo>& cameras,
                                  const runtime::Scene& scene, const PipelineOptions& options) {
  PENUMBRA_TRY(penumbra::check(options));
  if (any_shows_surroundings(cameras)) PENUMBRA_TRY(check(cameras));
  runtime::BakeSettings settings = options.bake;
  settings.bands = options.bands;
  PENUMBRA_ASSIGN(prepared, runtime::prepare(scene, settings, options.progress));
  const auto own = std::make_shared<runtime::PreparedScene>(std::move(prepared));
  PENUMBRA_ASSIGN(pipeline, create(cameras, own, options));
  runtime::drop_coefficients(*own);
  return std::move(pipeline);
}

Result<Pipeline> Pipeline::create(const std::vector<capture::CameraInfo>& cameras,
                                  std::shared_ptr<const runtime::PreparedScene> scene,
                                  const PipelineOptions& options) {
  PENUMBRA_TRY(penumbra::check(options));
  auto impl = std::make_unique<Impl>();
  if (!scene) return fail(ErrorCode::kInvalid, "scene", "is null");
  for (const runtime::PreparedObject& o : scene->objects)
    if (!o.animation && o.baked.transfer.points > 0 && o.baked.transfer.values.empty())
      return fail(ErrorCode::kInvalid, o.name, "keeps no transfer: another pipeline loaded it");
  impl->cameras = cameras;
  impl->options = options;
  impl->scene = std::move(scene);
  impl->times = options.timings ? options.timings : std::make_shared<StageTimes>();
  if (any_shows_surroundings(cameras)) {
    PENUMBRA_ASSIGN(light, runtime::LightEstimationStage::create(
                               cameras, estimate_options(options, *impl->scene), *impl->times));
    PENUMBRA_ASSIGN(config, impl->make_governor(*impl->scene));
    impl->governor = config;
    light.set_governor(config);
    light.mirror(runtime::mirrored_roughness(*impl->scene));
    impl->light.emplace(std::move(light));
  }
  const auto composite_on = [&](Compositor::Surface surface) {
    return impl->make_stage(*impl->scene, surface);
  };
  if (options.window && has_display()) {
    if (auto windowed = composite_on(Compositor::Surface::kWindow))
      impl->composite = std::move(*windowed);
    else
      log_warning("{}: {}; the run goes on without a window", windowed.error().where,
                  windowed.error().detail);
  }
  if (!impl->composite) {
    PENUMBRA_ASSIGN(composite, composite_on(Compositor::Surface::kOffscreen));
    impl->composite = std::move(composite);
  }
  return Pipeline(std::move(impl));
}

bool Pipeline::shows_surroundings(int camera) const {
  return impl_->light && camera >= 0 && static_cast<std::size_t>(camera) < impl_->cameras.size() &&
         impl_->light->takes(camera);
}

Result<bool> Pipeline::add_environment(const capture::Frame& frame) {
  if (!impl_->light) return std::unexpected(no_environment_camera());
  if (const auto governor = impl_->next_governor.take()) impl_->light->set_governor(*governor);
  if (const auto mirrored = impl_->next_mirror.take()) impl_->light->mirror(*mirrored);
  PENUMBRA_TRY(impl_->check(frame));
  if (!impl_->light->takes(frame.camera))
    return fail(ErrorCode::kInvalid, "frame",
                "belongs to a camera that does not show the surroundings");
  const auto measured = impl_->light->process(frame, impl_->estimate);
  if (measured) return true;
  if (measured.error().code == ErrorCode::kUndetermined) return false;
  return std::unexpected(measured.error());
}

Result<void> Pipeline::add_foreground(const capture::Frame& frame) {
  PENUMBRA_TRY(impl_->check(frame));
  return impl_->composite->add_foreground(frame);
}

void Pipeline::set_light(const lighting::LightEstimate& light) {
  impl_->estimate = light;
  impl_->estimate.valid = true;
}

Result<runtime::Composited> Pipeline::composite(const capture::Frame& view) {
  PENUMBRA_TRY(impl_->check(view));
  (void)impl_->take_next_stage();
  if (impl_->cameras[static_cast<std::size_t>(view.camera)].role != capture::Role::kView)
    return fail(ErrorCode::kInvalid, "frame", "does not belong to a view camera");
  runtime::Composited out;
  if (!impl_->estimate.valid) {
    out.pixels = *view.pixels;
    return out;
  }
  // Whether the caller can film it darker is not known: until then the light is a lower bound.
  const auto note = [&out](double factor) {
    out.darker_view = factor;
    return false;
  };
  if (impl_->light)
    impl_->light->add_recoveries(impl_->composite->recover_lights(view, impl_->estimate, note));
  if (view.for_light) {
    out.pixels = *view.pixels;
    return out;
  }
  PENUMBRA_TRY(impl_->composite->process(view, impl_->estimate, out));
  return out;
}

Result<void> Pipeline::move_object(std::string_view object, const runtime::ObjectPlace& place) {
  const std::scoped_lock lock(impl_->stage_mutex);
  return impl_->composite->moves().put(object, place);
}

Result<void> Pipeline::show_object(std::string_view object, bool visible) {
  const std::scoped_lock lock(impl_->stage_mutex);
  return impl_->composite->moves().show(object, visible);
}

Result<void> Pipeline::play_object(std::string_view object,
                                   const runtime::ObjectPlayback& playback) {
  const std::scoped_lock lock(impl_->stage_mutex);
  return impl_->composite->moves().play(object, playback);
}

Result<void> Pipeline::follow(const runtime::ObjectTrack& track) {
  const std::scoped_lock lock(impl_->stage_mutex);
  return impl_->composite->moves().follow(track);
}

std::vector<runtime::ObjectState> Pipeline::objects() const {
  const std::scoped_lock lock(impl_->stage_mutex);
  return impl_->composite->moves().states();
}

Result<void> Pipeline::change_scene(runtime::PreparedScene scene) {
  {
    const std::scoped_lock lock(impl_->stage_mutex);
    if (impl_->composite->output().has_window())
      return fail(ErrorCode::kUnavailable, "scene", "cannot change in a pipeline with a window");
  }
  std::optional<lighting::GovernorConfig> config;
  if (impl_->light) {
    PENUMBRA_ASSIGN(made, impl_->make_governor(scene));
    config = made;
  }
  const lighting::SurfaceRoughness mirrored = runtime::mirrored_roughness(scene);
  PENUMBRA_ASSIGN(next,
                  impl_->prepare_next(std::make_shared<runtime::PreparedScene>(std::move(scene))));
  impl_->next_mirror.put(mirrored);
  if (config) {
    const std::scoped_lock lock(impl_->governor_mutex);
    config->limits.max_error = impl_->governor.limits.max_error;
    impl_->governor = *config;
    impl_->next_governor.put(*config);
  }
  impl_->next_stage.put(std::move(next));
  return {};
}

Result<void> Pipeline::set_max_shadow_error(double error) {
  if (!(error > 0 && error <= 1))
    return fail(ErrorCode::kInvalid, "max_shadow_error", "is not above 0 and at most 1");
  const std::scoped_lock lock(impl_->governor_mutex);
  impl_->governor.limits.max_error = error;
  impl_->next_governor.put(impl_->governor);
  return {};
}

double Pipeline::max_shadow_error() const {
  const std::scoped_lock lock(impl_->governor_mutex);
  return impl_->governor.limits.max_error;
}

void Pipeline::watch_light(LightWatch watch) {
  impl_->watch = std::move(watch);
}

void Pipeline::watch_turns(std::function<void()> turn) {
  impl_->turn = std::move(turn);
}

Result<runtime::RunCounts> Pipeline::replay(capture::FrameSource& source,
                                            const runtime::Sink& sink) {
  if (impl_->scene->sun && !impl_->scene->sun->time)
    return fail(ErrorCode::kInvalid, "sun",
                "has no time: a replay needs the one at which it was filmed");
  PENUMBRA_TRY(impl_->check(source));
  return runtime::run_replay(source, *impl_->light, *impl_->composite, sink, *impl_->times);
}

Result<runtime::RunCounts> Pipeline::run_live(capture::FrameSource& source,
                                              const runtime::Sink& sink,
                                              const std::atomic<bool>& stop) {
  PENUMBRA_TRY(impl_->check(source));
  runtime::LiveChanges changes;
  changes.turn = impl_->turn;
  changes.stage_waits = [this] { return impl_->next_stage.waiting(); };
  changes.take_stage = [this] { return impl_->take_next_stage(); };
  changes.take_governor = [this] { return impl_->next_governor.take(); };
  changes.take_mirror = [this] { return impl_->next_mirror.take(); };
  changes.on_light = [this](const auto& stage, const auto& light) {
    {
      const std::scoped_lock lock(impl_->light_mutex);
      impl_->newest_light = light;
    }
    if (impl_->watch) impl_->watch(stage.environment(), light);
  };
  impl_->live = true;
  return runtime::run_live(source, *impl_->light, *impl_->composite, sink, *impl_->times, stop,
                           changes);
}

const lighting::LightEstimate& Pipeline::light() const {
  return impl_->estimate;
}
const StageTimes& Pipeline::timings() const {
  return *impl_->times;
}
StageTimes& Pipeline::timings() {
  return *impl_->times;
}
const runtime::PreparedScene& Pipeline::scene() const {
  return *impl_->scene;
}
runtime::CompositeStage& runtime::StageAccess::stage_of(Pipeline& pipeline) {
  return *pipeline.impl_->composite;
}
compositor::Compositor& Pipeline::output() {
  return impl_->composite->output();
}

}  // namespace penumbra
