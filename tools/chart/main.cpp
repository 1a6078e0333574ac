// The `penumbra-chart` program: evaluation, also started by `penumbra chart` and `penumbra
// compare`.
#include "tools/chart/commands.h"

int main(int argc, char** argv) {
  using namespace penumbra::tools;
  keep_freed_memory();
  return run_program(argc, argv, "penumbra-chart", "Error against time, and between pictures",
                     [](CLI::App& app, Action& action) {
                       app.require_subcommand(1);
                       add_chart(app, action);
                       add_compare(app, action);
                     });
}
