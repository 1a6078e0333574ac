// The `penumbra-demo` program, also started by `penumbra demo`: a first picture is built without
// cameras, service and the other commands.
#include "tools/demo/demo.h"

int main(int argc, char** argv) {
  using namespace penumbra::tools;
  return run_program(
      argc, argv, "penumbra-demo",
      "Run the whole pipeline in a synthetic studio: writes a video, a still and a summary",
      add_demo);
}
