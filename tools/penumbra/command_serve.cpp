#include "service/serve.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

void add_serve(CLI::App& parent, Action& action) {
  static service::ServeOptions options;
  auto* c = parent.add_subcommand("serve", "The live service with its HTTP interface on loopback");
  c->add_option("--config", options.config, "rig.toml")->required();
  c->callback([&] { action = [] { return service::serve(options, progress_bar); }; });
}

}  // namespace penumbra::tools
