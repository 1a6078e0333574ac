// A scene that is loaded and baked while the service runs already.
// threads: thread-bound
#pragma once

#include <chrono>
#include <future>

#include "core/result.h"
#include "runtime/scene/scene.h"
#include "service/rig_source.h"

namespace penumbra::service {

class BackgroundScene {
 public:
  /// Begins at once, on a thread of its own. `progress` is called there.
  BackgroundScene(const runtime::Scene& scene, const runtime::BakeSettings& settings,
                  const ProgressOf& progress);
  /// Whether it is ready, or has failed, within that time.
  bool is_ready(std::chrono::milliseconds within = {}) const;
  /// Waits for it; once.
  /// errors: as runtime::prepare, kUnavailable (out of memory)
  Result<runtime::PreparedScene> take();

 private:
  std::future<Result<runtime::PreparedScene>> prepared_;
};

}  // namespace penumbra::service
