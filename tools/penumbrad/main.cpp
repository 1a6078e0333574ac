// The `penumbrad` program: the live service alone.
#include "service/serve.h"
#include "tools/common/command.h"

int main(int argc, char** argv) {
  using namespace penumbra;
  return tools::run_program(
      argc, argv, "penumbrad", "The mixed reality service: light and composited frames of a rig",
      [](CLI::App& app, tools::Action& action) {
        static service::ServeOptions options;
        app.add_option("--config", options.config, "Rig to run, rig.toml")->required();
        const auto silent = [](const std::string&) { return std::function<void(double)>(); };
        action = [silent] { return service::serve(options, silent); };
      });
}
