// Owners of GL names and the context they live in.
#pragma once

#include <EGL/egl.h>
#include <GLES3/gl31.h>

#include <algorithm>
#include <bit>
#include <memory>
#include <string>
#include <utility>

#include "compositor/view.h"
#include "core/result.h"

namespace penumbra::compositor {

/// Levels of a texture with all halvings, down to one texel.
inline GLint mip_levels(int width, int height) {
  return static_cast<GLint>(std::bit_width(static_cast<unsigned>(std::max(width, height))));
}
/// Of the bound texture of two dimensions: linear, with the values of its rim beside it.
inline void read_to_the_rim(GLint smaller = GL_LINEAR) {
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, smaller);
  for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T})
    glTexParameteri(GL_TEXTURE_2D, wrap, GL_CLAMP_TO_EDGE);
}

/// One GL name, deleted with its owner on the thread of the context.
template <void (*Make)(GLuint&), void (*Delete)(GLuint)>
class GlName {
 public:
  GlName() { Make(name_); }
  ~GlName() {
    if (name_) Delete(name_);
  }
  GlName(GlName&& other) noexcept : name_(std::exchange(other.name_, 0)) {}
  GlName& operator=(GlName&& other) noexcept {
    std::swap(name_, other.name_);
    return *this;
  }
  GLuint get() const { return name_; }

 private:
  GLuint name_ = 0;
};

namespace gl {
inline void make_buffer(GLuint& n) {
  glGenBuffers(1, &n);
}
inline void delete_buffer(GLuint n) {
  glDeleteBuffers(1, &n);
}
inline void make_texture(GLuint& n) {
  glGenTextures(1, &n);
}
inline void delete_texture(GLuint n) {
  glDeleteTextures(1, &n);
}
inline void make_vertex_array(GLuint& n) {
  glGenVertexArrays(1, &n);
}
inline void delete_vertex_array(GLuint n) {
  glDeleteVertexArrays(1, &n);
}
inline void make_framebuffer(GLuint& n) {
  glGenFramebuffers(1, &n);
}
inline void delete_framebuffer(GLuint n) {
  glDeleteFramebuffers(1, &n);
}
inline void make_renderbuffer(GLuint& n) {
  glGenRenderbuffers(1, &n);
}
inline void delete_renderbuffer(GLuint n) {
  glDeleteRenderbuffers(1, &n);
}
inline void make_sampler(GLuint& n) {
  glGenSamplers(1, &n);
}
inline void delete_sampler(GLuint n) {
  glDeleteSamplers(1, &n);
}
inline void make_program(GLuint& n) {
  n = glCreateProgram();
}
inline void delete_program(GLuint n) {
  glDeleteProgram(n);
}
}  // namespace gl

using GlBuffer = GlName<gl::make_buffer, gl::delete_buffer>;
using GlTexture = GlName<gl::make_texture, gl::delete_texture>;
using GlVertexArray = GlName<gl::make_vertex_array, gl::delete_vertex_array>;
using GlFramebuffer = GlName<gl::make_framebuffer, gl::delete_framebuffer>;
using GlRenderbuffer = GlName<gl::make_renderbuffer, gl::delete_renderbuffer>;
using GlSampler = GlName<gl::make_sampler, gl::delete_sampler>;
using GlProgram = GlName<gl::make_program, gl::delete_program>;

/// Compiles and links.
/// errors: kUnavailable with GL's log
Result<GlProgram> make_program(const char* vertex, const char* fragment);

/// A current OpenGL ES 3.1 context: surfaceless EGL, or a GLFW window.
class GlContext {
 public:
  virtual ~GlContext() = default;
  virtual bool has_window() const = 0;
  /// On the calling thread; cheap when it is already.
  virtual void make_current() = 0;
  /// From then on another thread may make it current.
  virtual void release() = 0;
  /// Swaps and polls; false when the window was closed.
  virtual bool show() = 0;
  /// Size of the window's framebuffer in pixels.
  virtual std::pair<int, int> size() const = 0;
  /// As of the last show().
  virtual Pointer pointer() const { return {}; }
};

Result<std::unique_ptr<GlContext>> make_offscreen_context();
Result<std::unique_ptr<GlContext>> make_window_context(int width, int height,
                                                       const std::string& title);

}  // namespace penumbra::compositor
