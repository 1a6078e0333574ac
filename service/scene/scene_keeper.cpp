#include "service/scene/scene_keeper.h"

#include <algorithm>
#include <utility>

#include "core/exceptions.h"
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
    return fail(ErrorCode::kUnavailable, "the scene", reason_of(e));
  }
}

bool has_object(const runtime::Scene& scene, const std::string& name) {
  return std::ranges::find(scene.objects, name, &runtime::SceneObject::name) != scene.objects.end();
}

runtime::Scene with_objects(const runtime::Scene& scene, std::size_t count) {
  runtime::Scene out = scene;
  out.objects.resize(count);
  return out;
}

std::function<void(double)> no_progress(const std::string&) {
  return [](double) {};
}

}  // namespace

SceneKeeper::SceneKeeper(const runtime::BakeSettings& settings, ProgressOf progress, Ready ready,
                         Failed failed)
    : settings_(settings),
      progress_(std::move(progress)),
      ready_(std::move(ready)),
      failed_(std::move(failed)),
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

bool SceneKeeper::forget_fault(const std::string& object) {
  const std::scoped_lock lock(mutex_);
  return faults_.erase(object) > 0;
}

void SceneKeeper::forget_faults() {
  const std::scoped_lock lock(mutex_);
  faults_.clear();
}

std::optional<Result<void>> SceneKeeper::first_outcome() const {
  const std::scoped_lock lock(mutex_);
  return first_;
}

bool SceneKeeper::is_overtaken() const {
  const std::scoped_lock lock(mutex_);
  return wanted_ || ends_;
}

// A client may have taken an object away while it was baked.
bool SceneKeeper::brings_back_what_is_gone(const runtime::Scene& scene) const {
  const std::scoped_lock lock(mutex_);
  return wanted_ && std::ranges::any_of(scene.objects, [&](const auto& o) {
           return !has_object(*wanted_, o.name);
         });
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
      std::erase_if(faults_, [&](const auto& f) { return has_object(scene, f.first); });
      faults_.erase("scene");
    }
    prepare(std::move(scene));
  }
}

void SceneKeeper::tell(const std::string& object, const Error& error) {
  log_warning("{}: {}: {}", object, error.where, error.detail);
  {
    const std::scoped_lock lock(mutex_);
    std::erase_if(told_, [&](const auto& o) { return o == object || !faults_.contains(o); });
    // Who asks again and again for what is not there fills no memory.
    if (told_.size() >= kMaxFaults) {
      faults_.erase(told_.front());
      told_.pop_front();
    }
    told_.push_back(object);
    faults_[object] = error.where + " " + error.detail;
    if (!first_) first_ = std::unexpected(error);
  }
  if (failed_ && object != "scene") failed_(object);
}

// False where it is not shown.
bool SceneKeeper::hand_over(const runtime::Scene& scene, Result<runtime::PreparedScene> prepared) {
  if (!prepared) {
    tell("scene", prepared.error());
    return false;
  }
  if (brings_back_what_is_gone(scene)) return false;
  Result<void> taken;
  try {
    taken = ready_(scene, std::move(*prepared));
  } catch (const std::exception& e) {
    taken = fail(ErrorCode::kUnavailable, "the scene", reason_of(e));
  }
  if (!taken) {
    tell("scene", taken.error());
    return false;
  }
  shows_objects_ = !scene.objects.empty();
  const std::scoped_lock lock(mutex_);
  if (!first_) first_.emplace();
  return true;
}

// True where all of it was baked before.
bool SceneKeeper::recall(const runtime::Scene& scene) {
  runtime::BakeSettings only = settings_;
  only.cache = runtime::BakeCache::kOnly;
  auto recalled = prepare_safely(scene, only, no_progress);
  if (!recalled) return false;  // for whatever reason: who bakes it tells
  (void)hand_over(scene, std::move(recalled));
  return true;
}

// Those that the cache does not hold as finely as is asked for.
void SceneKeeper::mark_coarse(runtime::Scene& scene) const {
  runtime::BakeSettings only = settings_;
  only.cache = runtime::BakeCache::kOnly;
  for (runtime::SceneObject& o : scene.objects) {
    runtime::Scene alone = scene;
    alone.objects = {o};
    o.coarse = settings_.cache == runtime::BakeCache::kNotUsed ||
               !prepare_safely(alone, only, no_progress);
  }
}

// Each shown as soon as it is there; those that cannot be baked leave the scene. False where no
// more is to be baked.
bool SceneKeeper::bake_one_by_one(runtime::Scene& scene) {
  for (std::size_t count = 1; count <= scene.objects.size() && !is_overtaken();) {
    const runtime::Scene first = with_objects(scene, count);
    auto prepared = prepare_safely(first, settings_, progress_);
    if (prepared) {
      (void)hand_over(first, std::move(prepared));
      ++count;
      continue;
    }
    tell(scene.objects[count - 1].name, prepared.error());
    scene.objects.erase(scene.objects.begin() + static_cast<std::ptrdiff_t>(count) - 1);
    if (const auto outcome = first_outcome(); outcome && !*outcome) return false;
  }
  return true;
}

// All at once, so that nothing that is shown is missing meanwhile. An object that cannot be baked
// leaves the scene.
bool SceneKeeper::bake_beside_the_shown(runtime::Scene& scene) {
  const bool keeps_bakes = settings_.cache != runtime::BakeCache::kNotUsed;
  for (std::size_t i = 0; keeps_bakes && i < scene.objects.size() && !is_overtaken();) {
    runtime::Scene alone = scene;
    alone.objects = {scene.objects[i]};
    const auto prepared = prepare_safely(alone, settings_, progress_);
    if (prepared) {
      ++i;
      continue;
    }
    tell(scene.objects[i].name, prepared.error());
    scene.objects.erase(scene.objects.begin() + static_cast<std::ptrdiff_t>(i));
  }
  if (is_overtaken()) return true;
  return hand_over(scene, prepare_safely(scene, settings_, progress_));
}

void SceneKeeper::prepare(runtime::Scene scene) {
  const bool uses_cache = settings_.cache != runtime::BakeCache::kNotUsed;
  if (uses_cache && recall(scene)) return;
  // How finely a real mesh is cut depends on all objects: it would be baked anew with each.
  const bool has_real_mesh =
      std::ranges::any_of(scene.real, [](const auto& real) { return !real.plane; });
  if (!has_real_mesh) {
    mark_coarse(scene);
    const bool goes_on = shows_objects_ ? bake_beside_the_shown(scene) : bake_one_by_one(scene);
    if (!goes_on) return;
    for (runtime::SceneObject& o : scene.objects) o.coarse = false;
  }
  if (is_overtaken()) return;
  (void)hand_over(scene, prepare_safely(scene, settings_, progress_));
}

}  // namespace penumbra::service
