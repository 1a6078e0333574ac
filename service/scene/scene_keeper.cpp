#include "service/scene/scene_keeper.h"

#include <algorithm>
#include <utility>

#include "core/io/log.h"

namespace penumbra::service {

namespace {

// No exception leaves the keeper's thread.
Result<runtime::PreparedScene> prepare_safely(const runtime::Scene& scene,
                                              const runtime::BakeSettings& settings,
                                              const ProgressOf& progress) {
  try {
    return runtime::prepare(scene, settings, progress);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, "the scene", e.what());
  }
}

runtime::BakeSettings coarse_of(const runtime::BakeSettings& settings) {
  runtime::BakeSettings out = runtime::BakeSettings::coarse();
  out.bands = settings.bands;
  out.cache = settings.cache;
  return out;
}

runtime::Scene with_objects(const runtime::Scene& scene, std::size_t count) {
  runtime::Scene out = scene;
  out.objects.resize(count);
  return out;
}

}  // namespace

SceneKeeper::SceneKeeper(const runtime::BakeSettings& settings, ProgressOf progress, Ready ready)
    : settings_(settings),
      progress_(std::move(progress)),
      ready_(std::move(ready)),
      thread_([this] { run(); }) {}

SceneKeeper::~SceneKeeper() {
  {
    const std::scoped_lock lock(mutex_);
    ends_ = true;
  }
  changed_.notify_all();
}

void SceneKeeper::want(runtime::Scene scene) {
  {
    const std::scoped_lock lock(mutex_);
    wanted_ = std::move(scene);
  }
  changed_.notify_all();
}

bool SceneKeeper::is_busy() const {
  const std::scoped_lock lock(mutex_);
  return busy_ || wanted_;
}

std::map<std::string, std::string> SceneKeeper::faults() const {
  const std::scoped_lock lock(mutex_);
  return faults_;
}

std::optional<Result<void>> SceneKeeper::first_outcome() const {
  const std::scoped_lock lock(mutex_);
  return first_;
}

bool SceneKeeper::is_overtaken() const {
  const std::scoped_lock lock(mutex_);
  return wanted_ || ends_;
}

void SceneKeeper::run() noexcept {
  while (true) {
    runtime::Scene scene;
    {
      std::unique_lock lock(mutex_);
      busy_ = false;
      changed_.wait(lock, [&] { return wanted_ || ends_; });
      if (ends_) return;
      scene = *std::exchange(wanted_, std::nullopt);
      busy_ = true;
      faults_.clear();
    }
    prepare(std::move(scene));
  }
}

// in: whose fault it would be
void SceneKeeper::hand_over(const runtime::Scene& scene, Result<runtime::PreparedScene> prepared,
                            const std::string& object) {
  if (prepared) {
    ready_(scene, std::move(*prepared));
    const std::scoped_lock lock(mutex_);
    if (!first_) first_.emplace();
    return;
  }
  log_warning("{}: {}: {}", object, prepared.error().where, prepared.error().detail);
  const std::scoped_lock lock(mutex_);
  faults_[object] = prepared.error().where + " " + prepared.error().detail;
  if (!first_) first_ = std::unexpected(prepared.error());
}

// True where all of it was baked before.
bool SceneKeeper::recall(const runtime::Scene& scene) {
  runtime::BakeSettings only = settings_;
  only.cache = runtime::BakeCache::kOnly;
  auto recalled = prepare_safely(scene, only, progress_);
  if (!recalled) return false;  // for whatever reason: who bakes it tells
  hand_over(scene, std::move(recalled), "scene");
  return true;
}

// One object after the other; those that cannot be baked leave the scene.
void SceneKeeper::bake_coarsely(runtime::Scene& scene) {
  const runtime::BakeSettings coarse = coarse_of(settings_);
  for (std::size_t count = 1; count <= scene.objects.size() && !is_overtaken();) {
    const runtime::Scene first = with_objects(scene, count);
    auto prepared = prepare_safely(first, coarse, progress_);
    const bool baked = prepared.has_value();
    hand_over(first, std::move(prepared), scene.objects[count - 1].name);
    if (baked)
      ++count;
    else
      scene.objects.erase(scene.objects.begin() + static_cast<std::ptrdiff_t>(count) - 1);
  }
}

void SceneKeeper::prepare(runtime::Scene scene) {
  if (settings_.cache != runtime::BakeCache::kNotUsed && recall(scene)) return;
  // How finely a real mesh is cut depends on all objects: it would be baked anew with each.
  const bool has_real_mesh =
      std::ranges::any_of(scene.real, [](const auto& real) { return !real.plane; });
  if (!has_real_mesh) bake_coarsely(scene);
  if (is_overtaken()) return;
  hand_over(scene, prepare_safely(scene, settings_, progress_), "scene");
}

}  // namespace penumbra::service
