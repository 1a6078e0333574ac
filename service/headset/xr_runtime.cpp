#include "service/headset/internal/xr_runtime.h"

#include <fmt/format.h>
#include <openxr/openxr_reflection.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <vector>

namespace penumbra::service {

namespace {

constexpr const char* kClock = XR_KHR_CONVERT_TIMESPEC_TIME_EXTENSION_NAME;
constexpr std::int64_t kSecond_ns = 1'000'000'000;

std::string result_name(XrResult result) {
  switch (result) {
#define PENUMBRA_XR_NAME(name, value) \
  case name:                          \
    return #name;
    XR_LIST_ENUM_XrResult(PENUMBRA_XR_NAME)
#undef PENUMBRA_XR_NAME
        default : return fmt::format("OpenXR error {}", static_cast<int>(result));
  }
}

std::vector<const char*> needed_extensions(const HeadsetGraphics& graphics) {
  std::vector<const char*> out = graphics.extensions();
  out.push_back(kClock);
  return out;
}

const char* purpose(const std::string& extension) {
  if (extension == kClock) return "so it does not tell which time its poses are of";
  return "so it takes no picture from EGL; pictures from GLX or Vulkan are not built in";
}

// What a text of a runtime may do to a log ends at its array.
template <std::size_t N>
std::string text_of(const char (&array)[N]) {
  return {array, ::strnlen(array, N)};
}

}  // namespace

Result<void> xr_try(XrResult result, const char* what) {
  if (XR_SUCCEEDED(result)) return {};
  const bool lost = result == XR_ERROR_INSTANCE_LOST || result == XR_ERROR_SESSION_LOST;
  return fail(
      lost ? ErrorCode::kClosed : ErrorCode::kUnavailable, "headset",
      lost ? "the OpenXR runtime has gone" : fmt::format("{}: {}", what, result_name(result)));
}

Pose from_xr(const XrPosef& p) {
  const glm::dquat q(p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z);
  return {glm::normalize(q), {p.position.x, p.position.y, p.position.z}};
}

XrPosef to_xr(const Pose& p) {
  const auto f = [](double v) { return static_cast<float>(v); };
  const glm::dquat q = glm::normalize(p.rotation);
  return {{f(q.x), f(q.y), f(q.z), f(q.w)},
          {f(p.translation.x), f(p.translation.y), f(p.translation.z)}};
}

bool is_pose(const XrPosef& p) {
  const XrQuaternionf& q = p.orientation;
  const float n = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
  return std::abs(n - 1) < .02f && std::isfinite(p.position.x + p.position.y + p.position.z);
}

TimestampNs monotonic_now() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return {std::int64_t{t.tv_sec} * kSecond_ns + t.tv_nsec};
}

Result<void> XrRuntime::check_extensions(const HeadsetGraphics& graphics) {
  std::uint32_t count = 0;
  if (XR_FAILED(xrEnumerateInstanceExtensionProperties(nullptr, 0, &count, nullptr))) return {};
  constexpr std::uint32_t kMost = 4096;
  count = std::min(count, kMost);
  XrExtensionProperties empty{};
  empty.type = XR_TYPE_EXTENSION_PROPERTIES;
  std::vector<XrExtensionProperties> all(count, empty);
  if (XR_FAILED(xrEnumerateInstanceExtensionProperties(nullptr, count, &count, all.data())))
    return {};
  for (const std::string needed : needed_extensions(graphics))
    if (std::ranges::none_of(all,
                             [&](const auto& one) { return text_of(one.extensionName) == needed; }))
      return fail(ErrorCode::kUnavailable, "headset",
                  fmt::format("the OpenXR runtime does not offer {}, {}", needed, purpose(needed)));
  return {};
}

