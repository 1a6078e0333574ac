// The OpenXR functions that the layer answers itself or sees pass.
// threads: thread-safe, as far as OpenXR asks
#pragma once

#include <exception>
#include <new>
#include <string_view>

#include "service/openxr/layer_registry.h"

namespace penumbra::openxr {

/// Null where the layer leaves the function to those below.
PFN_xrVoidFunction function_of_layer(const LayerInstance& instance, std::string_view name);

/// No exception may go through a C interface.
template <class Call>
XrResult without_exceptions(Call call) {
  try {
    return call();
  } catch (const std::bad_alloc&) {
    return XR_ERROR_OUT_OF_MEMORY;
  } catch (const std::exception&) {
    return XR_ERROR_RUNTIME_FAILURE;
  }
}

}  // namespace penumbra::openxr
