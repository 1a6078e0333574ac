// What OpenXR's loader agrees on with API layers and runtimes. No package has a header for it.
// threads: plain data
#pragma once

#include <openxr/openxr.h>

#include <cstddef>

// Kinds of these structs, in `kind`; all of them have version 1.
enum XrLoaderStructKind : std::uint32_t {
  kXrLoaderInfo = 1,
  kXrLayerRequest = 2,
  kXrRuntimeRequest = 3,
  kXrLayerCreateInfo = 4,
  kXrLayerNextInfo = 5
};
inline constexpr std::uint32_t kXrInterfaceVersion = 1;  // of layers and of runtimes

struct XrLoaderInfo {
  std::uint32_t kind, struct_version;
  std::size_t struct_size;
  std::uint32_t least_interface, most_interface;
  XrVersion least_api, most_api;
};

struct XrLayerNextInfo;
struct XrLayerCreateInfo;
using PFN_xrCreateLayerInstance = XrResult(XRAPI_PTR*)(const XrInstanceCreateInfo* info,
                                                       const XrLayerCreateInfo* layer,
                                                       XrInstance* instance);

struct XrLayerRequest {
  std::uint32_t kind, struct_version;
  std::size_t struct_size;
  std::uint32_t layer_interface;
  XrVersion layer_api;
  PFN_xrGetInstanceProcAddr get_instance_proc_addr;
  PFN_xrCreateLayerInstance create_instance;
};

struct XrRuntimeRequest {
  std::uint32_t kind, struct_version;
  std::size_t struct_size;
  std::uint32_t runtime_interface;
  XrVersion runtime_api;
  PFN_xrGetInstanceProcAddr get_instance_proc_addr;
};

// What is below a layer: another layer, or the loader's way to the runtime.
struct XrLayerNextInfo {
  std::uint32_t kind, struct_version;
  std::size_t struct_size;
  char layer_name[XR_MAX_API_LAYER_NAME_SIZE];  // of the layer that gets this
  PFN_xrGetInstanceProcAddr next_get_instance_proc_addr;
  PFN_xrCreateLayerInstance next_create_instance;
  XrLayerNextInfo* next;
};

struct XrLayerCreateInfo {
  std::uint32_t kind, struct_version;
  std::size_t struct_size;
  void* loader_instance;
  char settings_file[512];
  XrLayerNextInfo* next_info;
};

static_assert(sizeof(XrLoaderInfo) == 40 && sizeof(XrRuntimeRequest) == 40);
static_assert(sizeof(XrLayerRequest) == 48 && sizeof(XrLayerNextInfo) == 296);
static_assert(sizeof(XrLayerCreateInfo) == 544);
