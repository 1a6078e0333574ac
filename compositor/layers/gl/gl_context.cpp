#include <EGL/egl.h>
// After egl.h, which it needs.
#include <EGL/eglext.h>
#include <fmt/format.h>

#include <cstring>
#include <vector>

#include "compositor/layers/gl/gl.h"

namespace penumbra::compositor {

namespace {

class OffscreenContext final : public GlContext {
 public:
  OffscreenContext(EGLDisplay display, EGLContext context) : display_(display), context_(context) {}
  ~OffscreenContext() override {
    eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display_, context_);
    // The display is shared by the whole process and stays.
  }
  bool has_window() const override { return false; }
  void make_current() override {
    if (eglGetCurrentContext() == context_) return;
    eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_);
  }
  void release() override {
    if (eglGetCurrentContext() == context_)
      eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  }
  bool show() override { return true; }
  std::pair<int, int> size() const override { return {0, 0}; }

 private:
  EGLDisplay display_;
  EGLContext context_;
};

bool has(const char* extensions, const char* name) {
  return extensions != nullptr && std::strstr(extensions, name) != nullptr;
}

// GPUs first, whoever drives them; then Mesa's surfaceless platform; then software devices.
std::vector<EGLDisplay> candidate_displays() {
  const char* client = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  const auto get_display = reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(
      eglGetProcAddress("eglGetPlatformDisplayEXT"));
  if (get_display == nullptr) return {eglGetDisplay(EGL_DEFAULT_DISPLAY)};
  std::vector<EGLDisplay> hardware, software;
  const auto query =
      reinterpret_cast<PFNEGLQUERYDEVICESEXTPROC>(eglGetProcAddress("eglQueryDevicesEXT"));
  const auto describe = reinterpret_cast<PFNEGLQUERYDEVICESTRINGEXTPROC>(
      eglGetProcAddress("eglQueryDeviceStringEXT"));
  EGLDeviceEXT devices[16];
  EGLint count = 0;
  if (has(client, "EGL_EXT_platform_device") && query && describe && query(16, devices, &count))
    for (EGLint i = 0; i < count; ++i) {
      const bool soft = has(describe(devices[i], EGL_EXTENSIONS), "EGL_MESA_device_software");
      (soft ? software : hardware)
          .push_back(get_display(EGL_PLATFORM_DEVICE_EXT, devices[i], nullptr));
    }
  if (has(client, "EGL_MESA_platform_surfaceless"))
    hardware.push_back(get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr));
  hardware.insert(hardware.end(), software.begin(), software.end());
  return hardware;
}

// An OpenGL ES 3.1 context without a surface.
// errors: kUnavailable
Result<std::unique_ptr<GlContext>> make_context(EGLDisplay display) {
  EGLint major = 0, minor = 0;
  if (display == EGL_NO_DISPLAY || !eglInitialize(display, &major, &minor))
    return fail(ErrorCode::kUnavailable, "EGL",
                "has no display, neither surfaceless nor of a device");
  if (!has(eglQueryString(display, EGL_EXTENSIONS), "EGL_KHR_surfaceless_context"))
    return fail(ErrorCode::kUnavailable, "EGL", "has no surfaceless contexts");
  eglBindAPI(EGL_OPENGL_ES_API);
  const EGLint config_attributes[] = {EGL_SURFACE_TYPE, 0, EGL_RENDERABLE_TYPE, EGL_OPENGL_ES3_BIT,
                                      EGL_NONE};
  EGLConfig config = nullptr;
  EGLint count = 0;
  if (!eglChooseConfig(display, config_attributes, &config, 1, &count) || count < 1)
    return fail(ErrorCode::kUnavailable, "EGL", "has no OpenGL ES 3 configuration");
  const EGLint context_attributes[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 1,
                                       EGL_NONE};
  const EGLContext context = eglCreateContext(display, config, EGL_NO_CONTEXT, context_attributes);
  if (context == EGL_NO_CONTEXT)
    return fail(ErrorCode::kUnavailable, "EGL", "cannot create an OpenGL ES 3.1 context");
  auto out = std::make_unique<OffscreenContext>(display, context);
  out->make_current();
  return out;
}

}  // namespace

Result<std::unique_ptr<GlContext>> make_offscreen_context() {
  Result<std::unique_ptr<GlContext>> last = fail(
      ErrorCode::kUnavailable, "EGL",
      "has no display: a driver of OpenGL ES 3.1 is missing, of Debian's libgl1-mesa-dri for one");
  for (const EGLDisplay display : candidate_displays()) {
    last = make_context(display);
    if (last) return last;
  }
  return last;
}

namespace {

// Attaches one shader; the log on failure.
Result<void> attach(GLuint program, GLenum kind, const char* source) {
  const GLuint shader = glCreateShader(kind);
  glShaderSource(shader, 1, &source, nullptr);
  glCompileShader(shader);
  GLint ok = 0;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &ok);
  char log[1024] = {};
  if (!ok) glGetShaderInfoLog(shader, sizeof log, nullptr, log);
  glAttachShader(program, shader);
  glDeleteShader(shader);
  if (!ok) return fail(ErrorCode::kUnavailable, "GL shader", log);
  return {};
}

}  // namespace

namespace {

Result<GlProgram> linked(GlProgram program) {
  glLinkProgram(program.get());
  GLint ok = 0;
  glGetProgramiv(program.get(), GL_LINK_STATUS, &ok);
  if (ok) return program;
  char log[1024] = {};
  glGetProgramInfoLog(program.get(), sizeof log, nullptr, log);
  return fail(ErrorCode::kUnavailable, "GL program", log);
}

}  // namespace

Result<GlProgram> make_program(const char* vertex, const char* fragment) {
  GlProgram program;
  PENUMBRA_TRY(attach(program.get(), GL_VERTEX_SHADER, vertex));
  PENUMBRA_TRY(attach(program.get(), GL_FRAGMENT_SHADER, fragment));
  return linked(std::move(program));
}

}  // namespace penumbra::compositor
