// The text of one datagram of a stream of poses.
// threads: reentrant
#pragma once

#include <string_view>

#include "capture/poses/pose_history.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Longest line that is read, in bytes.
inline constexpr std::size_t kLargestPoseLine = 512;

/// `time_ns tx ty tz qx qy qz qw [sigma_m sigma_rad]`, with spaces between and a newline or none at
/// the end: nanoseconds as a whole number, metres within a million, a unit quaternion, standard
/// deviations above 0 and at most 10.
/// errors: kInvalid, kNonFinite
Result<TimedPose> parse_pose_line(std::string_view line);

}  // namespace penumbra::capture
#pragma GCC visibility pop
