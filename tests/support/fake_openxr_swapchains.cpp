// The fake OpenXR runtime's pictures: swapchains of real textures, and what frames show of them.
// threads: thread-safe; calls on textures come from the thread of the session's context
#include "tests/support/fake_openxr_internal.h"

namespace fake_xr {

std::map<XrSwapchain, Swapchain> swapchains;
std::deque<FakeOpenXrFrame> frames;

namespace {

constexpr std::array<std::int64_t, 3> kFormats = {GL_RGBA16F, GL_SRGB8_ALPHA8, GL_RGBA8};

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_formats(XrSession of, std::uint32_t capacity,
                                                      std::uint32_t* count, std::int64_t* out) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  return give(kFormats, kFormats.size(), capacity, count, out);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_swapchain(XrSession of,
                                                     const XrSwapchainCreateInfo* info,
                                                     XrSwapchain* out) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_SWAPCHAIN_CREATE_INFO)) return fault("xrCreateSwapchain: type");
  if (std::ranges::find(kFormats, info->format) == kFormats.end())
    return fault("xrCreateSwapchain: format", XR_ERROR_SWAPCHAIN_FORMAT_UNSUPPORTED);
  if (info->width < 1 || info->width > 4096 || info->height < 1 || info->height > 4096 ||
      info->sampleCount != 1 || info->faceCount != 1 || info->arraySize != 1 || info->mipCount != 1)
    return fault("xrCreateSwapchain: size");
  Swapchain made;
  made.info = *info;
  made.images = {1, 2, 3};
  if (session.has_graphics) {
    if (!has_context())
      return fault("xrCreateSwapchain: no current context", XR_ERROR_RUNTIME_FAILURE);
    glGenTextures(static_cast<GLsizei>(made.images.size()), made.images.data());
    for (const GLuint image : made.images) {
      glBindTexture(GL_TEXTURE_2D, image);
      glTexStorage2D(GL_TEXTURE_2D, 1, static_cast<GLenum>(info->format),
                     static_cast<GLsizei>(info->width), static_cast<GLsizei>(info->height));
    }
    glBindTexture(GL_TEXTURE_2D, 0);
  }
  *out = new_handle<XrSwapchain>();
  swapchains[*out] = made;
  state.swapchains = static_cast<int>(swapchains.size());
  return XR_SUCCESS;
}

