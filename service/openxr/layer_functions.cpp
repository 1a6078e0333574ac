#include "service/openxr/layer_functions.h"

#include <algorithm>
#include <cmath>
#include <span>

namespace penumbra::openxr {

LayerRegistry& layer_registry() {
  static LayerRegistry registry;
  return registry;
}

namespace {

// ---- Passing by. ----

XRAPI_ATTR XrResult XRAPI_CALL layer_create_session(XrInstance instance,
                                                    const XrSessionCreateInfo* info,
                                                    XrSession* session) {
  return without_exceptions([&] {
    const auto known = layer_registry().find(instance);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    const XrResult result = known->below.create_session(instance, info, session);
    if (XR_SUCCEEDED(result)) layer_registry().add(*session, known);
    return result;
  });
}

XRAPI_ATTR XrResult XRAPI_CALL layer_destroy_session(XrSession session) {
  return without_exceptions([&] {
    // The runtime destroys the spaces of its estimators with the session.
    const auto known = layer_registry().take(session);
    return known ? known->below.destroy_session(session) : XR_ERROR_HANDLE_INVALID;
  });
}

XRAPI_ATTR XrResult XRAPI_CALL layer_destroy_instance(XrInstance instance) {
  return without_exceptions([&] {
    const auto known = layer_registry().take(instance);
    return known ? known->below.destroy_instance(instance) : XR_ERROR_HANDLE_INVALID;
  });
}

// ---- What the system can do. ----

// Where the struct takes its answer; null for structs that are not the layer's.
XrBool32* answer_of(XrBaseOutStructure& one) {
  switch (static_cast<std::int64_t>(one.type)) {
    case XR_TYPE_SYSTEM_LIGHT_ESTIMATION_PROPERTIES_ANDROID:
      return &reinterpret_cast<XrSystemLightEstimationPropertiesANDROID&>(one)
                  .supportsLightEstimation;
    case XR_TYPE_SYSTEM_CUBEMAP_LIGHT_ESTIMATION_PROPERTIES_ANDROID:
      return &reinterpret_cast<XrSystemCubemapLightEstimationPropertiesANDROID&>(one)
                  .supportsCubemapLightEstimation;
    default:
      return nullptr;
  }
}

// Takes the layer's structs out of a chain, and puts each back where it was.
class UnlinkedStructs {
 public:
  explicit UnlinkedStructs(XrSystemProperties& properties) : head_(&properties.next) {
    auto* one = static_cast<XrBaseOutStructure*>(properties.next);
    for (; one; one = one->next) links_.push_back(one);
    first_ = links_.empty() ? nullptr : links_.front();
    XrBaseOutStructure* last = nullptr;
    *head_ = nullptr;
    for (XrBaseOutStructure* kept : links_) {
      if (answer_of(*kept)) continue;
      if (last)
        last->next = kept;
      else
        *head_ = kept;
      last = kept;
    }
    if (last) last->next = nullptr;
  }
  ~UnlinkedStructs() {
    *head_ = first_;
    for (std::size_t i = 0; i < links_.size(); ++i)
      links_[i]->next = i + 1 < links_.size() ? links_[i + 1] : nullptr;
  }
  UnlinkedStructs(const UnlinkedStructs&) = delete;
  UnlinkedStructs& operator=(const UnlinkedStructs&) = delete;

  void fill(const LayerInstance& instance) const {
    for (XrBaseOutStructure* one : links_)
      if (XrBool32* answer = answer_of(*one))
        *answer = static_cast<std::int64_t>(one->type) ==
                          XR_TYPE_SYSTEM_LIGHT_ESTIMATION_PROPERTIES_ANDROID
                      ? instance.light
                      : instance.cube;
  }

