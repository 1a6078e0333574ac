// What is asked of a runtime alike for each kind of graphics, in structs of its own.
// threads: thread-bound, to the thread of the graphics
#pragma once

#include <fmt/format.h>

#include <vector>

#include "core/result.h"
#include "service/headset/internal/openxr_headers.h"

namespace penumbra::service {

/// Whether the current context is new enough.
/// errors: kUnavailable
template <class Needs, XrStructureType kType>
Result<void> check_version(XrInstance instance, XrSystemId system, const char* function,
                           const char* graphics) {
  PFN_xrVoidFunction any = nullptr;
  xrGetInstanceProcAddr(instance, function, &any);
  const auto ask = reinterpret_cast<XrResult(XRAPI_PTR*)(XrInstance, XrSystemId, Needs*)>(any);
  Needs needs{};
  needs.type = kType;
  if (!ask || XR_FAILED(ask(instance, system, &needs)))
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("the OpenXR runtime does not tell which {} it needs", graphics));
  GLint major = 0, minor = 0;
  glGetIntegerv(GL_MAJOR_VERSION, &major);
  glGetIntegerv(GL_MINOR_VERSION, &minor);
  const XrVersion least = needs.minApiVersionSupported;
  if (XR_MAKE_VERSION(major, minor, 0) < least)
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("the OpenXR runtime needs {} {}.{}, and there is {}.{}", graphics,
                            XR_VERSION_MAJOR(least), XR_VERSION_MINOR(least), major, minor));
  return {};
}

/// errors: kUnavailable
template <class Image, XrStructureType kType>
Result<std::vector<unsigned>> images_of(XrSwapchain swapchain) {
  constexpr std::uint32_t kMost = 16;
  std::uint32_t count = 0;
  Image empty{};
  empty.type = kType;
  std::vector<Image> images(kMost, empty);
  const XrResult given = xrEnumerateSwapchainImages(
      swapchain, kMost, &count, reinterpret_cast<XrSwapchainImageBaseHeader*>(images.data()));
  if (XR_FAILED(given) || count < 1 || count > kMost)
    return fail(ErrorCode::kUnavailable, "headset", "the OpenXR runtime gives no images");
  std::vector<unsigned> out;
  for (std::uint32_t i = 0; i < count; ++i) out.push_back(images[i].image);
  return out;
}

}  // namespace penumbra::service
