// Bakes the scenes that are wanted while the service runs, one after the other.
// threads: thread-safe
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
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

/// What the cache holds is ready at once. Other objects come as they were baked coarsely, at the
/// start one by one, and then all of them as finely as was asked for. An object that is shown and
/// wanted stays in the picture.
class SceneKeeper {
 public:
  /// Is given each scene that is ready, and what it was made of, on the keeper's thread.
  using Ready = std::function<Result<void>(const runtime::Scene&, runtime::PreparedScene)>;
  /// Is told, there as well, of an object that cannot be baked; it is wanted no more.
  using Failed = std::function<void(const std::string& object)>;
  SceneKeeper(const runtime::BakeSettings& settings, ProgressOf progress, Ready ready,
              Failed failed = {});
  /// Waits for a bake that goes on, which cannot be told to stop.
  ~SceneKeeper();

  /// From now on; of what was wanted before only the bake that goes on is ended.
  void want(runtime::Scene scene);
  /// Whether something is baked or waits for it.
  bool is_busy() const;
  static constexpr std::size_t kMaxFaults = 64;
  /// Why objects that were wanted are not there, by object; "scene" where it is none of them. The
  /// newest kMaxFaults.
  std::map<std::string, std::string> faults() const;
  /// Takes what was said of an object, or of all, back. False: nothing was said.
  bool forget_fault(const std::string& object);
  void forget_faults();
  /// Of the scene that was wanted first: nothing while no word of it can be said yet. After a fault
  /// no more of it is baked.
  std::optional<Result<void>> first_outcome() const;

 private:
  void run() noexcept;
  void prepare(runtime::Scene scene);
  bool recall(const runtime::Scene& scene);
  void mark_coarse(runtime::Scene& scene) const;
  bool bake_one_by_one(runtime::Scene& scene);
  bool bake_beside_the_shown(runtime::Scene& scene);
  bool hand_over(const runtime::Scene& scene, Result<runtime::PreparedScene> prepared);
  void tell(const std::string& object, const Error& error);
  bool is_overtaken() const;
  bool brings_back_what_is_gone(const runtime::Scene& scene) const;

  const runtime::BakeSettings settings_;
  const ProgressOf progress_;
  const Ready ready_;
  const Failed failed_;
  bool shows_objects_ = false;  // of the keeper's thread alone
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<runtime::Scene> wanted_;  // guarded by mutex_, as are all below
  bool busy_ = false, ends_ = false;
  std::map<std::string, std::string> faults_;
  std::deque<std::string> told_;  // their objects, the oldest first
  std::optional<Result<void>> first_;
  std::jthread thread_;  // last: it uses all above
};

}  // namespace penumbra::service