 private:
  void* XR_MAY_ALIAS* head_;
  XrBaseOutStructure* first_ = nullptr;
  std::vector<XrBaseOutStructure*> links_;
};

XRAPI_ATTR XrResult XRAPI_CALL layer_get_system_properties(XrInstance instance, XrSystemId system,
                                                           XrSystemProperties* properties) {
  return without_exceptions([&] {
    const auto known = layer_registry().find(instance);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    if (!properties) return XR_ERROR_VALIDATION_FAILURE;
    const UnlinkedStructs own(*properties);
    const XrResult result = known->below.get_system_properties(instance, system, properties);
    if (XR_SUCCEEDED(result)) own.fill(*known);
    return result;
  });
}

// Twice called: without room for the count, then for the values.
template <class Value>
XrResult enumerate(XrInstance instance, XrSystemId system, std::span<const Value> values,
                   std::uint32_t capacity, std::uint32_t* count, Value* out) {
  return without_exceptions([&] {
    const auto known = layer_registry().find(instance);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    if (!count || (capacity > 0 && !out)) return XR_ERROR_VALIDATION_FAILURE;
    XrSystemProperties properties{XR_TYPE_SYSTEM_PROPERTIES, nullptr, 0, 0, {}, {}, {}};
    const XrResult result = known->below.get_system_properties(instance, system, &properties);
    if (XR_FAILED(result)) return result;
    *count = static_cast<std::uint32_t>(values.size());
    if (capacity == 0) return XR_SUCCESS;
    if (capacity < values.size()) return XR_ERROR_SIZE_INSUFFICIENT;
    std::ranges::copy(values, out);
    return XR_SUCCESS;
  });
}

XRAPI_ATTR XrResult XRAPI_CALL layer_enumerate_resolutions(XrInstance instance, XrSystemId system,
                                                           std::uint32_t capacity,
                                                           std::uint32_t* count,
                                                           std::uint32_t* out) {
  return enumerate<std::uint32_t>(instance, system, kCubeSizes, capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL layer_enumerate_formats(XrInstance instance, XrSystemId system,
                                                       std::uint32_t capacity, std::uint32_t* count,
                                                       XrCubemapLightingColorFormatANDROID* out) {
  return enumerate<XrCubemapLightingColorFormatANDROID>(instance, system, kCubeFormats, capacity,
                                                        count, out);
}

// ---- Estimators. ----

// Penumbra's world is the stage, turned by the settings' yaw; the local space where there is none.
XrResult make_world(const LayerInstance& instance, XrSession session, XrSpace& out) {
  const auto half = static_cast<float>(instance.settings.yaw_rad / 2);
  XrReferenceSpaceCreateInfo info{XR_TYPE_REFERENCE_SPACE_CREATE_INFO,
                                  nullptr,
                                  XR_REFERENCE_SPACE_TYPE_STAGE,
                                  {{0, std::sin(half), 0, std::cos(half)}, {0, 0, 0}}};
  const XrResult result = instance.below.create_reference_space(session, &info, &out);
  if (result != XR_ERROR_REFERENCE_SPACE_UNSUPPORTED) return result;
  info.referenceSpaceType = XR_REFERENCE_SPACE_TYPE_LOCAL;
  return instance.below.create_reference_space(session, &info, &out);
}

XrResult read_request(const LayerInstance& instance, const XrLightEstimatorCreateInfoANDROID& info,
                      std::optional<CubeRequest>& out) {
  for (auto* one = static_cast<const XrBaseInStructure*>(info.next); one; one = one->next) {
    if (!instance.cube || one->type != XR_TYPE_CUBEMAP_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID)
      continue;
    const auto& cube = *reinterpret_cast<const XrCubemapLightEstimatorCreateInfoANDROID*>(one);
    if (std::ranges::find(kCubeSizes, cube.cubemapResolution) == kCubeSizes.end() ||
        std::ranges::find(kCubeFormats, cube.colorFormat) == kCubeFormats.end())
      return XR_ERROR_FEATURE_UNSUPPORTED;
    out = CubeRequest{cube.cubemapResolution, cube.colorFormat, cube.reproject == XR_TRUE};
  }
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL layer_create_light_estimator(XrSession session,
                                                            XrLightEstimatorCreateInfoANDROID* info,
                                                            XrLightEstimatorANDROID* out) {
  return without_exceptions([&] {
    const auto known = layer_registry().find(session);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    if (!info || !out || info->type != XR_TYPE_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID)
      return XR_ERROR_VALIDATION_FAILURE;
    std::optional<CubeRequest> cube;
    if (const XrResult read = read_request(*known, *info, cube); XR_FAILED(read)) return read;
    auto made = std::make_shared<LayerEstimator>();
    made->instance = known;
    made->session = session;
    made->estimator = std::make_unique<RoomLightEstimator>(*known->room, known->settings, cube);
    const XrResult result = make_world(*known, session, made->world);
    if (XR_FAILED(result)) return result;
    const XrSpace world = made->world;
    *out = layer_registry().add(std::move(made));
    if (*out != XR_NULL_HANDLE) return result;
    known->below.destroy_space(world);
    return XR_ERROR_LIMIT_REACHED;
  });
}

XRAPI_ATTR XrResult XRAPI_CALL layer_destroy_light_estimator(XrLightEstimatorANDROID handle) {
  return without_exceptions([&] {
    const auto known = layer_registry().take(handle);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    return known->instance->below.destroy_space(known->world);
  });
}

std::optional<XrTime> time_published(const LayerInstance& instance, const penumbra_light& light) {
  if (!instance.below.time_of_timespec) return std::nullopt;
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  const timespec published = {static_cast<time_t>(light.published_ns / kSecond_ns),
                              static_cast<long>(light.published_ns % kSecond_ns)};
  XrTime out = 0;
  if (XR_FAILED(instance.below.time_of_timespec(instance.handle, &published, &out)))
    return std::nullopt;
  return out;
}

XRAPI_ATTR XrResult XRAPI_CALL layer_get_light_estimate(XrLightEstimatorANDROID handle,
                                                        const XrLightEstimateGetInfoANDROID* info,
                                                        XrLightEstimateANDROID* out) {
  return without_exceptions([&] {
    const auto known = layer_registry().find(handle);
    if (!known) return XR_ERROR_HANDLE_INVALID;
    if (!info || !out || info->type != XR_TYPE_LIGHT_ESTIMATE_GET_INFO_ANDROID ||
        out->type != XR_TYPE_LIGHT_ESTIMATE_ANDROID)
      return XR_ERROR_VALIDATION_FAILURE;
    if (info->space == XR_NULL_HANDLE) return XR_ERROR_HANDLE_INVALID;
    if (info->time <= 0) return XR_ERROR_TIME_INVALID;
    XrSpaceLocation place{XR_TYPE_SPACE_LOCATION, nullptr, 0, {}};
    const XrResult result =
        known->instance->below.locate_space(info->space, known->world, info->time, &place);
    if (XR_FAILED(result)) return result;
    penumbra_light light;
    if (!(place.locationFlags & XR_SPACE_LOCATION_ORIENTATION_VALID_BIT) ||
        !known->instance->room->read(light)) {
      RoomLightEstimator::invalidate(*out);
      return result;
    }
    const XrQuaternionf& q = place.pose.orientation;
    known->estimator->fill(light,
                           {.world_from_application = rotation_of(q),
                            .application_from_world = {-q.x, -q.y, -q.z, q.w},
                            .now = info->time,
                            .published = time_published(*known->instance, light)},
                           *out);
    return result;
  });
}

// ---- By name. ----

enum class Needs : std::uint8_t { kNothing, kLight, kCube };

struct NamedFunction {
  std::string_view name;
  PFN_xrVoidFunction function;
  Needs needs;
};

template <class Function>
PFN_xrVoidFunction any(Function* function) {
  return reinterpret_cast<PFN_xrVoidFunction>(function);
}

}  // namespace

PFN_xrVoidFunction function_of_layer(const LayerInstance& instance, std::string_view name) {
  static const NamedFunction kFunctions[] = {
      {"xrDestroyInstance", any(layer_destroy_instance), Needs::kNothing},
      {"xrGetSystemProperties", any(layer_get_system_properties), Needs::kLight},
      {"xrCreateSession", any(layer_create_session), Needs::kLight},
      {"xrDestroySession", any(layer_destroy_session), Needs::kLight},
      {"xrCreateLightEstimatorANDROID", any(layer_create_light_estimator), Needs::kLight},
      {"xrDestroyLightEstimatorANDROID", any(layer_destroy_light_estimator), Needs::kLight},
      {"xrGetLightEstimateANDROID", any(layer_get_light_estimate), Needs::kLight},
      {"xrEnumerateCubemapLightingResolutionsANDROID", any(layer_enumerate_resolutions),
       Needs::kCube},
      {"xrEnumerateCubemapLightingColorFormatsANDROID", any(layer_enumerate_formats),
       Needs::kCube}};
  const auto* found = std::ranges::find(kFunctions, name, &NamedFunction::name);
  if (found == std::end(kFunctions)) return nullptr;
  const bool given = found->needs == Needs::kNothing ||
                     (found->needs == Needs::kLight ? instance.light : instance.cube);
  return given ? found->function : nullptr;
}

}  // namespace penumbra::openxr
