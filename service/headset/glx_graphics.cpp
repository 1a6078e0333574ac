// For runtimes that take pictures from GLX and not from EGL. X11's macros stay in this file.
#include <X11/Xlib.h>
// After Xlib.h, which it needs.
#include <GL/glx.h>

#define XR_USE_PLATFORM_XLIB
#define XR_USE_GRAPHICS_API_OPENGL
#include "service/headset/internal/headset_graphics.h"
// After the headers of OpenXR.
#include "service/headset/internal/graphics_calls.h"

namespace penumbra::service {

namespace {

int pass_over(Display*, XErrorEvent*) {
  return 0;
}

// What a server refuses would end the program.
class ErrorsPassedOver {
 public:
  ErrorsPassedOver() : before_(XSetErrorHandler(pass_over)) {}
  ~ErrorsPassedOver() { XSetErrorHandler(before_); }
  ErrorsPassedOver(const ErrorsPassedOver&) = delete;
  ErrorsPassedOver& operator=(const ErrorsPassedOver&) = delete;

 private:
  XErrorHandler before_;
};

class GlxGraphics : public HeadsetGraphics {
 public:
  ~GlxGraphics() override;
  Result<void> make();
  std::vector<const char*> extensions() const override { return glx_extensions(); }
  bool is_lost() const override { return lost_; }
  Result<void> check_requirements(XrInstance instance, XrSystemId system) override {
    return check_version<XrGraphicsRequirementsOpenGLKHR, XR_TYPE_GRAPHICS_REQUIREMENTS_OPENGL_KHR>(
        instance, system, "xrGetOpenGLGraphicsRequirementsKHR", "OpenGL");
  }
  const void* binding() const override { return &binding_; }
  Result<std::vector<unsigned>> images(XrSwapchain swapchain) const override {
    return images_of<XrSwapchainImageOpenGLKHR, XR_TYPE_SWAPCHAIN_IMAGE_OPENGL_KHR>(swapchain);
  }

 private:
  Result<void> choose_config();
  Result<void> make_context();

  Display* display_ = nullptr;
  bool lost_ = false;  // the server has gone
  GLXFBConfig config_ = nullptr;
  GLXPbuffer drawable_ = 0;  // nobody sees it
  GLXContext context_ = nullptr;
  XrGraphicsBindingOpenGLXlibKHR binding_{};
};

GlxGraphics::~GlxGraphics() {
  if (!display_) return;
  const ErrorsPassedOver passed_over;
  glXMakeContextCurrent(display_, 0, 0, nullptr);
  if (context_) glXDestroyContext(display_, context_);
  if (drawable_) glXDestroyPbuffer(display_, drawable_);
  XCloseDisplay(display_);
}

Result<void> GlxGraphics::make() {
  XInitThreads();  // a runtime may ask the same server from threads of its own
  display_ = XOpenDisplay(nullptr);
  if (!display_)
    return fail(ErrorCode::kUnavailable, "headset",
                "the OpenXR runtime takes pictures from GLX, which needs an X display: is DISPLAY "
                "set?");
  // A server that goes would end the program: by the first handler, and after it.
  XSetIOErrorHandler([](Display*) { return 0; });
  XSetIOErrorExitHandler(
      display_, [](Display*, void* lost) { *static_cast<bool*>(lost) = true; }, &lost_);
  const ErrorsPassedOver passed_over;
  PENUMBRA_TRY(choose_config());
  PENUMBRA_TRY(make_context());
  XVisualInfo* const visual = glXGetVisualFromFBConfig(display_, config_);
  binding_.type = XR_TYPE_GRAPHICS_BINDING_OPENGL_XLIB_KHR;
  binding_.xDisplay = display_;
  binding_.visualid = visual ? static_cast<std::uint32_t>(visual->visualid) : 0;
  binding_.glxFBConfig = config_;
  binding_.glxDrawable = drawable_;
  binding_.glxContext = context_;
  if (visual) XFree(visual);
  return {};
}

Result<void> GlxGraphics::choose_config() {
  const int wanted[] = {GLX_DRAWABLE_TYPE,
                        GLX_PBUFFER_BIT | GLX_WINDOW_BIT,
                        GLX_RENDER_TYPE,
                        GLX_RGBA_BIT,
                        GLX_X_RENDERABLE,
                        1,
                        0};
  int count = 0;
  GLXFBConfig* const configs = glXChooseFBConfig(display_, DefaultScreen(display_), wanted, &count);
  if (configs && count > 0) config_ = configs[0];
  if (configs) XFree(configs);
  if (!config_)
    return fail(ErrorCode::kUnavailable, "headset", "the X display has no OpenGL to draw with");
  return {};
}

// Shaders of OpenGL ES 3.1 are part of OpenGL 4.5.
Result<void> GlxGraphics::make_context() {
  const auto create = reinterpret_cast<PFNGLXCREATECONTEXTATTRIBSARBPROC>(
      glXGetProcAddressARB(reinterpret_cast<const GLubyte*>("glXCreateContextAttribsARB")));
  const int version[] = {GLX_CONTEXT_MAJOR_VERSION_ARB,
                         4,
                         GLX_CONTEXT_MINOR_VERSION_ARB,
                         5,
                         GLX_CONTEXT_PROFILE_MASK_ARB,
                         GLX_CONTEXT_CORE_PROFILE_BIT_ARB,
                         0};
  if (create) context_ = create(display_, config_, nullptr, 1, version);
  const int size[] = {GLX_PBUFFER_WIDTH, 1, GLX_PBUFFER_HEIGHT, 1, 0};
  drawable_ = glXCreatePbuffer(display_, config_, size);
  if (!context_ || !drawable_ || !glXMakeContextCurrent(display_, drawable_, drawable_, context_))
    return fail(ErrorCode::kUnavailable, "headset", "the X display has no OpenGL 4.5");
  // OpenGL ES turns what is drawn into textures of sRGB always, OpenGL where it is asked to.
  glEnable(GL_FRAMEBUFFER_SRGB);
  return {};
}

}  // namespace

std::vector<const char*> glx_extensions() {
  return {XR_KHR_OPENGL_ENABLE_EXTENSION_NAME};
}

Result<std::unique_ptr<HeadsetGraphics>> make_glx_graphics() {
  auto out = std::make_unique<GlxGraphics>();
  PENUMBRA_TRY(out->make());
  return out;
}

}  // namespace penumbra::service
