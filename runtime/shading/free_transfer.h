// Transfer of an object with nothing around it, not even its floor: for one that is lifted off it.
// threads: thread-bound; traces beside its caller
#pragma once

#include <atomic>

#include "core/threads/background_task.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/transfer.h"

namespace penumbra::runtime {

class FreeTransfer {
 public:
  static constexpr int kRays = 128;  // a vertex

  /// Begins to trace: a second for 40,000 vertices on two cores.
  FreeTransfer(prt::Mesh mesh, int bands);
  /// Until then it has no points. It stays so where tracing failed.
  bool ready() const { return ready_; }
  void wait() { tracing_.wait(); }
  /// All of it, and the part of it that came by reflection between the object's own parts.
  /// in: ready()
  const prt::Transfer& surface() const { return surface_; }
  const prt::Transfer& reflected() const { return reflected_; }

 private:
  void trace(prt::Mesh mesh, int bands);

  prt::Transfer surface_, reflected_;
  std::atomic<bool> ready_ = false;
  BackgroundTask tracing_;  // the last: it is waited for before the rest goes
};

}  // namespace penumbra::runtime