Result<std::unique_ptr<XrRuntime>> XrRuntime::open(const std::string& application,
                                                   HeadsetGraphics& graphics) {
  PENUMBRA_TRY(check_extensions(graphics));
  const auto extensions = needed_extensions(graphics);
  XrInstanceCreateInfo info{};
  info.type = XR_TYPE_INSTANCE_CREATE_INFO;
  std::snprintf(info.applicationInfo.applicationName, XR_MAX_APPLICATION_NAME_SIZE, "%s",
                application.c_str());
  std::snprintf(info.applicationInfo.engineName, XR_MAX_ENGINE_NAME_SIZE, "Penumbra");
  info.applicationInfo.apiVersion = XR_MAKE_VERSION(1, 0, 0);
  info.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
  info.enabledExtensionNames = extensions.data();
  std::unique_ptr<XrRuntime> out(new XrRuntime);
  const XrResult made = xrCreateInstance(&info, &out->instance_);
  if (XR_FAILED(made)) {
    out->instance_ = XR_NULL_HANDLE;
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("no OpenXR runtime answers: {}", result_name(made)));
  }
  PENUMBRA_TRY(out->find_functions());
  PENUMBRA_TRY(out->find_headset());
  PENUMBRA_TRY(graphics.check_requirements(out->instance_, out->system_));
  return out;
}

XrRuntime::~XrRuntime() {
  if (instance_) xrDestroyInstance(instance_);
}

Result<void> XrRuntime::find_functions() {
  XrInstanceProperties properties{};
  properties.type = XR_TYPE_INSTANCE_PROPERTIES;
  PENUMBRA_TRY(xr_try(xrGetInstanceProperties(instance_, &properties), "the runtime's name"));
  const XrVersion v = properties.runtimeVersion;
  name_ = fmt::format("{} {}.{}.{}", text_of(properties.runtimeName), XR_VERSION_MAJOR(v),
                      XR_VERSION_MINOR(v), XR_VERSION_PATCH(v));
  const auto find = [&](const char* name, auto& out) {
    PFN_xrVoidFunction any = nullptr;
    const XrResult found = xrGetInstanceProcAddr(instance_, name, &any);
    out = reinterpret_cast<std::remove_reference_t<decltype(out)>>(any);
    return xr_try(any ? found : XR_ERROR_FUNCTION_UNSUPPORTED, name);
  };
  PENUMBRA_TRY(find("xrConvertTimespecTimeToTimeKHR", time_of_timespec_));
  return find("xrConvertTimeToTimespecTimeKHR", timespec_of_time_);
}

Result<void> XrRuntime::find_headset() {
  const XrSystemGetInfo get = {XR_TYPE_SYSTEM_GET_INFO, nullptr,
                               XR_FORM_FACTOR_HEAD_MOUNTED_DISPLAY};
  const XrResult found = xrGetSystem(instance_, &get, &system_);
  if (found == XR_ERROR_FORM_FACTOR_UNAVAILABLE || found == XR_ERROR_FORM_FACTOR_UNSUPPORTED)
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("{} has no headset: is it plugged in?", name_));
  PENUMBRA_TRY(xr_try(found, "a headset"));
  XrSystemProperties properties{};
  properties.type = XR_TYPE_SYSTEM_PROPERTIES;
  PENUMBRA_TRY(
      xr_try(xrGetSystemProperties(instance_, system_, &properties), "the headset's name"));
  headset_ = text_of(properties.systemName);
  return {};
}

Result<XrTime> XrRuntime::to_xr_time(TimestampNs time) const {
  const timespec t = {static_cast<time_t>(time.value / kSecond_ns),
                      static_cast<long>(time.value % kSecond_ns)};
  XrTime out = 0;
  PENUMBRA_TRY(xr_try(time_of_timespec_(instance_, &t, &out), "the runtime's clock"));
  return out;
}

Result<TimestampNs> XrRuntime::from_xr_time(XrTime time) const {
  timespec t{};
  PENUMBRA_TRY(xr_try(timespec_of_time_(instance_, time, &t), "the runtime's clock"));
  return TimestampNs{std::int64_t{t.tv_sec} * kSecond_ns + t.tv_nsec};
}

}  // namespace penumbra::service
