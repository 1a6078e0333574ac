#include "service/serve.h"
#include "tools/common/progress.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

// Flags of --quick that a rig.toml tells by itself.
Result<service::ServeOptions> with_quick(const CLI::App& command, bool quick,
                                         const service::ServeOptions& options,
                                         const service::QuickStart& start) {
  service::ServeOptions out = options;
  if (quick == !options.config.empty())
    return fail(ErrorCode::kInvalid, "serve", "needs either --config or --quick");
  if (quick) {
    out.quick = start;
    return out;
  }
  for (const char* flag :
       {"--source", "--board", "--lens", "--environment", "--asset", "--size", "--port"})
    if (command.count(flag) > 0)
      return fail(ErrorCode::kInvalid, flag, "belongs to --quick: rig.toml tells it");
  return out;
}

}  // namespace

void add_serve(CLI::App& parent, Action& action) {
  static service::ServeOptions options;
  static service::QuickStart start;
  static bool quick = false;
  auto* c = parent.add_subcommand(
      "serve", "Run the live service, with its HTTP interface on a socket of your own or a port");
  c->add_option("--config", options.config, "Rig to run, rig.toml");
  c->add_flag("--quick", quick,
              "Put an object on a printed board before a webcam, without a rig.toml");
  c->add_option("--source", start.source,
                "With --quick: a camera such as /dev/video0, or a recording that is played in a "
                "loop; by default the first camera");
  c->add_option("--board", start.board,
                "With --quick: the board that lies on the table, as calibrate board prints it")
      ->capture_default_str();
  c->add_option("--lens", start.lens,
                "With --quick: camera file of the webcam; by default a guess");
  c->add_option("--environment", start.environment,
                "With --quick: HDR map of the light; by default a built-in room");
  c->add_option("--asset", start.asset, "With --quick: the object")->capture_default_str();
  c->add_option("--size", start.size_m, "With --quick: the object's largest extent, in metres")
      ->capture_default_str();
  c->add_option("--port", start.port, "With --quick: port on 127.0.0.1; 0 takes any free one")
      ->check(CLI::Range(0, 65535))
      ->capture_default_str();
  c->callback([&, c] {
    action = [c]() -> Result<void> {
      PENUMBRA_ASSIGN(all, with_quick(*c, quick, options, start));
      return service::serve(all, progress_bar);
    };
  });
}

}  // namespace penumbra::tools
