// What the layer keeps for an application: its instances, sessions and estimators.
// threads: LayerRegistry is thread-safe
#pragma once

#include <time.h>

#ifndef XR_USE_TIMESPEC
#define XR_USE_TIMESPEC
#endif
#include <openxr/openxr.h>
#include <openxr/openxr_platform.h>

#include <memory>
#include <mutex>
#include <unordered_map>
#include <utility>
#include <vector>

#include "service/openxr/light_estimator.h"

namespace penumbra::openxr {

/// The functions below the layer, of one instance.
struct FunctionsBelow {
  PFN_xrGetInstanceProcAddr get_instance_proc_addr = nullptr;
  PFN_xrDestroyInstance destroy_instance = nullptr;
  PFN_xrGetSystemProperties get_system_properties = nullptr;
  PFN_xrCreateSession create_session = nullptr;
  PFN_xrDestroySession destroy_session = nullptr;
  PFN_xrCreateReferenceSpace create_reference_space = nullptr;
  PFN_xrDestroySpace destroy_space = nullptr;
  PFN_xrLocateSpace locate_space = nullptr;
  PFN_xrConvertTimespecTimeToTimeKHR time_of_timespec = nullptr;  // null where it is not offered
};

struct LayerInstance {
  XrInstance handle = XR_NULL_HANDLE;
  FunctionsBelow below;
  bool light = false, cube = false;  // the application has enabled the extension
  LayerSettings settings;
  std::unique_ptr<RoomLight> room;  // null without the extension
};

struct LayerEstimator {
  std::shared_ptr<LayerInstance> instance;
  XrSession session = XR_NULL_HANDLE;
  XrSpace world = XR_NULL_HANDLE;  // Penumbra's world in the session
  std::unique_ptr<RoomLightEstimator> estimator;
};

class LayerRegistry {
 public:
  using InstancePtr = std::shared_ptr<LayerInstance>;
  using EstimatorPtr = std::shared_ptr<LayerEstimator>;
  static constexpr int kMaxEstimators = 16;  // of a session

  void add(InstancePtr instance) {
    const std::lock_guard lock(mutex_);
    const XrInstance handle = instance->handle;
    instances_[handle] = std::move(instance);
  }
  /// Null for a handle that is not known, as in what follows.
  InstancePtr find(XrInstance handle) {
    const std::lock_guard lock(mutex_);
    const auto found = instances_.find(handle);
    return found == instances_.end() ? nullptr : found->second;
  }
  /// With all that belongs to it.
  InstancePtr take(XrInstance handle) {
    const std::lock_guard lock(mutex_);
    const auto node = instances_.extract(handle);
    if (!node) return nullptr;
    std::erase_if(sessions_, [&](const auto& s) { return s.second == node.mapped(); });
    std::erase_if(estimators_, [&](const auto& e) { return e.second->instance == node.mapped(); });
    return node.mapped();
  }

  void add(XrSession session, InstancePtr instance) {
    const std::lock_guard lock(mutex_);
    sessions_[session] = std::move(instance);
  }
  InstancePtr find(XrSession session) {
    const std::lock_guard lock(mutex_);
    const auto found = sessions_.find(session);
    return found == sessions_.end() ? nullptr : found->second;
  }
  /// With its estimators.
  InstancePtr take(XrSession session) {
    const std::lock_guard lock(mutex_);
    const auto node = sessions_.extract(session);
    std::erase_if(estimators_, [&](const auto& e) { return e.second->session == session; });
    return node ? node.mapped() : nullptr;
  }

  /// XR_NULL_HANDLE when the session has too many.
  XrLightEstimatorANDROID add(EstimatorPtr estimator) {
    const std::lock_guard lock(mutex_);
    int count = 0;
    for (const auto& [handle, other] : estimators_) count += other->session == estimator->session;
    if (count >= kMaxEstimators) return XR_NULL_HANDLE;
    // Never used twice, so that a handle of a destroyed estimator stays wrong.
    const auto handle = reinterpret_cast<XrLightEstimatorANDROID>(++last_handle_);
    estimators_[handle] = std::move(estimator);
    return handle;
  }
  EstimatorPtr find(XrLightEstimatorANDROID handle) {
    const std::lock_guard lock(mutex_);
    const auto found = estimators_.find(handle);
    return found == estimators_.end() ? nullptr : found->second;
  }
  EstimatorPtr take(XrLightEstimatorANDROID handle) {
    const std::lock_guard lock(mutex_);
    const auto node = estimators_.extract(handle);
    return node ? node.mapped() : nullptr;
  }

 private:
  std::mutex mutex_;
  std::unordered_map<XrInstance, InstancePtr> instances_;
  std::unordered_map<XrSession, InstancePtr> sessions_;  // of instances with the extension
  std::unordered_map<XrLightEstimatorANDROID, EstimatorPtr> estimators_;
  std::uintptr_t last_handle_ = 0;
};

/// Of this library.
LayerRegistry& layer_registry();

}  // namespace penumbra::openxr
