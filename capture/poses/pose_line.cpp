#include "capture/poses/pose_line.h"

#include <array>
#include <charconv>
#include <cmath>
#include <optional>

namespace penumbra::capture {

namespace {

constexpr std::string_view kBlanks = " \t\r\n";

// The next word; empty at the end.
std::string_view take_word(std::string_view& line) {
  line.remove_prefix(std::min(line.find_first_not_of(kBlanks), line.size()));
  const std::string_view word = line.substr(0, line.find_first_of(kBlanks));
  line.remove_prefix(word.size());
  return word;
}

template <class Number>
std::optional<Number> number_of(std::string_view word) {
  Number out{};
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), out);
  if (word.empty() || error != std::errc() || end != word.data() + word.size()) return std::nullopt;
  return out;
}

}  // namespace

Result<TimedPose> parse_pose_line(std::string_view line) {
  constexpr double kFar_m = 1e6, kLargestSigma = 10;
  const auto invalid = [](const char* why) { return fail(ErrorCode::kInvalid, "pose line", why); };
  if (line.size() > kLargestPoseLine) return invalid("is longer than 512 bytes");
  const auto time = number_of<std::int64_t>(take_word(line));
  if (!time) return invalid("does not begin with a time in whole nanoseconds");
  if (*time > kLargestPoseTime_ns || *time < -kLargestPoseTime_ns)
    return invalid("has a time beyond any clock");
  std::array<double, 9> v{};
  std::size_t count = 0;
  for (std::string_view word = take_word(line); !word.empty(); word = take_word(line)) {
    const auto value = number_of<double>(word);
    if (!value || count == v.size()) return invalid("does not have eight or ten numbers");
    if (!std::isfinite(*value))
      return fail(ErrorCode::kNonFinite, "pose line", "has a number that is not finite");
    v[count++] = *value;
  }
  if (count != 7 && count != 9) return invalid("does not have eight or ten numbers");
  TimedPose out;
  out.time.value = *time;
  for (const double metres : {v[0], v[1], v[2]})
    if (std::abs(metres) > kFar_m) return invalid("has a position beyond a thousand kilometres");
  const glm::dquat q(v[6], v[3], v[4], v[5]);
  if (!(std::abs(glm::length(q) - 1) <= kQuaternionSlack))
    return invalid("has a quaternion that is not of unit length");
  out.world_from_body = {glm::normalize(q), {v[0], v[1], v[2]}};
  if (count == 7) return out;
  for (const double sigma : {v[7], v[8]})
    if (!(sigma > 0 && sigma <= kLargestSigma))
      return invalid("has a standard deviation that is not above 0 and at most 10");
  out.sigma_m = v[7], out.sigma_rad = v[8];
  return out;
}

}  // namespace penumbra::capture
