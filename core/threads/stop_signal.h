// A polite end: SIGINT and SIGTERM become a flag that the running loops look at.
// threads: any may read the flag; catch_stop_signals() before others start
#pragma once

#include <atomic>
#include <string>

#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra {

/// Takes the two signals over from here on and returns the flag they set. A second signal ends the
/// program at once.
const std::atomic<bool>& catch_stop_signals();

/// The error of a run that a signal ended before its results were whole.
inline std::unexpected<Error> stopped(const std::string& what) {
  return fail(ErrorCode::kUnavailable, what, "stopped by a signal; nothing of this run was kept");
}

}  // namespace penumbra
#pragma GCC visibility pop
