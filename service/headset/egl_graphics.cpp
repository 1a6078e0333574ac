#include "compositor/layers/gl/gl.h"
#include "service/headset/internal/graphics_calls.h"
#include "service/headset/internal/headset_graphics.h"

namespace penumbra::service {

namespace {

class EglGraphics : public HeadsetGraphics {
 public:
  Result<void> make();
  std::vector<const char*> extensions() const override { return egl_extensions(); }
  Result<void> check_requirements(XrInstance instance, XrSystemId system) override {
    return check_version<XrGraphicsRequirementsOpenGLESKHR,
                         XR_TYPE_GRAPHICS_REQUIREMENTS_OPENGL_ES_KHR>(
        instance, system, "xrGetOpenGLESGraphicsRequirementsKHR", "OpenGL ES");
  }
  const void* binding() const override { return &binding_; }
  Result<std::vector<unsigned>> images(XrSwapchain swapchain) const override {
    return images_of<XrSwapchainImageOpenGLESKHR, XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_ES_KHR>(swapchain);
  }

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

}  // namespace

std::vector<const char*> egl_extensions() {
  return {XR_MNDX_EGL_ENABLE_EXTENSION_NAME, XR_KHR_OPENGL_ES_ENABLE_EXTENSION_NAME};
}

Result<std::unique_ptr<HeadsetGraphics>> make_egl_graphics() {
  auto out = std::make_unique<EglGraphics>();
  PENUMBRA_TRY(out->make());
  return out;
}

}  // namespace penumbra::service
