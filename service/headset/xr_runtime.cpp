#include "service/headset/internal/xr_runtime.h"

#include <fmt/format.h>
#include <openxr/openxr_reflection.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <utility>
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

// Nothing where no runtime answers.
std::optional<std::vector<std::string>> XrRuntime::offered_extensions() {
  std::uint32_t count = 0;
  if (XR_FAILED(xrEnumerateInstanceExtensionProperties(nullptr, 0, &count, nullptr)))
    return std::nullopt;
  constexpr std::uint32_t kMost = 4096;
  count = std::min(count, kMost);
  XrExtensionProperties empty{};
  empty.type = XR_TYPE_EXTENSION_PROPERTIES;
  std::vector<XrExtensionProperties> all(count, empty);
  if (XR_FAILED(xrEnumerateInstanceExtensionProperties(nullptr, count, &count, all.data())))
    return std::nullopt;
  std::vector<std::string> out;
  for (const XrExtensionProperties& one : all) out.push_back(text_of(one.extensionName));
  return out;
}

bool XrRuntime::takes(const std::vector<const char*>& needed) {
  const auto offered = offered_extensions();
  return !offered || std::ranges::all_of(needed, [&](const char* name) {
    return std::ranges::find(*offered, name) != offered->end();
  });
}

bool XrRuntime::takes(const HeadsetGraphics& graphics) {
  return takes(needed_extensions(graphics));
}

Result<std::unique_ptr<HeadsetGraphics>> XrRuntime::make_graphics() {
  if (!takes({kClock}))
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("the OpenXR runtime does not offer {}, so it does not tell which time "
                            "its poses are of",
                            kClock));
  if (takes(egl_extensions())) return make_egl_graphics();
  if (takes(glx_extensions())) return make_glx_graphics();
  return fail(
      ErrorCode::kUnavailable, "headset",
      fmt::format("the OpenXR runtime offers neither {} with {} nor {}; pictures for Vulkan "
                  "are not built in",
                  egl_extensions()[0], egl_extensions()[1], glx_extensions()[0]));
}

Result<std::unique_ptr<XrRuntime>> XrRuntime::open(const std::string& application,
                                                   HeadsetGraphics& graphics) {
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
