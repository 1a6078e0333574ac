// What a stream of poses may send: a line a datagram, and the history that takes it.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <glm/geometric.hpp>
#include <string_view>

#include "calib/camera/pose_file.h"
#include "capture/poses/pose_history.h"
#include "capture/poses/pose_line.h"
#include "core/io/log.h"

// Lines are datagrams of one stream. The first byte chooses: a pose file instead.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace penumbra;
  if (size == 0) return 0;
  set_log_sink({});
  std::string_view text(reinterpret_cast<const char*>(data + 1), size - 1);
  if (data[0] == 'f') {
    if (const auto file = calib::parse_pose_file(text, "fuzz"))
      for (const auto& [name, pose] : file->cameras)
        if (!(std::abs(glm::length(pose.rotation) - 1) < 1e-6)) __builtin_trap();
    return 0;
  }
  capture::PoseHistory history({.capacity = 32});
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    const auto pose = capture::parse_pose_line(line);
    if (!pose) continue;
    if (!(std::abs(glm::length(pose->world_from_body.rotation) - 1) < 1e-6)) __builtin_trap();
    (void)history.put(*pose);
    if (history.size() > 32) __builtin_trap();
    for (const double late_s : {-.5, 0., .02}) {
      const auto at = history.at(pose->time + Seconds(late_s));
      if (at && !(std::isfinite(at->pose.translation.x) && at->sigma_m >= 0)) __builtin_trap();
    }
  }
  return 0;
}
