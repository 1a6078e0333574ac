// Preloaded, it takes the GL context away once a file is there, as a GPU's driver does that has to
// begin anew. Software renderers lose none.
#include <GLES3/gl31.h>
#include <dlfcn.h>
#include <unistd.h>

#include <cstdlib>

extern "C" __attribute__((visibility("default"))) GLenum glGetError() {
  constexpr GLenum kContextLost = 0x0507;
  static const auto real = reinterpret_cast<GLenum (*)()>(::dlsym(RTLD_NEXT, "glGetError"));
  static const char* const when = std::getenv("PENUMBRA_LOST_GL_WHEN");
  if (when && ::access(when, F_OK) == 0) return kContextLost;
  return real();
}