void delete_textures(const Swapchain& one) {
  if (session.has_graphics && has_context())
    glDeleteTextures(static_cast<GLsizei>(one.images.size()), one.images.data());
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_swapchain(XrSwapchain swapchain) {
  const std::lock_guard lock(mutex);
  const auto found = swapchains.find(swapchain);
  if (found == swapchains.end())
    return fault("xrDestroySwapchain: handle", XR_ERROR_HANDLE_INVALID);
  delete_textures(found->second);
  swapchains.erase(found);
  state.swapchains = static_cast<int>(swapchains.size());
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_images(XrSwapchain swapchain, std::uint32_t capacity,
                                                     std::uint32_t* count,
                                                     XrSwapchainImageBaseHeader* out) {
  const std::lock_guard lock(mutex);
  const auto found = swapchains.find(swapchain);
  if (found == swapchains.end())
    return fault("xrEnumerateSwapchainImages: handle", XR_ERROR_HANDLE_INVALID);
  const auto& images = found->second.images;
  *count = static_cast<std::uint32_t>(images.size());
  if (capacity == 0) return XR_SUCCESS;
  if (capacity < images.size()) return XR_ERROR_SIZE_INSUFFICIENT;
  // Laid out alike for both kinds.
  auto* const to = reinterpret_cast<XrSwapchainImageOpenGLESKHR*>(out);
  const XrStructureType wanted =
      session.has_glx ? XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_KHR : XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_ES_KHR;
  for (std::size_t i = 0; i < images.size(); ++i) {
    if (to[i].type != wanted) return fault("xrEnumerateSwapchainImages: type");
    to[i].image = images[i];
  }
  return XR_SUCCESS;
}

// The swapchain, or null with the error in `result`.
Swapchain* living_swapchain(XrSwapchain handle, XrResult& result) {
  const auto found = swapchains.find(handle);
  result = session.lost ? XR_ERROR_INSTANCE_LOST
           : found == swapchains.end()
               ? fault("a swapchain that does not live", XR_ERROR_HANDLE_INVALID)
               : XR_SUCCESS;
  return XR_SUCCEEDED(result) ? &found->second : nullptr;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_acquire_image(XrSwapchain handle,
                                                  const XrSwapchainImageAcquireInfo*,
                                                  std::uint32_t* out) {
  const std::lock_guard lock(mutex);
  XrResult result;
  Swapchain* const one = living_swapchain(handle, result);
  if (!one) return result;
  if (one->acquired >= 0)
    return fault("xrAcquireSwapchainImage: order", XR_ERROR_CALL_ORDER_INVALID);
  *out = one->next;
  one->next = (one->next + 1) % static_cast<std::uint32_t>(one->images.size());
  one->acquired = static_cast<int>(*out);
  one->waited = false;
  ++state.images_acquired;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_wait_image(XrSwapchain handle,
                                               const XrSwapchainImageWaitInfo* info) {
  const std::lock_guard lock(mutex);
  XrResult result;
  Swapchain* const one = living_swapchain(handle, result);
  if (!one) return result;
  if (!has_type(info, XR_TYPE_SWAPCHAIN_IMAGE_WAIT_INFO))
    return fault("xrWaitSwapchainImage: type");
  if (one->acquired < 0 || one->waited)
    return fault("xrWaitSwapchainImage: order", XR_ERROR_CALL_ORDER_INVALID);
  one->waited = true;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_release_image(XrSwapchain handle,
                                                  const XrSwapchainImageReleaseInfo*) {
  const std::lock_guard lock(mutex);
  XrResult result;
  Swapchain* const one = living_swapchain(handle, result);
  if (!one) return result;
  if (one->acquired < 0 || !one->waited)
    return fault("xrReleaseSwapchainImage: order", XR_ERROR_CALL_ORDER_INVALID);
  one->released = std::exchange(one->acquired, -1);
  one->fresh = true;
  ++state.images_released;
  return XR_SUCCESS;
}

// ---- What a frame shows. ----

std::vector<std::uint8_t> pixels_of(const Swapchain& one) {
  const auto width = static_cast<GLsizei>(one.info.width),
             height = static_cast<GLsizei>(one.info.height);
  std::vector<std::uint8_t> out(std::size_t{4} * one.info.width * one.info.height);
  GLuint framebuffer = 0;
  glGenFramebuffers(1, &framebuffer);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D,
                         one.images[static_cast<std::size_t>(one.released)], 0);
  glReadPixels(0, 0, width, height, GL_RGBA, GL_UNSIGNED_BYTE, out.data());
  glDeleteFramebuffers(1, &framebuffer);
  return out;
}

XrResult keep_view(const XrCompositionLayerProjectionView& view, FakeOpenXrFrame& frame) {
  if (!has_type(&view, XR_TYPE_COMPOSITION_LAYER_PROJECTION_VIEW))
    return fault("xrEndFrame: a view's type");
  if (!is_pose(view.pose)) return fault("xrEndFrame: a view's pose", XR_ERROR_POSE_INVALID);
  const XrFovf& f = view.fov;
  if (!(f.angleLeft < f.angleRight && f.angleDown < f.angleUp && f.angleRight < 1.57f &&
        f.angleLeft > -1.57f && f.angleUp < 1.57f && f.angleDown > -1.57f))
    return fault("xrEndFrame: a view's angles");
  const auto found = swapchains.find(view.subImage.swapchain);
  if (found == swapchains.end())
    return fault("xrEndFrame: a view's swapchain", XR_ERROR_HANDLE_INVALID);
  Swapchain& one = found->second;
  if (one.released < 0) return fault("xrEndFrame: no released image", XR_ERROR_LAYER_INVALID);
  const XrRect2Di& r = view.subImage.imageRect;
  if (r.offset.x < 0 || r.offset.y < 0 || r.extent.width < 1 || r.extent.height < 1 ||
      static_cast<std::uint32_t>(r.offset.x + r.extent.width) > one.info.width ||
      static_cast<std::uint32_t>(r.offset.y + r.extent.height) > one.info.height ||
      view.subImage.imageArrayIndex != 0)
    return fault("xrEndFrame: a view's rectangle", XR_ERROR_SWAPCHAIN_RECT_INVALID);
  const XrQuaternionf& q = view.pose.orientation;
  const XrVector3f& p = view.pose.position;
  FakeOpenXrView out{
      {q.x, q.y, q.z, q.w}, {p.x, p.y, p.z}, {f.angleLeft, f.angleRight, f.angleUp, f.angleDown},
      r.extent.width,       r.extent.height, {}};
  if (knobs.keep && session.has_graphics && std::exchange(one.fresh, false))
    out.rgba = pixels_of(one);
  frame.views.push_back(std::move(out));
  return XR_SUCCESS;
}

}  // namespace

XrResult keep_layers(const XrFrameEndInfo& info) {
  for (const auto& [handle, one] : swapchains)
    if (one.acquired >= 0) return fault("xrEndFrame: an image is not released");
  for (std::uint32_t i = 0; i < info.layerCount; ++i) {
    const auto* base = info.layers[i];
    if (!has_type(base, XR_TYPE_COMPOSITION_LAYER_PROJECTION))
      return fault("xrEndFrame: a layer's type", XR_ERROR_LAYER_INVALID);
    const auto& layer = *reinterpret_cast<const XrCompositionLayerProjection*>(base);
    if (!spaces.contains(layer.space))
      return fault("xrEndFrame: a layer's space", XR_ERROR_HANDLE_INVALID);
    if (layer.viewCount != knobs.views) return fault("xrEndFrame: count of views");
    FakeOpenXrFrame frame;
    frame.display_ns = info.displayTime - FakeOpenXrState::kTimeAhead_ns;
    for (std::uint32_t v = 0; v < layer.viewCount; ++v)
      if (const XrResult kept = keep_view(layer.views[v], frame); XR_FAILED(kept)) return kept;
    constexpr std::size_t kMost = 256;
    if (frames.size() == kMost) frames.pop_front();
    frames.push_back(std::move(frame));
  }
  return XR_SUCCESS;
}

void end_session() {
  for (const auto& [handle, one] : swapchains) delete_textures(one);
  spaces.clear();  // children go with their parent
  swapchains.clear();
  session = Session{};
  state.sessions = state.spaces = state.swapchains = 0;
}

Functions swapchain_functions() {
  return {{"xrEnumerateSwapchainFormats", any(fake_enumerate_formats)},
          {"xrCreateSwapchain", any(fake_create_swapchain)},
          {"xrDestroySwapchain", any(fake_destroy_swapchain)},
          {"xrEnumerateSwapchainImages", any(fake_enumerate_images)},
          {"xrAcquireSwapchainImage", any(fake_acquire_image)},
          {"xrWaitSwapchainImage", any(fake_wait_image)},
          {"xrReleaseSwapchainImage", any(fake_release_image)}};
}

}  // namespace fake_xr
