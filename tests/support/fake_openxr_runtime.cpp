// An OpenXR runtime without a headset: spaces, session states, a paced frame loop, and swapchains
// that count. Debian's loader finds it through XR_RUNTIME_JSON.
// threads: thread-safe
#include "tests/support/fake_openxr_runtime.h"

#include <EGL/egl.h>
#include <GLES3/gl32.h>
#include <time.h>

#define XR_USE_TIMESPEC
#define XR_USE_GRAPHICS_API_OPENGL_ES
#include <openxr/openxr.h>
#include <openxr/openxr_platform.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <map>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include "service/openxr/loader_negotiation.h"

namespace {

constexpr std::uint32_t kEdge_px = 128;
constexpr std::array<const char*, 4> kExtensions = {XR_KHR_CONVERT_TIMESPEC_TIME_EXTENSION_NAME,
                                                    XR_KHR_OPENGL_ES_ENABLE_EXTENSION_NAME,
                                                    "XR_MNDX_egl_enable", "XR_MND_headless"};

struct Space {
  XrReferenceSpaceType type;
  XrPosef pose;
};

struct Knobs {
  XrQuaternionf local{0, 0, 0, 1};
  std::uint32_t views = 2;
  double rate_hz = 72;
  int lose_after = 0;
  bool alpha = false;
  std::string refuse;

