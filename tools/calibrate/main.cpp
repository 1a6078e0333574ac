// The `penumbra-calibrate` program, also started by `penumbra calibrate`.
#include "tools/calibrate/commands.h"

int main(int argc, char** argv) {
  using namespace penumbra::tools;
  keep_freed_memory();
  return run_program(argc, argv, "penumbra-calibrate", "Calibrate cameras and rigs",
                     [](CLI::App& app, Action& action) {
                       app.require_subcommand(1);
                       add_calibrate_response(app, action);
                       add_calibrate_board(app, action);
                       add_calibrate_camera(app, action);
                       add_calibrate_vignetting(app, action);
                       add_calibrate_ball(app, action);
                       add_calibrate_noise(app, action);
                       add_calibrate_rig(app, action);
                       add_calibrate_latency(app, action);
                       add_calibrate_colour(app, action);
                       add_calibrate_import(app, action);
                     });
}
