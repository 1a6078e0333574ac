// An OpenXR runtime without a headset, which checks how it is called. Debian's loader finds it
// through XR_RUNTIME_JSON. This file has the instance and the system.
// threads: thread-safe
#include "tests/support/fake_openxr_runtime.h"

#include <cstdlib>
#include <cstring>
#include <iterator>
#include <sstream>

#include "service/openxr/loader_negotiation.h"
#include "tests/support/fake_openxr_internal.h"

namespace fake_xr {

FakeOpenXrState state;
std::mutex mutex;
Knobs knobs;
static std::mutex faults_mutex;
static std::set<std::string> faults;  // guarded by faults_mutex

Knobs Knobs::read() {
  const auto text = [](const char* name) {
    const char* value = std::getenv((std::string("PENUMBRA_FAKE_XR_") + name).c_str());
    return std::string(value ? value : "");
  };
  Knobs k;
  if (const auto turn = text("LOCAL"); !turn.empty())
    std::istringstream(turn) >> k.local.w >> k.local.x >> k.local.y >> k.local.z;
  if (text("VIEWS") == "1") k.views = 1;
  if (const auto edge = text("EDGE"); !edge.empty())
    k.edge_px = static_cast<std::uint32_t>(std::stoul(edge));
  if (const auto rate = text("RATE_HZ"); !rate.empty()) k.rate_hz = std::stod(rate);
  if (const auto turn = text("TURN"); !turn.empty()) k.turn_deg_s = std::stod(turn);
  if (const auto n = text("LOSE_AFTER"); !n.empty()) k.lose_after = std::stoi(n);
  if (const auto span = text("PUT_DOWN"); !span.empty())
    std::istringstream(span) >> k.put_down >> k.put_up;
  k.alpha = !text("ALPHA").empty();
  k.keep = !text("KEEP").empty();
  k.refuse = text("REFUSE");
  return k;
}

std::int64_t monotonic_ns() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

// Called with and without `mutex`.
XrResult fault(const std::string& what, XrResult error) {
  const std::lock_guard lock(faults_mutex);
  faults.insert(what);
  return error;
}

bool has_context() {
  return eglGetCurrentContext() != EGL_NO_CONTEXT || glXGetCurrentContext();
}

XrViewConfigurationType view_type() {
  return knobs.views == 1 ? XR_VIEW_CONFIGURATION_TYPE_PRIMARY_MONO
                          : XR_VIEW_CONFIGURATION_TYPE_PRIMARY_STEREO;
}

namespace {

constexpr std::array<const char*, 5> kExtensions = {
    XR_KHR_CONVERT_TIMESPEC_TIME_EXTENSION_NAME, XR_MNDX_EGL_ENABLE_EXTENSION_NAME,
    XR_KHR_OPENGL_ES_ENABLE_EXTENSION_NAME, XR_KHR_OPENGL_ENABLE_EXTENSION_NAME, "XR_MND_headless"};

std::vector<std::string> offered_extensions(const Knobs& knobs) {
  std::vector<std::string> out(kExtensions.begin(), kExtensions.end());
  if (knobs.refuses("clock")) std::erase(out, kExtensions[0]);
  if (knobs.refuses("egl")) std::erase(out, kExtensions[1]);
  if (knobs.refuses("glx")) std::erase(out, kExtensions[3]);
  return out;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_extensions(const char*, std::uint32_t capacity,
                                                         std::uint32_t* count,
                                                         XrExtensionProperties* out) {
  const auto names = offered_extensions(Knobs::read());
  *count = static_cast<std::uint32_t>(names.size());
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < names.size()) return XR_ERROR_SIZE_INSUFFICIENT;
  for (std::size_t i = 0; i < names.size(); ++i) {
    std::strncpy(out[i].extensionName, names[i].c_str(), XR_MAX_EXTENSION_NAME_SIZE - 1);
    out[i].extensionVersion = 1;
  }
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_instance(const XrInstanceCreateInfo* info,
                                                    XrInstance* out) {
  const std::lock_guard lock(mutex);
  knobs = Knobs::read();
  if (knobs.refuses("instance")) return XR_ERROR_RUNTIME_FAILURE;
  if (!has_type(info, XR_TYPE_INSTANCE_CREATE_INFO)) return fault("xrCreateInstance: type");
  const auto offered = offered_extensions(knobs);
  std::string names;
  for (std::uint32_t i = 0; i < info->enabledExtensionCount; ++i) {
    const std::string name = info->enabledExtensionNames[i];
    if (std::ranges::find(offered, name) == offered.end()) return XR_ERROR_EXTENSION_NOT_PRESENT;
    names += name + " ";
  }
  std::memset(state.extensions, 0, sizeof state.extensions);
  std::strncpy(state.extensions, names.c_str(), sizeof state.extensions - 1);
  session = Session{};
  ++state.instances;
  ++state.instances_made;
  *out = kInstance;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_instance(XrInstance) {
  const std::lock_guard lock(mutex);
  end_session();
  actions.clear();
  action_sets.clear();
  --state.instances;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_instance_properties(XrInstance, XrInstanceProperties* out) {
  if (!has_type(out, XR_TYPE_INSTANCE_PROPERTIES)) return fault("xrGetInstanceProperties: type");
  out->runtimeVersion = XR_MAKE_VERSION(1, 0, 0);
  std::strncpy(out->runtimeName, "fake", XR_MAX_RUNTIME_NAME_SIZE - 1);
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

XRAPI_ATTR XrResult XRAPI_CALL fake_get_system(XrInstance, const XrSystemGetInfo* info,
                                               XrSystemId* out) {
  if (!has_type(info, XR_TYPE_SYSTEM_GET_INFO)) return fault("xrGetSystem: type");
  if (knobs.refuses("system")) return XR_ERROR_FORM_FACTOR_UNAVAILABLE;
  *out = kSystem;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_system_properties(XrInstance, XrSystemId system,
                                                          XrSystemProperties* out) {
  if (system != kSystem) return XR_ERROR_SYSTEM_INVALID;
  if (!has_type(out, XR_TYPE_SYSTEM_PROPERTIES)) return fault("xrGetSystemProperties: type");
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
  const std::uint32_t edge = knobs.edge_px;
  const XrViewConfigurationView view = {
      XR_TYPE_VIEW_CONFIGURATION_VIEW, nullptr, edge, 4096, edge, 4096, 1, 4};
  return give(std::array{view, view}, knobs.views, capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_gles_requirements(XrInstance, XrSystemId,
                                                      XrGraphicsRequirementsOpenGLESKHR* out) {
  const std::lock_guard lock(mutex);
  if (!has_type(out, XR_TYPE_GRAPHICS_REQUIREMENTS_OPENGL_ES_KHR))
    return fault("xrGetOpenGLESGraphicsRequirementsKHR: type");
  out->minApiVersionSupported = XR_MAKE_VERSION(3, 1, 0);
  out->maxApiVersionSupported = XR_MAKE_VERSION(3, 2, 0);
  session.asked_for_gles = true;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_gl_requirements(XrInstance, XrSystemId,
                                                    XrGraphicsRequirementsOpenGLKHR* out) {
  const std::lock_guard lock(mutex);
  if (!has_type(out, XR_TYPE_GRAPHICS_REQUIREMENTS_OPENGL_KHR))
    return fault("xrGetOpenGLGraphicsRequirementsKHR: type");
  out->minApiVersionSupported = XR_MAKE_VERSION(4, 3, 0);
  out->maxApiVersionSupported = XR_MAKE_VERSION(4, 6, 0);
  session.asked_for_gl = true;
  return XR_SUCCESS;
}

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

// ---- By name. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_get_instance_proc_addr(XrInstance, const char* name,
                                                           PFN_xrVoidFunction* out);

Functions all_functions() {
  Functions out = {{"xrGetInstanceProcAddr", any(fake_get_instance_proc_addr)},
                   {"xrEnumerateInstanceExtensionProperties", any(fake_enumerate_extensions)},
                   {"xrCreateInstance", any(fake_create_instance)},
                   {"xrDestroyInstance", any(fake_destroy_instance)},
                   {"xrGetInstanceProperties", any(fake_get_instance_properties)},
                   {"xrResultToString", any(fake_result_to_string)},
                   {"xrStructureTypeToString", any(fake_structure_type_to_string)},
                   {"xrGetSystem", any(fake_get_system)},
                   {"xrGetSystemProperties", any(fake_get_system_properties)},
                   {"xrEnumerateEnvironmentBlendModes", any(fake_enumerate_blend_modes)},
                   {"xrEnumerateViewConfigurations", any(fake_enumerate_view_configurations)},
                   {"xrGetViewConfigurationProperties", any(fake_get_view_configuration)},
                   {"xrEnumerateViewConfigurationViews", any(fake_enumerate_views)},
                   {"xrGetOpenGLESGraphicsRequirementsKHR", any(fake_gles_requirements)},
                   {"xrGetOpenGLGraphicsRequirementsKHR", any(fake_gl_requirements)},
                   {"xrConvertTimespecTimeToTimeKHR", any(fake_time_of_timespec)},
                   {"xrConvertTimeToTimespecTimeKHR", any(fake_timespec_of_time)}};
  for (const Functions& more : {space_functions(), session_functions(), swapchain_functions()})
    out.insert(more.begin(), more.end());
  return out;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_get_instance_proc_addr(XrInstance, const char* name,
                                                           PFN_xrVoidFunction* out) {
  static const Functions functions = all_functions();
  const std::string key = name;
  const auto found = functions.find(key);
  // As a function of an extension that is not enabled.
  const bool clock = key.find("Timespec") != std::string::npos &&
                     std::strstr(state.extensions, kExtensions[0]) == nullptr;
  *out = found == functions.end() || clock ? nullptr : found->second;
  return *out ? XR_SUCCESS : XR_ERROR_FUNCTION_UNSUPPORTED;
}

}  // namespace

}  // namespace fake_xr

extern "C" {

__attribute__((visibility("default"))) FakeOpenXrState* fake_openxr_state() {
  return &fake_xr::state;
}

__attribute__((visibility("default"))) void fake_openxr_take_frames(
    std::vector<FakeOpenXrFrame>* out) {
  const std::lock_guard lock(fake_xr::mutex);
  out->assign(std::make_move_iterator(fake_xr::frames.begin()),
              std::make_move_iterator(fake_xr::frames.end()));
  fake_xr::frames.clear();
}

__attribute__((visibility("default"))) void fake_openxr_take_faults(std::string* out) {
  const std::lock_guard lock(fake_xr::faults_mutex);
  out->clear();
  for (const std::string& line : fake_xr::faults) *out += line + "\n";
  fake_xr::faults.clear();
}

__attribute__((visibility("default"))) XrResult xrNegotiateLoaderRuntimeInterface(
    const XrLoaderInfo* loader, XrRuntimeRequest* request) {
  if (!loader || !request || loader->kind != kXrLoaderInfo || request->kind != kXrRuntimeRequest ||
      request->struct_size != sizeof *request)
    return XR_ERROR_INITIALIZATION_FAILED;
  request->runtime_interface = kXrInterfaceVersion;
  request->runtime_api = XR_MAKE_VERSION(1, 0, 20);
  request->get_instance_proc_addr = fake_xr::fake_get_instance_proc_addr;
  return XR_SUCCESS;
}
}
