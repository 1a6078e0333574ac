#include <fmt/format.h>

#include <algorithm>

#include "compositor/layers/gl/gl.h"
#include "service/headset/internal/headset_graphics.h"
#include "service/headset/internal/openxr_headers.h"

namespace penumbra::service {

namespace {

class EglGraphics : public HeadsetGraphics {
 public:
  Result<void> make();
  std::vector<const char*> extensions() const override {
    return {XR_MNDX_EGL_ENABLE_EXTENSION_NAME, XR_KHR_OPENGL_ES_ENABLE_EXTENSION_NAME};
  }
  Result<void> check_requirements(XrInstance instance, XrSystemId system) override;
  const void* binding() const override { return &binding_; }
  Result<std::vector<unsigned>> images(XrSwapchain swapchain) const override;

 private:
  std::unique_ptr<compositor::GlContext> context_;
  XrGraphicsBindingEGLMNDX binding_{};
};

Result<void> EglGraphics::make() {
  PENUMBRA_ASSIGN(context, compositor::make_offscreen_context());
  context_ = std::move(context);
  binding_.type = XR_TYPE_GRAPHICS_BINDING_EGL_MNDX;
  binding_.getProcAddress = eglGetProcAddress;
  binding_.display = eglGetCurrentDisplay();
  binding_.context = eglGetCurrentContext();
  EGLint id = 0, count = 0;
  eglQueryContext(binding_.display, binding_.context, EGL_CONFIG_ID, &id);
  const EGLint wanted[] = {EGL_CONFIG_ID, id, EGL_NONE};
  if (!eglChooseConfig(binding_.display, wanted, &binding_.config, 1, &count) || count != 1)
    return fail(ErrorCode::kUnavailable, "EGL", "does not tell the configuration of its context");
  return {};
}

Result<void> EglGraphics::check_requirements(XrInstance instance, XrSystemId system) {
  PFN_xrVoidFunction any = nullptr;
  xrGetInstanceProcAddr(instance, "xrGetOpenGLESGraphicsRequirementsKHR", &any);
  const auto ask = reinterpret_cast<PFN_xrGetOpenGLESGraphicsRequirementsKHR>(any);
  XrGraphicsRequirementsOpenGLESKHR needs{};
  needs.type = XR_TYPE_GRAPHICS_REQUIREMENTS_OPENGL_ES_KHR;
  if (!ask || XR_FAILED(ask(instance, system, &needs)))
    return fail(ErrorCode::kUnavailable, "headset",
                "the OpenXR runtime does not tell which OpenGL ES it needs");
  GLint major = 0, minor = 0;
  glGetIntegerv(GL_MAJOR_VERSION, &major);
  glGetIntegerv(GL_MINOR_VERSION, &minor);
  const XrVersion least = needs.minApiVersionSupported;
  if (XR_MAKE_VERSION(major, minor, 0) < least)
    return fail(ErrorCode::kUnavailable, "headset",
                fmt::format("the OpenXR runtime needs OpenGL ES {}.{}, and there is {}.{}",
                            XR_VERSION_MAJOR(least), XR_VERSION_MINOR(least), major, minor));
  return {};
}

Result<std::vector<unsigned>> EglGraphics::images(XrSwapchain swapchain) const {
  constexpr std::uint32_t kMost = 16;
  std::uint32_t count = 0;
  XrSwapchainImageOpenGLESKHR empty{};
  empty.type = XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_ES_KHR;
  std::vector<XrSwapchainImageOpenGLESKHR> images(kMost, empty);
  const XrResult given = xrEnumerateSwapchainImages(
      swapchain, kMost, &count, reinterpret_cast<XrSwapchainImageBaseHeader*>(images.data()));
  if (XR_FAILED(given) || count < 1 || count > kMost)
    return fail(ErrorCode::kUnavailable, "headset", "the OpenXR runtime gives no images");
  std::vector<unsigned> out;
  for (std::uint32_t i = 0; i < count; ++i) out.push_back(images[i].image);
  return out;
}

}  // namespace

Result<std::unique_ptr<HeadsetGraphics>> make_egl_graphics() {
  auto out = std::make_unique<EglGraphics>();
  PENUMBRA_TRY(out->make());
  return out;
}

}  // namespace penumbra::service
