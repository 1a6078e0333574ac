// Bakes the scenes that are wanted while the service runs, one after the other.
// threads: thread-safe
#pragma once

#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "core/result.h"
#include "runtime/scene/scene.h"

namespace penumbra::service {

/// Makes what is told how far a piece of work, by its name, has come.
using ProgressOf = std::function<std::function<void(double)>(const std::string&)>;

/// What the cache holds is ready at once. Else objects come one by one as they were baked coarsely,
/// and then all of them as finely as was asked for.
class SceneKeeper {
 public:
  /// Is given each scene that is ready, and what it was made of, on the keeper's thread.
  using Ready = std::function<void(const runtime::Scene&, runtime::PreparedScene)>;
  SceneKeeper(const runtime::BakeSettings& settings, ProgressOf progress, Ready ready);
  /// Waits for a bake that goes on, which cannot be told to stop.
  ~SceneKeeper();

  /// From now on; of what was wanted before only the bake that goes on is ended.
  void want(runtime::Scene scene);
  /// Whether something is baked or waits for it.
  bool is_busy() const;
  /// Why objects of the newest scene are not there, by object; "scene" where it is none of them.
  std::map<std::string, std::string> faults() const;
  /// Of the scene that was wanted first: nothing while no word of it can be said yet.
  std::optional<Result<void>> first_outcome() const;

 private:
  void run() noexcept;
  void prepare(runtime::Scene scene);
  bool recall(const runtime::Scene& scene);
  void bake_coarsely(runtime::Scene& scene);
  void hand_over(const runtime::Scene& scene, Result<runtime::PreparedScene> prepared,
                 const std::string& object);
  bool is_overtaken() const;

  const runtime::BakeSettings settings_;
  const ProgressOf progress_;
  const Ready ready_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<runtime::Scene> wanted_;  // guarded by mutex_, as are all below
  bool busy_ = false, ends_ = false;
  std::map<std::string, std::string> faults_;
  std::optional<Result<void>> first_;
  std::jthread thread_;  // last: it uses all above
};

}  // namespace penumbra::service
