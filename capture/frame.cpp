#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>
#include <variant>

#include "capture/frames.h"

namespace penumbra::capture {

namespace {

constexpr std::array<std::pair<Role, std::string_view>, 4> kRoles{
    {{Role::kEnvironment, "environment"},
     {Role::kView, "view"},
     {Role::kDepth, "depth"},
     {Role::kMask, "mask"}}};

}  // namespace

std::string_view role_name(Role role) {
  return kRoles[static_cast<std::size_t>(role)].second;
}

std::optional<Role> role_from(std::string_view name) {
  const auto found = std::ranges::find(kRoles, name, &std::pair<Role, std::string_view>::second);
  return found == kRoles.end() ? std::nullopt : std::optional(found->first);
}

int width(const FramePixels& pixels) {
  return std::visit([](const auto& image) { return image.width(); }, pixels);
}

int height(const FramePixels& pixels) {
  return std::visit([](const auto& image) { return image.height(); }, pixels);
}

Result<std::vector<Exposure>> exposures_of(std::span<const double> times_s,
                                           std::span<const double> gains) {
  constexpr std::size_t kMax = 16;
  constexpr double kShortest_s = 1e-7, kLongest_s = 60, kMinGain = 1e-3, kMaxGain = 1e4;
  if (times_s.empty() || times_s.size() > kMax)
    return fail(ErrorCode::kInvalid, "exposures_s",
                fmt::format("are not 1 to {} exposure times", kMax));
  if (!gains.empty() && gains.size() != times_s.size())
    return fail(ErrorCode::kInvalid, "gains",
                fmt::format("are {}, of {} exposure times", gains.size(), times_s.size()));
  std::vector<Exposure> out;
  for (std::size_t i = 0; i < times_s.size(); ++i) {
    const double gain = gains.empty() ? 1 : gains[i];
    if (!(times_s[i] >= kShortest_s && times_s[i] <= kLongest_s))
      return fail(ErrorCode::kInvalid, "exposures_s", "has a time that is not within 1e-7..60 s");
    if (!(gain >= kMinGain && gain <= kMaxGain))
      return fail(ErrorCode::kInvalid, "gains", "has a gain that is not within .001..10000");
    out.push_back({Seconds(times_s[i]), Gain(gain)});
  }
  return out;
}

Result<void> FrameSource::set_exposures(int /*camera*/,
                                        const std::vector<Exposure>& /*exposures*/) {
  return fail(ErrorCode::kInvalid, "exposures_s",
              "of these frames were chosen when they were taken");
}

}  // namespace penumbra::capture
