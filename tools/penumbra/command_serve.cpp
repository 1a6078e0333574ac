#include "service/serve.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

void add_serve(CLI::App& parent, Action& action) {
  static service::ServeOptions options;
  auto* c = parent.add_subcommand(
      "serve", "Run the live service, with its HTTP interface on a loopback address");
  c->add_option("--config", options.config, "Rig to run, rig.toml")->required();
  c->callback([&] { action = [] { return service::serve(options, progress_bar); }; });
}

}  // namespace penumbra::tools
