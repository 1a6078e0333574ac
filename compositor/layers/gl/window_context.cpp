#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>

#include "compositor/layers/gl/gl.h"

namespace penumbra::compositor {

namespace {

class WindowContext final : public GlContext {
 public:
  explicit WindowContext(GLFWwindow* window) : window_(window) {
    glfwSetWindowUserPointer(window, this);
    glfwSetScrollCallback(window, [](GLFWwindow* w, double, double notches) {
      static_cast<WindowContext*>(glfwGetWindowUserPointer(w))->wheel_ += notches;
    });
    glfwSetKeyCallback(window, [](GLFWwindow* w, int key, int, int action, int) {
      if (action != GLFW_PRESS) return;
      auto* const self = static_cast<WindowContext*>(glfwGetWindowUserPointer(w));
      if (key >= GLFW_KEY_1 && key <= GLFW_KEY_9) self->number_ = key - GLFW_KEY_0;
      if (key == GLFW_KEY_SPACE) self->space_ = true;
    });
  }
  ~WindowContext() override {
    glfwDestroyWindow(window_);
    glfwTerminate();
  }
  bool has_window() const override { return true; }
  void make_current() override {
    if (glfwGetCurrentContext() != window_) glfwMakeContextCurrent(window_);
  }
  void release() override {
    if (glfwGetCurrentContext() == window_) glfwMakeContextCurrent(nullptr);
  }
  bool show() override {
    glfwSwapBuffers(window_);
    wheel_ = 0;
    number_ = 0;
    space_ = false;
    glfwPollEvents();
    return !glfwWindowShouldClose(window_) && glfwGetKey(window_, GLFW_KEY_ESCAPE) != GLFW_PRESS;
  }
  Pointer pointer() const override {
    Pointer out;
    int width = 0, height = 0;
    glfwGetWindowSize(window_, &width, &height);
    glfwGetCursorPos(window_, &out.place.x, &out.place.y);
    out.place /= glm::dvec2(std::max(width, 1), std::max(height, 1));
    out.left = glfwGetMouseButton(window_, GLFW_MOUSE_BUTTON_LEFT) == GLFW_PRESS;
    out.right = glfwGetMouseButton(window_, GLFW_MOUSE_BUTTON_RIGHT) == GLFW_PRESS;
    for (const int key : {GLFW_KEY_LEFT_SHIFT, GLFW_KEY_RIGHT_SHIFT})
      out.shift |= glfwGetKey(window_, key) == GLFW_PRESS;
    out.wheel = wheel_;
    out.number = number_;
    out.space = space_;
    return out;
  }
  std::pair<int, int> size() const override {
    std::pair<int, int> out;
    glfwGetFramebufferSize(window_, &out.first, &out.second);
    return out;
  }

 private:
  GLFWwindow* window_;
  double wheel_ = 0;  // notches since the last show()
  int number_ = 0;    // the last number key since then
  bool space_ = false;
};

}  // namespace

Result<std::unique_ptr<GlContext>> make_window_context(int width, int height,
                                                       const std::string& title) {
  if (!glfwInit()) return fail(ErrorCode::kUnavailable, "window", "has no display");
  glfwWindowHint(GLFW_CLIENT_API, GLFW_OPENGL_ES_API);
  glfwWindowHint(GLFW_CONTEXT_CREATION_API, GLFW_EGL_CONTEXT_API);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 1);
  GLFWwindow* window = glfwCreateWindow(width, height, title.c_str(), nullptr, nullptr);
  if (window == nullptr) {
    glfwTerminate();
    return fail(ErrorCode::kUnavailable, "window", "cannot be created with OpenGL ES 3.1");
  }
  auto out = std::make_unique<WindowContext>(window);
  out->make_current();
  glfwSwapInterval(0);  // the camera sets the pace, not the screen
  return out;
}

}  // namespace penumbra::compositor