  static Knobs read() {
    const auto text = [](const char* name) {
      const char* value = std::getenv(name);
      return std::string(value ? value : "");
    };
    Knobs k;
    if (const auto turn = text("PENUMBRA_FAKE_XR_LOCAL"); !turn.empty())
      std::istringstream(turn) >> k.local.w >> k.local.x >> k.local.y >> k.local.z;
    if (text("PENUMBRA_FAKE_XR_VIEWS") == "1") k.views = 1;
    if (const auto rate = text("PENUMBRA_FAKE_XR_RATE_HZ"); !rate.empty())
      k.rate_hz = std::stod(rate);
    if (const auto frames = text("PENUMBRA_FAKE_XR_LOSE_AFTER"); !frames.empty())
      k.lose_after = std::stoi(frames);
    k.alpha = !text("PENUMBRA_FAKE_XR_ALPHA").empty();
    k.refuse = text("PENUMBRA_FAKE_XR_REFUSE");
    return k;
  }
  [[nodiscard]] bool refuses(const char* word) const {
    return refuse.find(word) != std::string::npos;
  }
};

FakeOpenXrState state;
std::mutex mutex;  // of all below
Knobs knobs;
std::map<XrSpace, Space> spaces;
std::deque<XrSessionState> events;
std::map<XrSwapchain, std::uint32_t> swapchains;  // the next image of each
std::uintptr_t last_handle = 0;
std::int64_t next_frame_ns = 0;
const XrSession kSession = reinterpret_cast<XrSession>(0x5e55);
const XrInstance kInstance = reinterpret_cast<XrInstance>(0x1257);
constexpr XrSystemId kSystem = 7;
constexpr std::uint32_t kImages = 3;

std::int64_t monotonic_ns() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

// ---- Poses. ----

XrQuaternionf times(const XrQuaternionf& a, const XrQuaternionf& b) {
  return {
      a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
      a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}

XrQuaternionf conjugate(const XrQuaternionf& q) {
  return {-q.x, -q.y, -q.z, q.w};
}

XrVector3f turned(const XrQuaternionf& q, const XrVector3f& v) {
  const XrQuaternionf r = times(times(q, {v.x, v.y, v.z, 0}), conjugate(q));
  return {r.x, r.y, r.z};
}

XrPosef times(const XrPosef& a, const XrPosef& b) {
  const XrVector3f p = turned(a.orientation, b.position);
  return {times(a.orientation, b.orientation),
          {a.position.x + p.x, a.position.y + p.y, a.position.z + p.z}};
}

XrPosef inverse(const XrPosef& p) {
  const XrQuaternionf q = conjugate(p.orientation);
  return {q, turned(q, {-p.position.x, -p.position.y, -p.position.z})};
}

// The head stands at its place; the local space begins there, turned as the knob says.
XrPosef in_stage(const Space& space) {
  XrPosef origin = {{0, 0, 0, 1}, {0, 0, 0}};
  if (space.type == XR_REFERENCE_SPACE_TYPE_LOCAL) origin = {knobs.local, {0, 1.6f, 0}};
  if (space.type == XR_REFERENCE_SPACE_TYPE_VIEW) origin = {{0, 0, 0, 1}, {0, 1.6f, 0}};
  return times(origin, space.pose);
}

// ---- Instance and system. ----

template <class Value, std::size_t N>
XrResult give(const std::array<Value, N>& values, std::size_t used, std::uint32_t capacity,
              std::uint32_t* count, Value* out) {
  *count = static_cast<std::uint32_t>(used);
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < used) return XR_ERROR_SIZE_INSUFFICIENT;
  std::copy_n(values.begin(), used, out);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_extensions(const char*, std::uint32_t capacity,
                                                         std::uint32_t* count,
                                                         XrExtensionProperties* out) {
  const bool clock = !Knobs::read().refuses("clock");
  std::vector<const char*> names(kExtensions.begin() + (clock ? 0 : 1), kExtensions.end());
  *count = static_cast<std::uint32_t>(names.size());
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < names.size()) return XR_ERROR_SIZE_INSUFFICIENT;
  for (std::size_t i = 0; i < names.size(); ++i) {
    std::strncpy(out[i].extensionName, names[i], XR_MAX_EXTENSION_NAME_SIZE - 1);
    out[i].extensionVersion = 1;
  }
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_instance(const XrInstanceCreateInfo* info,
                                                    XrInstance* out) {
  const std::lock_guard lock(mutex);
  knobs = Knobs::read();
  if (knobs.refuses("instance")) return XR_ERROR_RUNTIME_FAILURE;
  std::string names;
  for (std::uint32_t i = 0; i < info->enabledExtensionCount; ++i) {
    const std::string name = info->enabledExtensionNames[i];
    const bool clock = name == kExtensions[0] && knobs.refuses("clock");
    if (clock || std::ranges::find(kExtensions, name) == kExtensions.end())
      return XR_ERROR_EXTENSION_NOT_PRESENT;
    names += name + " ";
  }
  std::strncpy(state.extensions, names.c_str(), sizeof state.extensions - 1);
  ++state.instances;
  ++state.instances_made;
  *out = kInstance;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_instance(XrInstance) {
  --state.instances;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_instance_properties(XrInstance, XrInstanceProperties* out) {
  out->runtimeVersion = XR_MAKE_VERSION(1, 0, 0);
  std::strncpy(out->runtimeName, "fake", XR_MAX_RUNTIME_NAME_SIZE - 1);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_poll_event(XrInstance, XrEventDataBuffer* out) {
  const std::lock_guard lock(mutex);
  if (events.empty()) return XR_EVENT_UNAVAILABLE;
  const XrEventDataSessionStateChanged event = {XR_TYPE_EVENT_DATA_SESSION_STATE_CHANGED, nullptr,
                                                kSession, events.front(),
                                                monotonic_ns() + FakeOpenXrState::kTimeAhead_ns};
  events.pop_front();
  std::memcpy(out, &event, sizeof event);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_result_to_string(XrInstance, XrResult value,
                                                     char out[XR_MAX_RESULT_STRING_SIZE]) {
  std::strncpy(out, ("result " + std::to_string(value)).c_str(), XR_MAX_RESULT_STRING_SIZE - 1);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_structure_type_to_string(XrInstance, XrStructureType value,
                                                             char out[XR_MAX_STRUCTURE_NAME_SIZE]) {
  std::strncpy(out, ("type " + std::to_string(value)).c_str(), XR_MAX_STRUCTURE_NAME_SIZE - 1);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_system(XrInstance, const XrSystemGetInfo*,
                                               XrSystemId* out) {
  if (knobs.refuses("system")) return XR_ERROR_FORM_FACTOR_UNAVAILABLE;
  *out = kSystem;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_system_properties(XrInstance, XrSystemId system,
                                                          XrSystemProperties* out) {
  if (system != kSystem) return XR_ERROR_SYSTEM_INVALID;
  state.structs_of_properties = 0;
  for (auto* one = static_cast<XrBaseOutStructure*>(out->next); one; one = one->next)
    ++state.structs_of_properties;
  out->systemId = system;
  std::strncpy(out->systemName, "fake headset", XR_MAX_SYSTEM_NAME_SIZE - 1);
  out->graphicsProperties = {4096, 4096, 16};
  out->trackingProperties = {XR_TRUE, XR_TRUE};
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_blend_modes(XrInstance, XrSystemId,
                                                          XrViewConfigurationType,
                                                          std::uint32_t capacity,
                                                          std::uint32_t* count,
                                                          XrEnvironmentBlendMode* out) {
  return give(std::array{XR_ENVIRONMENT_BLEND_MODE_OPAQUE, XR_ENVIRONMENT_BLEND_MODE_ALPHA_BLEND},
              knobs.alpha ? 2 : 1, capacity, count, out);
}

XrViewConfigurationType view_type() {
  return knobs.views == 1 ? XR_VIEW_CONFIGURATION_TYPE_PRIMARY_MONO
                          : XR_VIEW_CONFIGURATION_TYPE_PRIMARY_STEREO;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_view_configurations(XrInstance, XrSystemId,
                                                                  std::uint32_t capacity,
                                                                  std::uint32_t* count,
                                                                  XrViewConfigurationType* out) {
  return give(std::array{view_type()}, 1, capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_view_configuration(XrInstance, XrSystemId,
                                                           XrViewConfigurationType type,
                                                           XrViewConfigurationProperties* out) {
  if (type != view_type()) return XR_ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED;
  out->viewConfigurationType = type;
  out->fovMutable = XR_TRUE;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_views(XrInstance, XrSystemId,
                                                    XrViewConfigurationType type,
                                                    std::uint32_t capacity, std::uint32_t* count,
                                                    XrViewConfigurationView* out) {
  if (type != view_type()) return XR_ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED;
  const XrViewConfigurationView view = {
      XR_TYPE_VIEW_CONFIGURATION_VIEW, nullptr, kEdge_px, 4096, kEdge_px, 4096, 1, 4};
  return give(std::array{view, view}, knobs.views, capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_gles_requirements(XrInstance, XrSystemId,
                                                      XrGraphicsRequirementsOpenGLESKHR* out) {
  out->minApiVersionSupported = XR_MAKE_VERSION(3, 1, 0);
  out->maxApiVersionSupported = XR_MAKE_VERSION(3, 2, 0);
  return XR_SUCCESS;
}

// ---- Time and spaces. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_time_of_timespec(XrInstance, const timespec* t, XrTime* out) {
  *out = std::int64_t{t->tv_sec} * 1'000'000'000 + t->tv_nsec + FakeOpenXrState::kTimeAhead_ns;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_timespec_of_time(XrInstance, XrTime time, timespec* out) {
  const std::int64_t t = time - FakeOpenXrState::kTimeAhead_ns;
  if (t <= 0) return XR_ERROR_TIME_INVALID;
  *out = {static_cast<time_t>(t / 1'000'000'000), static_cast<long>(t % 1'000'000'000)};
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_reference_spaces(XrSession, std::uint32_t capacity,
                                                               std::uint32_t* count,
                                                               XrReferenceSpaceType* out) {
  return give(std::array{XR_REFERENCE_SPACE_TYPE_VIEW, XR_REFERENCE_SPACE_TYPE_LOCAL,
                         XR_REFERENCE_SPACE_TYPE_STAGE},
              knobs.refuses("stage") ? 2 : 3, capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_reference_space(XrSession,
                                                           const XrReferenceSpaceCreateInfo* info,
                                                           XrSpace* out) {
  const std::lock_guard lock(mutex);
  if (info->referenceSpaceType == XR_REFERENCE_SPACE_TYPE_STAGE && knobs.refuses("stage"))
    return XR_ERROR_REFERENCE_SPACE_UNSUPPORTED;
  *out = reinterpret_cast<XrSpace>(++last_handle);
  spaces[*out] = {info->referenceSpaceType, info->poseInReferenceSpace};
  state.spaces = static_cast<int>(spaces.size());
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_bounds(XrSession, XrReferenceSpaceType, XrExtent2Df* out) {
  *out = {0, 0};
  return XR_SPACE_BOUNDS_UNAVAILABLE;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_space(XrSpace space) {
  const std::lock_guard lock(mutex);
  const bool known = spaces.erase(space) == 1;
  state.spaces = static_cast<int>(spaces.size());
  return known ? XR_SUCCESS : XR_ERROR_HANDLE_INVALID;
}

constexpr XrSpaceLocationFlags kLocated =
    XR_SPACE_LOCATION_ORIENTATION_VALID_BIT | XR_SPACE_LOCATION_POSITION_VALID_BIT |
    XR_SPACE_LOCATION_ORIENTATION_TRACKED_BIT | XR_SPACE_LOCATION_POSITION_TRACKED_BIT;

XRAPI_ATTR XrResult XRAPI_CALL fake_locate_space(XrSpace space, XrSpace base, XrTime time,
                                                 XrSpaceLocation* out) {
  const std::lock_guard lock(mutex);
  if (!spaces.contains(space) || !spaces.contains(base)) return XR_ERROR_HANDLE_INVALID;
  if (time <= 0) return XR_ERROR_TIME_INVALID;
  out->locationFlags = knobs.refuses("tracking") ? 0 : kLocated;
  out->pose = times(inverse(in_stage(spaces[base])), in_stage(spaces[space]));
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_locate_views(XrSession, const XrViewLocateInfo* info,
                                                 XrViewState* view_state, std::uint32_t capacity,
                                                 std::uint32_t* count, XrView* out) {
  const std::lock_guard lock(mutex);
  if (!spaces.contains(info->space)) return XR_ERROR_HANDLE_INVALID;
  view_state->viewStateFlags = knobs.refuses("tracking") ? 0 : kLocated;
  const XrPosef head = times(inverse(in_stage(spaces[info->space])),
                             in_stage({XR_REFERENCE_SPACE_TYPE_VIEW, {{0, 0, 0, 1}, {0, 0, 0}}}));
  std::array<XrView, 2> views{};
  for (std::size_t i = 0; i < 2; ++i) {
    const float side = knobs.views == 1 ? 0 : (i == 0 ? -.0315f : .0315f);
    views[i] = {XR_TYPE_VIEW,
                nullptr,
                times(head, {{0, 0, 0, 1}, {side, 0, 0}}),
                {-.78f, .78f, .78f, -.78f}};
  }
  return give(views, knobs.views, capacity, count, out);
}

// ---- Sessions and frames. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_create_session(XrInstance, const XrSessionCreateInfo*,
                                                   XrSession* out) {
  const std::lock_guard lock(mutex);
  if (knobs.refuses("session")) return XR_ERROR_RUNTIME_FAILURE;
  ++state.sessions;
  events = {XR_SESSION_STATE_IDLE, XR_SESSION_STATE_READY};
  state.frames_waited = state.frames_begun = state.frames_ended = 0;
  next_frame_ns = monotonic_ns();
  *out = kSession;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_session(XrSession) {
  const std::lock_guard lock(mutex);
  --state.sessions;
  spaces.clear();  // children go with their parent
  swapchains.clear();
  events.clear();
  state.spaces = state.swapchains = 0;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_begin_session(XrSession, const XrSessionBeginInfo* info) {
  const std::lock_guard lock(mutex);
  if (info->primaryViewConfigurationType != view_type())
    return XR_ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED;
  for (const auto next :
       {XR_SESSION_STATE_SYNCHRONIZED, XR_SESSION_STATE_VISIBLE, XR_SESSION_STATE_FOCUSED})
    events.push_back(next);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_request_exit(XrSession) {
  const std::lock_guard lock(mutex);
  events.push_back(XR_SESSION_STATE_STOPPING);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_end_session(XrSession) {
  const std::lock_guard lock(mutex);
  events.push_back(XR_SESSION_STATE_IDLE);
  events.push_back(XR_SESSION_STATE_EXITING);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_wait_frame(XrSession, const XrFrameWaitInfo*,
                                               XrFrameState* out) {
  const auto period_ns = static_cast<std::int64_t>(1e9 / knobs.rate_hz);
  if (knobs.lose_after && state.frames_waited >= knobs.lose_after) return XR_ERROR_INSTANCE_LOST;
  const std::int64_t wait_ns = next_frame_ns - monotonic_ns();
  if (wait_ns > 0) {
    const timespec t = {static_cast<time_t>(wait_ns / 1'000'000'000),
                        static_cast<long>(wait_ns % 1'000'000'000)};
    ::nanosleep(&t, nullptr);
  }
  const std::lock_guard lock(mutex);
  next_frame_ns = std::max(next_frame_ns + period_ns, monotonic_ns());
  out->predictedDisplayTime = next_frame_ns + FakeOpenXrState::kTimeAhead_ns;
  out->predictedDisplayPeriod = period_ns;
  out->shouldRender = state.frames_waited++ > 0;  // not the first, as other runtimes do
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_begin_frame(XrSession, const XrFrameBeginInfo*) {
  if (state.frames_begun >= state.frames_waited) return XR_ERROR_CALL_ORDER_INVALID;
  ++state.frames_begun;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_end_frame(XrSession, const XrFrameEndInfo* info) {
  if (state.frames_ended >= state.frames_begun) return XR_ERROR_CALL_ORDER_INVALID;
  ++state.frames_ended;
  state.layers_of_last_frame = info->layerCount;
  return XR_SUCCESS;
}

// ---- Swapchains. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_formats(XrSession, std::uint32_t capacity,
                                                      std::uint32_t* count, std::int64_t* out) {
  return give(std::array<std::int64_t, 3>{GL_RGBA16F, GL_SRGB8_ALPHA8, GL_RGBA8}, 3, capacity,
              count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_swapchain(XrSession, const XrSwapchainCreateInfo*,
                                                     XrSwapchain* out) {
  const std::lock_guard lock(mutex);
  *out = reinterpret_cast<XrSwapchain>(++last_handle);
  swapchains[*out] = 0;
  state.swapchains = static_cast<int>(swapchains.size());
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_swapchain(XrSwapchain swapchain) {
  const std::lock_guard lock(mutex);
  const bool known = swapchains.erase(swapchain) == 1;
  state.swapchains = static_cast<int>(swapchains.size());
  return known ? XR_SUCCESS : XR_ERROR_HANDLE_INVALID;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_images(XrSwapchain, std::uint32_t capacity,
                                                     std::uint32_t* count,
                                                     XrSwapchainImageBaseHeader* out) {
  *count = kImages;
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < kImages) return XR_ERROR_SIZE_INSUFFICIENT;
  if (out->type != XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_ES_KHR) return XR_ERROR_VALIDATION_FAILURE;
  auto* images = reinterpret_cast<XrSwapchainImageOpenGLESKHR*>(out);
  for (std::uint32_t i = 0; i < kImages; ++i) images[i].image = i + 1;  // names of no textures
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_acquire_image(XrSwapchain swapchain,
                                                  const XrSwapchainImageAcquireInfo*,
                                                  std::uint32_t* out) {
  const std::lock_guard lock(mutex);
  if (!swapchains.contains(swapchain)) return XR_ERROR_HANDLE_INVALID;
  *out = swapchains[swapchain]++ % kImages;
  ++state.images_acquired;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_wait_image(XrSwapchain, const XrSwapchainImageWaitInfo*) {
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_release_image(XrSwapchain, const XrSwapchainImageReleaseInfo*) {
  if (state.images_released >= state.images_acquired) return XR_ERROR_CALL_ORDER_INVALID;
  ++state.images_released;
  return XR_SUCCESS;
}

// ---- By name. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_get_instance_proc_addr(XrInstance, const char* name,
                                                           PFN_xrVoidFunction* out) {
  const auto any = [](auto* function) { return reinterpret_cast<PFN_xrVoidFunction>(function); };
  static const std::map<std::string, PFN_xrVoidFunction> functions = {
      {"xrGetInstanceProcAddr", any(fake_get_instance_proc_addr)},
      {"xrEnumerateInstanceExtensionProperties", any(fake_enumerate_extensions)},
      {"xrCreateInstance", any(fake_create_instance)},
      {"xrDestroyInstance", any(fake_destroy_instance)},
      {"xrGetInstanceProperties", any(fake_get_instance_properties)},
      {"xrPollEvent", any(fake_poll_event)},
      {"xrResultToString", any(fake_result_to_string)},
      {"xrStructureTypeToString", any(fake_structure_type_to_string)},
      {"xrGetSystem", any(fake_get_system)},
      {"xrGetSystemProperties", any(fake_get_system_properties)},
      {"xrEnumerateEnvironmentBlendModes", any(fake_enumerate_blend_modes)},
      {"xrEnumerateViewConfigurations", any(fake_enumerate_view_configurations)},
      {"xrGetViewConfigurationProperties", any(fake_get_view_configuration)},
      {"xrEnumerateViewConfigurationViews", any(fake_enumerate_views)},
      {"xrGetOpenGLESGraphicsRequirementsKHR", any(fake_gles_requirements)},
      {"xrConvertTimespecTimeToTimeKHR", any(fake_time_of_timespec)},
      {"xrConvertTimeToTimespecTimeKHR", any(fake_timespec_of_time)},
      {"xrEnumerateReferenceSpaces", any(fake_enumerate_reference_spaces)},
      {"xrCreateReferenceSpace", any(fake_create_reference_space)},
      {"xrGetReferenceSpaceBoundsRect", any(fake_bounds)},
      {"xrDestroySpace", any(fake_destroy_space)},
      {"xrLocateSpace", any(fake_locate_space)},
      {"xrLocateViews", any(fake_locate_views)},
      {"xrCreateSession", any(fake_create_session)},
      {"xrDestroySession", any(fake_destroy_session)},
      {"xrBeginSession", any(fake_begin_session)},
      {"xrRequestExitSession", any(fake_request_exit)},
      {"xrEndSession", any(fake_end_session)},
      {"xrWaitFrame", any(fake_wait_frame)},
      {"xrBeginFrame", any(fake_begin_frame)},
      {"xrEndFrame", any(fake_end_frame)},
      {"xrEnumerateSwapchainFormats", any(fake_enumerate_formats)},
      {"xrCreateSwapchain", any(fake_create_swapchain)},
      {"xrDestroySwapchain", any(fake_destroy_swapchain)},
      {"xrEnumerateSwapchainImages", any(fake_enumerate_images)},
      {"xrAcquireSwapchainImage", any(fake_acquire_image)},
      {"xrWaitSwapchainImage", any(fake_wait_image)},
      {"xrReleaseSwapchainImage", any(fake_release_image)}};
  const std::string key = name;
  const auto found = functions.find(key);
  // As a function of an extension that is not enabled.
  const bool clock = key.find("Timespec") != std::string::npos &&
                     std::strstr(state.extensions, kExtensions[0]) == nullptr;
  *out = found == functions.end() || clock ? nullptr : found->second;
  return *out ? XR_SUCCESS : XR_ERROR_FUNCTION_UNSUPPORTED;
}

}  // namespace

extern "C" {

__attribute__((visibility("default"))) FakeOpenXrState* fake_openxr_state() {
  return &state;
}

__attribute__((visibility("default"))) XrResult xrNegotiateLoaderRuntimeInterface(
    const XrLoaderInfo* loader, XrRuntimeRequest* request) {
  if (!loader || !request || loader->kind != kXrLoaderInfo || request->kind != kXrRuntimeRequest ||
      request->struct_size != sizeof *request)
    return XR_ERROR_INITIALIZATION_FAILED;
  request->runtime_interface = kXrInterfaceVersion;
  request->runtime_api = XR_MAKE_VERSION(1, 0, 20);
  request->get_instance_proc_addr = fake_get_instance_proc_addr;
  return XR_SUCCESS;
}
}
