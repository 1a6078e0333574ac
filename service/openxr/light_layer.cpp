// The API layer XR_APILAYER_PENUMBRA_light: what the loader calls to put it above a runtime.
// threads: thread-safe, as far as OpenXR asks
#include <algorithm>
#include <cstring>

#include "service/openxr/layer_functions.h"
#include "service/openxr/loader_negotiation.h"

namespace penumbra::openxr {

namespace {

constexpr std::string_view kLayerName = "XR_APILAYER_PENUMBRA_light";
constexpr std::string_view kLightName = XR_ANDROID_LIGHT_ESTIMATION_EXTENSION_NAME;
constexpr std::string_view kCubeName = XR_ANDROID_LIGHT_ESTIMATION_CUBEMAP_EXTENSION_NAME;
constexpr std::string_view kTimeName = XR_KHR_CONVERT_TIMESPEC_TIME_EXTENSION_NAME;

XRAPI_ATTR XrResult XRAPI_CALL layer_get_instance_proc_addr(XrInstance instance, const char* name,
                                                            PFN_xrVoidFunction* function) {
  return without_exceptions([&] {
    if (!name || !function) return XR_ERROR_VALIDATION_FAILURE;
    *function = nullptr;
    const auto known = layer_registry().find(instance);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    if (std::string_view(name) == "xrGetInstanceProcAddr") {
      *function = reinterpret_cast<PFN_xrVoidFunction>(layer_get_instance_proc_addr);
      return XR_SUCCESS;
    }
    *function = function_of_layer(*known, name);
    return *function ? XR_SUCCESS : known->below.get_instance_proc_addr(instance, name, function);
  });
}

template <class Function>
void load(PFN_xrGetInstanceProcAddr get, XrInstance instance, const char* name, Function& out) {
  PFN_xrVoidFunction found = nullptr;
  if (XR_SUCCEEDED(get(instance, name, &found))) out = reinterpret_cast<Function>(found);
}

// False where one is missing that every runtime has.
bool load_all(PFN_xrGetInstanceProcAddr get, XrInstance instance, FunctionsBelow& out) {
  out.get_instance_proc_addr = get;
  load(get, instance, "xrDestroyInstance", out.destroy_instance);
  load(get, instance, "xrGetSystemProperties", out.get_system_properties);
  load(get, instance, "xrCreateSession", out.create_session);
  load(get, instance, "xrDestroySession", out.destroy_session);
  load(get, instance, "xrCreateReferenceSpace", out.create_reference_space);
  load(get, instance, "xrDestroySpace", out.destroy_space);
  load(get, instance, "xrLocateSpace", out.locate_space);
  load(get, instance, "xrConvertTimespecTimeToTimeKHR", out.time_of_timespec);
  return out.destroy_instance && out.get_system_properties && out.create_session &&
         out.destroy_session && out.create_reference_space && out.destroy_space && out.locate_space;
}

// The runtime refuses names that it does not know.
std::vector<const char*> names_below(const XrInstanceCreateInfo& info, LayerInstance& instance) {
  std::vector<const char*> out;
  for (std::uint32_t i = 0; i < info.enabledExtensionCount; ++i) {
    const char* name = info.enabledExtensionNames[i];
    if (name == kLightName)
      instance.light = true;
    else if (name == kCubeName)
      instance.cube = true;
    else
      out.push_back(name);
  }
  instance.cube = instance.cube && instance.light;
  return out;
}

// For those who ask for light the runtime's clock is wanted, too, but not needed.
XrResult create_below(const XrInstanceCreateInfo& info, std::vector<const char*> names,
                      bool with_clock, const XrLayerCreateInfo& layer, XrInstance* instance) {
  XrLayerCreateInfo below = layer;
  below.next_info = layer.next_info->next;
  const auto create = [&] {
    XrInstanceCreateInfo own = info;
    own.enabledExtensionCount = static_cast<std::uint32_t>(names.size());
    own.enabledExtensionNames = names.empty() ? nullptr : names.data();
    return layer.next_info->next_create_instance(&own, &below, instance);
  };
  const bool added = with_clock && std::ranges::find(names, kTimeName) == names.end();
  if (added) names.push_back(kTimeName.data());
  const XrResult result = create();
  if (!added || result != XR_ERROR_EXTENSION_NOT_PRESENT) return result;
  names.pop_back();
  return create();
}

XRAPI_ATTR XrResult XRAPI_CALL layer_create_instance(const XrInstanceCreateInfo* info,
                                                     const XrLayerCreateInfo* layer,
                                                     XrInstance* instance) {
  return without_exceptions([&] {
    if (!info || !layer || !instance || layer->kind != kXrLayerCreateInfo || !layer->next_info ||
        layer->next_info->kind != kXrLayerNextInfo || layer->next_info->layer_name != kLayerName)
      return XR_ERROR_INITIALIZATION_FAILED;
    auto made = std::make_shared<LayerInstance>();
    const std::vector<const char*> names = names_below(*info, *made);
    const XrResult result = create_below(*info, names, made->light, *layer, instance);
    if (XR_FAILED(result)) return result;
    made->handle = *instance;
    if (!load_all(layer->next_info->next_get_instance_proc_addr, *instance, made->below)) {
      if (made->below.destroy_instance) made->below.destroy_instance(*instance);
      return XR_ERROR_INITIALIZATION_FAILED;
    }
    if (made->light) {
      const char* engine = info->applicationInfo.engineName;
      made->settings = read_layer_settings({engine, ::strnlen(engine, XR_MAX_ENGINE_NAME_SIZE)});
      made->room = std::make_unique<RoomLight>();
    }
    layer_registry().add(std::move(made));
    return result;
  });
}

}  // namespace

}  // namespace penumbra::openxr

/// errors: XR_ERROR_INITIALIZATION_FAILED for another interface than version 1
extern "C" __attribute__((visibility("default"))) XrResult XRAPI_CALL
xrNegotiateLoaderApiLayerInterface(const XrLoaderInfo* loader, const char* layer_name,
                                   XrLayerRequest* request) {
  using namespace penumbra::openxr;
  if (!loader || !request || loader->kind != kXrLoaderInfo || loader->struct_version != 1 ||
      loader->struct_size != sizeof *loader || request->kind != kXrLayerRequest ||
      request->struct_version != 1 || request->struct_size != sizeof *request ||
      loader->least_interface > kXrInterfaceVersion ||
      loader->most_interface < kXrInterfaceVersion || (layer_name && layer_name != kLayerName))
    return XR_ERROR_INITIALIZATION_FAILED;
  request->layer_interface = kXrInterfaceVersion;
  request->layer_api = XR_CURRENT_API_VERSION;
  request->get_instance_proc_addr = layer_get_instance_proc_addr;
  request->create_instance = layer_create_instance;
  return XR_SUCCESS;
}
