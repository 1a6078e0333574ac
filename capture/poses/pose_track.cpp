#include "capture/poses/pose_track.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "core/io/files.h"
#include "core/io/log.h"

namespace penumbra::capture {

namespace {

constexpr std::string_view kByNanoseconds = "time_ns,tx,ty,tz,qx,qy,qz,qw",
                           kBySeconds = "time_s,tx,ty,tz,qx,qy,qz,qw";
constexpr std::size_t kLargestTrack_bytes = std::size_t{1} << 30;

template <class Number>
bool read_cell(std::string_view& line, bool last, Number& out) {
  const std::size_t comma = last ? line.size() : line.find(',');
  if (comma == std::string_view::npos) return false;
  const auto [end, error] = std::from_chars(line.data(), line.data() + comma, out);
  if (error != std::errc() || end != line.data() + comma) return false;
  line.remove_prefix(std::min(comma + 1, line.size()));
  return true;
}

bool read_time(std::string_view& line, bool nanoseconds, TimestampNs& out) {
  if (nanoseconds)
    return read_cell(line, false, out.value) && out.value <= kLargestPoseTime_ns &&
           out.value >= -kLargestPoseTime_ns;
  double seconds = 0;
  if (!read_cell(line, false, seconds) || !(std::abs(seconds) * 1e9 <= kLargestPoseTime_ns))
    return false;
  out.value = std::llround(seconds * 1e9);
  return true;
}

std::optional<TimedPose> read_row(std::string_view line, bool nanoseconds) {
  TimedPose out;
  std::array<double, 7> v{};
  if (!read_time(line, nanoseconds, out.time)) return std::nullopt;
  for (std::size_t i = 0; i < v.size(); ++i)
    if (!read_cell(line, i + 1 == v.size(), v[i]) || !std::isfinite(v[i])) return std::nullopt;
  out.world_from_body = {glm::dquat(v[6], v[3], v[4], v[5]), {v[0], v[1], v[2]}};
  return out;
}

}  // namespace

Result<std::vector<TimedPose>> read_pose_track(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(whole, read_text(path, kLargestTrack_bytes));
  std::string_view text = whole;
  std::vector<TimedPose> out;
  bool nanoseconds = false;
  for (int number = 1; !text.empty(); ++number) {
    std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    const auto invalid = [&](const std::string& detail) {
      return fail(ErrorCode::kInvalid, fmt::format("{}:{}", path.string(), number), detail);
    };
    if (number == 1) {
      nanoseconds = line == kByNanoseconds;
      if (!nanoseconds && line != kBySeconds)
        return invalid(fmt::format("is neither the header {} nor {}", kBySeconds, kByNanoseconds));
      continue;
    }
    if (line.empty()) continue;
    auto row = read_row(line, nanoseconds);
    if (!row) return invalid("does not have eight numbers");
    glm::dquat& q = row->world_from_body.rotation;
    if (!(std::abs(glm::length(q) - 1) <= kQuaternionSlack))
      return invalid("has a quaternion that is not of unit length");
    q = glm::normalize(q);
    if (!out.empty() && row->time <= out.back().time)
      return invalid("is not later than the line before");
    out.push_back(*row);
  }
  if (out.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no pose");
  return out;
}

Result<std::unique_ptr<PoseTrack>> PoseTrack::open(const std::filesystem::path& path,
                                                   Seconds clock_offset,
                                                   Seconds max_extrapolation) {
  PENUMBRA_ASSIGN(poses, read_pose_track(path));
  std::unique_ptr<PoseTrack> out(new PoseTrack(
      {.name = path.string(), .capacity = poses.size(), .max_extrapolation = max_extrapolation}));
  for (TimedPose& pose : poses) {
    pose.time = pose.time + clock_offset;
    if (const auto taken = out->history_.put(pose); !taken) return std::unexpected(taken.error());
  }
  if (out->history_.refused() > 0)
    log_warning("{}: {} of {} poses jump and are left out", path.string(), out->history_.refused(),
                poses.size());
  out->state_ = {.name = "track " + path.filename().string(),
                 .age = {},
                 .taken = out->history_.taken(),
                 .refused = out->history_.refused(),
                 .trouble = {}};
  return out;
}

std::optional<FramePose> PoseTrack::pose_of(const Frame& frame) {
  const auto newest = history_.newest();
  const auto pose = history_.at(frame.time);
  const std::scoped_lock lock(mutex_);
  state_.age = std::max(Seconds(0), frame.time - *newest);
  state_.trouble = pose ? "" : "the track has no pose at the frame's time";
  return pose;
}

PoseSourceState PoseTrack::state() const {
  const std::scoped_lock lock(mutex_);
  return state_;
}

}  // namespace penumbra::capture
